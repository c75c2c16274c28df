"""Look at a folder, print the commands that fit it, and run them if asked.

cellwise start: say what lies in a folder and which commands fit it
    requires a folder with logs, native files among them
    $ start measurements
    $ start flights --run --nominal-ah 5.2
    FOLDER  logs of a cell, a pack or a flight
    --run  run the commands and end on a page
    --nominal-ah X  rated capacity [the largest whole discharge]
    --prior MODEL  model to start from [by the logs]
    --sign auto|charge-positive|discharge-positive=auto  sign of the current
    -o, --output DIR=started  where models and pages go, one folder for each cell
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cli.command_line import INTERRUPTED, main
from cellwise.cli.common import printing
from cellwise.errors import InputError
from cellwise.files import made_folder
from cellwise.identify.measured_capacity import LIMITS as SIZES
from cellwise.report.page.markup import MOST
from cellwise.workflows.found_files import TESTS, FoundFile, look_at

UNKNOWN = "X"  # stands for what has to be stated
DRIVES = ("drive", "flight", "pack")
MISSING = {
    "hppc": "a pulse test (HPPC: 10 s pulses after rests, every 5 to 10 % of SOC): without it "
    "resistances and time constants come from drives and a prior",
    "ocv": "a low-rate test (C/20 discharge and charge): without it the OCV comes from rests, or a "
    "prior",
    "drive": "a drive or flight that takes no part in the fit: without it nothing judges the model",
}


# Which files go together, and how many of a kind are used.
OTHER_FULL_V = 0.4  # LFP is full this much below all others; a loaded test is not
MOST_FITTED = 6  # drives in one fit: more add time, and little else
FEWEST_OF_LIFE = 8  # discharges of a cell that was cycled, at one current and temperature
SAME_CURRENT = 1.1  # times: one current
SAME_K = 5.0  # one temperature


class CellPlan(NamedTuple):
    """The commands of one cell, where they write, the page that they end on, what is missing."""

    place: Path
    commands: list[list[str]]
    page: str
    missing: list[str]

    @property
    def runs(self) -> bool:
        """Whether nothing has to be stated first."""
        return not any(UNKNOWN in one for one in self.commands)


def run_start(arguments: argparse.Namespace) -> None:
    """Look at the folder, plan, print, run."""
    folder, out = Path(arguments.folder), Path(arguments.output)
    with printing.working(f"looking at {folder}") as follow:
        files, arguments.sign = look_at(folder, arguments.sign, arguments.nominal_ah, follow)
    groups = groups_of(files)
    if not groups:
        raise _nothing(folder, files)
    places = [out] if len(groups) == 1 else [out / f"cell_{k + 1}" for k in range(len(groups))]
    plans = [plan_of(g, arguments, place) for g, place in zip(groups, places, strict=True)]
    names = [""] if len(plans) == 1 else [f"{plan.place.name}: " for plan in plans]
    found: dict[str, Any] = {
        "files": [
            {"path": str(f.path), "kind": f.kind, "why": why_of(f), "instance": f.instance}
            for f in files
        ],
        "missing": [n + m for n, plan in zip(names, plans, strict=True) for m in plan.missing],
        "commands": [shlex.join(("cellwise", *one)) for plan in plans for one in plan.commands],
    }
    if arguments.run and not any(plan.runs for plan in plans):
        what = f"logs in '{folder}' that do not say all that is needed"
        raise InputError(what, plans[0].missing[0], "Give it.")
    if not arguments.json:
        rows = [(f.name, f.kind, why_of(f)) for f in files]
        printing.table(str(folder), ("file", "taken for", "why"), rows)
        for text in found["missing"]:
            printing.say(f"  missing: {text}")
        printing.say("\n  ".join(["commands (--run runs them):", *found["commands"]]))
    if arguments.run:
        found["ran"] = run_all(plans, quiet=arguments.json)
        found["pages"] = pages = [r["page"] for r in found["ran"] if r["page"]]
        if len(pages) > 1 and not arguments.json:  # of one, its command has said it
            printing.say(f"pages to open: {', '.join(pages)}")
    if arguments.json:
        printing.print_json(found)


def why_of(file: FoundFile) -> str:
    """Why a file is taken for what it is; of one under other names the command that reads it."""
    if not file.channels:
        return file.why
    named = [word for pair in file.channels for word in ("--channel", "=".join(pair))]
    into = file.path.with_name(f"{file.path.name.partition('.')[0]}_tidy.csv")
    what = ("cellwise", "convert", str(file.path), *named, "-o", str(into))
    return file.why + f": {shlex.join(what)}"


def _nothing(folder: Path, files: list[FoundFile]) -> InputError:
    """Why a folder gives nothing to do."""
    unread = [f for f in files if f.kind in ("unread", "several")]
    inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and p.name[0] not in "._")
    what = f"no battery log in the folder '{folder}' ({len(files)} file(s)"
    what += "".join(f"; '{f.name}': {why_of(f).rstrip('.')}" for f in unread[: MOST.listed]) + ")"
    hint = f"Name one of its folders: {', '.join(inside[:8])}." if inside else "Check the path."
    return InputError(what, "logs with time, current and voltage of a cell", hint)


def run_all(plans: list[CellPlan], *, quiet: bool) -> list[dict[str, Any]]:
    """Run each cell's commands; what came of each cell.

    Raises
    ------
    InputError        no cell's commands came to an end
    """
    ran = []
    for plan in plans:
        error: str | None = f"not run: {plan.missing[0]} is needed" if not plan.runs else None
        if error is None:
            made_folder(plan.place, "models and pages")
            error = next(filter(None, (_run(c, quiet=quiet) for c in plan.commands)), None)
        ran.append({"page": None if error else plan.page, "error": error})
    errors = [one["error"] for one in ran if one["error"]]
    if len(errors) == len(ran):
        raise InputError(
            f"no cell whose commands ran to their end ({errors[0]})",
            "logs that give a model",
            "See the table without --run, and state what is missing.",
        )
    for error in errors:
        printing.warn(error)
    return ran


def _run(command: list[str], *, quiet: bool) -> str | None:
    """Run one command; what it says where it was refused."""
    said = io.StringIO()
    shown = contextlib.redirect_stdout(io.StringIO()) if quiet else contextlib.nullcontext()
    with contextlib.redirect_stderr(said), shown:
        code = main(command)
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    if code == 0:
        return None
    return said.getvalue().strip().splitlines()[-1]


def _of(group: Sequence[FoundFile], *kinds: str) -> list[FoundFile]:
    return [f for f in group if f.kind in kinds]


def _size_Ah(group: Sequence[FoundFile]) -> float:
    """The largest whole discharge [Ah]; what pulse tests moved where there is none, else 0."""
    return _whole_Ah(group) or max((f.moved_Ah for f in _of(group, "hppc")), default=0.0)


def _whole_Ah(group: Sequence[FoundFile]) -> float:
    """The largest whole discharge [Ah], else 0: pulses over a part of the range are no capacity."""
    return max((f.whole_Ah for f in group if f.kind != "charge"), default=0.0)


def groups_of(files: Sequence[FoundFile]) -> list[list[FoundFile]]:
    """Files that may be of one cell: by cells in series, full voltage and whole discharges."""
    found: list[list[FoundFile]] = []
    for one in sorted(_of(files, *TESTS), key=lambda f: -f.moved_Ah):
        home = next((g for g in found if _belongs(one, g)), None)
        if home is None:
            found.append(home := [])
        home.append(one)
    for one in _of(files, *DRIVES, "charge"):
        home = next((g for g in found if _may_belong(one, g)), None)
        if home is None:
            found.append(home := [])
        home.append(one)
    order = {f.path: k for k, f in enumerate(files)}
    ordered = [sorted(group, key=lambda f: order[f.path]) for group in found]
    return [group for group in ordered if _of(group, *TESTS, *DRIVES)]


def _belongs(one: FoundFile, group: list[FoundFile]) -> bool:
    """Whether a test is of a group's cell."""
    full_V = max(f.highest_V for f in group)
    return (
        one.series == group[0].series
        and abs(one.highest_V - full_V) < OTHER_FULL_V
        and _size_Ah(group) < SIZES.far * one.moved_Ah
    )


def _may_belong(one: FoundFile, group: list[FoundFile]) -> bool:
    """Whether a drive may be of a group's cell."""
    first, size_Ah = group[0], _size_Ah(group)
    if size_Ah == 0.0 or one.kind == "pack":
        return (one.kind, one.series) == (first.kind, first.series)
    return (
        first.kind != "pack"
        and one.series == first.series
        and one.moved_Ah < SIZES.far * size_Ah
        and one.highest_V < max(f.highest_V for f in group) + OTHER_FULL_V
    )


def plan_of(group: list[FoundFile], arguments: argparse.Namespace, place: Path) -> CellPlan:
    """The commands for a group's files; what they write goes to ``place``."""
    used, held_out = _chosen(group)
    series = group[0].series
    read = ["--series", str(series)] if series > 1 else []
    read += ["--sign", arguments.sign] if arguments.sign != "auto" else []
    model, page = str(place / "model.json"), str(place / "identify.html")
    identify = ["identify"]
    for one in used:
        identify += [f"--{one.kind if one.kind in TESTS else 'drive'}", one.stated]
    nominal = arguments.nominal_ah or float(f"{_whole_Ah(group):.3g}")
    identify += ["--nominal-ah", f"{nominal:g}" if nominal else UNKNOWN]
    prior = arguments.prior or ("lipo-pouch" if _of(group, "flight") else None)
    identify += ["--prior", prior] if prior else []
    commands = [[*identify, *read, "-o", model, "--report", page]]
    # What follows it: where there are logs for it, and the last one's page is the one to open.
    packs = _of(group, "pack")[-MOST_FITTED:]
    driven = _of(held_out, *DRIVES) or _of(used, *DRIVES)
    for command, logs in (("replay", driven[:1]), ("pack", packs), ("history", _life(group))):
        if logs:
            page = str(place / f"{command}.html")
            paths = (one.stated for one in logs)
            commands.append([command, "--model", model, *paths, *read, "--report", page])
    return CellPlan(place, commands, page, _missing(group, nominal, held_out))


def _chosen(group: list[FoundFile]) -> tuple[list[FoundFile], list[FoundFile]]:
    """The files that the model is made of, and the drives that are left to judge it."""
    driven = _of(group, *DRIVES)
    spread = driven[:: -(-len(driven) // MOST_FITTED) or 1]
    if 1 < len(driven) <= MOST_FITTED:
        spread = driven[:-1]
    elif len(driven) == 1 and _of(group, "hppc", "ocv"):
        spread = []
    later = _life(group)[1:]
    tests = [f for f in _of(group, *TESTS) if f not in later]
    return [*tests, *spread], [f for f in driven if f not in spread]


def _life(group: list[FoundFile]) -> list[FoundFile]:
    """Discharges at one rate and temperature, of a cell that was cycled; none where few."""

    def alike(one: FoundFile, other: FoundFile) -> bool:
        ratio = max(one.current_A, other.current_A) / min(one.current_A, other.current_A)
        apart_K = abs((one.usual_C or 0.0) - (other.usual_C or 0.0))
        return ratio < SAME_CURRENT and apart_K < SAME_K

    tests = _of(group, "capacity")
    lives = ([f for f in tests if alike(f, first)] for first in tests)
    return next((life for life in lives if len(life) >= FEWEST_OF_LIFE), [])


def _missing(group: list[FoundFile], nominal_Ah: float, judged: list[FoundFile]) -> list[str]:
    found = [] if nominal_Ah else ["the rated capacity: --nominal-ah"]
    if _of(group, *TESTS):
        found += [MISSING[kind] for kind in ("hppc", "ocv") if not _of(group, kind)]
    found += [] if judged else [MISSING["drive"]]
    unknown = [f.path.name for f in group if f.named_C is not None]
    if unknown:
        found.append(
            f"a measured temperature: {len(unknown)} file(s) state one in the name only "
            f"('{unknown[0]}'); correct it behind the @ where that is wrong"
        )
    return found

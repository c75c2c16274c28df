"""cellwise start: look at a folder, print the commands that fit it, and run them if asked."""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cellwise.cli.common import options, printing
from cellwise.cli.common.log_options import SIGNS
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cli.found_files import FoundFile

UNKNOWN = "X"  # stands for what has to be stated


class _Limits(NamedTuple):
    """Which files go together, and how many of a kind are used."""

    other_full_V: float = 0.4  # LFP is full this much below all others; a loaded test is not
    fitted: int = 6  # drives in one fit: more add time, and little else
    # Discharges of a cell that was cycled: so many, at one current and temperature.
    life: int = 8
    same_current: float = 1.1
    same_K: float = 5.0


LIMITS = _Limits()
ROLES = {"hppc": "hppc", "ocv": "ocv", "capacity": "capacity", "drive": "drive",
         "flight": "drive", "pack": "drive"}  # fmt: skip
MISSING = {
    "hppc": "a pulse test (HPPC: 10 s pulses after rests, every 5 to 10 % of SOC): without it "
    "resistances and time constants come from drives and a prior",
    "ocv": "a low-rate test (C/20 discharge and charge): without it the OCV comes from rests, or a "
    "prior",
    "drive": "a drive or flight that takes no part in the fit: without it nothing judges the model",
}


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that begins with whatever there is."""
    p = commands.add_parser("start", help="say what lies in a folder and which commands fit it")
    p.add_argument("folder", metavar="FOLDER", help="logs of a cell, a pack or a flight")
    text = "run the commands and end on a page"
    p.add_argument("--run", dest="run_them", action="store_true", help=text)
    options.number(p, "--nominal-ah", "X", "rated capacity [the largest whole discharge]")
    p.add_argument("--prior", metavar="MODEL", help="model to start from [by the logs]")
    p.add_argument("--sign", choices=SIGNS, default="auto", help="sign of the current [auto]")
    text = "where models and pages go, one folder for each cell [started]"
    p.add_argument("-o", "--output", default="started", metavar="DIR", help=text)
    options.add_json(p)
    p.set_defaults(run=run_start)


def run_start(arguments: argparse.Namespace) -> None:
    """Look at the folder, plan, print, run."""
    from cellwise.cli.found_files import look_at

    folder, out = Path(arguments.folder), Path(arguments.output)
    with printing.working(f"looking at {folder}") as follow:
        files = look_at(folder, arguments, follow)
    groups = groups_of(files)
    if not groups:
        raise _nothing(folder, files)
    places = [out] if len(groups) == 1 else [out / f"cell_{k + 1}" for k in range(len(groups))]
    plans = [plan_of(g, arguments, place) for g, place in zip(groups, places, strict=True)]
    names = [""] if len(plans) == 1 else [f"{place.name}: " for place in places]
    found: dict[str, Any] = {
        "files": [{"path": str(f.path), "kind": f.kind, "why": f.why} for f in files],
        "missing": [n + m for n, plan in zip(names, plans, strict=True) for m in plan.missing],
        "commands": [line for plan in plans for line in plan.lines],
    }
    if arguments.run_them and not any(plan.runs for plan in plans):
        what = f"logs in '{folder}' that do not say all that is needed"
        raise InputError(what, plans[0].missing[0], "Give it.")
    if not arguments.json:
        _print(folder, found)
    if arguments.run_them:
        found["ran"] = _run_all(plans, places, quiet=arguments.json)
        found["pages"] = [r["page"] for r in found["ran"] if r["page"]]
        if len(found["pages"]) > 1 and not arguments.json:  # of one, its command has said it
            printing.say(f"pages to open: {', '.join(found['pages'])}")
    if arguments.json:
        printing.print_json(found)


def _nothing(folder: Path, files: list[FoundFile]) -> InputError:
    """Why a folder gives nothing to do."""
    unread = next((f for f in files if f.kind == "unread"), None)
    inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and p.name[0] not in "._")
    what = f"no battery log in the folder '{folder}' ({len(files)} file(s)"
    what += f"; '{unread.path.name}': {unread.why.rstrip('.')})" if unread else ")"
    hint = f"Name one of its folders: {', '.join(inside[:8])}." if inside else "Check the path."
    return InputError(what, "logs with time, current and voltage of a cell", hint)


def _print(folder: Path, found: dict[str, Any]) -> None:
    rows = [(Path(f["path"]).name, f["kind"], f["why"]) for f in found["files"]]
    printing.table(str(folder), ("file", "taken for", "why"), rows)
    for text in found["missing"]:
        printing.say(f"  missing: {text}")
    printing.say("commands (--run runs them):")
    for line in found["commands"]:
        printing.say(f"  {line}")


def _run_all(plans: list[Plan], places: list[Path], *, quiet: bool) -> list[dict[str, Any]]:
    """Run each cell's commands in a process of their own; what came of each cell.

    Raises
    ------
    InputError        no cell's commands came to an end
    """
    from cellwise.files import made_folder

    ran = []
    for plan, place in zip(plans, places, strict=True):
        if not plan.runs:
            ran.append({"page": None, "error": f"not run: {plan.missing[0]} is needed"})
            continue
        made_folder(place, "models and pages")
        error = next(filter(None, (_run(c, quiet=quiet) for c in plan.commands)), None)
        ran.append({"page": None if error else plan.page, "error": error})
    errors = [one["error"] for one in ran if one["error"]]
    if len(errors) < len(ran):
        for error in errors:
            printing.warn(error)
    else:
        raise InputError(
            f"no cell whose commands ran to their end ({errors[0]})",
            "logs that give a model",
            "See the table without --run, and state what is missing.",
        )
    return ran


def _run(command: tuple[str, ...], *, quiet: bool) -> str | None:
    """Run one command; what it says where it was refused."""
    out = subprocess.DEVNULL if quiet else None
    done = subprocess.run(
        [sys.executable, "-m", "cellwise", *command],
        stdout=out,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines() or [f"cellwise {command[0]} ended unexpectedly"]
    return lines[-1]


@dataclass
class Group:
    """Files of one cell, or of cells of one kind."""

    files: list[FoundFile] = field(default_factory=list)

    @property
    def size_Ah(self) -> float:
        """The largest whole discharge [Ah]; by pulse tests where there is none, else 0."""
        whole = [f.whole_Ah for f in self.files if f.kind != "charge"]
        return max(whole, default=0.0) or max((f.moved_Ah for f in self.of("hppc")), default=0.0)

    @property
    def full_V(self) -> float:
        """The highest voltage of a cell."""
        return max(f.highest_V for f in self.files)

    def of(self, *kinds: str) -> list[FoundFile]:
        """The files of some kinds."""
        return [f for f in self.files if f.kind in kinds]


@dataclass(frozen=True)
class Plan:
    """The commands of one cell, the page that they end on, and what is missing."""

    commands: tuple[tuple[str, ...], ...]
    page: str
    missing: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """The commands as they are typed."""
        return [shlex.join(("cellwise", *one)) for one in self.commands]

    @property
    def runs(self) -> bool:
        """Whether nothing has to be stated first."""
        return not any(UNKNOWN in one for one in self.commands)


def groups_of(files: Sequence[FoundFile]) -> list[Group]:
    """Files that may be of one cell: by cells in series, full voltage and whole discharges."""
    found: list[Group] = []
    tests = [f for f in files if f.kind in ("hppc", "ocv", "capacity")]
    for one in sorted(tests, key=lambda f: -f.moved_Ah):
        home = next((g for g in found if _belongs(one, g)), None)
        if home is None:
            found.append(home := Group())
        home.files.append(one)
    for one in (f for f in files if f.kind in ("drive", "flight", "pack", "charge")):
        homes = [g for g in found if _may_belong(one, g)]
        if not homes:
            found.append(Group())
        (homes or found[-1:])[0].files.append(one)
    order = {f.path: k for k, f in enumerate(files)}
    for group in found:
        group.files.sort(key=lambda f: order[f.path])
    return [g for g in found if g.of(*ROLES)]


def _belongs(one: FoundFile, group: Group) -> bool:
    """Whether a test is of a group's cell."""
    from cellwise.identify.measured_capacity import LIMITS as SIZES

    return (
        one.series == group.files[0].series
        and abs(one.highest_V - group.full_V) < LIMITS.other_full_V
        and group.size_Ah < SIZES.far * one.moved_Ah
    )


def _may_belong(one: FoundFile, group: Group) -> bool:
    """Whether a drive may be of a group's cell."""
    from cellwise.identify.measured_capacity import LIMITS as SIZES

    first = group.files[0]
    if group.size_Ah == 0.0 or one.kind == "pack":
        return (one.kind, one.series) == (first.kind, first.series)
    return (
        first.kind != "pack"
        and one.series == first.series
        and one.moved_Ah < SIZES.far * group.size_Ah
        and one.highest_V < group.full_V + LIMITS.other_full_V
    )


def plan_of(group: Group, arguments: argparse.Namespace, folder: Path) -> Plan:
    """The commands for a group's files; what they write goes to ``folder``."""
    used, held_out = _chosen(group)
    read = _reading(group, arguments)
    model, page = str(folder / "model.json"), str(folder / "identify.html")
    identify = ["identify"]
    for one in used:
        identify += [f"--{ROLES[one.kind]}", one.stated]
    nominal = arguments.nominal_ah or float(f"{group.size_Ah:.3g}")
    identify += ["--nominal-ah", f"{nominal:g}" if nominal else UNKNOWN]
    prior = arguments.prior or ("lipo-pouch" if group.of("flight") else None)
    identify += ["--prior", prior] if prior else []
    commands = [[*identify, *read, "-o", model, "--report", page]]

    def add(command: str, logs: Sequence[FoundFile]) -> str:
        target = str(folder / f"{command}.html")
        paths = (one.stated for one in logs)
        commands.append([command, "--model", model, *paths, *read, "--report", target])
        return target

    drives = [f for f in held_out if f.kind in ("drive", "flight", "pack")]
    driven = drives or [f for f in used if f.kind in ("drive", "flight", "pack")]
    if driven:
        page = add("replay", driven[:1])
    if group.of("pack"):
        page = add("pack", group.of("pack")[-LIMITS.fitted :])
    life = _life(group)
    if life:
        page = add("history", life)
    missing = _missing(group, nominal, drives)
    return Plan(tuple(tuple(c) for c in commands), page, tuple(missing))


def _chosen(group: Group) -> tuple[list[FoundFile], list[FoundFile]]:
    """The files that the model is made of, and the drives that are left to judge it."""
    driven = group.of("drive", "flight", "pack")
    spread = driven[:: -(-len(driven) // LIMITS.fitted) or 1]
    laboratory = bool(group.of("hppc", "ocv"))
    if len(driven) <= LIMITS.fitted and len(driven) > 1:
        spread = driven[:-1]
    elif len(driven) == 1 and laboratory:
        spread = []
    life = _life(group)
    tests = [f for f in group.of("hppc", "ocv", "capacity") if f not in life[1:]]
    return [*tests, *spread], [f for f in driven if f not in spread]


def _life(group: Group) -> list[FoundFile]:
    """Discharges at one rate, of a cell that was cycled; none where they are few."""
    tests = group.of("capacity")
    for first in tests:
        alike = [f for f in tests if _alike(f, first)]
        if len(alike) >= LIMITS.life:
            return alike
    return []


def _alike(one: FoundFile, other: FoundFile) -> bool:
    ratio = max(one.current_A, other.current_A) / min(one.current_A, other.current_A)
    apart_K = abs((one.usual_C or 0.0) - (other.usual_C or 0.0))
    return ratio < LIMITS.same_current and apart_K < LIMITS.same_K


def _reading(group: Group, arguments: argparse.Namespace) -> list[str]:
    """The options that every command reads these files with."""
    series = group.files[0].series
    said = ["--series", str(series)] if series > 1 else []
    return said + (["--sign", arguments.sign] if arguments.sign != "auto" else [])


def _missing(group: Group, nominal_Ah: float, judged: Sequence[FoundFile]) -> list[str]:
    found = [] if nominal_Ah else ["the rated capacity: --nominal-ah"]
    laboratory = bool(group.of("hppc", "ocv", "capacity"))
    kinds = {"hppc": laboratory, "ocv": laboratory, "drive": True}
    has = {"hppc": group.of("hppc"), "ocv": group.of("ocv"), "drive": judged}
    found += [MISSING[kind] for kind, wanted in kinds.items() if wanted and not has[kind]]
    unknown = [f.path.name for f in group.files if f.named_C is not None]
    if unknown:
        found.append(
            f"a measured temperature: {len(unknown)} file(s) state one in the name only "
            f"('{unknown[0]}'); correct it behind the @ where that is wrong"
        )
    return found

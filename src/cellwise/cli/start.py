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
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.plausibility.validity import ONE_CELL, cells_in_series
from cellwise.cli.command_line import INTERRUPTED, main
from cellwise.cli.common import printing
from cellwise.errors import InputError, MachineError
from cellwise.files import made_folder
from cellwise.identify.measured_capacity import LIMITS as SIZES
from cellwise.identify.test_kind import kind_of
from cellwise.logs import CellLog, read_log
from cellwise.logs.checks.sign import CONTRADICTED
from cellwise.logs.reading import AS_MEAN_CELL
from cellwise.logs.stated import SUFFIXES, in_order

FLIGHTS = ("px4-ulog", "ardupilot-dataflash")
DATABASES = (".dbc", ".arxml", ".kcd", ".sym")
CAN_LOGS = (".blf", ".asc", ".log", ".trc", ".mf4")
MISSING_COLUMNS = re.compile(r"; missing: (.+)$", re.DOTALL)  # of a table that was refused
# A temperature in a name: _p25, _n10, -10degC.
NAMED_C = re.compile(r"[_-]([pn])(\d\d)(?=[_.-]|$)|([-_]|_-)(\d{1,2}) ?deg", re.IGNORECASE)
OTHER_SIGN = re.compile(CONTRADICTED + r".*`sign='([a-z-]+)'`", re.DOTALL)  # in a notice
UNKNOWN = "X"  # stands for what has to be stated
TESTS = ("hppc", "ocv", "capacity")
DRIVES = ("drive", "flight", "pack")
MISSING = {
    "hppc": "a pulse test (HPPC: 10 s pulses after rests, every 5 to 10 % of SOC): without it "
    "resistances and time constants come from drives and a prior",
    "ocv": "a low-rate test (C/20 discharge and charge): without it the OCV comes from rests, or a "
    "prior",
    "drive": "a drive or flight that takes no part in the fit: without it nothing judges the model",
}


class _Limits(NamedTuple):
    """What a file is taken for, which files go together, how many of a kind are used."""

    # The last per cent of a low-rate test, its dither too: of a whole discharge, and its rates.
    end_moved: float = 0.05
    end_rates: tuple[float, float] = (0.01, 0.5)
    other_full_V: float = 0.4  # LFP is full this much below all others; a loaded test is not
    fitted: int = 6  # drives in one fit: more add time, and little else
    # Discharges of a cell that was cycled: so many, at one current and temperature.
    life: int = 8
    same_current: float = 1.1
    same_K: float = 5.0


LIMITS = _Limits()


@dataclass(frozen=True)
class FoundFile:
    """A file and what it is taken for.

    ``kind``: hppc, ocv, capacity, charge, drive, rest; end (of a low-rate test); pack (a voltage
    for each cell), flight; unread (refused, ``why`` says for what), other (no log by its name).
    ``moved_Ah`` through one string of cells, ``whole_Ah`` by a discharge at one current,
    ``current_A``; ``highest_V`` of one cell; ``usual_C`` as measured, ``named_C`` a temperature
    that only the name states; ``other_sign`` what the current's sign would have to mean where the
    voltage contradicts it.
    """

    path: Path
    kind: str
    why: str
    series: int = 1
    moved_Ah: float = 0.0
    whole_Ah: float = 0.0
    current_A: float = 0.0
    largest_A: float = 0.0
    highest_V: float = 0.0
    usual_C: float | None = None
    named_C: float | None = None
    other_sign: str = ""

    @property
    def stated(self) -> str:
        """The path as a command takes it, with the temperature that only its name states."""
        return str(self.path) if self.named_C is None else f"{self.path}@{self.named_C:g}"


class Plan(NamedTuple):
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
        files = look_at(folder, arguments, follow)
    groups = groups_of(files)
    if not groups:
        raise _nothing(folder, files)
    places = [out] if len(groups) == 1 else [out / f"cell_{k + 1}" for k in range(len(groups))]
    plans = [plan_of(g, arguments, place) for g, place in zip(groups, places, strict=True)]
    names = [""] if len(plans) == 1 else [f"{plan.place.name}: " for plan in plans]
    found: dict[str, Any] = {
        "files": [{"path": str(f.path), "kind": f.kind, "why": f.why} for f in files],
        "missing": [n + m for n, plan in zip(names, plans, strict=True) for m in plan.missing],
        "commands": [shlex.join(("cellwise", *one)) for plan in plans for one in plan.commands],
    }
    if arguments.run and not any(plan.runs for plan in plans):
        what = f"logs in '{folder}' that do not say all that is needed"
        raise InputError(what, plans[0].missing[0], "Give it.")
    if not arguments.json:
        rows = [(f.path.name, f.kind, f.why) for f in files]
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


def _nothing(folder: Path, files: list[FoundFile]) -> InputError:
    """Why a folder gives nothing to do."""
    unread = next((f for f in files if f.kind == "unread"), None)
    inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and p.name[0] not in "._")
    what = f"no battery log in the folder '{folder}' ({len(files)} file(s)"
    what += f"; '{unread.path.name}': {unread.why.rstrip('.')})" if unread else ")"
    hint = f"Name one of its folders: {', '.join(inside[:8])}." if inside else "Check the path."
    return InputError(what, "logs with time, current and voltage of a cell", hint)


def run_all(plans: list[Plan], *, quiet: bool) -> list[dict[str, Any]]:
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


def look_at(
    folder: Path, arguments: argparse.Namespace, follow: Callable[..., None]
) -> list[FoundFile]:
    """Every file of a folder, in the order of time; those of folders in it are left alone.

    Raises
    ------
    InputError        no such folder
    """
    if not folder.is_dir():
        raise InputError(f"no folder '{folder}'", "a folder with logs", "Check the path.")
    places = [p for p in folder.iterdir() if p.is_file() and p.name[0] not in "._"]
    places.sort(key=in_order)
    databases = [p for p in places if p.suffix.lower() in DATABASES]
    dbc = databases[0] if len(databases) == 1 else None

    def read_as(sign: str) -> list[FoundFile]:
        found = []
        for k, place in enumerate(places):
            follow(f"reading {place.name}", k, len(places))
            found.append(_look_at_one(place, sign, arguments.nominal_ah, dbc))
        return found

    found = read_as(arguments.sign)
    others = {one.other_sign for one in found if one.other_sign}
    if arguments.sign == "auto" and len(others) == 1:
        again = read_as(sign := others.pop())
        if not any(one.other_sign for one in again):
            arguments.sign, said = sign, f"; {sign}, by its voltage"
            found = [
                replace(now, why=now.why + said) if before.other_sign else now
                for before, now in zip(found, again, strict=True)
            ]
    found = [_with_a_wrong_sign(one) if one.other_sign else one for one in found]
    return [_end_of_test(one, found) for one in found]


def _with_a_wrong_sign(one: FoundFile) -> FoundFile:
    """Of no use beside files whose sign is another's."""
    why = f"the sign of the current looks wrong: read it by itself, with --sign {one.other_sign}"
    return replace(one, kind="unread", why=why)


def _end_of_test(one: FoundFile, files: list[FoundFile]) -> FoundFile:
    """A slow test that moves hardly anything beside a whole discharge in the folder."""
    low, high = LIMITS.end_rates
    steady = _of(files, "ocv", "capacity", "charge")
    whole = (f.whole_Ah for f in steady if f.series == one.series)
    size = max((w for w in whole if low * w < one.largest_A < high * w), default=0.0)
    if one.kind not in (*TESTS, "drive") or one.moved_Ah >= LIMITS.end_moved * size:
        return one
    share = one.moved_Ah / size
    return replace(one, kind="end", why=f"{share:.1%} of {size:.3g} Ah, slowly: not used")


def _look_at_one(place: Path, sign: str, nominal_Ah: float | None, dbc: Path | None) -> FoundFile:
    if not place.name.lower().endswith(SUFFIXES):
        return FoundFile(place, "other", "no log by its name")
    try:
        dbc = dbc if place.suffix.lower() in CAN_LOGS else None
        log = read_log(place, sign=sign, dbc=dbc)
    except MachineError:
        raise
    except InputError as error:
        lacks = MISSING_COLUMNS.search(error.found)
        if lacks is not None and "," in lacks[1]:  # most columns: only what it lacks
            return FoundFile(place, "unread", f"a table without {lacks[1]}: no log")
        return FoundFile(place, "unread", f"{error.found}. {error.action}")
    series = 1
    if log.typical_voltage_V > ONE_CELL.largest_V:
        series = cells_in_series(log, ONE_CELL.full_V)
    return _taken_for(place, replace(log, voltage_V=log.voltage_V / series), series, nominal_Ah)


def _taken_for(place: Path, log: CellLog, series: int, nominal_Ah: float | None) -> FoundFile:
    """What a log of one cell, of so many in series, is."""
    test = kind_of(log, nominal_Ah)
    kind: str = "flight" if log.format in FLIGHTS else test.kind
    why = test.why if series == 1 else f"{series} cells in series; {test.why}"
    moved_Ah = float(np.ptp(log.counted_charge_Ah()))
    mean = next((n for n in log.notices if AS_MEAN_CELL in n), None)
    if mean is not None:  # what a test is called by its load says nothing of a day on the road
        hours = log.duration_s / 3600.0
        kind = "pack"
        why = f"{mean.partition(',')[0]}; {moved_Ah:.3g} Ah moved within {hours:.3g} h"
    return FoundFile(
        place,
        kind,
        why,
        series,
        moved_Ah,
        test.charge_Ah,
        test.current_A,
        largest_A=float(np.nanmax(np.abs(log.current_A))),
        highest_V=float(np.nanmax(log.voltage_V)),
        usual_C=None if log.temperature_C is None else float(np.nanmedian(log.temperature_C)),
        named_C=_named_C(log),
        other_sign=next((m[1] for n in log.notices if (m := OTHER_SIGN.search(n))), ""),
    )


def _named_C(log: CellLog) -> float | None:
    """The temperature that the name states, of a log that measured none."""
    said = None if log.temperature_C is not None else NAMED_C.search(log.name)
    if said is None:
        return None
    if said[1]:
        return float(said[2]) * (-1.0 if said[1].lower() == "n" else 1.0)
    return float(said[4]) * (-1.0 if said[3].endswith("-") else 1.0)


def _of(group: Sequence[FoundFile], *kinds: str) -> list[FoundFile]:
    return [f for f in group if f.kind in kinds]


def _size_Ah(group: Sequence[FoundFile]) -> float:
    """The largest whole discharge [Ah]; by pulse tests where there is none, else 0."""
    whole = max((f.whole_Ah for f in group if f.kind != "charge"), default=0.0)
    return whole or max((f.moved_Ah for f in _of(group, "hppc")), default=0.0)


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
        and abs(one.highest_V - full_V) < LIMITS.other_full_V
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
        and one.highest_V < max(f.highest_V for f in group) + LIMITS.other_full_V
    )


def plan_of(group: list[FoundFile], arguments: argparse.Namespace, place: Path) -> Plan:
    """The commands for a group's files; what they write goes to ``place``."""
    used, held_out = _chosen(group)
    series = group[0].series
    read = ["--series", str(series)] if series > 1 else []
    read += ["--sign", arguments.sign] if arguments.sign != "auto" else []
    model, page = str(place / "model.json"), str(place / "identify.html")
    identify = ["identify"]
    for one in used:
        identify += [f"--{one.kind if one.kind in TESTS else 'drive'}", one.stated]
    nominal = arguments.nominal_ah or float(f"{_size_Ah(group):.3g}")
    identify += ["--nominal-ah", f"{nominal:g}" if nominal else UNKNOWN]
    prior = arguments.prior or ("lipo-pouch" if _of(group, "flight") else None)
    identify += ["--prior", prior] if prior else []
    commands = [[*identify, *read, "-o", model, "--report", page]]
    # What follows it: where there are logs for it, and the last one's page is the one to open.
    packs = _of(group, "pack")[-LIMITS.fitted :]
    driven = _of(held_out, *DRIVES) or _of(used, *DRIVES)
    for command, logs in (("replay", driven[:1]), ("pack", packs), ("history", _life(group))):
        if logs:
            page = str(place / f"{command}.html")
            paths = (one.stated for one in logs)
            commands.append([command, "--model", model, *paths, *read, "--report", page])
    return Plan(place, commands, page, _missing(group, nominal, held_out))


def _chosen(group: list[FoundFile]) -> tuple[list[FoundFile], list[FoundFile]]:
    """The files that the model is made of, and the drives that are left to judge it."""
    driven = _of(group, *DRIVES)
    spread = driven[:: -(-len(driven) // LIMITS.fitted) or 1]
    if 1 < len(driven) <= LIMITS.fitted:
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
        return ratio < LIMITS.same_current and apart_K < LIMITS.same_K

    tests = _of(group, "capacity")
    lives = ([f for f in tests if alike(f, first)] for first in tests)
    return next((life for life in lives if len(life) >= LIMITS.life), [])


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

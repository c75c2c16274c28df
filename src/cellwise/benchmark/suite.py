"""A suite: the cells, logs, estimators, starts and faults that a benchmark runs, read from TOML."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cellwise.benchmark.adapter import is_adapter, short_name
from cellwise.benchmark.faults import FAULTS, GROUPS, NONE, Fault
from cellwise.benchmark.known_logs import KnownLog, file_digest
from cellwise.benchmark.package_rows import NotRun, PackageRow
from cellwise.benchmark.records import checked, need, records
from cellwise.errors import InputError
from cellwise.estimate.estimators import ESTIMATORS
from cellwise.logs.stated import Stated

BASELINES = ("coulomb", "rest-ocv", "filterpy-ekf", "filterpy-ukf")
SUITES = Path(__file__).with_name("suites")
EMBEDDED = "embedded:"


@dataclass(frozen=True)
class SuiteCell:
    """How a model comes about: a model file, or the tests that it is identified on.

    Every log is ``embedded:NAME`` or a path, beside the suite or in the folder of measured data,
    with what is known of it behind an @ (``@-10``, ``@temperature_C=-10,soc0=1``).

    Parameters
    ----------
    name : str
    model : str                      a model file instead of tests
    hppc, ocv, capacity, drive : tuple of str
    tune : tuple of str              logs that `tune_noise` may use, none of them judged
    nominal_Ah : float or None
    capacity_choice : str or None
    temperature_C : float or None    of the tests where no log measures it
    chemistry : str
    rested_full_V : float or None    drives began full, rested at this voltage
    """

    name: str
    model: str = ""
    hppc: tuple[str, ...] = ()
    ocv: tuple[str, ...] = ()
    capacity: tuple[str, ...] = ()
    drive: tuple[str, ...] = ()
    tune: tuple[str, ...] = ()
    nominal_Ah: float | None = None
    capacity_choice: str | None = None
    temperature_C: float | None = None
    chemistry: str = ""
    rested_full_V: float | None = None

    @property
    def tests(self) -> tuple[str, ...]:
        """Every log that the model has seen."""
        return (*self.hppc, *self.ocv, *self.capacity, *self.drive, *self.tune)


@dataclass(frozen=True)
class SuiteLog:
    """A log to judge on.

    Parameters
    ----------
    cell : str                       name of the cell whose model runs
    log : str                        as in :class:`SuiteCell`
    soc0 : float or None             true SOC at the first row; None: the catalogue's
    reference_Ah : float or None     charge between SOC 1 and 0 for the reference; None: as above
    from_soc : float or None         only the rest from where the reference passes this SOC
    hours : float or None            no more than so much of it [h]
    summed : bool                    a tester without a counter: its current, summed, is the truth
    quick : bool                     in the quick cut as well
    name : str                       in tables; empty: the log's own
    """

    cell: str
    log: str
    soc0: float | None = None
    reference_Ah: float | None = None
    from_soc: float | None = None
    hours: float | None = None
    summed: bool = False
    quick: bool = False
    name: str = ""

    @property
    def shown(self) -> str:
        """Name in tables."""
        if self.name:
            return self.name
        stem = Path(Stated.parse(self.log).path.removeprefix(EMBEDDED)).name.split(".")[0]
        return stem if self.from_soc is None else f"{stem} from {100 * self.from_soc:g} %"


@dataclass(frozen=True)
class Slow:
    """What is asked of estimators that take long: fewer rows, starts and faults."""

    estimators: tuple[str, ...] = ("filterpy-ekf", "filterpy-ukf")
    dt_s: float | None = None
    start_errors: tuple[float, ...] | None = None
    faults: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Quick:
    """What of the suite is in its quick cut, beside the logs that are marked."""

    start_errors: tuple[float, ...] = ()
    faults: tuple[str, ...] = ()

    def has(self, log: SuiteLog, fault: str, start_error: float) -> bool:
        """Whether a run is in it."""
        named = start_error in self.start_errors if fault == NONE else fault in self.faults
        return log.quick and named


@dataclass(frozen=True, kw_only=True)
class SuiteKeys:
    """The plain keys of a suite's file.

    Parameters
    ----------
    name, about : str
    estimators : of str               names of cellwise, or adapters as ``file.py:Name``; the
                                      baselines join them whether named or not
    start_errors : of float           what is added to the true SOC, as fractions
    fault_start_error : float         the start of runs with a fault
    every_start : bool                faults from every start
    soc0_std : float                  standard deviation of the initial SOC given to a filter
    dt_s : float or None              resample every log to this step
    frozen : int                      version of a suite that does not change any more; 0: it may
    """

    name: str = ""
    about: str = ""
    estimators: tuple[str, ...] = ("ekf", "ukf", "adaptive")
    start_errors: tuple[float, ...] = (0.0, 0.1, -0.1, 0.3, -0.3)
    fault_start_error: float = -0.3
    every_start: bool = False
    soc0_std: float = 0.15
    dt_s: float | None = None
    frozen: int = 0


@dataclass(frozen=True, kw_only=True)
class Suite(SuiteKeys):
    """Everything that a benchmark runs: its plain keys and its tables.

    Parameters
    ----------
    faults : of Fault                 beside the run without any
    cells, logs, slow
    rows, not_run                     other people's estimators; those that cannot be had
    quick, only_quick                 the quick cut, and whether nothing else is run
    folder : Path                     where paths begin
    data : of KnownLog                what every log of a frozen suite holds
    sha256 : str                      of the suite's file
    """

    faults: tuple[Fault, ...]
    cells: tuple[SuiteCell, ...]
    logs: tuple[SuiteLog, ...]
    slow: Slow = field(default_factory=Slow)
    rows: tuple[PackageRow, ...] = ()
    not_run: tuple[NotRun, ...] = ()
    quick: Quick = field(default_factory=Quick)
    only_quick: bool = False
    folder: Path = Path()
    data: tuple[KnownLog, ...] = ()
    sha256: str = ""


def shipped_suites() -> dict[str, Path]:
    """Suites that come with cellwise, by name."""
    return {path.stem: path for path in sorted(SUITES.glob("*.toml"))}


def read_suite(name: str | Path) -> Suite:
    """A suite by the name of a shipped one or the path of a TOML file.

    Raises
    ------
    InputError       no such suite, no TOML, an unknown key, a value of the wrong kind or one that
                     nothing can be run with
    """
    path = shipped_suites().get(str(name), Path(name))
    if not path.is_file():
        raise InputError(
            f"no suite '{name}'",
            f"a TOML file, or one of {', '.join(shipped_suites())}",
            "Correct the name.",
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(
            f"'{path.name}', which is no TOML ({error})", "a suite in TOML", "Correct the file."
        ) from error
    suite = suite_from_table(table, path.stem, path.resolve().parent)
    return replace(suite, sha256=file_digest(path))


def suite_from_table(table: dict[str, Any], name: str, folder: Path) -> Suite:
    """A suite from what a TOML file holds; raises InputError as :func:`read_suite`."""
    own = records(Fault, table.pop("fault", []), "[[fault]]")
    (slow,) = records(Slow, [table.pop("slow", {})], "[slow]")
    (quick,) = records(Quick, [table.pop("quick", {})], "[quick]")
    faults = (*_named_faults(table.pop("faults", [])), *own)
    tables: dict[str, Any] = {
        "cells": records(SuiteCell, table.pop("cell", []), "[[cell]]"),
        "logs": records(SuiteLog, table.pop("log", []), "[[log]]"),
        "data": records(KnownLog, table.pop("data", []), "[[data]]"),
        "rows": records(PackageRow, table.pop("row", []), "[[row]]"),
        "not_run": records(NotRun, table.pop("not_run", []), "[[not_run]]"),
    }
    keys = checked(SuiteKeys, table, "the suite")
    keys["name"] = keys["name"] or name
    keys["estimators"] = _with_baselines(keys["estimators"])
    suite = Suite(**keys, **tables, faults=faults, slow=slow, quick=quick, folder=folder)
    _check(suite)
    return suite


def with_estimators(suite: Suite, names: tuple[str, ...]) -> Suite:
    """The suite with other estimators; files of adapters are then looked for from here as well.

    Those of a frozen suite run beside them: its rows are compared.
    """
    beside = suite.estimators if suite.frozen else ()
    return replace(suite, estimators=_with_baselines((*names, *beside)))


def _with_baselines(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if not is_adapter(name) and name not in ESTIMATORS:
            raise InputError(
                f"estimator '{name}'",
                f"one of {', '.join(ESTIMATORS)}, or file.py:Name",
                "Correct it.",
            )
    every = tuple(dict.fromkeys((*names, *BASELINES)))
    short = [short_name(n) for n in every]
    if len(set(short)) != len(short):
        raise InputError(
            f"estimators {', '.join(short)}", "different names", "Rename one of the classes."
        )
    return every


def _named_faults(names: Any) -> tuple[Fault, ...]:
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise InputError(
            f"faults = {names}", "a list of names", 'Write e.g. faults = ["standard"].'
        )
    found: list[Fault] = []
    for name in names:
        if name in GROUPS:
            found += GROUPS[name]
        elif name in FAULTS:
            found.append(FAULTS[name])
        else:
            raise InputError(
                f"fault '{name}'",
                f"one of {', '.join((*GROUPS, *FAULTS))}",
                "Choose one of them, or describe your own in [[fault]].",
            )
    return tuple(f for f in dict.fromkeys(found) if f.name != NONE)


def _check(suite: Suite) -> None:
    need(
        bool(suite.logs and suite.cells),
        f"{len(suite.cells)} cells and {len(suite.logs)} logs in suite '{suite.name}'",
        "at least one [[cell]] and one [[log]]",
        "Add them.",
    )
    for kind, names in (
        ("cell", [c.name for c in suite.cells]),
        ("fault", [f.name for f in suite.faults]),
        ("log", [f"{g.cell}: {g.shown}" for g in suite.logs]),
        ("estimator", [*map(short_name, suite.estimators), *(r.name for r in suite.rows)]),
    ):
        twice = next((n for n in names if names.count(n) > 1), None)
        need(twice is None, f"two of {kind} '{twice}'", "one of a name", "Rename one.")
    for error in (*suite.start_errors, suite.fault_start_error, *(suite.slow.start_errors or ())):
        need(-1.0 < error < 1.0, f"a start error of {error:g}", "a fraction, as 0.3")
    for step in (suite.dt_s, suite.slow.dt_s):
        need(step is None or 0.0 < step < 1e6, f"dt_s = {step}", "seconds above zero")
    need(
        bool(suite.start_errors) and 0.0 < suite.soc0_std < 1.0,
        f"start_errors = {list(suite.start_errors)}, soc0_std = {suite.soc0_std:g}",
        "at least one start, a deviation between 0 and 1",
        "Correct them.",
    )
    for cell in suite.cells:
        _check_cell(cell)
    if suite.frozen:
        _check_frozen(suite)
    for log in suite.logs:
        _check_log(log, {c.name for c in suite.cells})


def _check_frozen(suite: Suite) -> None:
    """Every log is known, and none that is judged is a test of any cell, whatever its name."""
    known = {one.log for one in suite.data}
    locations = [*(p for c in suite.cells for p in c.tests), *(g.log for g in suite.logs)]
    missing = [p for p in (Stated.parse(one).path for one in locations) if p not in known]
    need(
        not missing,
        f"log '{next(iter(missing), '')}' of the frozen suite '{suite.name}' without [[data]]",
        "what every log holds",
        "Add it: python -m benchmarks.leaderboard freeze prints it.",
    )
    held = {one.log: one.held for one in suite.data}
    tests = {held[Stated.parse(p).path]: p for c in suite.cells for p in c.tests}
    for log in suite.logs:
        same = tests.get(held[Stated.parse(log.log).path], "")
        need(
            not same,
            f"log '{log.log}' of the frozen suite '{suite.name}', which is a test of a cell too "
            f"(as '{same}')",
            "training and test logs apart",
            "Judge on another.",
        )


def _check_cell(cell: SuiteCell) -> None:
    tests = (*cell.hppc, *cell.drive)
    what = "both a model and tests" if tests else "neither a model nor a test"
    need(
        bool(cell.model) != bool(tests),
        f"{what} of cell '{cell.name}'",
        "model = FILE, or hppc or drive logs to identify on",
        "Give one of the two.",
    )
    for location in cell.tests:
        Stated.parse(location)


def _check_log(log: SuiteLog, cells: set[str]) -> None:
    need(
        log.cell in cells,
        f"cell '{log.cell}' of log '{log.shown}'",
        f"one of {', '.join(sorted(cells))}",
        "Add a [[cell]] of that name.",
    )
    stated = Stated.parse(log.log)
    need(
        log.soc0 is None or stated.soc0 in (None, log.soc0),
        f"soc0 = {log.soc0} of log '{log.log}'",
        "one initial SOC",
        "Leave out one of them.",
    )
    known = (log.soc0 is not None or stated.soc0 is not None) and log.reference_Ah is not None
    need(
        known or stated.path.startswith(EMBEDDED),
        f"log '{log.shown}' without soc0 or reference_Ah",
        "the true SOC at its first row and the charge between full and empty",
        "Add both: nothing can be judged without.",
    )
    limits = {"soc0": (0.0, 1.0), "reference_Ah": (1e-6, 1e6), "from_soc": (0.0, 1.0),
              "hours": (1e-3, 1e6)}  # fmt: skip
    for name, (low, high) in limits.items():
        value = getattr(log, name)
        there = value is None or low <= value <= high
        need(there, f"{name} = {value} of log '{log.shown}'", f"{low:g} to {high:g}")

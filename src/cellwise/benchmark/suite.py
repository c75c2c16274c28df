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
from cellwise.errors import InputError
from cellwise.estimate.estimators import ESTIMATORS
from cellwise.logs.stated import Stated
from cellwise.records import check_ranges, keyed, need, record, within

GAUGES = ("cellwise.benchmark.gauges:TableGauge", "cellwise.benchmark.gauges:OneStateEkf")
BASELINES = ("coulomb", "rest-ocv", *GAUGES, "filterpy-ekf", "filterpy-ukf")
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
    soc0: float | None = within(0.0, 1.0, None)
    reference_Ah: float | None = within(1e-6, 1e6, None)
    from_soc: float | None = within(0.0, 1.0, None)
    hours: float | None = within(1e-3, 1e6, None)
    summed: bool = False
    quick: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, f"log '{self.log}'")

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
    dt_s: float | None = within(1e-6, 1e6, None)
    start_errors: tuple[float, ...] | None = within(-1.0, 1.0, None)
    faults: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        check_ranges(self, "[slow]")


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
class Suite:
    """Everything that a benchmark runs, as its file has it.

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
    cells, logs, slow
    data : of KnownLog                what every log of a frozen suite holds
    rows, not_run                     other people's estimators; those that cannot be had
    quick, only_quick                 the quick cut, and whether nothing else is run
    faults : of Fault                 beside the run without any
    folder : Path                     where paths begin
    sha256 : str                      of the suite's file
    """

    name: str = ""
    about: str = ""
    estimators: tuple[str, ...] = ("ekf", "ukf", "adaptive")
    start_errors: tuple[float, ...] = within(-1.0, 1.0, (0.0, 0.1, -0.1, 0.3, -0.3))
    fault_start_error: float = within(-1.0, 1.0, -0.3)
    every_start: bool = False
    soc0_std: float = within(1e-6, 1.0, 0.15)
    dt_s: float | None = within(1e-6, 1e6, None)
    frozen: int = 0
    cells: tuple[SuiteCell, ...] = keyed("cell")
    logs: tuple[SuiteLog, ...] = keyed("log")
    slow: Slow = field(default_factory=Slow)
    data: tuple[KnownLog, ...] = ()
    rows: tuple[PackageRow, ...] = keyed("row")
    not_run: tuple[NotRun, ...] = ()
    quick: Quick = field(default_factory=Quick)
    faults: tuple[Fault, ...] = keyed("")
    only_quick: bool = field(default=False, metadata={"key": ""})
    folder: Path = field(default=Path(), metadata={"key": ""})
    sha256: str = field(default="", metadata={"key": ""})

    def __post_init__(self) -> None:
        check_ranges(self, f"suite '{self.name}'")


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
    own = tuple(
        record(Fault, one, f"[[fault]] {k}") for k, one in enumerate(table.pop("fault", []), 1)
    )
    faults = (*_named_faults(table.pop("faults", [])), *own)
    suite = record(Suite, table, "the suite", faults=faults, folder=folder)
    estimators = _with_baselines(suite.estimators)
    suite = replace(suite, name=suite.name or name, estimators=estimators)
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
    known = {**GROUPS, **{name: (fault,) for name, fault in FAULTS.items()}}
    need(isinstance(names, list), f"faults = {names}", "a list of names, such as ['standard']")
    unknown = next((n for n in names if n not in known), None)
    need(
        unknown is None,
        f"fault '{unknown}'",
        f"one of {', '.join(known)}",
        "Choose one of them, or describe your own in [[fault]].",
    )
    found = dict.fromkeys(fault for name in names for fault in known[name])
    return tuple(f for f in found if f.name != NONE)


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
    need(bool(suite.start_errors), "no start_errors", "at least one start")
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

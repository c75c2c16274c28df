"""A suite's logs and models: found, read, cut, identified."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from cellwise.benchmark.known_logs import file_digest, find_known
from cellwise.benchmark.suite import EMBEDDED, Suite, SuiteCell, SuiteLog
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.model_file import read_model
from cellwise.cell.stock import stock_model, stock_names
from cellwise.data import datasets_folder, list_datasets
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.replay import reference_soc
from cellwise.estimate.tune_noise import tune_noise
from cellwise.identify.identification import CellTests, IdentifySettings
from cellwise.identify.pipeline import identify_cell
from cellwise.logs.cell_log import CellLog, resample
from cellwise.logs.reading import read_log
from cellwise.logs.stated import Stated
from cellwise.typing import FloatArray
from cellwise.wording import arg

MOST_LOCATED = 512


@dataclass(frozen=True, eq=False)
class JudgedLog:
    """A log as the benchmark judges it: what a filter may see, and the truth beside it."""

    log: CellLog
    truth: FloatArray
    reference_Ah: float

    @property
    def soc0(self) -> float:
        """True SOC at the first row."""
        return float(self.truth[0])

    @property
    def temperature_C(self) -> float | None:
        """Median of the measured temperatures."""
        if self.log.temperature_C is None or np.all(np.isnan(self.log.temperature_C)):
            return None
        return float(np.nanmedian(self.log.temperature_C))


def locate(location: str, suite: Suite, data: Path | None) -> Path:
    """The file of ``embedded:NAME`` or of a path, beside the suite or among the measured data.

    Raises
    ------
    InputError        nowhere
    """
    return _located(location, suite, data)[0]


def has_own_files(suite: Suite, data: Path | None) -> bool:
    """Whether every log of a frozen suite is the very file that it was frozen with."""
    return all(_located(one.log, suite, data)[1] for one in suite.data)


@lru_cache(maxsize=MOST_LOCATED)
def _located(location: str, suite: Suite, data: Path | None) -> tuple[Path, bool]:
    place = Stated.parse(location).path
    known = next((one for one in suite.data if one.log == place), None)
    places = _places(place, suite, data)
    if known is not None:
        return find_known(known, places, data)
    found = next((path for path in places if path.is_file()), None)
    if found is None:
        raise InputError(
            f"no log '{place}' of suite '{suite.name}'"
            + (" and no folder of measured data" if data is None else f" below '{data}'"),
            "a file beside the suite or in the folder of measured data",
            "Add " + arg("data", letter="DIR") + " or set CELLWISE_DATA."
            if data is None
            else "Correct its path.",
        )
    return found, True


def _places(place: str, suite: Suite, data: Path | None) -> tuple[Path, ...]:
    """Where a location may lead to."""
    if place.startswith(EMBEDDED):
        return (datasets_folder() / str(_entry(place.removeprefix(EMBEDDED))["file"]),)
    return tuple(folder / place for folder in (suite.folder, data) if folder is not None)


def check_files(suite: Suite, data: Path | None) -> None:
    """Refuse a suite that lacks a file, or judges a log that its model has seen.

    Raises
    ------
    InputError
    """
    seen: dict[str, dict[str, str]] = {}
    for cell in suite.cells:
        if cell.model:
            _named(cell.model, suite, data)
        seen[cell.name] = {file_digest(locate(p, suite, data)): p for p in cell.tests}
    for log in suite.logs:
        same = seen[log.cell].get(file_digest(locate(log.log, suite, data)))
        if same is not None:
            raise InputError(
                f"log '{log.log}', on which cell '{log.cell}' was identified (as '{same}')",
                "logs that the model has not seen",
                "Take it out of the cell's tests, or judge on another.",
            )


def read_at(location: str, suite: Suite, data: Path | None) -> CellLog:
    """A log, with what is stated of it."""
    return Stated.parse(location).applied(read_log(locate(location, suite, data)))


def judged_log(one: SuiteLog, suite: Suite, data: Path | None) -> JudgedLog:
    """A log with its truth: the tester's counter over the reference capacity.

    Raises
    ------
    InputError        no counter, no truth in the catalogue, a reference that never passes
                      ``from_soc``
    """
    log = read_at(one.log, suite, data)
    soc0, capacity = log.soc0 if one.soc0 is None else one.soc0, one.reference_Ah
    if soc0 is None or capacity is None:
        entry = _entry(Stated.parse(one.log).path.removeprefix(EMBEDDED))
        soc0 = float(str(entry["initial_soc"])) if soc0 is None else soc0
        capacity = float(str(entry["true_capacity_Ah"])) if capacity is None else capacity
    if one.summed and log.charge_Ah is None:
        log = replace(log, charge_Ah=np.cumsum(log.interval_current_A * log.interval_s) / 3600.0)
    truth = reference_soc(log, soc0, capacity)
    if truth is None:
        raise InputError(
            f"no charge counter in log '{one.shown}'",
            "the tester's counter (column ampere_hours)",
            "SOC has no other reference: judge on a log that has it.",
        )
    if one.from_soc is not None:
        rows = np.flatnonzero(truth <= one.from_soc)
        if rows.size == 0 or rows[0] > len(log) - 3:
            raise InputError(
                f"a SOC of {np.nanmin(truth):.3f} and more in log '{one.shown}'",
                f"one that passes {one.from_soc:g}",
                "Correct from_soc.",
            )
        log, truth = log.part(int(rows[0]), len(log)), truth[rows[0] :]
    if one.hours is not None:
        rows_kept = int(np.searchsorted(log.time_s - log.time_s[0], 3600.0 * one.hours, "right"))
        log, truth = log.part(0, rows_kept), truth[:rows_kept]
    return JudgedLog(replace(log, name=one.shown), truth, capacity)


def at_step(judged: JudgedLog, dt_s: float | None) -> JudgedLog:
    """The same on an even time step, gaps left as gaps; None: as it is."""
    if dt_s is None:
        return judged
    log = _even(judged.log, dt_s)
    if log.charge_Ah is None:
        raise InputError("no counter", "the tester's counter", "Judge on another log.")
    first = judged.log.charge_Ah
    start = 0.0 if first is None else float(first[np.isfinite(first)][0])
    truth = judged.soc0 - (log.charge_Ah - start) / judged.reference_Ah
    return JudgedLog(log, np.asarray(truth), judged.reference_Ah)


def _even(log: CellLog, dt_s: float) -> CellLog:
    even = resample(log, dt_s)
    kept = np.ones(len(even), dtype=np.bool_)
    for gap in log.gaps:  # a week's pause is no reason to step through it
        kept &= (even.time_s <= gap.start_s) | (even.time_s >= gap.start_s + gap.duration_s)
    return even.rows(kept)


def training_logs(
    cell: SuiteCell, model: CellModel, suite: Suite, data: Path | None
) -> list[tuple[str, CellLog, float]]:
    """A cell's tests by role, no finer than the suite's step, each with the SOC that it begins at.

    Pulses, capacities and drives begin full, as the tests of a cell do unless one states its SOC;
    a low-rate test where its rest is.
    """
    found = []
    for role in ("hppc", "ocv", "capacity", "drive"):
        for location in getattr(cell, role):
            log = read_at(location, suite, data)
            began = log.soc0 if log.soc0 is not None else 1.0
            if role == "ocv":
                began = initial_soc(model, log).soc
            step = max(suite.dt_s or 1.0, float(np.median(np.diff(log.time_s))))
            found.append((role, _even(log, step), began))
    return found


def cell_model(cell: SuiteCell, suite: Suite, data: Path | None) -> tuple[CellModel, Noise | None]:
    """A cell's model, and its tuned noise where there are logs to tune on."""
    if cell.model:
        model = _named(cell.model, suite, data)
    else:
        model = identify_cell(cell_tests(cell, suite, data), _settings(cell)).model
    if not cell.tune:
        return model, None
    logs = [_began_full(cell, suite, read_at(p, suite, data)) for p in cell.tune]
    return model, tune_noise(model, logs).noise


def _named(name: str, suite: Suite, data: Path | None) -> CellModel:
    """A model file beside the suite or among the measured data, else a stock model.

    Raises
    ------
    InputError        neither
    """
    try:
        place = locate(name, suite, data)
    except InputError:
        if name not in stock_names():
            raise
        return stock_model(name)
    return read_model(place)


def _settings(cell: SuiteCell) -> IdentifySettings:
    return IdentifySettings(
        nominal_Ah=cell.nominal_Ah,
        capacity_choice=cell.capacity_choice,
        temperature_C=cell.temperature_C,
        name=cell.name,
        chemistry=cell.chemistry,
    )


def cell_tests(cell: SuiteCell, suite: Suite, data: Path | None) -> CellTests:
    """A cell's tests as its identification takes them."""
    return CellTests(
        hppc=tuple((read_at(p, suite, data), Stated.parse(p).temperature_C) for p in cell.hppc),
        ocv=tuple(read_at(p, suite, data) for p in cell.ocv),
        capacity=tuple(read_at(p, suite, data) for p in cell.capacity),
        drive=tuple(
            (_began_full(cell, suite, read_at(p, suite, data)), Stated.parse(p).temperature_C)
            for p in cell.drive
        ),
    )


def _began_full(cell: SuiteCell, suite: Suite, log: CellLog) -> CellLog:
    """A drive with the start that rows of other packages are given: full.

    In the cold the first minute under load does not separate full from half, and a drive whose
    start nobody states is no test of a cell there.
    """
    stated = suite.frozen or cell.rested_full_V is not None
    return replace(log, soc0=1.0) if stated and log.soc0 is None else log


def _entry(name: str) -> dict[str, object]:
    entries = {str(e["name"]): e for e in list_datasets()}
    if name not in entries:
        raise InputError(
            f"data set '{name}'", f"one of {', '.join(entries)}", "See `cellwise data list`."
        )
    return entries[name]

"""A suite's runs, and what one process does: make a model, run one log with one fault."""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.adapter import described, is_adapter, load_adapter, short_name
from cellwise.benchmark.faults import NONE, Fault, applies, faulty_log, faulty_model
from cellwise.benchmark.figures import figures_of, state_bytes, whole_row
from cellwise.benchmark.package_rows import (
    PackageRow,
    RowError,
    RowEstimator,
    fitted_row,
    training_arrays,
)
from cellwise.benchmark.suite import Suite, SuiteCell
from cellwise.benchmark.suite_logs import (
    JudgedLog,
    at_step,
    cell_model,
    judged_log,
    training_logs,
)
from cellwise.cell.model import USUAL_C, CellModel
from cellwise.cell.model_file import read_model, write_model
from cellwise.errors import InputError
from cellwise.estimate.estimators import Adapted, Estimator, make_estimator
from cellwise.estimate.noise import Noise
from cellwise.estimate.replay import Replay, replay
from cellwise.files import write_atomically
from cellwise.logs.cell_log import CellLog
from cellwise.logs.stated import Stated


class BenchmarkRun(NamedTuple):
    """One estimator on one log from one start with one fault."""

    log: int
    fault: Fault
    start_error: float
    estimator: str
    dt_s: float | None


def runs_of(suite: Suite, log: int, judged: JudgedLog) -> Iterator[BenchmarkRun]:
    """Runs on one of the suite's logs.

    A start beyond full or empty does not exist and is left out, and so is a fault that the log
    cannot have.
    """
    soc0 = judged.soc0
    chemistry = next(c.chemistry for c in suite.cells if c.name == suite.logs[log].cell)
    for fault in (Fault(NONE), *suite.faults):
        if not applies(fault, chemistry, judged.log):
            continue
        healthy = fault.name == NONE
        starts = suite.start_errors
        if not healthy and not suite.every_start:
            starts = (possible(suite.fault_start_error, soc0),)
        for error in starts:
            if not 0.0 <= soc0 + error <= 1.0:
                continue
            in_quick = suite.quick.has(suite.logs[log], fault.name, error)
            if suite.only_quick and not in_quick:
                continue
            for name in suite.estimators:
                if _wanted(suite, name, fault, error):
                    yield BenchmarkRun(log, fault, error, name, _step(suite, name))
            for row in suite.rows:  # the fault of a model that they do not use is none
                if (in_quick or row.cut != "quick") and fault.capacity == 1.0:
                    yield BenchmarkRun(log, fault, error, row.name, suite.dt_s)


def marks(suite: Suite, run: BenchmarkRun) -> dict[str, bool]:
    """Whether a run is easy, and whether it is in the quick cut, as the suite now has it."""
    in_quick = suite.quick.has(suite.logs[run.log], run.fault.name, run.start_error)
    return {"easy": run.fault.name == NONE and run.start_error == 0.0, "quick": in_quick}


def possible(error: float, soc0: float) -> float:
    """A start error, to the other side where the SOC has no room for it, or none at all."""
    return next((e for e in (error, -error) if 0.0 <= soc0 + e <= 1.0), 0.0)


def is_slow(suite: Suite, name: str) -> bool:
    """Whether an estimator runs on less."""
    return name in suite.slow.estimators or short_name(name) in suite.slow.estimators


def _wanted(suite: Suite, name: str, fault: Fault, error: float) -> bool:
    if not is_slow(suite, name):
        return True
    starts, faults = suite.slow.start_errors, suite.slow.faults
    return (starts is None or error in starts) and (faults is None or fault.name in faults)


def _step(suite: Suite, name: str) -> float | None:
    return (suite.slow.dt_s or suite.dt_s) if is_slow(suite, name) else suite.dt_s


SEED = 20240725
KEPT_LOGS = 4
# A replay that takes less is clocked again: its first touch of the memory is not its step.
SHORT_S = 0.1
CLOCKED = 3


class SuiteFolders(NamedTuple):
    """A suite, its data and results; the folder of other packages' rows, and a Python for each."""

    suite: Suite
    data: Path | None
    folder: Path
    adapters: Path = Path()
    pythons: tuple[tuple[str, Path], ...] = ()

    def file(self, key: str, kind: str = "json") -> Path:
        """What is kept of a cell: model (``json``), ``noise.json``, ``training.npz`` of rows."""
        return self.folder / "models" / f"{key}.{kind}"


def make_model(place: SuiteFolders, number: int, key: str) -> str:
    """Identify the cell, unless it has been done before; its name."""
    cell = place.suite.cells[number]
    if not place.file(key).is_file():
        try:
            model, noise = cell_model(cell, place.suite, place.data)
        except InputError as error:
            raise InputError(
                f"cell '{cell.name}' of suite '{place.suite.name}': " + error.found,
                error.expected,
                error.action,
            ) from error
        if noise is not None:
            write_atomically(place.file(key, "noise.json"), json.dumps(vars(noise)))
        write_model(model, place.file(key))
    if place.suite.rows and not place.file(key, "training.npz").is_file():
        model = read_model(place.file(key))
        logs = training_logs(cell, model, place.suite, place.data)
        arrays = training_arrays(model, _temperature_C(cell), logs)
        whole = place.file(key, "training.npz")
        np.savez(whole.with_suffix(".part.npz"), **arrays)
        whole.with_suffix(".part.npz").replace(whole)
    return cell.name


def _temperature_C(cell: SuiteCell) -> float:
    """At which a cell was tested, as it is stated; a room's where it is not."""
    stated = (Stated.parse(p).temperature_C for p in (*cell.hppc, *cell.drive))
    known = (t for t in (cell.temperature_C, *stated) if t is not None)
    return next(known, USUAL_C)


def run_all(place: SuiteFolders, runs: tuple[BenchmarkRun, ...], key: str) -> list[dict[str, Any]]:
    """Rows of runs that share a log and a fault, each with the run's own number as ``key``."""
    return [_run(place, run, key) for run in runs]


@lru_cache(maxsize=KEPT_LOGS)
def _judged(place: SuiteFolders, number: int, dt_s: float | None) -> JudgedLog:
    return at_step(judged_log(place.suite.logs[number], place.suite, place.data), dt_s)


@lru_cache(maxsize=KEPT_LOGS)
def _model(model_file: Path, noise_file: Path) -> tuple[CellModel, Noise | None]:
    noise = None
    if noise_file.is_file():
        noise = Noise(**json.loads(noise_file.read_text(encoding="utf-8")))
    return read_model(model_file), noise


def _run(place: SuiteFolders, run: BenchmarkRun, key: str) -> dict[str, Any]:
    suite = place.suite
    one = suite.logs[run.log]
    judged = _judged(place, run.log, run.dt_s)
    true_model, noise = _model(place.file(key), place.file(key, "noise.json"))
    row: dict[str, Any] = {
        "suite": suite.name,
        "cell": one.cell,
        "log": judged.log.name,
        "temperature_C": _or_nan(judged.temperature_C),
        "estimator": short_name(run.estimator),
        "fault": run.fault.name,
        "start_error": run.start_error,
        "soc0": judged.soc0 + run.start_error,
        "soc0_true": judged.soc0,
        "samples": len(judged.log),
        "dt_s": float(np.median(np.diff(judged.log.time_s))),
        "reference_Ah": judged.reference_Ah,
        "model_Ah": true_model.capacity_Ah,
        "noise": "model" if noise is None else "tuned",
        **marks(suite, run),
    }
    try:
        row |= _judge(place, run, judged, (true_model, noise), key)
    except RowError as error:
        row["problem"] = str(error)
    except Exception as error:  # whatever somebody's filter does, the others go on
        row["problem"] = described(error)
    return whole_row(row)


def _judge(
    place: SuiteFolders,
    run: BenchmarkRun,
    judged: JudgedLog,
    identified: tuple[CellModel, Noise | None],
    key: str,
) -> dict[str, Any]:
    suite, (true_model, noise) = place.suite, identified
    rng = np.random.default_rng([SEED, zlib.crc32(f"{judged.log.name}{run.fault.name}".encode())])
    log = faulty_log(run.fault, judged.log, judged.reference_Ah, rng)
    model = faulty_model(run.fault, true_model)
    row = next((r for r in suite.rows if r.name == run.estimator), None)
    if row is None:
        estimator = _estimator(suite, run.estimator, model, noise)
    else:
        estimator = _row_estimator(place, row, model, key)
    found = replay(
        model,
        log,
        estimator,
        soc0=min(max(judged.soc0 + run.start_error, 0.0), 1.0),
        soc0_std=suite.soc0_std,
        reference_soc0=judged.soc0,
        reference_capacity_Ah=judged.reference_Ah,
    )
    lost = int(np.sum(~np.isfinite(found.trace.soc) & np.isfinite(judged.truth)))
    if lost:
        return {"problem": f"no SOC in {lost} of {len(log)} rows"}
    figures = figures_of(found, judged.truth)
    if isinstance(estimator, RowEstimator):
        figures["ns_per_step"] = estimator.ns_per_step
        figures["process_MB"] = estimator.process_MB
    elif run.fault.name == NONE:
        figures["ns_per_step"] = _best_ns(found, log, estimator, suite.soc0_std)
    return {**figures, "state_bytes": state_bytes(estimator)}


def _best_ns(found: Replay, log: CellLog, estimator: Estimator, soc0_std: float) -> float:
    """Nanoseconds per step, the best of a few replays where one is short."""
    best = found.ns_per_step
    for _ in range(CLOCKED):
        if best * len(log) > 1e9 * SHORT_S:
            break
        began = time.perf_counter()
        estimator.run(log, found.start.soc, soc0_std)
        best = min(best, 1e9 * (time.perf_counter() - began) / len(log))
    return best


def _estimator(suite: Suite, name: str, model: CellModel, noise: Noise | None) -> Estimator:
    if is_adapter(name):
        return Adapted(short_name(name), model, load_adapter(name, suite.folder)(model))
    return make_estimator(name, model, noise)


def _row_estimator(
    place: SuiteFolders, row: PackageRow, model: CellModel, key: str
) -> RowEstimator:
    """A row in its process, fitted to the cell's tests the first time.

    Raises
    ------
    RowError
    """
    training, python = place.file(key, "training.npz"), dict(place.pythons)[row.name]
    process, fitted = fitted_row(python, place.adapters, row, training, SEED)
    return RowEstimator(process, model, training, fitted)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value

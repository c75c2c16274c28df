"""Faults where they count: Panasonic at 25 degC, cut in the middle, under load, 30 points wrong.

US06, NN and HWFTa, which no fit has seen, with one thing wrong; the worse sign of each, mean of six
runs. A model with two drives in its fit and one of laboratory tests alone; filterpy's EKF beside,
at samples of 1 s, as it needs hundreds of microseconds for one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy.panasonic import CELL, NOMINAL_AH, REFERENCE_AH
from benchmarks.figures import Figure, Progress, missing
from benchmarks.measured_data import measured_log
from cellwise import IdentifySettings, InputError, TestLogs, identify_cell
from cellwise.cell.model import CellModel
from cellwise.estimate.estimators import make_estimator
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample
from cellwise.typing import FloatArray

FITTED, JUDGED = ("cycle_2", "cycle_4"), ("us06", "nn", "hwfta")
STARTS = ((0.65, -0.3), (0.50, 0.3))
LOADED_A = 1.0
ESTIMATORS = ("ekf", "ukf", "adaptive", "filterpy-ekf")
Wrong = Callable[[CellModel, CellLog], tuple[CellModel, CellLog]]


@dataclass(frozen=True)
class Fault:
    """What is asked with a model that has seen drives [% of SOC]; ``put`` does it."""

    name: str
    asked: float | None
    put: tuple[Wrong, ...]


def off_by(share: float) -> Wrong:
    """A current sensor with an offset, as a share of 1C."""
    return lambda m, g: (m, replace(g, current_A=g.current_A + share * NOMINAL_AH))


def gained(factor: float) -> Wrong:
    """A current sensor with a gain."""
    return lambda m, g: (m, replace(g, current_A=factor * g.current_A))


def lifted(by_V: float) -> Wrong:
    """A voltage sensor with an offset."""
    return lambda m, g: (m, replace(g, voltage_V=g.voltage_V + by_V))


def late(by_s: float) -> Wrong:
    """A voltage that is sampled later than the current."""

    def put(model: CellModel, log: CellLog) -> tuple[CellModel, CellLog]:
        when = log.time_s - by_s
        return model, replace(log, voltage_V=np.interp(when, log.time_s, log.voltage_V))

    return put


def sized(factor: float) -> Wrong:
    """A model whose capacity is not the cell's."""
    return lambda m, g: (replace(m, capacity_Ah=factor * m.capacity_Ah), g)


FAULTS = (
    Fault("nothing wrong", None, (lambda m, g: (m, g),)),
    Fault("offset 3 % of 1C", 0.8, (off_by(0.03), off_by(-0.03))),
    Fault("gain 3 %", 0.8, (gained(1.03), gained(0.97))),
    Fault("voltage 5 mV", 0.7, (lifted(0.005), lifted(-0.005))),
    Fault("skew 0.2 s", 0.5, (late(0.2), late(-0.2))),
    Fault("capacity 10 % wrong", 1.2, (sized(0.9), sized(1.0 / 0.9))),
)
SLOW, SLOW_S = "filterpy-ekf", 1.0
LABORATORY = 1.5  # times as much is asked of the model without drives


def faults_figures(data: Path, say: Progress) -> list[Figure]:
    """Both models, every fault, every estimator."""
    drives = tuple((measured_log(data, f"{CELL}/drive_p25_{n}"), None) for n in FITTED)
    tests = TestLogs(
        hppc=((measured_log(data, f"{CELL}/hppc_p25"), None),),
        ocv=(measured_log(data, f"{CELL}/ocv_c20_p25"),),
        capacity=tuple(measured_log(data, f"{CELL}/cap_1c_p25_start_{k}") for k in (1, 2)),
        drive=drives,
    )
    settings = IdentifySettings(nominal_Ah=NOMINAL_AH, name="Panasonic 18650PF")
    figures: list[Figure] = []
    for name, given, more in (
        ("laboratory tests, cycles 2 and 4", tests, 1.0),
        ("laboratory tests alone", replace(tests, drive=()), LABORATORY),
    ):
        say(f"faults: model of {name}")
        model = identify_cell(given, settings).model
        parts = list(_cut(data))
        for fault in FAULTS:
            group = f"Panasonic 25 degC from the middle, {fault.name}; {name}"
            asked = None if fault.asked is None else more * fault.asked
            figures += [_judged(group, e, fault, model, parts, asked) for e in ESTIMATORS]
    return figures


def _cut(data: Path) -> Iterator[tuple[CellLog, float]]:
    """The rest of each drive from where it is loaded in the middle, and how far off it begins."""
    for name in JUDGED:
        log = measured_log(data, f"{CELL}/drive_p25_{name}")
        truth = truth_of(log)
        for soc, wrong in STARTS:
            begin = int(np.argmax(truth < soc))
            begin += int(np.argmax(log.current_A[begin:] > LOADED_A))
            yield log.part(begin, len(log)), wrong


def truth_of(log: CellLog) -> FloatArray:
    """SOC by the tester's counter, of a log that began full."""
    if log.charge_Ah is None:
        raise ValueError(f"no counter in log '{log.name}'")
    return np.asarray(1.0 - log.charge_Ah / REFERENCE_AH)


def _judged(
    group: str,
    estimator: str,
    fault: Fault,
    model: CellModel,
    parts: list[tuple[CellLog, float]],
    asked: float | None,
) -> Figure:
    """One estimator and fault: the worse sign, mean over drives and starts."""
    who = f"{estimator}: SOC RMSE after the first quarter"
    try:
        signs = [
            np.mean([_run(estimator, *put(model, log), wrong) for log, wrong in parts], axis=0)
            for put in fault.put
        ]
    except InputError as error:
        return missing(group, who, "%", str(error))
    rmse, inside = max(signs, key=lambda s: float(s[0]))
    note = f"{100 * inside:.0f} % of the rows inside two sigma"
    return Figure(group, who, 100.0 * float(rmse), "%", target=asked, note=note)


def _run(estimator: str, model: CellModel, log: CellLog, wrong: float) -> tuple[float, float]:
    """RMSE after the first quarter, and the share of the rows inside two sigma."""
    if estimator == SLOW:
        log = resample(log, SLOW_S)
    truth = truth_of(log)
    found = make_estimator(estimator, model).run(log, float(truth[0]) + wrong, 0.15)
    error = found.soc - truth
    late = error[error.size // 4 :]
    inside = float(np.mean(np.abs(error) < 2.0 * found.soc_std))
    return float(np.sqrt(np.mean(late**2))), inside

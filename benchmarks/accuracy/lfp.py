"""A123 26650 (LFP), each temperature of -25 to 45 degC left out of the fit in turn.

Identified on the C/30 branches at 25 degC and the drives of the other temperatures, judged on the
drive at the one left out: from a start that is known and one that nobody vouches for, beside
counting; 30 points wrong from the middle of the plateau; with a current that is 3 % of 1C off. The
log's own current drifts from the tester's counter by up to 1.2 %.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.accuracy.judging import voltage_rmse_mV
from benchmarks.figures import Figure, Progress
from benchmarks.measured_data import measured_log
from benchmarks.parts import each_case
from cellwise import CellTests, IdentifySettings, identify_cell
from cellwise.cell.model import CellModel
from cellwise.estimate.estimators import make_estimator
from cellwise.logs import CellLog
from cellwise.typing import FloatArray

CELL = "plett_a123"
NOMINAL_AH = 2.07
REFERENCE_AH = 2.0725
CHAMBER_C = {"n25": -25.0, "n15": -15.0, "p05": 5.0, "p25": 25.0, "p35": 35.0, "p45": 45.0}
BRANCHES = ("s1", "s3")  # C/30 discharge and charge at 25 degC
ESTIMATORS = ("ekf", "ukf", "adaptive")
KNOWN_STD, UNVOUCHED_STD = 0.005, 0.15
# In the middle of the plateau; 30 points away on either side.
STARTS = ((0.65, -0.3), (0.5, 0.3), (0.5, -0.3))
LOADED_A = 1.0
PASSED = 0.2  # of the capacity, by when the start must be forgotten
OFFSET_C = 0.03
LOST = 0.3  # points, against counting
WORSE = 0.2  # points, adaptive against the EKF


@dataclass(frozen=True)
class Judged:
    """Error of an estimated SOC, the rows' own, and the share of rows inside two sigma."""

    error: FloatArray
    inside: float

    @property
    def rmse(self) -> float:
        """Over all rows, 0..1."""
        return float(np.sqrt(np.mean(np.square(self.error))))


def chamber_log(data: Path, name: str, chamber_C: float, soc0: float | None) -> CellLog:
    """A log with its chamber's temperature, which the file does not hold."""
    log = measured_log(data, f"{CELL}/{name}")
    return replace(log, name=name, temperature_C=np.full(len(log), chamber_C), soc0=soc0)


def drive(data: Path, tag: str) -> CellLog:
    """The drive at one temperature, from full."""
    return chamber_log(data, f"dyn_{tag}_s1", CHAMBER_C[tag], 1.0)


def model_without(data: Path, tag: str) -> CellModel:
    """The model that has not seen a temperature."""
    branches = tuple(chamber_log(data, f"ocv_p25_{part}", 25.0, None) for part in BRANCHES)
    others = tuple((drive(data, t), CHAMBER_C[t]) for t in CHAMBER_C if t != tag)
    tests = CellTests(ocv=branches, drive=others)
    return identify_cell(tests, IdentifySettings(nominal_Ah=NOMINAL_AH)).model


def judged(
    model: CellModel, log: CellLog, name: str, soc0: float, std: float, truth: FloatArray
) -> Judged:
    """One estimator over one log."""
    trace = make_estimator(name, model).run(log, soc0, std)
    error = trace.soc - truth
    return Judged(error, float(np.mean(np.abs(error) < 2.0 * trace.soc_std)))


def truth_of(log: CellLog) -> FloatArray:
    """SOC by the tester's counter, of a log that begins full."""
    if log.charge_Ah is None:
        raise ValueError(f"no counter in log '{log.name}'")
    return np.asarray(1.0 - (log.charge_Ah - log.charge_Ah[0]) / REFERENCE_AH)


def from_known(model: CellModel, log: CellLog, name: str, std: float = KNOWN_STD) -> Judged:
    """From full, which is true."""
    return judged(model, log, name, 1.0, std, truth_of(log))


def from_plateau(model: CellModel, log: CellLog, name: str) -> Iterator[tuple[Judged, FloatArray]]:
    """30 points wrong, under load, from the middle of the plateau; with the true SOC."""
    whole = truth_of(log)
    for at_soc, wrong in STARTS:
        begin = int(np.argmax(whole < at_soc))
        begin += int(np.argmax(log.current_A[begin:] > LOADED_A))
        truth = whole[begin:]
        part = log.part(begin, len(log))
        yield judged(model, part, name, float(truth[0]) + wrong, UNVOUCHED_STD, truth), truth


def with_offset(model: CellModel, log: CellLog, name: str) -> list[Judged]:
    """From a known start with a current that is off, either way."""
    off = OFFSET_C * REFERENCE_AH
    logs = (replace(log, current_A=log.current_A + sign * off) for sign in (1.0, -1.0))
    return [from_known(model, one, name) for one in logs]


def lfp_figures(data: Path, say: Progress) -> list[Figure]:
    """Every temperature left out in turn."""
    cases = (
        (f"A123 {warm:.0f} degC, no drive of it in the fit", tag) for tag, warm in CHAMBER_C.items()
    )
    return each_case(((group, partial(_left_out, data, group, tag)) for group, tag in cases), say)


def _left_out(data: Path, group: str, tag: str) -> list[Figure]:
    """One temperature."""
    model, log = model_without(data, tag), drive(data, tag)
    voltage_mV = voltage_rmse_mV(model, log, 1.0)
    figures = [Figure(group, "voltage RMSE above 10 % SOC", voltage_mV, "mV")]
    known = {name: from_known(model, log, name) for name in ("coulomb", *ESTIMATORS)}
    for name in ESTIMATORS:
        figures += _of_estimator(group, model, log, name, known)
    return figures


def _of_estimator(
    group: str, model: CellModel, log: CellLog, name: str, known: dict[str, Judged]
) -> list[Figure]:
    """What the issue asks of one estimator at one temperature."""
    counted = known["coulomb"]
    unvouched = from_known(model, log, name, UNVOUCHED_STD)
    found = [
        _lost(group, f"{name}, known start", known[name], counted, LOST),
        _lost(group, f"{name}, true start +-15 points", unvouched, counted, LOST),
    ]
    if name == "adaptive":
        found.append(_lost(group, f"{name} less ekf", known[name], known["ekf"], WORSE))
    middle = list(from_plateau(model, log, name))
    inside = float(np.mean([run.inside for run, _ in middle]))
    late = [run.error[truth < truth[0] - PASSED] for run, truth in middle]
    worst = max(float(np.sqrt(np.mean(np.square(e)))) for e in late)
    largest = max(float(np.max(np.abs(e))) for e in late)
    wrong = f"{name}, 30 points wrong on the plateau"
    found += [
        Figure(group, f"{wrong}: rows inside two sigma",
               100 * inside, "%", target=95.0, at_least=True),
        Figure(group, f"{wrong}: SOC RMSE after 20 % of the charge, worst start",
               100 * worst, "%", target=2.0, headline=name == "ekf",
               note=f"{100 * inside:.0f} % of the rows inside two deviations, largest error "
               f"{100 * largest:.1f} %"),
    ]  # fmt: skip
    off, counting = with_offset(model, log, name), with_offset(model, log, "coulomb")
    found.append(
        Figure(
            group,
            f"{name}, known start, current 3 % of 1C off: SOC RMSE, worse sign",
            100 * max(run.rmse for run in off),
            "%",
            target=1.0,
            note=f"counting {100 * max(run.rmse for run in counting):.1f} %; 2-sigma band covers "
            f"{100 * min(run.inside for run in off):.0f} %",
        )
    )
    return found


def _lost(group: str, who: str, ours: Judged, other: Judged, most: float) -> Figure:
    """Points of RMSE lost against another estimator."""
    return Figure(
        group,
        f"{who}: SOC RMSE lost",
        100 * (ours.rmse - other.rmse),
        "points",
        target=most,
        note=f"{100 * ours.rmse:.2f} %; 2-sigma band covers {100 * ours.inside:.0f} %",
    )

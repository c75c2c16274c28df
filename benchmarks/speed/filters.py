"""EKF replay: time per step, ours and filterpy's."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np

from benchmarks.example_cell import SAMPLES, START_SOC, load_log, three_branches, two_branches
from benchmarks.figures import Figure, Progress, clock, missing, with_ratios
from benchmarks.measured_data import HOW, measured_log
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.filters.bank_kernels import empty_bank
from cellwise.estimate.filters.filter_state import OUTPUTS, TraceArrays
from cellwise.estimate.filters.kalman import Ekf, log_arrays
from cellwise.estimate.filters.kalman_kernels import kalman_rows
from cellwise.estimate.lockstep import LockstepEkf, LockstepState
from cellwise.logs import CellLog

UNIT = "ns/step"
TARGET_NS = 120.0
DRIVE = "panasonic_18650pf/drive_p25_us06"
FEW = 3000
CELLS = 10_000
LOCKSTEP_STEPS = 200
LOCKSTEP_NS = 40.0


def filter_figures(data: Path | None, say: Progress, *, full: bool = False) -> list[Figure]:
    """Ours over 36,000 samples and over a measured drive, step by step, and filterpy."""
    log = load_log()
    group = f"EKF, {SAMPLES:,} samples at 1 Hz, start 30 points wrong"
    figures = [
        _kernel(group, "cellwise, compiled replay, 2-RC", two_branches(), log, say),
        _kernel(group, "cellwise, compiled replay, 3 branches", three_branches(), log, say),
    ]
    who = "cellwise, compiled replay, 3 branches, measured 10 Hz drive"
    if data is None:
        figures.append(missing(group, who, UNIT, f"no measured drive: {HOW}"))
    else:
        figures.append(_kernel(group, who, three_branches(), measured_log(data, DRIVE), say))
    figures += [_online(group, log, say), _filterpy(group, log, say)]
    return [*with_ratios(figures), *lockstep_figures(say)]


def lockstep_figures(say: Progress) -> list[Figure]:
    """Ten thousand cells, one call per sample, on one core."""
    group = f"EKF in lockstep, {CELLS:,} cells, 1 Hz"
    log = load_log().part(0, LOCKSTEP_STEPS)
    rng = np.random.default_rng(1)
    figures = []
    for who, model in (("2-RC", two_branches()), ("3 branches", three_branches())):
        say(f"lockstep, {who}")
        fleet = LockstepEkf(model, CELLS, 1.0)
        voltage = simulate(model, log, START_SOC).voltage_V
        current = log.current_A[:, None] + 0.01 * rng.standard_normal((len(log), CELLS))
        measured = voltage[:, None] + 0.002 * rng.standard_normal((len(log), CELLS))
        state = fleet.init(START_SOC, 0.01)
        turn = iter(itertools.cycle(range(len(log))))
        short = 0

        def work(fleet: LockstepEkf = fleet, state: LockstepState = state) -> None:
            nonlocal short
            k = next(turn)  # noqa: B023
            _, info = fleet.step(state, current[k], measured[k], 25.0)  # noqa: B023
            short = info.short

        timing = clock(work)
        figures.append(
            Figure(
                group,
                f"cellwise, LockstepEkf.step, {who}",
                1e9 * timing.best / CELLS,
                "ns/cell-step",
                target=LOCKSTEP_NS,
                headline=who == "3 branches",
                note=f"best of {timing.runs} steps, median {1e9 * timing.median / CELLS:.0f}; "
                f"{100 * short / CELLS:.0f} % of the cells the short way",
            )
        )
    return figures


def _kernel(group: str, who: str, model: CellModel, log: CellLog, say: Progress) -> Figure:
    say(who)
    ekf = Ekf(model)
    tables, noise = model.parameters(), ekf.noise.scalars()
    start = ekf.start(START_SOC - 0.3)
    rows = log_arrays(log)
    out = TraceArrays(np.empty((OUTPUTS, len(log))), np.empty(len(log), dtype=np.int32))
    bank = empty_bank()

    def work() -> None:
        kalman_rows(tables, noise, None, start, start, bank, rows, out)

    timing = clock(work)
    return Figure(
        group,
        who,
        1e9 * timing.best / len(log),
        UNIT,
        target=TARGET_NS,
        headline="measured" in who,
        note=f"{len(log):,} steps, best of {timing.runs}, "
        f"median {1e9 * timing.median / len(log):.0f}",
    )


def _online(group: str, log: CellLog, say: Progress) -> Figure:
    """The step that a program calls sample by sample."""
    say("Ekf.step")
    ekf = Ekf(three_branches())
    few = log.part(0, FEW)
    samples = list(
        zip(few.current_A.tolist(), few.voltage_V.tolist(), few.interval_s.tolist(), strict=True)
    )

    def work() -> None:
        state = ekf.init(START_SOC - 0.3)
        for current, voltage, dt in samples:
            state, _ = ekf.step(state, current, voltage, 25.0, dt_s=dt)

    timing = clock(work)
    note = "called from Python, one sample at a time"
    return Figure(group, "cellwise, Ekf.step", 1e9 * timing.best / FEW, UNIT, note=note)


def _filterpy(group: str, log: CellLog, say: Progress) -> Figure:
    """filterpy's matrices on the same model and noise."""
    who = "filterpy ExtendedKalmanFilter"
    say(who)
    try:
        baseline = make_estimator("filterpy-ekf", three_branches())
    except ImportError as error:
        return missing(group, who, UNIT, f"{error.name} is not installed")
    few = log.part(0, FEW)
    timing = clock(lambda: baseline.run(few, START_SOC), seconds=2.0)
    theirs = baseline.run(few, START_SOC).soc
    ours = Ekf(three_branches()).run(few, START_SOC).soc
    apart = float(np.max(np.abs(theirs - ours)))
    note = f"{FEW:,} steps; SOC at most {100 * apart:.2g} points from ours from the right start"
    if not math.isfinite(apart):
        note = f"{FEW:,} steps; its SOC is not finite"
    return Figure(group, who, 1e9 * timing.best / FEW, UNIT, note=note)

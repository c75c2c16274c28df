"""Simulation: time per sample, ours and others'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.example_cell import SAMPLES, START_SOC, load_log, three_branches, two_branches
from benchmarks.figures import Figure, Progress, clock, missing, with_ratios
from benchmarks.measured_data import HOW, measured_log
from benchmarks.speed import simulation_references as references
from cellwise.cell.equations import empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C, simulate, simulate_rows
from cellwise.logs import CellLog

UNIT = "ns/sample"
TARGET_NS = 40.0
DRIVE = "panasonic_18650pf/drive_p25_us06"


def simulate_figures(data: Path | None, say: Progress, *, full: bool = False) -> list[Figure]:
    """Ours over 36,000 samples at 1 Hz and over a measured drive, then the others."""
    log = load_log()
    group = f"simulate, 2-RC, {SAMPLES:,} samples at 1 Hz"
    figures = [_kernel(group, "cellwise, compiled loop", two_branches(), log, say)]
    figures += [
        _kernel(group, "cellwise, compiled loop, 3 branches", three_branches(), log, say),
        _whole_call(group, two_branches(), log, say),
        _drive(group, data, say),
    ]
    lengths = {
        "plain NumPy loop": (references.plain_loop, SAMPLES),
        "PyBaMM Thevenin": (references.pybamm_thevenin, SAMPLES if full else 7200),
        "thevenin Simulation": (references.thevenin_simulation, SAMPLES if full else 1800),
        "thevenin Prediction": (references.thevenin_prediction, SAMPLES if full else 1800),
    }
    for who, (run, samples) in lengths.items():
        say(who)
        figures.append(_peer(group, who, run, log.part(0, samples)))
    return with_ratios(figures)


def _kernel(group: str, who: str, model: CellModel, log: CellLog, say: Progress) -> Figure:
    say(who)
    tables = model.parameters()
    dt, current = log.interval_s, log.known_current_A()
    temperature = known_temperature_C(model, log)
    voltage, soc = np.empty(len(log)), np.empty(len(log))
    start = empty_state(START_SOC)

    def work() -> None:
        simulate_rows(tables, start, dt, current, temperature, voltage, soc)

    timing = clock(work)
    return Figure(
        group,
        who,
        1e9 * timing.best / len(log),
        UNIT,
        target=TARGET_NS,
        note=f"best of {timing.runs} runs, median {1e9 * timing.median / len(log):.1f}",
    )


def _whole_call(group: str, model: CellModel, log: CellLog, say: Progress) -> Figure:
    say("simulate()")
    timing = clock(lambda: simulate(model, log, START_SOC))
    note = "with intervals, gaps and temperature of the log prepared"
    return Figure(group, "cellwise, simulate()", 1e9 * timing.best / len(log), UNIT, note=note)


def _drive(group: str, data: Path | None, say: Progress) -> Figure:
    who = "cellwise, compiled loop, 3 branches, measured 10 Hz drive"
    if data is None:
        return missing(group, who, UNIT, f"no measured drive: {HOW}")
    log = measured_log(data, DRIVE)
    figure = _kernel(group, who, three_branches(), log, say)
    return Figure(
        group, who, figure.value, UNIT, target=TARGET_NS, note=f"{len(log):,} rows of {log.name}"
    )


def _peer(
    group: str,
    who: str,
    run: Callable[[CellModel, CellLog, float], references.Answer],
    log: CellLog,
) -> Figure:
    """Somebody else over the log; their voltage is compared with ours, so that both did the job."""
    model = two_branches()
    try:
        voltage, seconds = min((run(model, log, START_SOC) for _ in range(2)), key=lambda x: x[1])
    except ImportError as error:
        return missing(group, who, UNIT, f"{error.name} is not installed")
    ours = simulate(model, log, START_SOC).voltage_V
    apart = 1e3 * float(np.sqrt(np.mean((voltage - ours)[1:] ** 2)))
    note = f"{apart:.2g} mV RMS from ours"
    if len(log) < SAMPLES:
        note = (
            f"measured over {len(log):,} samples ({seconds:.1f} s), not extrapolated; more samples "
            f"with --full; {note}"
        )
    return Figure(group, who, 1e9 * seconds / len(log), UNIT, note=note)

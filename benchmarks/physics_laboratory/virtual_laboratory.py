"""The laboratory of a healthy cell: C/20 out and in, HPPC, as an instrument writes them."""

from __future__ import annotations

import numpy as np

from benchmarks.physics_laboratory.cell_physics import (
    Array,
    Limits,
    Response,
    capacity_Ah,
    limits_of,
    respond,
)
from benchmarks.physics_laboratory.changes import Condition
from benchmarks.physics_laboratory.published_cells import PublishedCell
from cellwise.logs.cell_log import CellLog

VOLTAGE_NOISE_V, TEMPERATURE_NOISE_C = 0.3e-3, 0.05
CURRENT_NOISE = 2e-4  # of 1C
# What a channel can show; that of the current is a share of 1C.
VOLTAGE_STEP_V, CURRENT_STEP, TEMPERATURE_STEP_C = 1e-4, 1e-4, 0.1
HEALTHY = Condition()
Step = tuple[float, float, float]  # current over capacity [1/h], seconds, interval of the rows

PULSE_C, CHARGE_PULSE_C = 0.75, 0.5  # of the largest rate of the drives
REST_S = 2400.0


def low_rate_log(cell: PublishedCell, rng: np.random.Generator) -> CellLog:
    """C/20 from full to empty, an hour of rest, C/20 to full."""
    rest, out = [(0.0, 60.0, 10.0)], [(0.05, 22.0 * 3600.0, 60.0)]
    down = _run(cell, [*rest, *out], limits_of(cell))
    seconds = 60.0 * (down[2].voltage_V.size - 8)
    steps = [*rest, (0.05, seconds, 60.0), (0.0, 3600.0, 60.0), (-0.05, 22.0 * 3600.0, 60.0)]
    low = Limits(limits_of(cell).lower_V - 0.3, limits_of(cell).upper_V)
    return _log(cell, *_run(cell, steps, low), rng, "C/20")


def hppc_log(cell: PublishedCell, rng: np.random.Generator) -> CellLog:
    """Ten levels from full; pulses out and, below full, in; the SOC between them at C/3."""
    out, into = PULSE_C * cell.largest_C, CHARGE_PULSE_C * cell.largest_C
    steps: list[Step] = [(0.0, 60.0, 1.0)]
    for level in np.arange(1.0, 0.05, -0.1):
        steps += [(out, 10.0, 0.1), (0.0, 60.0, 0.2), (0.0, 240.0, 2.0)]
        kept = -10.0 * out / 3600.0
        if level < 0.85:
            steps += [(-into, 10.0, 0.1), (0.0, 60.0, 0.2), (0.0, 240.0, 2.0)]
            kept += 10.0 * into / 3600.0
        steps += [(1.0 / 3.0, (0.1 + kept) * 3.0 * 3600.0, 5.0), (0.0, REST_S, 5.0)]
    window = limits_of(cell)
    wide = Limits(window.lower_V - 0.2, window.upper_V + 0.1)
    return _log(cell, *_run(cell, steps, wide), rng, "HPPC")


def _run(cell: PublishedCell, steps: list[Step], window: Limits) -> tuple[Array, Array, Response]:
    """Rows of time and current that the steps make of a full cell, and its response."""
    time, current = [0.0], [0.0]
    for rate, seconds, interval in steps:
        rows = max(round(seconds / interval), 1)
        time += list(time[-1] + seconds * np.arange(1, rows + 1) / rows)
        current += [rate * capacity_Ah(cell)] * rows
    t, amps = np.array(time), np.array(current)
    found = respond(cell, HEALTHY, t, amps, 1.0, window)
    rows = found.voltage_V.size
    return t[:rows], amps[:rows], found


def _log(
    cell: PublishedCell,
    time_s: Array,
    current_A: Array,
    found: Response,
    rng: np.random.Generator,
    name: str,
) -> CellLog:
    counter = np.concatenate(([0.0], np.cumsum(current_A[1:] * np.diff(time_s)))) / 3600.0
    q = capacity_Ah(cell)
    noise = rng.standard_normal((3, time_s.size))
    return CellLog(
        time_s,
        shown(current_A + CURRENT_NOISE * q * noise[0], CURRENT_STEP * q),
        shown(found.voltage_V + VOLTAGE_NOISE_V * noise[1], VOLTAGE_STEP_V),
        shown(found.cell_C + TEMPERATURE_NOISE_C * noise[2], TEMPERATURE_STEP_C),
        charge_Ah=counter,
        name=name,
    )


def shown(values: Array, step: float) -> Array:
    """Values as a channel of a resolution shows them."""
    return np.round(values / step) * step

"""A cell richer than any model fitted to it, and a logger that keeps rows in whatever way.

Four RC branches from a second to three quarters of an hour, every one a function of SOC: more than
the two or three branches of a model, so a fit is judged by what it says, not by what it repeats.
It goes through the tester of ``synthetic``, never through the package's own kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.logs.cell_log import CellLog
from synthetic import Array, HppcPlan, Table, Tester, drive_current, nmc_cell

FINE_HZ, COARSE_HZ = 10.0, 1.0  # of the true rows, the fine ones just after a switch
FINE_FIRST = HppcPlan(fast_s=20.0, limit="stop")


@dataclass(frozen=True)
class RichCell:
    """OCV, R0 and branches (resistance, time constant) over SOC; limits in volt."""

    capacity_Ah: float
    ocv_V: Table
    r0_ohm: Table
    branches: tuple[tuple[Table, Table], ...]
    lower_V: float = 2.5
    upper_V: float = 4.2


def rich_nmc(capacity_Ah: float = 3.0) -> RichCell:
    """Branches of 1, 15, 180 and 2600 s, all stiffer towards empty."""
    k = 3.0 / capacity_Ah

    def share(ohm: float, rise: float, steep: float) -> Table:
        return lambda s: k * ohm * (1.0 + rise * np.exp(-steep * s))

    return RichCell(
        capacity_Ah,
        nmc_cell(capacity_Ah).ocv_V,
        share(0.024, 0.4, 9.0),
        (
            (share(0.006, 1.0, 8.0), lambda s: 0.8 + 0.6 * s),
            (share(0.010, 1.5, 8.0), lambda s: 12.0 + 6.0 * s),
            (share(0.012, 1.5, 7.0), lambda s: 150.0 + 60.0 * s),
            (share(0.014, 1.5, 6.0), lambda s: 2200.0 + 800.0 * s),
        ),
    )


@dataclass(frozen=True)
class Logger:
    """How rows are taken: every ``period_s`` of its own clock, and at switches if ``switches``.

    change_V : then a row is kept only where the voltage, or the current, moved by that much
        (100 times that in ampere) since the last row kept, or ``keep_alive_s`` have passed
    offset_A : what the current sensor adds
    """

    period_s: float = 1.0
    switches: bool = True
    noise_V: float = 3e-4
    resolution_V: float = 1e-3
    noise_A: float = 1e-3
    resolution_A: float = 1e-3
    offset_A: float = 0.0
    change_V: float = 0.0
    keep_alive_s: float = 60.0
    counter: bool = True


@dataclass(frozen=True)
class Made:
    """A log, and what is true at its rows."""

    log: CellLog
    soc: Array
    voltage_V: Array


def run(
    cell: RichCell,
    steps: Sequence[tuple[float, float]],
    soc0: float,
    logger: Logger | None = None,
    *,
    seed: int = 0,
    name: str = "test",
    temperature_C: float | None = 25.0,
) -> Made:
    """Run steps of (current [A], duration [s]) from rest; a step ends early at a voltage limit."""
    logger, rng = logger or Logger(), np.random.default_rng(seed)
    tester = Tester(cell, soc0, rng)
    for current_A, seconds in steps:
        tester.run(current_A, seconds, COARSE_HZ, plan=FINE_FIRST, fast_hz=FINE_HZ)
    dt, i, soc, v, _ = (np.concatenate(c) for c in zip(*tester.columns, strict=True))
    return _logged(cell, np.cumsum(dt), i, soc, v, soc0, logger, rng, name, temperature_C)


def _logged(
    cell: RichCell,
    t: Array,
    i: Array,
    soc: Array,
    v: Array,
    soc0: float,
    logger: Logger,
    rng: np.random.Generator,
    name: str,
    temperature_C: float | None,
) -> Made:
    t, i = np.append(0.0, t), np.append(0.0, i)
    soc = np.append(soc0, soc)
    v = np.append(float(cell.ocv_V(np.array([soc0]))[0]), v)
    ticks = np.arange(0.0, t[-1], logger.period_s)
    rows = np.searchsorted(t, ticks - 1e-6)
    if logger.switches:
        switch = np.flatnonzero(np.abs(np.diff(i)) > 0.0)
        rows = np.union1d(rows, switch)
    rows = np.union1d(rows, [0, t.size - 1]).astype(np.int64)
    shown = _rounded(v[rows] + logger.noise_V * rng.standard_normal(rows.size),
                     logger.resolution_V)  # fmt: skip
    moving = i[rows] != 0.0
    noise = np.where(moving, logger.noise_A, 0.0) * rng.standard_normal(rows.size)
    amps = _rounded(i[rows] + noise + logger.offset_A, logger.resolution_A)
    if logger.change_V > 0.0:
        kept = _changes(t[rows], shown, amps, logger)
        rows, shown, amps = rows[kept], shown[kept], amps[kept]
    charge = (soc0 - soc[rows]) * cell.capacity_Ah + logger.offset_A * t[rows] / 3600.0
    log = CellLog(
        t[rows],
        amps,
        shown,
        None if temperature_C is None else np.full(rows.size, temperature_C),
        charge if logger.counter else None,
        name=name,
    )
    return Made(log, soc[rows], v[rows])


def _changes(t: Array, v: Array, i: Array, logger: Logger) -> np.ndarray:
    kept, last = [0], 0
    for k in range(1, t.size):
        moved = abs(v[k] - v[last]) >= logger.change_V
        moved |= abs(i[k] - i[last]) >= 100.0 * logger.change_V * 0.1
        if moved or t[k] - t[last] >= logger.keep_alive_s:
            if k - 1 > last and abs(i[k] - i[last]) >= 10.0 * logger.change_V:
                kept.append(k - 1)  # a logger by change writes the row before the change, too
            kept.append(k)
            last = k
    return np.array(kept)


def _rounded(x: Array, step: float) -> Array:
    return np.round(x / step) * step if step > 0.0 else x


def gitt(
    cell: RichCell,
    *,
    step: float = 0.1,
    rate: float = 0.5,
    rest_s: float = 7200.0,
    charge: bool = False,
) -> list[tuple[float, float]]:
    """Steps of a share of the capacity at a rate, each with a long rest."""
    current = (-1.0 if charge else 1.0) * rate * cell.capacity_Ah
    one = [(current, 3600.0 * step / rate), (0.0, rest_s)]
    return [(0.0, 1800.0), *(one * round(1.0 / step))]


def hppc(
    cell: RichCell, *, pairs: bool = True, rest_s: float = 3600.0
) -> list[tuple[float, float]]:
    """At every 10 %: 10 s at 1C out, 40 s, 10 s at 0.75C in, 10 min, then 10 % at C/2."""
    one_c = cell.capacity_Ah
    steps = [(0.0, 1800.0)]
    for _ in range(10):
        steps += [(one_c, 10.0), (0.0, 40.0)]
        steps += [(-0.75 * one_c, 10.0), (0.0, 600.0)] if pairs else [(0.0, 600.0)]
        steps += [(0.5 * one_c, 720.0), (0.0, rest_s)]
    return steps


def low_rate(
    cell: RichCell, rate: float = 0.05, *, charge: bool = True
) -> list[tuple[float, float]]:
    """A discharge to the limit at a low rate, an hour of rest, the charge back."""
    current, seconds = rate * cell.capacity_Ah, 1.2 * 3600.0 / rate
    back = [(-current, seconds), (0.0, 3600.0)] if charge else []
    return [(0.0, 1800.0), (current, seconds), (0.0, 3600.0), *back]


def drive(cell: RichCell, *, seed: int = 7, hours: float = 1.6) -> list[tuple[float, float]]:
    """A drive at 1 Hz from full to about 15 %."""
    current = drive_current(3600.0 * hours, 1.0, 2.2 * cell.capacity_Ah,
                            np.random.default_rng(seed))  # fmt: skip
    current = current[np.cumsum(current) < 3600.0 * 0.88 * cell.capacity_Ah]
    return [(float(i), 1.0) for i in current]

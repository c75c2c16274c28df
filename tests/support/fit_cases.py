"""Cells with smooth tables and their logs, simulated row by row in plain NumPy and Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwise.fit.population import SOC, TABLES, CellClass, prior_of
from cellwise.fit.rows import FitLog
from cellwise.fit.solve import FitResult, fit_logs
from cellwise.fit.solver import Prior
from cellwise.fit.splines import TABLE_KNOTS, greville
from cellwise.fit.unknowns import FitSettings, Layout, layout_of
from cellwise.identify.identification import Start
from cellwise.identify.joint_fit import JointLogs
from cellwise.logs.cell_log import CellLog
from synthetic import drive_current

CAPACITY_AH = 3.0
KNOTS = greville(TABLE_KNOTS)
Table = Callable[[np.ndarray], np.ndarray]


def constant(value: float) -> Table:
    return lambda s: np.full(np.shape(s), value)


R0 = constant(0.025)
PAIRS = ((constant(0.012), constant(6.0)), (constant(0.020), constant(90.0)))


CURVE_V = 3.45 + 0.62 * SOC - 0.5 * np.exp(-20.0 * SOC)


def ocv(s):
    """Straight between the points that a class of cells has."""
    return np.interp(s, SOC, CURVE_V)


@dataclass(frozen=True)
class Truth:
    """A cell that the fit's own class of models holds."""

    r0: Table = R0
    pairs: tuple[tuple[Table, Table], ...] = PAIRS
    m_V: float = 0.0
    gamma: float = 50.0
    activation_K: float = 0.0
    skew_s: float = 0.0

    def voltage(self, log: CellLog, soc, h0: float = 1.0) -> np.ndarray:
        """Terminal voltage of every row, one after the other."""
        dt, now = log.interval_s, log.current_A
        seen = now.copy()
        if self.skew_s:
            weight = np.minimum(self.skew_s / np.maximum(dt[1:], 1e-9), 1.0)
            seen[1:] += weight * (now[:-1] - now[1:])
        warm = np.ones(len(log))
        if log.temperature_C is not None:
            kelvin = log.temperature_C + 273.15
            warm = np.exp(self.activation_K * (1.0 / kelvin - 1.0 / 298.15))
        v = ocv(soc) - warm * self.r0(soc) * seen
        for r, tau in self.pairs:
            v -= _branch(np.exp(-dt / tau(soc)), warm * r(soc) * seen)
        if self.m_V:
            decay = np.exp(-self.gamma * np.abs(seen) * dt / (3600.0 * CAPACITY_AH))
            v += self.m_V * _branch(decay, -np.sign(seen), h0)
        return v


def _branch(decay, aim, start=0.0):
    out, x = np.empty(decay.size), start
    for k, (a, level) in enumerate(zip(decay.tolist(), aim.tolist(), strict=True)):
        x = a * x + (1.0 - a) * level
        out[k] = x
    return out


def pulse_current(levels=9, rest=1200) -> np.ndarray:
    """1 Hz, from full: rest, 10 s discharge, 40 s rest, 10 s charge, rest, 10 % at C/2."""
    one = [0.0] * rest + [6.0] * 10 + [0.0] * 40 + [-4.0] * 10 + [0.0] * 300 + [1.5] * 720
    return np.array(one * levels)


def log_of(current, truth, *, soc0=1.0, noise=0.0, rng=None, temperature_C=None, h0=1.0):
    """A 1 Hz log of the truth and its SOC."""
    bare = CellLog(np.arange(current.size, dtype=float), current, np.ones(current.size),
                   temperature_C)  # fmt: skip
    soc = soc0 - bare.counted_charge_Ah() / CAPACITY_AH
    v = truth.voltage(bare, soc, h0)
    if noise:
        v = v + noise * rng.standard_normal(v.size)
    return replace(bare, voltage_V=v), soc


def two_logs(truth, *, noise=0.0, seed=0, warm=False):
    """A pulse test and a drive of 50 minutes."""
    rng = np.random.default_rng(seed)
    drive = drive_current(3000, 1.0, 9.0, np.random.default_rng(77))
    pulses = pulse_current()
    degrees = 25.0 + 12.0 * np.sin(np.linspace(0.0, 9.0, drive.size)) if warm else None
    first, _ = log_of(pulses, replace(truth, skew_s=0.0), noise=noise, rng=rng)
    second, _ = log_of(drive, truth, noise=noise, rng=rng, temperature_C=degrees)
    return [FitLog(first, 1.0), FitLog(second, 1.0, skewed=bool(truth.skew_s))]


def cells_like(factor=1.0, gap_V=0.0, ocv_V=CURVE_V, tau_s=(6.0, 90.0, 1500.0)) -> CellClass:
    """A class around the plain cell, its resistances and time constants by a factor."""
    r_ohm = (0.025, 0.012, 0.020, 0.015)
    level = dict(
        zip(("r0", "r1", "r2", "r3"), np.log(np.multiply(factor * CAPACITY_AH, r_ohm)), strict=True)
    )
    level |= dict(zip(("tau1", "tau2", "tau3"), np.log(np.multiply(factor, tau_s)), strict=True))
    tables = {name: np.full((2, SOC.size), level[name]) for name in TABLES}
    return CellClass("made", np.tile(ocv_V, (2, 1)), tables, np.full(SOC.size, gap_V))


def prior_for(logs, cells, settings=None, grid_C=(25.0,)) -> tuple[Prior, Layout]:
    """The prior of a fit of some logs and its layout."""
    settings = settings or FitSettings(branches=2)
    layout = layout_of(settings.branches, settings.hysteresis, len(grid_C), len(logs))
    grid = np.array(grid_C)
    return prior_of(cells, layout, tuple(logs), CAPACITY_AH, grid, 25.0, settings), layout


def fit_of(logs, cells=None, settings=None, grid_C=(25.0,)) -> FitResult:
    """The fit of some logs with a class as prior."""
    cells = cells or cells_like()
    prior, layout = prior_for(logs, cells, settings, grid_C)
    return fit_logs(
        logs, cells.base(), prior, layout, capacity_Ah=CAPACITY_AH, grid_C=np.array(grid_C)
    )


CURVED = Truth(
    r0=lambda s: 0.022 + 0.012 * np.exp(-9.0 * s),
    pairs=(
        (lambda s: 0.010 + 0.010 * np.exp(-8.0 * s), lambda s: 5.0 + 2.0 * s),
        (lambda s: 0.016 + 0.015 * np.exp(-7.0 * s), lambda s: 80.0 + 30.0 * s),
    ),
)


def joint_logs(
    logs: Sequence[FitLog], cells: CellClass, settings: FitSettings, grid_C=(25.0,)
) -> JointLogs:
    """Logs for a joint fit, each from its own start."""
    starts = tuple(Start(item.log, item.soc0, item.compare) for item in logs)
    grid = np.array(grid_C)
    return JointLogs(tuple(logs), starts, cells, settings, CAPACITY_AH, 25.0, grid)

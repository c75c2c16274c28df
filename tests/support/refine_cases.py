"""Cells with smooth tables and their logs, simulated row by row in plain NumPy and Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwise.identify.identification import Start
from cellwise.identify.refinement.joint_fit import JointLogs
from cellwise.identify.refinement.layout import RefineSettings, StartTables
from cellwise.identify.refinement.refine_data import RefineLog
from cellwise.identify.refinement.splines import TABLE_KNOTS, greville
from cellwise.logs.cell_log import CellLog
from synthetic import drive_current

CAPACITY_AH = 3.0
KNOTS = greville(TABLE_KNOTS)
Table = Callable[[np.ndarray], np.ndarray]


def constant(value: float) -> Table:
    return lambda s: np.full(np.shape(s), value)


R0 = constant(0.025)
PAIRS = ((constant(0.012), constant(6.0)), (constant(0.020), constant(90.0)))


def ocv(s):
    return 3.45 + 0.62 * s - 0.5 * np.exp(-20.0 * s)


@dataclass(frozen=True)
class Truth:
    """A cell that the refinement's own class of models holds."""

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
    first, soc1 = log_of(pulses, truth if not truth.skew_s else replace(truth, skew_s=0.0),
                         noise=noise, rng=rng)  # fmt: skip
    second, soc2 = log_of(drive, truth, noise=noise, rng=rng, temperature_C=degrees)
    return [RefineLog(first, soc1), RefineLog(second, soc2, skewed=bool(truth.skew_s))]


def start_tables(branches=2, factor=1.0, m_V=None) -> StartTables:
    at = np.ones(KNOTS.size)
    return StartTables(
        ocv=ocv,
        r0_ohm=0.025 * factor * at,
        r_ohm=tuple(r * factor * at for r in (0.012, 0.020, 0.015)[:branches]),
        tau_s=tuple(t * factor * at for t in (6.0, 90.0, 1500.0)[:branches]),
        m_V=None if m_V is None else m_V * at,
    )


CURVED = Truth(
    r0=lambda s: 0.022 + 0.012 * np.exp(-9.0 * s),
    pairs=(
        (lambda s: 0.010 + 0.010 * np.exp(-8.0 * s), lambda s: 5.0 + 2.0 * s),
        (lambda s: 0.016 + 0.015 * np.exp(-7.0 * s), lambda s: 80.0 + 30.0 * s),
    ),
)


def joint_logs(
    logs: Sequence[RefineLog], start: StartTables, settings: RefineSettings, grid_C=(25.0,)
) -> JointLogs:
    """Logs for a joint fit, each from its own start."""
    starts = tuple(Start(item.log, float(item.soc[0]), item.compare) for item in logs)
    return JointLogs(tuple(logs), starts, start, settings, CAPACITY_AH, 25.0, np.array(grid_C), ())

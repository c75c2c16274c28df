"""Every estimator driven by the same samples, its state shown after each.

rows = Rows.steady(current_A, dt_s=1.0)
path = follow("ukf", model, rows, soc0=0.6)
path.soc, path.v1_V, path.heat_K
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    Entropy,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.packed import place_of
from cellwise.estimate.adaptive import Adaptive, AdaptiveSettings
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.lockstep import FIELDS, LANES, LockstepEkf
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog

Array = NDArray[np.float64]

# One record of each kind, and the same kinds at a neutral value, their other numbers odd.
ACTIVE = {
    effect.name: effect
    for effect in (
        SlowDiffusion(r3_ohm=0.015, tau3_s=1500.0),
        Hysteresis(m_V=0.02, gamma=40.0),
        TemperatureDependence(activation_K=2500.0, reference_C=20.0, r1_K=900.0, tau2_K=1500.0),
        TimeSkew(skew_s=0.4),
        RateDependence(rate_h=0.1),
        ChargeTransfer(asinh_per_V=60.0),
        SurfaceSoc(depth_h=0.08, tau_s=150.0, activation_K=1500.0, reference_C=15.0),
        ChargeAsymmetry(charge_scale=1.3),
        SelfHeating(rth_K_per_W=8.0, thermal_s=400.0),
        SelfDischarge(leak_A=0.02),
        Entropy(docv_dT_V_per_K=3e-4, reference_C=10.0),
    )
}
NEUTRAL = {
    effect.name: effect
    for effect in (
        SlowDiffusion(r3_ohm=0.0, tau3_s=77.0),
        Hysteresis(m_V=0.0, gamma=55.0),
        TemperatureDependence(activation_K=0.0, reference_C=-13.0),
        TimeSkew(skew_s=0.0),
        RateDependence(rate_h=0.0),
        ChargeTransfer(asinh_per_V=0.0),
        SurfaceSoc(depth_h=0.0, tau_s=44.0, activation_K=2000.0, reference_C=5.0),
        ChargeAsymmetry(charge_scale=1.0),
        SelfHeating(rth_K_per_W=0.0, thermal_s=33.0),
        SelfDischarge(leak_A=0.0),
        Entropy(docv_dT_V_per_K=0.0, reference_C=-7.0),
    )
}
NOTHING = AdaptiveSettings(learn=())
MEANS = ("soc", "v1_V", "v2_V", "v3_V", "h")
SHOWN = (*MEANS, "heat_K", "slow_A", "voltage_V", "soc_std", "p11", "p22", "p33")


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples that end intervals of ``dt_s``; ``tick_s`` is the time step of who has only one."""

    current_A: Array
    voltage_V: Array
    temperature_C: Array
    dt_s: Array
    gap: NDArray[np.bool_]
    tick_s: float

    @classmethod
    def of(cls, current_A, tick_s: float = 1.0, voltage_V=np.nan, temperature_C=25.0) -> Rows:
        """A current with the same interval before every sample but the first."""
        current = np.array(current_A, dtype=np.float64)
        dt = np.full(current.size, tick_s)
        dt[0] = 0.0
        voltage, warm = (np.array(np.broadcast_to(v, current.shape), dtype=np.float64)
                         for v in (voltage_V, temperature_C))  # fmt: skip
        return cls(current, voltage, warm, dt, np.zeros(current.size, dtype=bool), tick_s)

    def __len__(self) -> int:
        return self.current_A.size

    def interval(self, row: int, dt_s: float, gap: bool = False) -> Rows:
        """With another interval before one row."""
        dt, gaps = self.dt_s.copy(), self.gap.copy()
        dt[row], gaps[row] = dt_s, gap
        return replace(self, dt_s=dt, gap=gaps)

    def log(self) -> CellLog:
        """The same as a log, which finds its gaps by itself; a last row has the one voltage."""
        end = self.dt_s.sum() + self.tick_s
        return CellLog(
            np.append(np.cumsum(self.dt_s), end),
            np.append(self.current_A, 0.0),
            np.append(self.voltage_V, 3.7),
            np.append(self.temperature_C, 25.0),
        )


class Path(NamedTuple):
    """What an estimator carries after every sample, NaN where it does not carry it."""

    soc: Array
    v1_V: Array
    v2_V: Array
    v3_V: Array
    h: Array
    heat_K: Array
    slow_A: Array
    voltage_V: Array
    soc_std: Array
    p11: Array
    p22: Array
    p33: Array
    status: Array


def follow(name: str, model, rows: Rows, soc0: float, soc0_std: float = 0.01, noise=None) -> Path:
    """One estimator over every sample.

    The adaptive filter has nothing to learn.
    """
    noise = Noise.of_model(model) if noise is None else noise
    walk = {
        "coulomb": _online, "ekf": _online, "ukf": _online, "adaptive": _online,
        "lockstep": _lockstep, "fixed-step": _fixed, "firmware": _fixed,
        "filterpy-ekf": _filterpy, "filterpy-ukf": _filterpy,
    }[name]  # fmt: skip
    told = walk(name, model, rows, soc0, soc0_std, noise)
    found = np.full((len(SHOWN) + 1, len(rows)), np.nan)
    for k, values in enumerate(told):
        for i, field in enumerate((*SHOWN, "status")):
            found[i, k] = values.get(field, np.nan)
    return Path(*found)


def _online(name, model, rows, soc0, soc0_std, noise):
    estimator = (
        Adaptive(model, noise, NOTHING)
        if name == "adaptive"
        else make_estimator(name, model, noise)
    )
    held = () if name == "coulomb" else (rows.current_A[0],)
    state = estimator.init(soc0, soc0_std, *held)
    for k in range(len(rows)):
        state, info = estimator.step(
            state, rows.current_A[k], rows.voltage_V[k], rows.temperature_C[k],
            dt_s=rows.dt_s[k], gap=bool(rows.gap[k]),
        )  # fmt: skip
        carried = _carried(state)
        carried["voltage_V"] = getattr(info, "voltage_V", np.nan)
        yield {**carried, "status": int(info.status)}


def _carried(state):
    """What a state carries, by name, wherever it stands in the record."""
    parts = (state, getattr(state, "cell", None), getattr(state, "p", None))
    return {
        field: next((getattr(p, field) for p in parts if hasattr(p, field)), np.nan)
        for field in SHOWN
    }


def _moments(x, covariance):
    """Mean and variances by name, of a filter that carries them as arrays."""
    variances = np.diag(covariance)
    carried = dict(zip(MEANS, x, strict=False))
    carried |= {f"p{j}{j}": variances[j] for j in (1, 2, 3)}
    return {**carried, "soc_std": np.sqrt(variances[0])}


def _lockstep(name, model, rows, soc0, soc0_std, noise):
    """Its gaps last one time step; it takes no repeated stamp."""
    fleet = LockstepEkf(model, 1, rows.tick_s, noise)
    state = fleet.init(soc0, soc0_std)
    last_A = place_of(EkfState, "watch.current_A")
    state.blocks.reshape(-1, FIELDS, LANES)[:, last_A] = rows.current_A[0]
    for k in range(len(rows)):
        state, info = fleet.step(
            state, rows.current_A[k], rows.voltage_V[k], rows.temperature_C[k],
            gap=rows.gap[k : k + 1],
        )  # fmt: skip
        cell = fleet.cell_state(state, 0)
        carried = _carried(cell)
        yield {**carried, "voltage_V": info.voltage_V[0], "status": int(info.status[0])}


@cache
def _stepping(name, model, tick_s, noise):
    from cellwise.estimate.fixed.fixed_step import FixedStep
    from cellwise.export.firmware import Firmware

    return {"fixed-step": FixedStep, "firmware": Firmware}[name](model, noise, dt_s=tick_s)


def _fixed(name, model, rows, soc0, soc0_std, noise):
    """Time is told by the sequence number."""
    estimator = _stepping(name, model, rows.tick_s, noise)
    state = estimator.init(soc0, soc0_std)
    stepper = estimator.stepper(rows.tick_s)
    records = np.zeros(len(rows), dtype=INPUT)
    records["current_A"] = rows.current_A
    records["voltage_V"] = rows.voltage_V
    records["temperature_C"] = rows.temperature_C
    records["sequence"] = np.round(np.cumsum(rows.dt_s) / rows.tick_s).astype(np.uint32)
    for k in range(len(rows)):
        out = stepper.rows(state, records[k : k + 1])[0]
        carried = {field: float(state[field][0]) for field in SHOWN if field in state.dtype.names}
        yield {**carried, "voltage_V": float(out["voltage_V"]), "status": int(out["status"])}


def _filterpy(name, model, rows, soc0, soc0_std, noise):
    """The log's own loop, watched from the inside."""
    estimator = make_estimator(name, model, noise)
    seen = []
    predict, update = estimator.predict, estimator.update

    def watched_predict(kf, now, after, diagonal):
        predict(kf, now, after, diagonal)
        beside = {"heat_K": after.heat_K, "slow_A": after.slow_A}
        seen.append(beside | _moments(kf.x, kf.P))

    def watched_update(kf, *given):
        update(kf, *given)
        seen[-1] |= _moments(kf.x, kf.P)

    estimator.predict, estimator.update = watched_predict, watched_update
    trace = estimator.run(rows.log(), soc0, soc0_std)
    for k, carried in enumerate(seen[:-1]):
        yield {**carried, "soc": trace.soc[k], "voltage_V": trace.voltage_V[k]}

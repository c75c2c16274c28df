"""Accepted causes applied: an extended model, or a corrected log."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cellwise.cell.effects import (
    BRANCH_ACTIVATIONS,
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
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import with_temperature
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.point_kernels import ENTROPY, OCV, R0, R1, R2, R3, TAU1, TAU2, TAU3, M
from cellwise.cell.simulate import simulate
from cellwise.diagnose.causes.catalogue import Cause, Parameter
from cellwise.diagnose.causes.coordinates import CURRENT_NAMES, UNSEEN_NAMES, Coordinates
from cellwise.diagnose.fit.rows import shifted_current
from cellwise.identify.own_logs import joined, log_validity
from cellwise.logs.cell_log import CellLog

# Effects that have tables over the temperatures: made again from the tables of the point.
TABULATED = (SlowDiffusion, Hysteresis, Entropy)
MEASURED_NAMES = (*CURRENT_NAMES, "offset_V")


def parameters_of(
    cause: Cause, coordinates: Coordinates, z: Mapping[str, float], soc0: float
) -> dict[str, float]:
    """The values of a cause's parameters as people see them."""
    return {p.name: value_of(p, z.get(p.key, 0.0), coordinates, soc0) for p in cause.parameters}


def value_of(parameter: Parameter, x: float, coordinates: Coordinates, soc0: float) -> float:
    """A parameter's value at ``x`` in its coordinate."""
    start = parameter.coordinate == "soc0"
    return soc0 + x if start else coordinates.value_of(parameter.coordinate, x)


def split_skew(
    coordinates: Coordinates, z: Mapping[str, float], interval_s: float
) -> tuple[dict[str, float], dict[str, float]]:
    """A point as the model takes it and as the log takes it: the sampling delay goes to one.

    A filter can live with a voltage that is late by up to one interval, so that belongs to the
    model (:class:`TimeSkew`); any other skew is taken out of the log.
    """
    total = coordinates.inputs(z).skew_s
    model, log = dict(z), dict(z)
    if 0.0 <= total <= interval_s:
        log.pop("skew_s", None)
    else:
        model.pop("skew_s", None)
    return model, log


def extend_model(
    coordinates: Coordinates, z: Mapping[str, float], note: Mapping[str, Any]
) -> CellModel:
    """The model with everything of a point that belongs to the cell, and the sampling delay."""
    model = coordinates.model
    cell = {n: v for n, v in z.items() if n not in MEASURED_NAMES and ":" not in n}
    inputs = coordinates.inputs({**cell, "skew_s": z.get("skew_s", 0.0)})
    t, s = inputs.table, inputs.scalars
    grid = inputs.grid
    if not any(cell.get(n, 0.0) for n in UNSEEN_NAMES):
        seen = np.isin(grid, model.temperature_C)
        t, grid = t[seen], grid[seen]
    ocv = np.maximum.accumulate(t[..., OCV], axis=1)
    tau1 = np.minimum(t[..., TAU1], 0.99 * t[..., TAU2])
    new = replace(
        model,
        temperature_C=grid,
        effects=tuple(e for e in model.effects if not isinstance(e, TABULATED)),
        capacity_Ah=s.charge_As / 3600.0,
        ocv_V=ocv,
        r0_ohm=t[..., R0],
        r1_ohm=t[..., R1],
        tau1_s=tau1,
        r2_ohm=t[..., R2],
        tau2_s=t[..., TAU2],
        provenance={**model.provenance, "diagnosed": dict(note)},
    )
    if coordinates.has_slow or np.any(t[..., R3] > 0.0):
        new = new.with_effect(SlowDiffusion(np.maximum(t[..., R3], 0.0), t[..., TAU3]))
    if np.any(t[..., M]):
        new = new.with_effect(Hysteresis(t[..., M], s.hysteresis_rate))
    if s.activation_K != 0.0 or s.branch_activation != 0.0:
        own = model.effect(TemperatureDependence)
        of_branches = {f"{b}_K": getattr(s, f"{b}_activation_K") for b in BRANCH_ACTIVATIONS}
        new = new.with_effect(replace(own, activation_K=s.activation_K, **of_branches))
    if np.any(t[..., ENTROPY]):
        new = new.with_effect(Entropy(t[..., ENTROPY], s.entropy_K - ZERO_CELSIUS_K))
    if s.rate_per_A != 0.0:
        least = RateDependence.bounds["rate_h"][0]  # by rounding it may lie beyond
        new = new.with_effect(RateDependence(max(s.rate_per_A * new.capacity_Ah, least)))
    if s.surface_per_A != 0.0:
        own_surface = model.effect(SurfaceSoc)
        depth = s.surface_per_A * new.capacity_Ah
        new = new.with_effect(replace(own_surface, depth_h=depth, tau_s=s.surface_s))
    if s.asinh_per_V > 0.0:
        new = new.with_effect(ChargeTransfer(s.asinh_per_V))
    if s.charge_scale != 1.0:
        new = new.with_effect(ChargeAsymmetry(s.charge_scale))
    if s.heating_K_per_W > 0.0:
        new = new.with_effect(SelfHeating(s.heating_K_per_W, s.heating_s))
    if s.leak_A > 0.0:
        new = new.with_effect(SelfDischarge(s.leak_A))
    if inputs.skew_s > 0.0:
        new = new.with_effect(TimeSkew(min(inputs.skew_s, 60.0)))
    return new


def extended_validity(model: CellModel, logs: Sequence[CellLog], soc0: Sequence[float]) -> Validity:
    """Where the model is valid once it has explained these logs, too.

    Parameters
    ----------
    logs : sequence of CellLog      corrected
    soc0 : sequence of float        SOC at the first row of each
    """
    if not model.validity.known:
        return model.validity
    starts = (min(max(s, 0.0), 1.0) for s in soc0)
    parts = [
        log_validity(log, simulate(model, log, start).soc)
        for log, start in zip(logs, starts, strict=True)
    ]
    return model.validity.extended(joined(parts))


def with_error_at(model: CellModel, temperature_C: float, times: float) -> CellModel:
    """The model stating so many times the error that it stated at a temperature."""
    error = model.error
    for t in model.temperature_C if not error.temperature_C else ():
        error = with_temperature(error, float(t), 1.0)
    return replace(model, error=with_temperature(error, temperature_C, times))


def correct_log(log: CellLog, z: Mapping[str, float], number: int) -> CellLog:
    """The log without what belongs to the instrument: offset, gain, voltage offset, skew.

    ``number`` is its place among all logs. The model's own sampling delay stays in the model; one
    that was found is removed here.
    """
    offset_V = z.get("offset_V", 0.0) + z.get(f"offset_V:{number}", 0.0)
    if not (offset_V or any(z.get(n, 0.0) for n in CURRENT_NAMES)):
        return log
    known = log.known_current_A()
    shifted = shifted_current(log.time_s, log.interval_s, known, z.get("skew_s", 0.0))
    current = (shifted - z.get("offset_A", 0.0)) / math.exp(z.get("ln_gain", 0.0))
    current[~np.isfinite(log.current_A)] = np.nan
    return replace(log, current_A=current, voltage_V=log.voltage_V - offset_V)

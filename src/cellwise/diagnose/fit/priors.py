"""Priors: what is uncertain of a good model and a good log, and how large a fault may be."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cellwise.cell.effects import ChargeTransfer, TemperatureDependence
from cellwise.cell.model import CellModel
from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.causes.coordinates import OCV_NAMES, R_NAMES, Coordinates
from cellwise.diagnose.fit.least_squares import Fit, Prior
from cellwise.diagnose.fit.noise import LEAST_V, returning_V
from cellwise.diagnose.fit.rows import START_H, Evidence
from cellwise.diagnose.fit.start_readings import start_readings

# Of the square of what comes back of a model's error in every log its OCV owes one half at any
# knot, in volts at least so much; nobody knows the shape of the rest.
OCV_SHARE = 0.5
OCV_LEAST_V = 0.0015
R_SHARE = 0.5
R_LEAST = 0.015
# These owe equal shares of the other half.
OWED = (
    "ln_r0", "ln_r1", "ln_r2", "ln_tau1", "ln_tau2", "r3", "m_V", "activation_K", "rate_h",
    "ln_charge_scale",
)  # fmt: skip
# One electron and a symmetric reaction: F / (2 R T) at 25 degC [1/V]; two electrodes share a drop.
USUAL_ASINH_PER_V = 19.5
# A cell without a temperature law that heats itself: activation of a usual electrolyte.
USUAL_ACTIVATION_K = 3000.0
USUAL_SPREAD_K = 1500.0
# A start that was given is right to this; one that was found, to its own standard deviation.
GIVEN_SOC_STD = 0.0015
TOLERANCE_ENDS = 4.0
# Where a log starts between the branches of a hysteresis nobody knows, but that it is nearer to its
# own: a full cell was charged.
MOST_OFF_BRANCH = 0.5
# Starts that were given come from one source: what makes one wrong makes all wrong, and what is
# left of each alone is a third of that.
GIVEN_ALIKE = 8.0 / 9.0
# Memories are another one from this factor on (its logarithm).
ANOTHER = 0.7
SLOWER_THAN_TAU2 = 2.0
# Diffusion in a cell becomes slower, not faster: else it would take back from the slow branches
# what one factor on all resistances has given them too much.
MOST_SLOWED = 20.0

# Of what was calibrated, this share stays uncertain: the next log is another day.
STILL_OPEN = 0.3


def tolerances(coordinates: Coordinates, evidence: Evidence) -> Prior:
    """Standard deviations about neutral of everything that a good laboratory leaves uncertain."""
    model = coordinates.model
    capacity = model.capacity_Ah
    warm = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    knots = returning_V(model.error, np.linspace(0.0, 1.0, len(OCV_NAMES)), warm)
    interval = float(np.median(np.concatenate([g.dt_s[1:] for g in evidence.logs])))
    std = {
        "offset_A": 7e-4 * capacity,
        "ln_gain": 0.0015,
        "offset_V": 5e-4,
        "skew_s": min(0.02, 0.2 * max(interval, 1e-3)),
        "ln_capacity": 0.0025,
        "ln_scale": 0.01,
        **{
            n: max(OCV_LEAST_V, math.sqrt(OCV_SHARE) * float(v))
            for n, v in zip(OCV_NAMES, knots, strict=True)
        },
        **dict.fromkeys(R_NAMES, max(R_LEAST, R_SHARE * model.error.shown_share())),
        "ln_r0": 0.012,
        "ln_r1": 0.025,
        "ln_r2": 0.025,
        "ln_tau1": 0.08,
        "ln_tau2": 0.08,
        "r3": 0.15 if coordinates.has_slow else 0.02,
        "m_V": 5e-4,
        "activation_K": 100.0,
        "rate_h": 0.003,
        "ln_charge_scale": 0.01,
        "leak_A": 2e-4 * capacity,
        "rth_K_per_W": 0.2,
    }
    if coordinates.has_slow:
        std["ln_tau3"] = 0.2
    if coordinates.has_hysteresis:
        std["ln_gamma"] = 0.2
    for name, std_V in _owed(coordinates, evidence).items():
        std[name] = max(std[name], std_V)
    mean: dict[str, float] = {}
    for name, log in zip(evidence.starts(), evidence.logs, strict=True):
        # A start that all rows chose with the model as it is would be sure of a wrong model.
        first = log.start.beginning or log.start
        std[name] = max(first.std, GIVEN_SOC_STD)
        mean[name] = first.soc - log.start.soc
    known = _bounded(Prior(std, mean, {}, {}), std)
    ends = {START_H: 0.0}, {START_H: MOST_OFF_BRANCH}
    return known.widened({START_H: MOST_OFF_BRANCH}, {}, *ends)


def _owed(coordinates: Coordinates, evidence: Evidence) -> dict[str, float]:
    """Standard deviation of each coordinate that makes up its share of what comes back."""
    _, soc = evidence.simulate(coordinates, {})
    error = coordinates.model.error
    again = np.concatenate(
        [
            returning_V(error, np.clip(soc[rows], 0.0, 1.0), float(np.median(g.temperature_C)))
            for g, rows in evidence.each()
        ]
    )
    used = evidence.known & np.isfinite(again)
    # A model that states nothing there owes nothing.
    again = np.maximum(again[used], LEAST_V)
    columns = evidence.window_means(evidence.jacobian(coordinates, {}, OWED))[used]
    size = np.sqrt(np.mean((columns / again[:, None]) ** 2, axis=0))
    allowed = math.sqrt((1.0 - OCV_SHARE) / len(OWED))
    return {n: allowed / float(v) for n, v in zip(OWED, size, strict=True) if v > allowed}


def _bounded(prior: Prior, names: Iterable[str]) -> Prior:
    """Tolerances are bounded: they end at TOLERANCE_ENDS standard deviations."""
    low = {n: prior.mean.get(n, 0.0) - TOLERANCE_ENDS * prior.std[n] for n in names}
    high = {n: prior.mean.get(n, 0.0) + TOLERANCE_ENDS * prior.std[n] for n in names}
    return prior.widened({}, {}, low, high)


def widened_for(prior: Prior, cause: Cause, coordinates: Coordinates, evidence: Evidence) -> Prior:
    """The prior with a cause's coordinates as wide as a fault may be."""
    model = coordinates.model
    std: dict[str, float] = {}
    mean: dict[str, float] = {}
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    for p in cause.parameters:
        wide = p.wide * (model.capacity_Ah if p.per == "capacity" else 1.0)
        if p.coordinate == "offset_A" and evidence.rest.zero:
            wide = evidence.rest.std_A  # the sensor reads nothing where nothing flows
        if p.coordinate == "soc0":
            std.update(dict.fromkeys(evidence.starts(), wide))
            for name, log in zip(evidence.starts(), evidence.logs, strict=True):
                low[name], high[name] = -0.05 - log.start.soc, 1.05 - log.start.soc
            continue
        if p.coordinate == "r3" and coordinates.has_slow:
            wide = 0.7
        std[p.coordinate] = wide
        bounds = coordinate_bounds(p.coordinate, p.bounds, coordinates)
        low[p.coordinate], high[p.coordinate] = bounds
    if cause.name == "charge_transfer":
        has = model.effect(ChargeTransfer).asinh_per_V
        mean["asinh_per_V"] = 0.0 if has else USUAL_ASINH_PER_V
    if cause.name == "self_heating" and needs_activation(coordinates):
        std["activation_K"] = USUAL_SPREAD_K
        mean["activation_K"] = USUAL_ACTIVATION_K
        low["activation_K"], high["activation_K"] = 500.0, 8000.0
    readings = start_readings(std, coordinates, evidence)
    for name, log in zip(evidence.starts(), evidence.logs, strict=True):
        if name in readings:  # where the reading goes, the start may go
            low[name], high[name] = -0.05 - log.start.soc, 1.05 - log.start.soc
    wide_prior = prior.widened(std, mean, low, high).with_readings(readings)
    if cause.kind == "start":
        named = zip(evidence.starts(), evidence.logs, strict=True)
        given = [n for n, g in named if g.start.how == "given"]
        return wide_prior.together(given, GIVEN_ALIKE) if len(given) > 1 else wide_prior
    return wide_prior


def needs_activation(coordinates: Coordinates) -> bool:
    """Whether the model does not know what a warmer cell would do, and heating has to say it.

    At a temperature that the model was not measured at an activation is what the cold does, with
    or without heat: there it is `temperature_dependence`, and heating is a second cause beside it.
    """
    if coordinates.unseen_C is not None:
        return False
    known = coordinates.model.effect(TemperatureDependence).activation_K
    return coordinates.model.temperature_C.size == 1 and abs(known) < 300.0


def shortest_tau3_s(model: CellModel) -> float:
    """Slow is what the second branch does not reach [s]."""
    return SLOWER_THAN_TAU2 * float(np.median(model.tau2_s))


def coordinate_bounds(
    name: str, bounds: tuple[float, float], coordinates: Coordinates
) -> tuple[float, float]:
    """Bounds of a parameter as bounds of its coordinate."""
    model = coordinates.model
    low, high = bounds
    if name == "ln_capacity":
        return math.log(0.3), math.log(2.0)
    if name in ("ln_gain", "ln_scale", "ln_charge_scale"):
        return math.log(low), math.log(high)
    if name in ("ln_slow_r", "ln_slow_tau"):
        return 0.0, math.log(MOST_SLOWED)
    if name == "ln_r1":
        return -math.log(high), -math.log(low)
    if name == "asinh_per_V":
        has = model.effect(ChargeTransfer).asinh_per_V
        return low - has, max(high - has, high)
    if name == "ln_tau3":
        low = max(low, shortest_tau3_s(model))
        return math.log(low / coordinates.tau3_s), math.log(high / coordinates.tau3_s)
    if name == "ln_gamma":
        return math.log(low / coordinates.gamma), math.log(high / coordinates.gamma)
    if name == "ln_thermal_s":
        return math.log(low / coordinates.thermal_s), math.log(high / coordinates.thermal_s)
    if name == "ln_surface_s":
        return math.log(low / coordinates.surface_s), math.log(high / coordinates.surface_s)
    if name == "surface_h":
        return low - coordinates.surface_depth_h, high
    if name == "r3":
        return (-3.0, 3.0) if coordinates.has_slow else (0.0, high / coordinates.r_typical_ohm)
    if name == "activation_K":
        has = model.effect(TemperatureDependence).activation_K
        return low - has, high - has
    return coordinates.bounds_of(name, bounds)


def calibrated(prior: Prior, found: Fit, share: float = 1.0) -> Prior:
    """Tolerances about what a fit of a baseline made of them, with the correlations that it leaves.

    ``share`` (0..1) is how much of the calibration is taken; without any, tolerances stay as wide
    as those of a good laboratory.
    """
    names = [n for n in prior.std if ":" not in n]
    place = [found.names.index(n) for n in names]
    covariance = share * share * found.covariance[np.ix_(place, place)]
    still = STILL_OPEN**share
    drift = np.array([still * prior.std[n] for n in names])
    deviation = np.sqrt(np.diag(covariance) + drift**2)
    np.fill_diagonal(covariance, 0.0)
    # Same cell, same instruments: what else could be off has shown there too.
    std = {n: v if ":" in n else still * v for n, v in prior.std.items()} | dict(
        zip(names, (float(v) for v in deviation), strict=True)
    )
    mean = {n: share * found.z[n] for n in names}
    wider = _bounded(prior.widened(std, mean, {}, {}), [n for n in std if n != START_H])
    return replace(wider, linked=tuple(names), cross=covariance)


def starts_to_try(
    cause: Cause, coordinates: Coordinates, evidence: Evidence
) -> list[tuple[Coordinates, dict[str, float]]]:
    """Where the search for a cause begins: coordinates, and what is not at the base there.

    While an effect is neutral its memory means nothing: any is tried. Where the model has the
    effect, its own memory and the others: a change of both may hide behind a ridge.
    """
    plain = [(coordinates, dict(b)) for b in cause.beginnings or ({},)]
    if cause.shape is None:
        return plain
    name, values = cause.shape
    span = max(float(g.clock_s[-1] - g.clock_s[0]) for g in evidence.logs)
    least = shortest_tau3_s(coordinates.model) if name == "ln_tau3" else 0.0
    if name != "ln_gamma":
        values = tuple(v for v in values if least <= v < span) or (max(least, values[0]),)
    own = None
    if name == "ln_tau3" and coordinates.has_slow:
        own = coordinates.tau3_s
    if name == "ln_gamma" and coordinates.has_hysteresis:
        own = coordinates.gamma
    if name == "ln_surface_s" and coordinates.surface_depth_h > 0.0:
        own = coordinates.surface_s
    if own is None:
        return [(replace(coordinates, shapes={**coordinates.shapes, name: v}), {}) for v in values]
    away = [math.log(v / own) for v in values]
    return plain + [(coordinates, {name: x}) for x in away if abs(x) > ANOTHER]

"""Priors: what is uncertain of a good model and a good log, and how large a fault may be.

A fit takes every cause as normally distributed about neutral. What is known of sizes is more than
that (:func:`ln_size`): a cell loses capacity and gains resistance, and a sensor keeps its class but
for the few that were configured wrongly. And a start that was read from a voltage stands for
another SOC where the sensor is off, or the OCV another one (:func:`start_readings`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import ChargeTransfer, TemperatureDependence
from cellwise.cell.point_kernels import OCV, M
from cellwise.cell.simulate import start_hysteresis
from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.causes.coordinates import (
    LOSS_NAMES,
    OCV_NAMES,
    R_NAMES,
    Coordinates,
    step_of,
)
from cellwise.diagnose.fit.coordinate_fit import Fit, Tolerances
from cellwise.diagnose.fit.rests import OCV_KNOWN
from cellwise.diagnose.fit.rows import ScoredRows
from cellwise.fit.population import SPREAD
from cellwise.typing import FloatArray


class Laboratory(NamedTuple):
    """What a good laboratory leaves uncertain.

    ``r_share``: of the model's share of the polarisation, at any knot of the resistances, at least
    ``r_least``; ``soc0_std``: a start that was given is right to this, one that was found to its
    own standard deviation;
    ``ends``: standard deviations at which a tolerance ends; ``still_open``: share that stays
    uncertain of what was calibrated, since the next log is another day. A rest is read over
    ``about_soc``, on a flatter plateau than ``least_slope_V`` it reads nothing; ``wrong_class``:
    share of sensors that are configured or wired wrongly.
    """

    r_share: float = 0.5
    r_least: float = 0.015
    soc0_std: float = 0.0015
    ends: float = 4.0
    still_open: float = 0.3
    about_soc: float = 0.01
    least_slope_V: float = 0.02
    wrong_class: float = 0.03


class UsualCell(NamedTuple):
    """What a cell has of an effect that its model does not know.

    ``asinh_per_V``: one electron and a symmetric reaction, F / (2 R T) at 25 degC; two electrodes
    share a drop. ``activation_std_K``: of a usual electrolyte. ``ln_memory``: from this factor on
    (its logarithm) a memory is another one.
    """

    asinh_per_V: float = 19.5
    activation_std_K: float = 1500.0
    ln_memory: float = 0.7


GOOD, USUAL = Laboratory(), UsualCell()
READ_WITH = frozenset({"offset_V", "m_V", *OCV_NAMES, *LOSS_NAMES})
# Standard deviation below and above neutral. A cell is retired at 0.7 to 0.8 of its capacity;
# cells of one batch differ by 1 %, and none grows (Rumpf et al. 2017, 10.1016/j.est.2017.09.010).
# Until then its resistance grows by up to a half, at times to the double; what makes it fall is
# warmth (Schmalstieg et al. 2014, 10.1016/j.jpowsour.2014.02.012).
# Charge transfer is about a third of it and may have all of the growth.
AGE = {
    "ln_capacity": (0.12, 0.02),
    **dict.fromkeys(("ln_scale", "added_r0"), (0.1, 0.4)),
    "ln_r1": (0.3, 1.2),
}
# Of a class, and of those that are configured or wired wrongly, a few in a hundred. Current sensors
# of vehicles keep 1 to 3 % over temperature and life, shunts ten times better; cell monitors keep
# 1 to 9 mV by their data sheets.
CLASS = {"ln_gain": (0.02, 0.2), "offset_V": (0.005, 0.05)}


def tolerances(coordinates: Coordinates, evidence: ScoredRows) -> Tolerances:
    """Standard deviations about neutral of everything that a good laboratory leaves uncertain."""
    model = coordinates.model
    capacity = model.capacity_Ah
    interval = float(np.median(np.concatenate([g.dt_s[1:] for g in evidence.logs])))
    std = {
        "offset_A": 7e-4 * capacity,
        "ln_gain": 0.0015,
        "offset_V": 5e-4,
        "skew_s": min(0.02, 0.2 * max(interval, 1e-3)),
        "ln_capacity": 0.0025,
        "ln_scale": 0.01,
        **dict.fromkeys(OCV_NAMES, OCV_KNOWN.least_V),
        **dict.fromkeys(R_NAMES, max(GOOD.r_least, GOOD.r_share * model.error.shown_share())),
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
    mean: dict[str, float] = {}
    for name, log in zip(evidence.starts(), evidence.logs, strict=True):
        # A start that all rows chose with the model as it is would be sure of a wrong model.
        first = log.start.beginning or log.start
        std[name] = max(first.std, GOOD.soc0_std)
        mean[name] = first.soc - log.start.soc
    return _bounded(Tolerances(std, mean, {}, {}))


def _bounded(prior: Tolerances) -> Tolerances:
    """Tolerances are bounded: they end at some standard deviations."""
    low, high = (
        {n: prior.mean.get(n, 0.0) + way * GOOD.ends * s for n, s in prior.std.items()}
        for way in (-1.0, 1.0)
    )
    return replace(prior, low=low, high=high)


def widened_for(
    prior: Tolerances, cause: Cause, coordinates: Coordinates, evidence: ScoredRows
) -> Tolerances:
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
        bounds = coordinates.bounds_of(p.coordinate, p.bounds)
        low[p.coordinate], high[p.coordinate] = bounds
    if cause.name == "charge_transfer":
        has = model.effect(ChargeTransfer).asinh_per_V
        mean["asinh_per_V"] = 0.0 if has else USUAL.asinh_per_V
    if cause.name == "self_heating" and needs_activation(coordinates):
        std["activation_K"] = USUAL.activation_std_K
        mean["activation_K"] = SPREAD.activation_K
        low["activation_K"], high["activation_K"] = 500.0, 8000.0
    readings = start_readings(std, coordinates, evidence)
    for name, log in zip(evidence.starts(), evidence.logs, strict=True):
        if name in readings:  # where the reading goes, the start may go
            low[name], high[name] = -0.05 - log.start.soc, 1.05 - log.start.soc
    return prior.widened(std, mean, low, high, readings)


def needs_activation(coordinates: Coordinates) -> bool:
    """Whether the model does not know what a warmer cell would do, and heating has to say it.

    At a temperature that the model was not measured at an activation is what the cold does, with
    or without heat: there it is `temperature_dependence`, and heating is a second cause beside it.
    """
    if coordinates.unseen_C is not None:
        return False
    known = coordinates.model.effect(TemperatureDependence).activation_K
    return coordinates.model.temperature_C.size == 1 and abs(known) < 300.0


def calibrated(prior: Tolerances, found: Fit) -> Tolerances:
    """Tolerances about what a fit of a baseline made of them, with the correlations that it leaves.

    Same cell, same instruments: what else could be off has shown there too.
    """
    names = [n for n in prior.std if ":" not in n]
    place = [found.names.index(n) for n in names]
    covariance = found.covariance[np.ix_(place, place)]
    drift = GOOD.still_open * np.array([prior.std[n] for n in names])
    deviation = np.sqrt(np.diag(covariance) + drift**2)
    np.fill_diagonal(covariance, 0.0)
    std = dict(zip(names, (float(v) for v in deviation), strict=True))
    moved = prior.widened(std, {n: found.z[n] for n in names}, {}, {})
    return replace(_bounded(moved), linked=tuple(names), cross=covariance)


def starts_to_try(
    cause: Cause, coordinates: Coordinates, evidence: ScoredRows
) -> list[tuple[Coordinates, dict[str, float]]]:
    """Where the search for a cause begins: coordinates, and what is not at the base there.

    While an effect is neutral its memory means nothing: any is tried. Where the model has the
    effect, its own memory and the others: a change of both may hide behind a ridge.
    """
    first = cause.coordinates[0]
    plain = [(coordinates, {first: x}) for x in cause.beginnings] or [(coordinates, {})]
    if cause.shape is None:
        return plain
    name, values = cause.shape
    span = max(float(g.clock_s[-1] - g.clock_s[0]) for g in evidence.logs)
    least = coordinates.shortest_tau3_s if name == "ln_tau3" else 0.0
    if name != "ln_gamma":
        values = tuple(v for v in values if least <= v < span) or (max(least, values[0]),)
    own = None
    if name == "ln_tau3" and coordinates.has_slow:
        own = coordinates.tau3_s
    if name == "ln_gamma" and coordinates.has_hysteresis:
        own = coordinates.gamma
    if own is None:
        return [(replace(coordinates, shapes={**coordinates.shapes, name: v}), {}) for v in values]
    away = [math.log(v / own) for v in values]
    return plain + [(coordinates, {name: x}) for x in away if abs(x) > USUAL.ln_memory]


def start_readings(
    names: Collection[str], coordinates: Coordinates, evidence: ScoredRows
) -> dict[str, dict[str, float]]:
    """By how much a unit of each coordinate moves the SOC that each start stands for.

    Of the starts that were read from a voltage, and the coordinates in ``names`` that change what
    such a reading means: start to coordinate to change of SOC per unit.
    """
    asked = [n for n in names if n.partition(":")[0] in READ_WITH]
    read = [
        (name, log)
        for name, log in zip(evidence.starts(), evidence.logs, strict=True)
        if log.start.how != "given"
    ]
    if not asked or not read:
        return {}
    soc = coordinates.model.soc
    inputs = coordinates.inputs({})
    moved: dict[str, FloatArray] = {}
    for n in asked:
        column, step = M if n == "m_V" else OCV, step_of(n)
        change = (coordinates.inputs({n: step}).table - inputs.table)[0, :, column] / step
        moved[n] = np.ones(soc.size) if n.startswith("offset_V") else change
    found: dict[str, dict[str, float]] = {}
    for name, log in read:
        at = (log.start.beginning or log.start).soc
        ends = np.clip([at - GOOD.about_soc, at + GOOD.about_soc], soc[0], soc[-1])
        ocv = coordinates.model.ocv_at(float(log.temperature_C[0]))
        low, high = np.interp(ends, soc, ocv)
        slope = max(float(high - low) / float(ends[1] - ends[0]), GOOD.least_slope_V)
        found[name] = {
            n: -float(np.interp(at, soc, v)) / slope
            for n, v in moved.items()
            if n.partition(":")[2] in ("", name.partition(":")[2])  # of all logs, or of this one
        }
        if "m_V" in moved:  # as much of it as a log is taken to start with
            found[name]["m_V"] *= start_hysteresis(at)
    return found


def ln_size(z: Mapping[str, float], names: Iterable[str], prior: Tolerances) -> float:
    """Ln of how much likelier the sizes of causes are than the prior of the fit says.

    Parameters
    ----------
    z : the point; names : coordinates of causes; prior : what the fit took them for
    """
    total = 0.0
    for name in names:
        x, wide = z.get(name, 0.0), prior.std.get(name)
        if wide is None:
            continue
        if name in AGE:
            below, above = AGE[name]
            std = below if x < 0.0 else above
            total += math.log(2.0 * wide / (below + above)) + _ln_normal(x, std, wide)
        elif (of_all := name.partition(":")[0]) in CLASS:
            usual, other = CLASS[of_all]
            within = math.log((1.0 - GOOD.wrong_class) * wide / usual) + _ln_normal(x, usual, wide)
            wrong = math.log(GOOD.wrong_class * wide / other) + _ln_normal(x, other, wide)
            total += float(np.logaddexp(within, wrong))
            if of_all != name:  # of one log: it could as well be of another
                total -= math.log(sum(n.startswith("soc0:") for n in prior.std))
    return total


def _ln_normal(x: float, std: float, wide: float) -> float:
    """Ln of one normal density over another, both without their factor before the exponential."""
    return -0.5 * x * x * (1.0 / std**2 - 1.0 / wide**2)

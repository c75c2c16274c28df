"""What the adaptive filter carries, how fast its parameters may move, and its start."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import CellState, at_rest
from cellwise.estimate.adaptive.covariance_kernels import (
    AdaptiveCovariance,
    uncorrelated,
)
from cellwise.estimate.evidence_kernels import stated_deviation
from cellwise.estimate.filters.filter_state import EkfStart
from cellwise.estimate.filters.past_kernels import Past, no_past
from cellwise.estimate.sensing_kernels import Watch, first_watch

CHARGE_LOW, CHARGE_HIGH = 0.5, 2.5
NEARLY = 1e-12


class AdaptiveScalars(NamedTuple):
    """How the parameters may move; the variance of what is not estimated is 0."""

    offset_variance: float
    resistance_variance: float
    charge_variance: float
    offset_walk: float  # variance per second
    resistance_walk: float
    charge_walk: float
    estimates_offset: bool
    estimates_resistance: bool
    estimates_charge: bool
    settled_variance: float
    swing_V2: float
    fast_s: float
    tail_s: float
    misfit: float
    rest_after_s: float
    rest_band_A: float
    rest_limit_A: float
    rest_variance: float
    odds: float
    charge_odds: float


class Rest(NamedTuple):
    """A rest that may be going on: for how long, its mean current, whether it has been used."""

    since_s: float
    current_A: float
    used: bool


class Resistances(NamedTuple):
    """Factors on R0, R1 (``fast``) and R2 (``tail``), and the means they are estimated from.

    ``drop`` and ``miss`` are running means of the fast part of the polarisation and of the
    innovation, ``near`` and ``far`` those of the tail over the shorter and the longer time; the
    others mean squares of what moves within each band.
    """

    fast: float
    fast_variance: float
    tail: float
    tail_variance: float
    drop_V: float
    miss_V: float
    drop_V2: float
    miss_V2: float
    near_V: float
    far_V: float
    miss_far_V: float
    tail_V2: float
    miss_far_V2: float


class Persistent(NamedTuple):
    """How far an error of the model that stays has led the estimate, by one standard deviation.

    No voltage averages such an error out, and P does not know of it: on a plateau it reads as much
    SOC, and on the way there as much offset or capacity, as the data seem to ask for.
    """

    soc: float
    offset_A: float
    charge: float


class Estimate(NamedTuple):
    """Cell, parameters and covariance in the middle of a step."""

    x: CellState
    offset_A: float
    charge: float
    p: AdaptiveCovariance


class AdaptiveState(NamedTuple):
    """What must be carried: cell, parameters, P, how the model has done, the sensors' past.

    ``offset_A`` is what the current sensor adds, ``charge`` the model's capacity over the cell's;
    the other fields as in :class:`~cellwise.estimate.filters.filter_state.EkfState`.
    """

    cell: CellState
    offset_A: float
    charge: float
    p: AdaptiveCovariance
    rejections: float
    mismatch: float
    persistent: Persistent
    rest: Rest
    resistances: Resistances
    watch: Watch
    past: Past

    @property
    def soc(self) -> float:
        """State of charge, every parameter free."""
        return self.cell.soc

    @property
    def current_A(self) -> float:
        """The last valid current [A]."""
        return self.watch.current_A

    @property
    def soc_std(self) -> float:
        """Standard deviation of the state of charge, every parameter free."""
        return stated_deviation(self.p.ss, self.mismatch, self.persistent.soc, 0.0)


@kernel
def adaptive_start(start: EkfStart, rules: AdaptiveScalars, current_A: float) -> AdaptiveState:
    """A cell known as ``start`` says; parameters at the model's own values."""
    h = 1.0 if start.soc > 0.5 else -1.0
    p = uncorrelated(
        start.variance,
        0.0,
        0.0,
        0.0,
        start.hysteresis_variance,
        rules.offset_variance,
        rules.charge_variance,
    )
    unknown = rules.resistance_variance
    none = 0.0
    # fmt: off
    resistances = Resistances(
        1.0, unknown, 1.0, unknown, none, none, none, none, none, none, none, none, none
    )
    return AdaptiveState(
        at_rest(start.soc, h), 0.0, 1.0, p, 0.0, 1.0, Persistent(0.0, 0.0, 0.0),
        Rest(0.0, 0.0, False), resistances, first_watch(current_A), no_past(),
    )
    # fmt: on


@inline
def soc_by_parameters(p: AdaptiveCovariance) -> tuple[float, float]:
    """By how much SOC goes with offset [1/A] and capacity: its regression on both."""
    sb, sq = p.so, p.sq
    bb, bq, qq = p.poo, p.poq, p.pqq
    if bb > 0.0 and qq > 0.0:
        per = 1.0 / max(bb * qq - bq * bq, NEARLY * bb * qq)
        return (sb * qq - sq * bq) * per, (sq * bb - sb * bq) * per
    if bb > 0.0:
        return sb / bb, 0.0
    if qq > 0.0:
        return 0.0, sq / qq
    return 0.0, 0.0


@inline
def settled_variance(p: AdaptiveCovariance) -> float:
    """Variance that SOC would have if offset and capacity were known."""
    by_offset, by_charge = soc_by_parameters(p)
    return p.ss - (by_offset * p.so + by_charge * p.sq)


@inline
def settled_soc(e: Estimate) -> float:
    """SOC if offset and capacity were the model's."""
    by_offset, by_charge = soc_by_parameters(e.p)
    return e.x.soc - (by_offset * e.offset_A + by_charge * (e.charge - 1.0))


@inline
def is_sound(soc: float, p: AdaptiveCovariance) -> bool:
    """Whether the state can be gone on with."""
    return math.isfinite(soc) and math.isfinite(p.ss)

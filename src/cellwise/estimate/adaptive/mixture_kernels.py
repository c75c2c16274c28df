r"""Is there an offset, is the capacity another one: four hypotheses out of one covariance.

Each of the two is either what the model says or free. The filter carries the case in which both
are free; the others are that one conditioned on the values that they fix, and their evidence is the
posterior density at those values over the prior's (Savage-Dickey):

.. math:: \ln \frac{p(y | \theta_F = \theta_0)}{p(y)} =
   -\tfrac12 \delta^T P_{FF}^{-1} \delta - \tfrac12 \ln \frac{|P_{FF}|}{|P^0_{FF}|}

So a freedom that the data do not ask for costs hardly anything in SOC, and a parameter without
evidence goes back to the model's value. Where a persistent model error would have led a parameter
as far, that is no evidence: its variance has that, too, up to the prior's.

Source: J. M. Dickey, Ann. Math. Statist. 42 (1971) 204, doi:10.1214/aoms/1177693507.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.estimate.adaptive.covariance_kernels import VARIANCE_FLOOR
from cellwise.estimate.adaptive.state_kernels import (
    NEARLY,
    AdaptiveScalars,
    AdaptiveState,
    Persistent,
)
from cellwise.estimate.evidence_kernels import stated_deviation


class Before(NamedTuple):
    """Offset and capacity before any data: variances, 0 where not estimated, odds for the model."""

    offset_variance: float
    charge_variance: float
    offset_odds: float
    charge_odds: float


class Mixture(NamedTuple):
    """What the hypotheses say together: means, variances, probabilities of being free.

    ``charge`` is q - 1: the model's capacity over the cell's, less one. ``persistent`` is what a
    persistent error may have brought into the SOC, one deviation.
    """

    soc: float
    soc_variance: float
    offset_A: float
    offset_variance: float
    charge: float
    charge_variance: float
    offset_probability: float
    charge_probability: float
    persistent: float


@inline
def evidence(away: float, variance: float, stays: float, prior: float, odds: float) -> float:
    """How much likelier one parameter is at the model's value than free.

    ``stays`` is how far a persistent error may have led it.
    """
    per_variance = 1.0 / min(variance + stays * stays, prior)
    sharper = math.sqrt(prior * per_variance)
    return odds * sharper * math.exp(-0.5 * away * away * per_variance)


@inline
def fixed_or_free(
    soc: float, ss: float, away: float, cross: float, variance: float, fixed: float
) -> tuple[float, float, float, float, float]:
    """One parameter's two hypotheses: SOC, its variance, the parameter, its, probability of free.

    ``cross`` is the covariance of SOC and the parameter.
    """
    free = 1.0 / (1.0 + fixed)
    move = -cross / variance * away
    both = free * (1.0 - free)
    mixed = ss - (1.0 - free) * cross * cross / variance + both * move * move
    return (
        soc + (1.0 - free) * move,
        mixed,
        free * away,
        free * variance + both * away * away,
        free,
    )


@inline
def mix(
    soc: float,
    ss: float,
    b: float,
    q: float,
    sb: float,
    sq: float,
    bb: float,
    bq: float,
    qq: float,
    before: Before,
    stays: Persistent,
) -> Mixture:
    """Weigh: both free, offset fixed, capacity fixed, both fixed; what has no prior is fixed.

    Parameters
    ----------
    soc, ss : float            SOC and its variance, everything free
    b, q : float               offset [A] and capacity factor, less the model's values
    sb, sq, bb, bq, qq : float their covariances
    before : Before            what is known of offset and capacity before any data
    stays : Persistent         where a persistent error of the model has led them
    """
    prior_b, prior_q, odds_b, odds_q = before
    free_b = prior_b > 0.0 and bb > 0.0
    free_q = prior_q > 0.0 and qq > 0.0
    if not free_b and not free_q:
        return Mixture(soc, ss, b, 0.0, q, 0.0, 0.0, 0.0, stays.soc)
    if not free_q:
        fixed = evidence(b, bb, stays.offset_A, prior_b, odds_b)
        s, v, m, w, free = fixed_or_free(soc, ss, b, sb, bb, fixed)
        led = stays.soc - (1.0 - free) * sb / bb * stays.offset_A
        return Mixture(s, v, m, w, 0.0, 0.0, free, 0.0, led)
    if not free_b:
        fixed = evidence(q, qq, stays.charge, prior_q, odds_q)
        s, v, m, w, free = fixed_or_free(soc, ss, q, sq, qq, fixed)
        led = stays.soc - (1.0 - free) * sq / qq * stays.charge
        return Mixture(s, v, 0.0, 0.0, m, w, 0.0, free, led)
    det = max(bb * qq - bq * bq, NEARLY * bb * qq)
    ib, iq, i0 = 1.0 / bb, 1.0 / qq, 1.0 / det
    # The offset at zero.
    kb = sb * ib
    soc_b = soc - kb * b
    ss_b = ss - kb * sb
    q_b = q - bq * ib * b
    qq_b = det * ib
    # The model's capacity.
    kq = sq * iq
    soc_q = soc - kq * q
    ss_q = ss - kq * sq
    b_q = b - bq * iq * q
    bb_q = det * iq
    led_b, led_q = stays.offset_A, stays.charge
    by_b, by_q = kb * led_b, kq * led_q
    # Both.
    kb = (sb * qq - sq * bq) * i0
    kq = (sq * bb - sb * bq) * i0
    soc_0 = soc - (kb * b + kq * q)
    ss_0 = ss - (kb * sb + kq * sq)
    wb = evidence(b, bb, led_b, prior_b, odds_b)
    wq = evidence(q, qq, led_q, prior_q, odds_q)
    w0 = wb * evidence(q_b, qq_b, led_q - bq * ib * led_b, prior_q, odds_q)
    w1 = 1.0 / ((1.0 + wb) + (wq + w0))
    wb *= w1
    wq *= w1
    w0 *= w1
    # Away from the first, so that nothing is lost in differences of squares.
    eb, eq, e0 = soc_b - soc, soc_q - soc, soc_0 - soc
    mean = (wb * eb + wq * eq) + w0 * e0
    square = (w1 * ss + wb * (ss_b + eb * eb)) + (wq * (ss_q + eq * eq) + w0 * (ss_0 + e0 * e0))
    mean_b = w1 * b + wq * b_q
    mean_q = w1 * q + wb * q_b
    return Mixture(
        soc + mean,
        square - mean * mean,
        mean_b,
        w1 * (bb + b * b) + wq * (bb_q + b_q * b_q) - mean_b * mean_b,
        mean_q,
        w1 * (qq + q * q) + wb * (qq_b + q_b * q_b) - mean_q * mean_q,
        w1 + wq,
        w1 + wb,
        stays.soc - (wb * by_b + wq * by_q + w0 * (kb * led_b + kq * led_q)),
    )


@inline
def mixture(rules: AdaptiveScalars, state: AdaptiveState) -> Mixture:
    """The hypotheses together."""
    p = state.p
    return mix(
        state.cell.soc, p.ss, state.offset_A, state.charge - 1.0,
        p.so, p.sq, p.poo, p.poq, p.pqq,
        Before(rules.offset_variance, rules.charge_variance, rules.odds, rules.charge_odds),
        state.persistent,
    )  # fmt: skip


@inline
def soc_deviation(mixed: Mixture, mismatch: float) -> float:
    """Standard deviation of the SOC: the hypotheses', and what a persistent error has brought."""
    return stated_deviation(
        max(mixed.soc_variance, VARIANCE_FLOOR), mismatch, mixed.persistent, 0.0
    )

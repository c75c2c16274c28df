"""What a sample means to the fixed step: numbers missing, a current that is held; the charge."""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.cell.description import BRANCHES
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.covariance import Point, forget_correlations, relax
from cellwise.estimate.equations.evidence import stated_variance
from cellwise.estimate.equations.sensors import drifted_variance, is_dead, unseen_variance
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.covariance import forget_hysteresis
from cellwise.estimate.fixed.lookup import within_one
from cellwise.estimate.fixed.state import taken
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    CURRENT_LOST,
    DUPLICATE,
    SEQUENCE_GAP,
    TEMPERATURE_INVALID,
)


class Reading(NamedTuple):
    """A sample as the filter takes it.

    ``news`` says whether it ends an interval, ``missing`` how many were left out, ``silent`` for
    how many steps there was no current that could be used. ``current`` is the one that is held,
    ``delayed_current_A`` the one that the voltage has seen, ``counted_current_A`` the one whose
    charge is counted.
    """

    status: int
    news: int
    missing: int
    silent: int
    current: float
    delayed_current_A: float
    counted_current_A: float
    unmeasured_A2: float
    temperature_C: WarmFloat


class Charge(NamedTuple):
    """What an interval took: samples missing, and the current that bridges them."""

    status: int
    missing: int
    bridge: float


def see(c: Constants, x: State, sample: Sample, before: int) -> Reading:
    """Sequence number, current and temperature of a sample; the status ``before`` with theirs."""
    status = before
    news = NO_INTERVAL
    missing = U(0)
    silent = U(0)
    current = sample.current_A
    unmeasured_A2 = 0.0
    # The first sample ends no interval; a sequence number that was taken before ends none either.
    if x.evidence != NOT_BEGUN:
        elapsed = U(sample.sequence - x.sequence)
        if elapsed == U(0):
            news = REPEATED
            status = U(status | DUPLICATE)
        else:
            news = INTERVAL
            missing = U(elapsed - 1)
    if not size_within(current, c.current_limit_A):
        status = U(status | CURRENT_INVALID | out_of_range(current))
        silent = U(1)
    if silent != U(0) or news == REPEATED:
        current = x.current_A
    if WIDE:
        if not is_same(current, x.current_A):
            x.swings = 0.0
        elif is_dead(x.swings):
            status = U(status | CURRENT_INVALID)
            silent = U(1)
    temperature_C = 0.0
    if WARM:
        if not within(sample.temperature_C, COLDEST_C, HOTTEST_C):
            status = U(status | TEMPERATURE_INVALID)
        elif news != REPEATED:
            x.temperature_C = sample.temperature_C
        temperature_C = x.temperature_C
        if HEATING:
            temperature_C = temperature_C + x.heat_K
    delayed_current_A = current
    if SKEW and news == INTERVAL:
        delayed_current_A = current + (c.skew_share * (x.current_A - current))
    counted_current_A = delayed_current_A
    if WIDE:
        # Held for a while; then whatever was held is no guide any more: nothing is counted, and as
        # much as half a rate may flow either way.
        if silent != U(0) or news == REPEATED:
            silent = x.no_current
            if news == INTERVAL and silent < COUNT_MOST:
                silent = U(silent + 1)
        if silent > c.hold_steps:
            status = U(status | CURRENT_LOST)
            delayed_current_A = 0.0
            counted_current_A = 0.0
            unmeasured_A2 = c.lost_A2
    elif silent != U(0):
        unmeasured_A2 = c.lost_A2
    return Reading(
        status,
        news,
        missing,
        silent,
        current,
        delayed_current_A,
        counted_current_A,
        unmeasured_A2,
        temperature_C,
    )


def count_charge(c: Constants, x: State, reading: Reading) -> Charge:
    """SOC over the interval that ends now: charge comes first, then the branches at the new SOC."""
    status = reading.status
    missing = reading.missing
    bridge = 0.0
    if reading.news == INTERVAL:
        used = taken(c, x, reading.counted_current_A)
        if missing != U(0):
            status = U(status | SEQUENCE_GAP)
            if missing <= c.gap_steps:
                bridge = 0.5 * (reading.current + x.current_A)
                if WIDE and reading.silent > c.hold_steps:
                    bridge = 0.0
                used = used + (taken(c, x, bridge) * F(missing))
            else:  # nobody knows what flowed; self-discharge goes on
                missing = missing if missing < LONGEST_GAP else LONGEST_GAP
                if BANK and x.in_bank == ALONE:
                    x.in_bank = UNCOUNTED
                if LEAK:
                    lost = c.leak_soc * F(missing)
                    if HEALTH:
                        lost = lost * x.per_capacity
                    used = used + lost
        x.soc, x.soc_carry = add(x.soc, x.soc_carry, -used)
        if reading.unmeasured_A2 > 0.0:
            if WIDE:
                x.ss = drifted_variance(x.ss, c.lost_soc)
                if BANK and x.in_bank == ALONE:
                    x.in_bank = UNCOUNTED
            else:
                x.ss = x.ss + c.lost_walk
    return Charge(status, missing, bridge)


@unrolled_by_option
def cross_gap(
    c: Constants, x: State, p: Point, missing: int, current: float, bridge: float
) -> float:
    """Samples are missing: the branches may hold what the currents on both sides can have left.

    With CELLWISE_WIDE they relax towards the mean of these currents, too. Returns the variance of
    SOC that the voltage is asked for: of what has flowed unseen, and beyond the tangent's reach.
    """
    unknown_A2 = (current * current) + (x.current_A * x.current_A)
    steps = F(missing)
    spread = c.gap_variance
    moved = c.soc_per_A * steps
    if missing <= c.gap_steps:
        spread = (moved * moved) * unknown_A2
    elif WIDE:
        spread = unseen_variance(c.gap_variance, unknown_A2, c.lost_A2, moved)
    unseen = 0.0
    asks = WIDE and missing > c.gap_steps and x.evidence >= FIRST_VOLTAGE
    if not asks or (BANK and x.in_bank == COMPONENT):
        x.ss = x.ss + spread
    else:
        unseen = spread
        if x.ss > WIDE_VARIANCE:
            unseen = unseen + (x.ss - WIDE_VARIANCE)
            x.ss = WIDE_VARIANCE
            forget_correlations(x)
    if WIDE:
        gain: dict[Any, float] = {}
        for i in BRANCHES:
            gain[i] = risen(steps * p.gain[i]) if THERE else 0.0
        relax(x, p, *(gain[i] for i in BRANCHES), *(bridge for i in BRANCHES), unknown_A2)  # type: ignore[call-arg]
    else:
        for i in BRANCHES:
            x.p[i, i] = x.p[i, i] + (unknown_A2 * (p.r[i] * p.r[i]))
    if HYSTERESIS:
        forget_hysteresis(x)
    if HEATING:
        x.heat_K = x.heat_K * vanishing(steps * c.heat_rate)
    return F(unseen)


def follow(c: Constants, x: State, reading: Reading, charge: Charge) -> None:
    """Current that the particles' surface follows: over missing samples what bridges them."""
    if charge.missing != U(0):
        left = vanishing(F(charge.missing) * c.surface_rate)
        x.slow_A = charge.bridge + (left * (x.slow_A - charge.bridge))
    if reading.news == INTERVAL:
        x.slow_A = x.slow_A + (c.surface_gain * (reading.counted_current_A - x.slow_A))


def variance_of(x: State, known: float) -> float:
    """What is stated of the SOC beside P's variance ``known``; LARGE where it is no number."""
    sure = known
    if OFFSET:
        sure = known + ((x.reach * x.reach) * x.unsure)
    stated = stated_variance(sure, x.mismatch, x.persistent, x.contradicted)
    return stated if not_negative(stated, LARGE) else LARGE


def finish(x: State, reading: Reading, missing: int, sequence: int, out: Output) -> int:
    """Hold SOC within its bounds, remember the sample: the status of the clamp.

    A variance that memory which lost a bit has driven below zero is none: this step knows nothing,
    and the next one re-initialises the state.
    """
    status = U(0)
    if not not_negative(x.soc, 1.0):
        x.soc = within_one(x.soc)
        x.soc_carry = 0.0
        status = U(CLAMPED)
    if reading.news != REPEATED:
        x.current_A = reading.current
        x.sequence = sequence
        if WIDE:
            x.no_current = reading.silent
        if reading.news == INTERVAL and U(x.evidence - FIRST_VOLTAGE) < EVIDENCE_MOST:
            x.evidence = U(x.evidence + 1 + missing)
    out.soc = x.soc
    out.soc_variance = x.ss if not_negative(x.ss, LARGE) else KNOW_NOTHING_VARIANCE
    if WIDE:
        out.soc_variance = variance_of(x, out.soc_variance)
    return status

"""The adaptive filter as scalar code: SOC together with what is wrong with sensor and cell.

State x = [soc, v1, v2, v3, h, b, q]: the EKF's five, what the current sensor adds (b, [A]), and
the model's capacity over the cell's (q); beside it the factors r on R0, R1, and w on R2, which is
reported only:

    soc+ = soc - q (I - b) dt / (3600 Q)
    v_j+ = a_j v_j + R_j (1 - a_j) (I - b)
    v    = OCV(soc) - r (R0 (I - b) + v1) - v2 - v3 + M h

A sensor's gain and a capacity move the counted charge alike, so q stands for either.

A voltage says two things, and they are used apart. Its slow part, weighed as in the EKF with the
number of samples that share one model error, bears on soc, b and q. Its fast part, against the
fast part of the drop, bears on the resistances by recursive least squares.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    heat_step,
    terminal_voltage,
    with_heat,
    with_soc,
)
from cellwise.cell.equations.lookup import BEYOND
from cellwise.estimate.adaptive.covariance_kernels import (
    AdaptiveColumn,
    AdaptiveCovariance,
    column,
    corrected,
    explained,
    offset_column,
    rejudged,
    scaled,
    soc_row,
    uncorrelated,
    with_parameters,
)
from cellwise.estimate.adaptive.look_kernels import look_again, moved
from cellwise.estimate.adaptive.mixture_kernels import Mixture, mixture, soc_deviation
from cellwise.estimate.adaptive.predict_kernels import Predicted, predict
from cellwise.estimate.adaptive.state_kernels import (
    AdaptiveScalars,
    AdaptiveState,
    Estimate,
    Persistent,
    Resistances,
    Rest,
    settled_soc,
    settled_variance,
)
from cellwise.estimate.adaptive.watch_kernels import (
    walk_resistances,
    watch_resistances,
    watch_rest,
)
from cellwise.estimate.evidence_kernels import persistent_step, persistent_V, voltage_variance
from cellwise.estimate.filters.ekf_kernels import reading_of
from cellwise.estimate.filters.filter_state import EkfStart, LogArrays
from cellwise.estimate.gate_kernels import Innovation, Verdict, gate
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.recovery_kernels import Contradiction, Variances, recovered
from cellwise.estimate.sensing_kernels import REST_RATE, Reading, Sample, read_sample
from cellwise.estimate.slopes_kernels import WIDE_VARIANCE, bends, landing_slope
from cellwise.estimate.status import CLAMPED, CURRENT_INVALID
from cellwise.typing import FloatArray, IntArray

# Columns of the per-sample output: the EKF's, then value and deviation of each parameter.
OUT_SOC, OUT_STD, OUT_VOLTAGE, OUT_INNOVATION, OUT_VARIANCE, OUT_RATIO = range(6)
OUT_OFFSET, OUT_FAST, OUT_TAIL, OUT_CHARGE = range(6, 10)
OUT_OFFSET_STD, OUT_FAST_STD, OUT_TAIL_STD, OUT_CHARGE_STD = range(10, 14)
OUT_OFFSET_FREE, OUT_CHARGE_FREE = range(14, 16)
OUTPUTS = 16

# Why a parameter is held; the same values as in adaptive_settings.Held.
NOT_CHOSEN = 1
SOC_UNSURE = 2
NO_EXCITATION = 4
MODEL_MISFIT = 8
NO_VOLTAGE = 16
NO_CURRENT = 32

AT_AN_END = 0.01  # there a voltage is explained by nothing
IMPOSSIBLE_SOC = 0.005  # so far beyond full or empty: what leads there is not so


class Held(NamedTuple):
    """Why a parameter is held, 0 where it is estimated."""

    offset: int
    resistance: int
    charge: int


class AdaptiveStep(NamedTuple):
    """What may be looked at after a step."""

    voltage_V: float
    innovation_V: float
    innovation_variance_V2: float
    test_ratio: float
    status: int
    held: Held


class Polarisation(NamedTuple):
    """What the load takes off the OCV: fast part, tail, all with the factor, all without [V]."""

    drop_V: float
    tail_V: float
    whole_V: float
    own_V: float


@inline
def polarised(now: Predicted, x: CellState, r: Resistances) -> Polarisation:
    """The polarisation with the factors as they are known."""
    drop = now.point.r0_ohm * now.s.seen_A + x.v1_V
    # What the tail's factor moves of the voltage is within the model's claim for the whole
    # polarisation, which moves with it: the voltage keeps the model's.
    tail = x.v2_V
    slow = tail + x.v3_V
    return Polarisation(drop, tail, r.fast * drop + slow, drop + slow)


@inline
def consider(
    k: AdaptiveColumn, d: AdaptiveColumn, p: AdaptiveCovariance, held_offset: bool, held_q: bool
) -> tuple[AdaptiveColumn, AdaptiveCovariance]:
    """Gain and covariance of an update in which some parameters are held.

    A held parameter keeps value and variance, and its uncertainty still counts in all others
    (consider filter: S. F. Schmidt, Advances in Control Systems 3, 1966, p. 293).
    """
    after = corrected(p, k, d)
    after = with_parameters(
        after,
        p.poo if held_offset else after.poo,
        p.poq if held_offset and held_q else after.poq,
        p.pqq if held_q else after.pqq,
    )
    gain = AdaptiveColumn(
        k.s, k.v1, k.v2, k.v3, k.h, 0.0 if held_offset else k.o, 0.0 if held_q else k.q
    )
    return gain, after


@inline
def use_rest(
    rules: AdaptiveScalars,
    rest: Rest,
    e: Estimate,
    stays: Persistent,
    s: Sample,
    blind: bool,
    resting_A: float,
) -> tuple[Rest, Estimate, Persistent]:
    """A rest shows the offset by itself: a measurement of b, free of the model's errors.

    Above ``resting_A`` it may as well be a load, and shows as much as is known beforehand.
    """
    if blind:
        return Rest(0.0, rest.current_A, rest.used), e, stays
    after, shows = watch_rest(rules, rest, s.current_A, s.dt_s)
    if not (shows and rules.estimates_offset):
        return after, e, stays
    d = offset_column(e.p)
    rested = abs(after.current_A) <= resting_A
    variance = rules.rest_variance if rested else rules.offset_variance
    k, p = consider(scaled(d, 1.0 / (d.o + variance)), d, e.p, False, not rules.estimates_charge)
    stays = Persistent(
        stays.soc - k.s * stays.offset_A,
        stays.offset_A - k.o * stays.offset_A,
        stays.charge - k.q * stays.offset_A,
    )
    return after, moved(e, p, k, after.current_A - e.offset_A), stays


@inline
def innovate(
    tables: CellTables,
    noise: NoiseScalars,
    now: Predicted,
    e: Estimate,
    r: Resistances,
    pol: Polarisation,
    explained_V2: float,
) -> Innovation:
    """Measured less predicted voltage; H = [slope, -r, -1, -1, m, r R0, 0]."""
    s, x, point = now.s, e.x, now.point
    r0 = r.fast * point.r0_ohm
    predicted = terminal_voltage(point, x.h, pol.whole_V)
    bend2 = 3.0 * now.at.bend_V * now.at.bend_V
    state_variance = explained_V2 + bend2
    branches = abs(x.v1_V) + (abs(x.v2_V) + abs(x.v3_V))
    one = voltage_variance(noise, point, r0, s.seen_A, s.lost_A, branches)
    drop2, tail2 = pol.drop_V * pol.drop_V, pol.tail_V * pol.tail_V
    off = r.tail - 1.0
    one += drop2 * r.fast_variance + tail2 * (r.tail_variance + off * off)
    unsure = e.p.ss > WIDE_VARIANCE
    bent = bends(tables, now.at, bend2, one)
    miss = s.voltage_V - predicted
    return Innovation(predicted, miss, state_variance, one, point.r0_ohm, branches, unsure, bent)


@inline
def recover(
    tables: CellTables, now: Predicted, e: Estimate, pol: Polarisation, i: Innovation
) -> Estimate:
    """The gate may have locked the truth out: the SOC is searched for over all of 0..1.

    The voltage is what a cell with the model's own resistances would have shown; offset and
    capacity keep what they are known to, what SOC and branches had in common with anything goes.
    """
    x, p, s = e.x, e.p, now.s
    own = s.voltage_V + (pol.whole_V - pol.own_V)
    drop = abs(i.r0_ohm * s.seen_A) + i.branches_V
    followed = now.evidence_s >= 0.0
    seen = Contradiction(own, s.seen_A, now.warm_C, i.one, drop, followed)
    soc, v = recovered(tables, x, Variances(p.ss, p.p11, p.p22, p.p33, p.phh), seen)
    fresh = uncorrelated(v.soc, v.v1_V2, v.v2_V2, v.v3_V2, v.h, p.poo, p.pqq)
    fresh = with_parameters(fresh, p.poo, p.poq, p.pqq)
    return Estimate(with_soc(x, soc), e.offset_A, e.charge, fresh)


@inline
def update(
    tables: CellTables, now: Predicted, e: Estimate, d: AdaptiveColumn, v: Verdict, held: Held
) -> Estimate:
    """After an accepted voltage; as the EKF, with parameters held that the data cannot show."""
    k = scaled(d, v.inverse)
    p = e.p
    gained = True
    if now.at.spread > 0.0:
        move = k.s * v.innovation_V
        # fmt: off
        flat = landing_slope(
            tables, e.x.soc, now.at, now.warm_C, now.s.seen_A, e.x.slow_A, move
        )
        # fmt: on
        less = flat - now.at.slope_V
        extra = less * (2.0 * d.s + less * p.ss)
        c = soc_row(p, less)
        gained = k.s * (k.s * extra - 2.0 * c.s) < k.s * d.s
        if gained:
            p = rejudged(p, k, c, extra)
    gain, after = consider(k, d, p, held.offset != 0, held.charge != 0)
    return moved(e, after if gained else p, gain, v.innovation_V)


@inline
def given_up(rules: AdaptiveScalars, e: Estimate, stays: Persistent) -> Estimate:
    """Offset and capacity at the model's values, and as little known as before any data.

    Minutes of innovations that the stated error cannot explain: what the parameters are taken for
    is not so, and the SOC may be wrong by as much as they and the model's error have moved it.
    """
    p = e.p
    settled = settled_soc(e)
    moved = e.x.soc - settled
    ss = settled_variance(p) + moved * moved + stays.soc * stays.soc
    p = uncorrelated(
        max(ss, p.ss), p.p11, p.p22, p.p33, p.phh, rules.offset_variance, rules.charge_variance
    )
    return Estimate(with_soc(e.x, min(max(settled, 0.0), 1.0)), 0.0, 1.0, p)


@inline
def led_astray(
    old: Persistent, k: AdaptiveColumn, held: Held, now: Predicted, stays_V: float
) -> Persistent:
    """Where a persistent error leads SOC and parameters, after an update with the gain ``k``."""
    left_V = stays_V - now.at.slope_V * old.soc
    return Persistent(
        persistent_step(k.s, now.at.slope_V, old.soc, stays_V),
        old.offset_A + (0.0 if held.offset != 0 else k.o * left_V),
        old.charge + (0.0 if held.charge != 0 else k.q * left_V),
    )


@inline
def why_held(
    rules: AdaptiveScalars, p: AdaptiveCovariance, status: int, v: Verdict, moves: bool
) -> Held:
    """What the data cannot show now is held."""
    why = NO_CURRENT if status & CURRENT_INVALID else 0
    if not v.used:
        why |= NO_VOLTAGE
    if settled_variance(p) > rules.settled_variance:
        why |= SOC_UNSURE
    resistance = why | (0 if rules.estimates_resistance else NOT_CHOSEN)
    if not moves:
        resistance |= NO_EXCITATION
    if status & CLAMPED:
        why |= MODEL_MISFIT
    offset = why | (0 if rules.estimates_offset else NOT_CHOSEN)
    return Held(offset, resistance, why | (0 if rules.estimates_charge else NOT_CHOSEN))


@inline
def within(e: Estimate) -> float:
    """SOC when the model's own offset and capacity hold it within 0..1.

    With a capacity that is free it may lead beyond the ends; held there, it would move the
    hypotheses with the model's capacity, which do not. What is reported is within 0..1.
    """
    settled = settled_soc(e)
    back = min(max(settled, 0.0), 1.0) - settled
    return min(max(e.x.soc + back, -BEYOND), 1.0 + BEYOND)


@inline
def take_step(
    tables: CellTables,
    noise: NoiseScalars,
    rules: AdaptiveScalars,
    start: EkfStart,
    state: AdaptiveState,
    reading: Reading,
) -> tuple[AdaptiveState, AdaptiveStep]:
    """One step: predict over the interval that ends now, then use the voltage read now."""
    raw = read_sample(tables, noise, state.watch, start.temperature_C, reading)
    now = predict(tables, noise, rules, start, state, raw)
    old, s, point = now.state, now.s, now.point
    blind = s.gap or s.status & CURRENT_INVALID != 0
    e = Estimate(now.x, old.offset_A, old.charge, now.p)
    persistent, mismatch = now.persistent, old.mismatch
    from_middle = abs(e.x.soc - 0.5)
    misfit = mismatch > rules.misfit and from_middle < 0.5 - AT_AN_END
    if misfit or from_middle > 0.5 + IMPOSSIBLE_SOC:
        e, persistent, mismatch = given_up(rules, e, persistent), Persistent(0.0, 0.0, 0.0), 1.0
    resting_A = REST_RATE * tables.cell.charge_As / 3600.0
    rest, e, persistent = use_rest(rules, old.rest, e, persistent, raw, blind, resting_A)
    r = walk_resistances(rules, old.resistances, s.dt_s)
    pol = polarised(now, e.x, r)
    x = e.x
    heat = heat_step(tables.cell, x.heat_K, s.flow_A, pol.whole_V, s.dt_s)
    e = Estimate(with_heat(x, heat), e.offset_A, e.charge, e.p)
    by_offset = r.fast * point.r0_ohm if s.lost_A == 0.0 else 0.0
    d = column(e.p, now.at.slope_V, point.m_V, r.fast, by_offset)
    explained_V2 = explained(d, now.at.slope_V, point.m_V, r.fast, by_offset)
    i = innovate(tables, noise, now, e, r, pol, explained_V2)
    v = gate(tables.cell, noise, old.watch, s, now.evidence_s, old.rejections, mismatch, i)
    status = s.status | now.status | v.status
    if e.x.soc <= 0.0 or e.x.soc >= 1.0:
        status |= CLAMPED

    held = why_held(rules, e.p, status, v, True)
    if v.used and not s.gap:
        white = noise.voltage_V * noise.voltage_V
        hold = held.resistance != 0
        r, moves = watch_resistances(
            rules, r, pol.drop_V, pol.tail_V, v.innovation_V, white, s.dt_s, hold
        )
        held = why_held(rules, e.p, status, v, moves)
    if v.recover:
        e = recover(tables, now, e, pol, i)
        persistent = Persistent(0.0, persistent.offset_A, persistent.charge)
    elif v.accepted:
        stays_V = persistent_V(noise, point, v.mismatch)
        persistent = led_astray(persistent, scaled(d, v.inverse), held, now, stays_V)
        e = update(tables, now, e, d, v, held)
    own = v.innovation_V + (pol.own_V - pol.whole_V)
    e, persistent, past = look_again(tables, noise, now, v, own, e, persistent)
    x = e.x
    if x.soc < 0.0 or x.soc > 1.0:
        x = with_soc(x, within(e))
        status |= CLAMPED
    # fmt: off
    after = AdaptiveState(
        x, e.offset_A, e.charge, e.p, v.rejections, v.mismatch, persistent, rest, r, v.watch,
        past,
    )
    # fmt: on
    step = AdaptiveStep(i.predicted_V, v.innovation_V, v.variance, v.ratio, status, held)
    return after, step


@kernel
def adaptive_step(
    tables: CellTables,
    noise: NoiseScalars,
    rules: AdaptiveScalars,
    start: EkfStart,
    state: AdaptiveState,
    reading: Reading,
) -> tuple[AdaptiveState, AdaptiveStep, Mixture]:
    """One step for online use."""
    after, info = take_step(tables, noise, rules, start, state, reading)
    return after, info, mixture(rules, after)


@rows
def adaptive_rows(
    tables: CellTables,
    noise: NoiseScalars,
    rules: AdaptiveScalars,
    start: EkfStart,
    state: AdaptiveState,
    log: LogArrays,
    out: FloatArray,
    status: IntArray,
    held: IntArray,
) -> None:
    """Every row of a log through one step each; ``out`` (OUTPUTS, rows), ``held`` (3, rows)."""
    for k in range(log.dt_s.size):
        state, info = take_step(tables, noise, rules, start, state, reading_of(log, k))
        mixed = mixture(rules, state)
        r = state.resistances
        out[OUT_SOC, k] = min(max(mixed.soc, 0.0), 1.0)
        out[OUT_STD, k] = soc_deviation(mixed, state.mismatch)
        out[OUT_VOLTAGE, k] = info.voltage_V
        out[OUT_INNOVATION, k] = info.innovation_V
        out[OUT_VARIANCE, k] = info.innovation_variance_V2
        out[OUT_RATIO, k] = info.test_ratio
        out[OUT_OFFSET, k] = mixed.offset_A
        out[OUT_FAST, k] = r.fast
        out[OUT_TAIL, k] = r.tail
        out[OUT_CHARGE, k] = 1.0 + mixed.charge
        out[OUT_OFFSET_STD, k] = math.sqrt(max(mixed.offset_variance, 0.0))
        out[OUT_FAST_STD, k] = math.sqrt(r.fast_variance)
        out[OUT_TAIL_STD, k] = math.sqrt(r.tail_variance)
        out[OUT_CHARGE_STD, k] = math.sqrt(max(mixed.charge_variance, 0.0))
        out[OUT_OFFSET_FREE, k] = mixed.offset_probability
        out[OUT_CHARGE_FREE, k] = mixed.charge_probability
        status[k] = info.status
        held[0, k] = info.held.offset
        held[1, k] = info.held.resistance
        held[2, k] = info.held.charge

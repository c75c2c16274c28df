"""A sketch of the residual: what a diagnosis needs of weeks of use, in less than a kilobyte.

For every cause that is looked for, it carries by how much one unit of it would have moved the
filter's estimate, and with it the innovation, through every prediction and every correction that
the filter made (sensitivities of the prediction error: Ljung, System Identification, 2nd ed., 1999,
ch. 10; of a bias: Friedland 1969, doi:10.1109/TAC.1969.1099223). To first order an innovation is

    nu = h' theta + noise,   h = -d nu / d theta

so that sum(w h nu) and sum(w h h') are sufficient statistics of theta, whatever the log: a fit to
the whole log, linear in its unknowns, sees no more. w is the weight that the filter itself gave to
the voltage. The sums are kept in two stages, so that millions of small terms do not vanish in a
large float, and fade with age.
"""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Point, look_up, place_now


@noinline
def forget_carried(k: Sketch) -> None:
    """Nothing has moved the estimate yet: at a start, after a gap, while the SOC is not known."""
    for i in range(k.soc.size):
        k.soc[i] = 0.0
        k.v1[i] = 0.0
        k.v2[i] = 0.0
        if SLOW:
            k.v3[i] = 0.0
        k.held[i] = 0.0
    k.error_V = 0.0
    k.error_V2 = LARGE
    k.until = U(0)


@noinline
def start_sketch(m: Model, k: Sketch) -> None:
    """An empty sketch, beside a state that was just started or is running."""
    forget_carried(k)
    for i in range(k.score.size):
        k.score_now[i] = 0.0
        k.score[i] = 0.0
        k.seen[i] = 0.0
    for i in range(k.information.size):
        k.information_now[i] = 0.0
        k.information[i] = 0.0
    k.squares_now = 0.0
    k.squares = 0.0
    k.count_now = U(0)
    k.count = 0.0
    k.hours = 0.0
    k.charge_Ah = 0.0
    k.before_A = 0.0
    k.lag_A = 0.0
    k.slow_A = 0.0
    k.turned = 0.0
    k.warmest_C = -m.constant.sketch_limit
    k.coldest_C = m.constant.sketch_limit
    k.sequence = U(0)
    k.begun = U(0)


@noinline
def close_block(m: Model, k: Sketch) -> None:
    """Add a block to the sums of all blocks, which fade with their age."""
    keep = m.constant.sketch_keep
    sound = size_within(k.squares_now, SUM_MOST) and size_within(k.squares, SUM_MOST)
    for i in range(k.information.size):
        if not size_within(k.information_now[i], SUM_MOST):
            sound = False
        if not size_within(k.information[i], SUM_MOST):
            sound = False
    for i in range(k.score.size):
        if not size_within(k.score_now[i], SUM_MOST):
            sound = False
        if not size_within(k.score[i], SUM_MOST):
            sound = False
        if not size_within(k.soc[i], SUM_MOST):
            sound = False
    if sound:
        for i in range(k.information.size):
            k.information[i] = (keep * k.information[i]) + k.information_now[i]
            k.information_now[i] = 0.0
        for i in range(k.score.size):
            k.score[i] = (keep * k.score[i]) + k.score_now[i]
            k.score_now[i] = 0.0
        k.squares = (keep * k.squares) + k.squares_now
        k.count = (keep * k.count) + F(k.count_now)
        k.squares_now = 0.0
        k.count_now = U(0)
    else:
        start_sketch(m, k)


def carry_on(m: Model, k: Sketch, p: Point, q: Point, flow: float, aside: float) -> None:
    """What one unit of each cause does in one interval, beside what it did before."""
    c = m.constant
    # What a SOC that is off does to the branches: they follow the resistances of another SOC.
    one_rise_V = (p.gain1 * flow) * ((q.r1_ohm - p.r1_ohm) / aside)
    two_rise_V = (p.gain2 * flow) * ((q.r2_ohm - p.r2_ohm) / aside)
    if SLOW:
        three_rise_V = (p.gain3 * flow) * ((q.r3_ohm - p.r3_ohm) / aside)
    for i in range(k.soc.size):
        k.v1[i] = k.v1[i] + ((one_rise_V * k.soc[i]) - (p.gain1 * k.v1[i]))
        k.v2[i] = k.v2[i] + ((two_rise_V * k.soc[i]) - (p.gain2 * k.v2[i]))
        if SLOW:
            k.v3[i] = k.v3[i] + ((three_rise_V * k.soc[i]) - (p.gain3 * k.v3[i]))
    per_A = c.soc_per_A
    one_V = p.gain1 * p.r1_ohm
    two_V = p.gain2 * p.r2_ohm
    # A sensor that adds an ampere: the true current is less.
    k.soc[OF_OFFSET] = k.soc[OF_OFFSET] + per_A
    k.v1[OF_OFFSET] = k.v1[OF_OFFSET] - one_V
    k.v2[OF_OFFSET] = k.v2[OF_OFFSET] - two_V
    k.soc[OF_GAIN] = k.soc[OF_GAIN] + (per_A * flow)
    k.v1[OF_GAIN] = k.v1[OF_GAIN] - (one_V * flow)
    k.v2[OF_GAIN] = k.v2[OF_GAIN] - (two_V * flow)
    k.v1[OF_RESISTANCE] = k.v1[OF_RESISTANCE] + (one_V * flow)
    k.v2[OF_RESISTANCE] = k.v2[OF_RESISTANCE] + (two_V * flow)
    k.v2[OF_SLOWER] = k.v2[OF_SLOWER] + (two_V * flow)
    k.soc[OF_CAPACITY] = k.soc[OF_CAPACITY] + (per_A * flow)
    if SLOW:
        three_V = p.gain3 * p.r3_ohm
        k.v3[OF_OFFSET] = k.v3[OF_OFFSET] - three_V
        k.v3[OF_GAIN] = k.v3[OF_GAIN] - (three_V * flow)
        k.v3[OF_RESISTANCE] = k.v3[OF_RESISTANCE] + (three_V * flow)
        k.v3[OF_SLOWER] = k.v3[OF_SLOWER] + (three_V * flow)
    k.slow_A = k.slow_A + (c.sketch_slow * (flow - k.slow_A))
    rise = risen(c.sketch_turn * magnitude(flow))
    k.turned = k.turned + (rise * ((1.0 if flow < 0.0 else -1.0) - k.turned))


def look_at(k: Sketch, p: Point, q: Point, seen: float, aside: float) -> None:
    """By how much one unit of each cause moves the voltage: ``seen``."""
    drop_V = p.r0_ohm * seen
    slope_V = ((q.ocv_V - p.ocv_V) - (seen * (q.r0_ohm - p.r0_ohm))) / aside
    for i in range(k.soc.size):
        held_V = k.v1[i] + k.v2[i]
        if SLOW:
            held_V = held_V + k.v3[i]
        k.seen[i] = (slope_V * k.soc[i]) - held_V
    k.seen[OF_OFFSET] = k.seen[OF_OFFSET] + p.r0_ohm
    k.seen[OF_GAIN] = k.seen[OF_GAIN] + drop_V
    k.seen[OF_VOLTAGE] = k.seen[OF_VOLTAGE] + 1.0
    k.seen[OF_RESISTANCE] = k.seen[OF_RESISTANCE] - drop_V
    k.seen[OF_DIFFUSION] = k.seen[OF_DIFFUSION] - k.slow_A
    k.seen[OF_OHMIC] = k.seen[OF_OHMIC] - seen
    k.seen[OF_REVERSAL] = k.seen[OF_REVERSAL] + k.turned
    k.seen[OF_LATE] = k.seen[OF_LATE] - (p.r0_ohm * (k.lag_A - seen))


def correct_carried(k: Sketch, x: State) -> None:
    """A voltage that was used takes out of the estimate what it has seen of a cause."""
    for i in range(k.soc.size):
        k.soc[i] = k.soc[i] - (x.gain_s * k.seen[i])
        k.v1[i] = k.v1[i] - (x.gain_v1 * k.seen[i])
        k.v2[i] = k.v2[i] - (x.gain_v2 * k.seen[i])
        if SLOW:
            k.v3[i] = k.v3[i] - (x.gain_v3 * k.seen[i])


@noinline
def weigh_in(c: Constants, k: Sketch, drop_V: float, out: Output) -> None:
    """One voltage of every few seconds into the sums, beside the model's slow error.

    That error is a first-order process, and a state of a scalar Kalman filter: what of it the
    voltages before have shown is known, and so is what it has seen of each cause. What the model
    errs by for seconds is new every time.
    """
    keep = c.sketch_past
    slow_V2 = out.innovation_variance_V2
    ahead_V2 = slow_V2 + ((keep * keep) * (k.error_V2 - slow_V2))
    new_V2 = c.sketch_new_V2 + (c.sketch_new_share * (drop_V * drop_V))
    weight = 1.0 / (ahead_V2 + new_V2)
    gain = ahead_V2 * weight
    innovation = out.innovation_V - (keep * k.error_V)
    at = U(0)
    for i in range(k.soc.size):
        k.seen[i] = k.seen[i] - (keep * k.held[i])
        weighed = weight * k.seen[i]
        k.score_now[i] = k.score_now[i] + (weighed * innovation)
        for j in range(i + 1):
            k.information_now[at] = k.information_now[at] + (weighed * k.seen[j])
            at = U(at + 1)
    for i in range(k.soc.size):
        k.held[i] = (keep * k.held[i]) + (gain * k.seen[i])
    k.error_V = (keep * k.error_V) + (gain * innovation)
    k.error_V2 = ahead_V2 * (1.0 - gain)
    ratio = weight * (innovation * innovation)
    k.squares_now = k.squares_now + at_most(ratio, c.mismatch_cap)
    k.count_now = U(k.count_now + 1)


@noinline
def pass_by(c: Constants, k: Sketch, out: Output) -> None:
    """A voltage that is not used: the slow error goes on unseen."""
    keep = c.sketch_past
    slow_V2 = out.innovation_variance_V2
    for i in range(k.soc.size):
        k.held[i] = keep * k.held[i]
    k.error_V = keep * k.error_V
    k.error_V2 = slow_V2 + ((keep * keep) * (k.error_V2 - slow_V2))


def step_sketch(m: Model, x: State, k: Sketch, sample: Sample, out: Output) -> None:
    """Take what a step has just made of a sample; the state is read, never changed.

    Nothing is taken of a sample that the step did not take, that came twice or after a gap, nor
    while the SOC is badly known.
    """
    gone_on = k.begun != U(0) and sample.sequence == U(k.sequence + 1)
    again = k.begun != U(0) and sample.sequence == k.sequence
    if not again and x.sequence == sample.sequence:
        if not gone_on or x.ss > WIDE_VARIANCE:
            forget_carried(k)
        else:
            flow = x.current_A
            # A SOC aside from the estimate says how the tables rise with it.
            aside = ASIDE if x.soc < 0.5 else -ASIDE
            place = place_now(m, x)
            p = look_up(m, place, x.soc, flow)
            q = look_up(m, place, x.soc + aside, flow)
            carry_on(m, k, p, q, flow, aside)
            seen = flow
            if SKEW:
                seen = flow + (m.constant.skew_share * (k.before_A - flow))
            look_at(k, p, q, seen, aside)
            k.lag_A = k.lag_A + (m.constant.sketch_lag * (flow - k.lag_A))
            if x.inverse > 0.0:
                correct_carried(k, x)
            if k.until == U(0):
                k.until = m.constant.sketch_every
                if x.inverse > 0.0 and x.soc > 0.1:
                    weigh_in(m.constant, k, p.r0_ohm * seen, out)
                else:
                    pass_by(m.constant, k, out)
            k.until = U(k.until - 1)
            k.hours = k.hours + m.constant.sketch_hours
            k.charge_Ah = k.charge_Ah + (m.constant.sketch_hours * magnitude(flow))
            if WARM:
                k.warmest_C = at_least(k.warmest_C, x.temperature_C)
                k.coldest_C = at_most(k.coldest_C, x.temperature_C)
            if k.count_now >= SKETCH_BLOCK:
                close_block(m, k)
        k.before_A = x.current_A
        k.sequence = sample.sequence
        k.begun = U(1)

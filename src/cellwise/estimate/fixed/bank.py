"""A start that nobody knows: filters side by side over the SOC, weighed by what they predict.

A sum of Gaussians (D. Alspach, H. Sorenson, IEEE Trans. Automatic Control 17 (1972) 439,
doi:10.1109/TAC.1972.1100034). ``of`` are the states: the first is the estimate, which everything
else reads; behind it are the ``count`` components of the bank. Once they agree the first goes on
alone; where its voltages contradict it for long, they begin again.
"""

from __future__ import annotations

from typing import Any

from cellwise.cell.description import CARRIED, CELL, V3, triangle
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.components import (
    component_from,
    cost_of_past,
    kept_cost,
    mixture_variance,
    parts_before,
    past_of,
    soc_on_way,
)
from cellwise.estimate.equations.evidence import lately_shown
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.covariance import (
    Column,
    column_of_slow_branch,
    forget_correlations,
    move,
    narrow,
)
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import Place, look_up, place_now, within_one
from cellwise.estimate.fixed.sensing import variance_of
from cellwise.estimate.fixed.state import start
from cellwise.estimate.fixed.step import begin_at, step
from cellwise.estimate.status import INNOVATION_REJECTED, STATE_RESET


def component_start(a: State, t: float, apart: float, std: float) -> None:
    """A component from ``t`` on about the estimate, whose copy ``a`` is."""
    begins = component_from(t, apart, a.soc, a.ss, std)
    a.cost = begins.cost
    a.soc = begins.soc
    a.soc_carry = 0.0
    a.ss = begins.variance
    a.ss_carry = 0.0
    forget_correlations(a)
    if HYSTERESIS and a.evidence == NOT_BEGUN:
        a.h = 1.0 if a.soc > 0.5 else -1.0
    a.in_bank = COMPONENT


def weigh_components(of: States, count: int, least: float) -> None:
    """Weights that add up to one; the likeliest component costs nothing."""
    total = 0.0
    for k in range(count):
        of[k + 1].cost = kept_cost(of[k + 1].cost - least)
        of[k + 1].weight = vanishing(of[k + 1].cost)
        total = total + of[k + 1].weight
    for k in range(count):
        of[k + 1].weight = of[k + 1].weight / total


def spread_out(b: Bank, of: States, count: int) -> None:
    """Components over all of the SOC, densely about the estimate."""
    std = root(of[0].ss)
    apart = 2.0 / F(count)
    least = GIVEN_UP
    for k in range(count):
        of[k + 1] = of[0]
        component_start(of[k + 1], (apart * F(k)) - 1.0, apart, std)
        if of[k + 1].cost < least:
            least = of[k + 1].cost
            b.likeliest = U(k + 1)
    of[0].in_bank = ALONE
    b.spread = U(1)
    b.mismatch = of[0].mismatch
    weigh_components(of, count, least)


def hold_within(a: State) -> None:
    """SOC held within 0..1."""
    if not not_negative(a.soc, 1.0):
        a.soc = within_one(a.soc)
        a.soc_carry = 0.0


@unrolled_by_option
def mean_of(of: States, count: int) -> Column:
    """The components' mean state, as a column."""
    mean: dict[Any, float] = {}
    for i in CELL:
        mean[i] = 0.0
    for k in range(count):
        if of[k + 1].cost < GIVEN_UP:  # else dropped: nobody looks after its memory
            for i in CELL:
                mean[i] = mean[i] + (of[k + 1].weight * of[k + 1].state[i])
    return Column(0.0, *(mean[i] if THERE else 0.0 for i in CELL))


@unrolled_by_option
def take_mean(x: State, mean: Column) -> None:
    """A state at the mean, with no covariance yet."""
    for i in CELL:
        x.state[i] = mean.row[i]
    for i in CARRIED:
        x.carry[i] = 0.0
    for i, j in triangle(CELL):
        x.p[i, j] = 0.0
    x.ss_carry = 0.0
    x.persistent = 0.0
    x.in_bank = ALONE
    if SKETCH:
        no_gain(x)


@unrolled_by_option
def collect(x: State, a: State) -> None:
    """What a component adds to the covariance of the state ``x`` at the mean."""
    away: dict[Any, float] = {}
    for i in CELL:
        away[i] = a.state[i] - x.state[i]
    for i, j in triangle(CELL):
        x.p[i, j] = x.p[i, j] + (a.weight * (a.p[i, j] + (away[i] * away[j])))
    x.persistent = x.persistent + (a.weight * a.persistent)


def gather(b: Bank, of: States, count: int) -> None:
    """The estimate: mean and covariance of the whole bank; the rest is the likeliest one's."""
    mean = mean_of(of, count)
    of[0] = of[b.likeliest]
    take_mean(of[0], mean)
    hold_within(of[0])  # weights add up to one but for rounding
    for k in range(count):
        if of[k + 1].cost < GIVEN_UP:
            collect(of[0], of[k + 1])
    of[0].mismatch = b.mismatch
    if of[0].ss <= WIDE_VARIANCE and b.looks == LOOKS:
        b.spread = U(0)


@noinline
@unrolled_by_option
def left_by_load(m: Model, place: Place, mean_A: float, soc: float) -> float:
    """What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]."""
    before = 0.0
    size = at_least(magnitude(mean_A), m.constant.least_use_A)
    steps = PAST_PART / (m.constant.soc_per_A * size)
    parts = U(parts_before(soc, mean_A))
    for k in range(parts):
        p = look_up(m, place, soc_on_way(F(k + 1), mean_A), mean_A)
        for i in (V3,):
            end = p.r[i] * (size if mean_A >= 0.0 else -size)
            before = before + (risen(steps * p.gain[i]) * (end - before))
    return before


@noinline
@unrolled_by_option
def know_past(m: Model, a: State, since: float, mean_A: float) -> None:
    """A load under which a log begins was there before: what it has left in the slow branch.

    Half of that, and a twentieth of a rate, may be otherwise. It is knowledge of the start that
    comes late: the slow branch has been followed from nothing known.
    """
    place = place_now(m, a)
    p = look_up(m, place, a.soc, mean_A)
    before = left_by_load(m, place, mean_A, a.soc)
    for i in (V3,):
        gone = risen(since * p.gain[i])
        past = past_of(p.r[i], gone, mean_A, before, m.constant.past_A)
        d = column_of_slow_branch(a)
        variance = d.variance + past.variance_V2
        off = past.held_V - a.state[i]
        inverse = 1.0 / variance
        a.cost = a.cost + cost_of_past(off, variance)
        move(a, d, inverse, off)
        narrow(a, d, inverse)
    hold_within(a)


@noinline
@unrolled_by_option
def know_past_better(m: Model, a: State, since: float, mean_A: float, before_A: float) -> None:
    """A longer mean of the load says more of the past: what that moves in the slow branch.

    What has been taken for the branch's and was not is the SOC's, as far as they go together.
    """
    place = place_now(m, a)
    p = look_up(m, place, a.soc, mean_A)
    taken = left_by_load(m, place, before_A, a.soc)
    more = left_by_load(m, place, mean_A, a.soc) - taken
    for i in (V3,):
        gone = risen(since * p.gain[i])
        past = past_of(p.r[i], gone, 0.0, taken, m.constant.past_A)
        d = column_of_slow_branch(a)
        move(a, d, 1.0 / at_least(d.variance, past.variance_V2), (1.0 - gone) * more)


def look_back(m: Model, b: Bank, of: States, count: int, sample: Sample) -> None:
    """The mean of the load since a start under load, and what it says of the past, three times."""
    c = m.constant
    elapsed = U(sample.sequence - b.sequence)
    b.sequence = sample.sequence
    if b.looks < LOOKS and elapsed == U(1):
        b.since = U(b.since + 1)
        b.mean_A = b.mean_A + ((of[b.likeliest].current_A - b.mean_A) / F(b.since))
        if b.since >= b.next_look:
            for k in range(count):
                if of[k + 1].cost < GIVEN_UP:
                    if b.looks == U(0):
                        know_past(m, of[k + 1], F(b.since), b.mean_A)
                    else:
                        know_past_better(m, of[k + 1], F(b.since), b.mean_A, b.looked_A)
            b.looked_A = b.mean_A
            b.looks = U(b.looks + 1)
            b.next_look = U(b.next_look * LOOK_FACTOR)
    elif elapsed > U(1):  # nobody knows what flowed
        b.looks = LOOKS
    if b.looks == NEVER_LOOKED:
        b.looks = U(0)
        b.next_look = c.look_steps
        if size_below(of[b.likeliest].current_A, c.rest_A):
            b.looks = LOOKS


def step_components(m: Model, b: Bank, of: States, count: int, sample: Sample, out: Output) -> int:
    """Every component by its own step, the likeliest first: all share what it says of the noise."""
    c = m.constant
    error_V2 = 0.0
    status = U(0)
    first_V = 0.0
    mean_V = 0.0
    square_V2 = 0.0
    variance_V2 = 0.0
    for turn in range(count):
        k = b.likeliest
        if turn > 0:
            k = U(turn) if U(turn) <= b.likeliest - U(1) else U(turn + 1)
        if of[k].cost < GIVEN_UP:
            of[k].error_V2 = error_V2
            of[k].mismatch = b.mismatch
            said = step(m, of[k], sample, out)
            if turn == 0:
                error_V2 = of[k].error_V2
                status = said
                first_V = out.voltage_V
            away_V = out.voltage_V - first_V
            mean_V = mean_V + (of[k].weight * away_V)
            square_V2 = square_V2 + (of[k].weight * (away_V * away_V))
            variance_V2 = variance_V2 + (of[k].weight * out.innovation_variance_V2)
    out.voltage_V = first_V + mean_V
    out.innovation_variance_V2 = mixture_variance(variance_V2, mean_V, square_V2)
    out.innovation_V = 0.0
    if positive_within(sample.voltage_V, c.voltage_low_V, c.voltage_high_V):
        out.innovation_V = sample.voltage_V - out.voltage_V
        ratio = (out.innovation_V * out.innovation_V) / out.innovation_variance_V2
        if ratio > c.gate_square:
            status = U(status | INNOVATION_REJECTED)
        b.mismatch = lately_shown(b.mismatch, at_most(ratio, c.mismatch_cap), c.lately)
    return status


def likeliest_of(b: Bank, of: States, count: int) -> float:
    """The cost of the likeliest component."""
    least = of[b.likeliest].cost
    for k in range(count):
        if of[k + 1].cost < least:
            least = of[k + 1].cost
            b.likeliest = U(k + 1)
    return F(least)


def is_lost(x: State) -> bool:
    """Whether nobody knows what flowed, one filter is not enough, and a voltage is there."""
    lost = False
    if x.in_bank == UNCOUNTED and x.evidence >= FIRST_VOLTAGE and x.no_voltage == U(0):
        lost = x.ss > SPREAD_VARIANCE
    return lost


def bank_is_sound(b: Bank, of: States, count: int) -> bool:
    """Every number of a bank in its range: memory that lost its content is noticed."""
    good = within(b.mean_A, -LARGE, LARGE) and within(b.looked_A, -LARGE, LARGE)
    if not not_negative(b.mismatch, LARGE):
        good = False
    if b.likeliest < U(1) or b.likeliest > count:
        good = False
    for k in range(count):
        if not not_negative(of[k + 1].cost, GIVEN_UP) or not not_negative(of[k + 1].weight, 2.0):
            good = False
        if of[k + 1].cost < GIVEN_UP and of[k + 1].in_bank != COMPONENT:
            good = False
    return good


def know_nothing(m: Model, b: Bank, of: States, count: int) -> int:
    """A bank whose memory is damaged begins over all of the SOC."""
    start(m.constant, of[0], KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
    b.likeliest = U(1)
    b.looks = LOOKS
    b.mean_A = 0.0
    b.looked_A = 0.0
    if count > U(0):
        spread_out(b, of, count)
    else:
        b.spread = U(0)
    return U(STATE_RESET)


def start_bank(m: Model, b: Bank, of: States, count: int, soc: float, soc_variance: float) -> int:
    """A cell at rest at ``soc``, known with ``soc_variance``; ``of`` has count + 1 states.

    Arguments that are no such numbers give a state that knows nothing. Returns 0 or
    CELLWISE_STATE_RESET.
    """
    status = begin_at(m, of[0], soc, soc_variance)
    b.spread = U(0)
    b.likeliest = U(1)
    b.looks = NEVER_LOOKED
    b.since = U(0)
    b.next_look = U(0)
    b.sequence = U(0)
    b.mean_A = 0.0
    b.looked_A = 0.0
    b.mismatch = 1.0
    if count > U(0) and of[0].ss > WIDE_VARIANCE:
        spread_out(b, of, count)
    return status


def step_bank(m: Model, b: Bank, of: States, count: int, sample: Sample, out: Output) -> int:
    """One time step of a bank of ``count`` components; the estimate is in ``of[0]``.

    Returns the status bits, which are in ``out`` too.
    """
    status = U(0)
    lost = U(0)
    if b.spread != U(0) and not bank_is_sound(b, of, count):
        lost = know_nothing(m, b, of, count)
    if b.spread == U(0):
        of[0].in_bank = ALONE
        status = step(m, of[0], sample, out)
        b.looks = LOOKS
        if (count > U(0) and of[0].in_bank == CONTRADICTED) or (count > U(0) and is_lost(of[0])):
            spread_out(b, of, count)
    else:
        status = step_components(m, b, of, count, sample, out)
        look_back(m, b, of, count, sample)
        if not bank_is_sound(b, of, count):
            lost = know_nothing(m, b, of, count)
        if of[b.likeliest].evidence < FIRST_VOLTAGE:  # no voltage yet: as it was stated
            status = step(m, of[0], sample, out)
        else:
            weigh_components(of, count, likeliest_of(b, of, count))
            gather(b, of, count)
    status = U(status | lost)
    out.soc = of[0].soc
    out.soc_variance = variance_of(of[0], of[0].ss)
    out.status = status
    return status

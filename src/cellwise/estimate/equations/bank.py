"""A start that nobody knows: filters side by side over the SOC, weighed by what they predict.

A sum of Gaussians (D. Alspach, H. Sorenson, IEEE Trans. Automatic Control 17 (1972) 439,
doi:10.1109/TAC.1972.1100034). Each component knows its SOC well enough for slopes; what the
branches hold it has to find. ``of`` are the states: the first is the estimate, which everything
else reads; behind it are the ``count`` components of the bank. Once they agree the first goes on
alone; where its voltages contradict it for long, or nobody knows what flowed, they begin again.

A filter that begins under load knows neither the SOC nor what a slow branch holds, and in the cold
both move the voltage alike. What flowed before is taken to be like what flows after: said once a
minute of the load is known, and better twice, each four times as long after the start.

``m`` is the model with its ``constant``, ``b`` the record of the bank, ``out`` where a step says
what it has predicted; time is in steps of the fixed step, in seconds elsewhere. What a component's
own step does, and how tables are looked up, is imported: the fixed step has functions of the same
names.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from cellwise.cell.compiled import noinline, part
from cellwise.cell.description import CELL, V3, triangle
from cellwise.cell.equations.double import (
    magnitude,
    positive_within,
    risen,
    root,
    size_below,
    vanishing,
)
from cellwise.cell.equations.scalar import at_least, at_most
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.components import (
    component_from,
    cost_of_past,
    kept_cost,
    mixture_variance,
    parts_before,
    past_of,
    soc_on_way,
)
from cellwise.estimate.equations.constants import (
    GIVEN_UP,
    LOOK_FACTOR,
    LOOKS,
    NEVER_LOOKED,
    PAST_PART,
    WIDE_VARIANCE,
)
from cellwise.estimate.equations.covariance import (
    column_of_slow_branch,
    forget_correlations,
    scaled,
)
from cellwise.estimate.equations.evidence import lately_shown
from cellwise.estimate.filters.component_kernels import (
    has_voltage,
    hold_within,
    is_new,
    move,
    narrow,
    place_now,
    slow_branch,
    stand_alone,
    stand_in_bank,
    step,
)
from cellwise.estimate.status import INNOVATION_REJECTED

F, U = float, int  # kinds of numbers; those of the fixed step are of four bytes
SLOW = HYSTERESIS = True  # states that a fixed step may do without
Model: TypeAlias = Any
State: TypeAlias = Any
States: TypeAlias = Any
Bank: TypeAlias = Any
Place: TypeAlias = Any
Sample: TypeAlias = Any
Output: TypeAlias = Any


@part
def component_start(a: State, t: float, apart: float, std: float) -> None:
    """A component from ``t`` on about the estimate, whose copy ``a`` is."""
    begins = component_from(t, apart, a.soc, a.ss, std)
    stand_in_bank(a)
    forget_correlations(a)
    a.cost = begins.cost
    a.soc = begins.soc
    a.ss = begins.variance
    if HYSTERESIS and is_new(a):
        a.h = 1.0 if a.soc > 0.5 else -1.0


@part
def weigh_components(of: States, count: int, least: float) -> None:
    """Weights that add up to one; the likeliest component costs nothing."""
    total = 0.0
    for k in range(count):
        of[k + 1].cost = kept_cost(of[k + 1].cost - least)
        of[k + 1].weight = vanishing(of[k + 1].cost)
        total = total + of[k + 1].weight
    for k in range(count):
        of[k + 1].weight = of[k + 1].weight / total


@part
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
    stand_alone(of[0])
    b.spread = U(1)
    b.mismatch = of[0].mismatch
    weigh_components(of, count, least)


@part
def spread_again(b: Bank, of: States, count: int) -> None:
    """About an estimate that has been stepped alone: what was before its start is long over."""
    b.looks = LOOKS
    if count > U(1):
        spread_out(b, of, count)


@part
def begin_bank(b: Bank, of: States, count: int) -> None:
    """A cell that nobody has seen yet, or the estimate alone where its start is known."""
    b.spread = U(0)
    b.likeliest = U(1)
    b.looks = NEVER_LOOKED
    b.since = 0.0
    b.next_look = 0.0
    b.mean_A = 0.0
    b.looked_A = 0.0
    b.mismatch = 1.0
    if count > U(1) and of[0].ss > WIDE_VARIANCE:
        spread_out(b, of, count)


@part
@unrolled_by_option
def clear(x: State) -> None:
    """No mean and no covariance yet: what it goes on to collect."""
    for i in CELL:
        x.state[i] = 0.0
    for i, j in triangle(CELL):
        x.p[i, j] = 0.0
    x.persistent = 0.0
    stand_alone(x)


@part
@unrolled_by_option
def collect_mean(x: State, a: State) -> None:
    """What a component adds to the mean."""
    for i in CELL:
        x.state[i] = x.state[i] + (a.weight * a.state[i])


@part
@unrolled_by_option
def collect(x: State, a: State) -> None:
    """What a component adds to the covariance of the state ``x`` at the mean."""
    away: dict[Any, float] = {}
    share: dict[Any, float] = {}
    for i in CELL:
        away[i] = a.state[i] - x.state[i]
        share[i] = a.weight * away[i]
    for i, j in triangle(CELL):
        x.p[i, j] = (x.p[i, j] + (a.weight * a.p[i, j])) + (share[i] * away[j])
    x.persistent = x.persistent + (a.weight * a.persistent)


@part
def gather(b: Bank, of: States, count: int) -> None:
    """The estimate: mean and covariance of the whole bank; the rest is the likeliest one's.

    Where the components agree, however unsure each is, it goes on alone.
    """
    of[0] = of[U(b.likeliest)]
    clear(of[0])
    for k in range(count):
        if of[k + 1].cost < GIVEN_UP:  # else dropped: nobody looks after its memory
            collect_mean(of[0], of[k + 1])
    hold_within(of[0])  # weights add up to one but for rounding
    within = 0.0
    for k in range(count):
        if of[k + 1].cost < GIVEN_UP:
            collect(of[0], of[k + 1])
            within = within + (of[k + 1].weight * of[k + 1].ss)
    of[0].mismatch = b.mismatch
    if of[0].ss - within <= WIDE_VARIANCE and b.looks == LOOKS:
        b.spread = U(0)


@part
@noinline
@unrolled_by_option
def left_by_load(m: Model, place: Place, mean_A: float, soc: float) -> float:
    """What a load from full, or a charge from empty, has left in the slow branch at a SOC [V]."""
    before = 0.0
    size = at_least(magnitude(mean_A), m.constant.least_use_A)
    steps = PAST_PART / (m.constant.soc_per_A * size)
    parts = U(parts_before(soc, mean_A))
    for k in range(parts):
        p = slow_branch(m, place, soc_on_way(F(k + 1), mean_A), mean_A)
        for i in (V3,):
            end = p.r[i] * (size if mean_A >= 0.0 else -size)
            before = before + (risen(steps * p.gain[i]) * (end - before))
    return before


@part
@noinline
@unrolled_by_option
def know_past(m: Model, a: State, since: float, mean_A: float) -> None:
    """A load under which a log begins was there before: what it has left in the slow branch.

    Half of that, and a twentieth of a rate, may be otherwise. It is knowledge of the start that
    comes late: the slow branch has been followed from nothing known.
    """
    place = place_now(m, a)
    p = slow_branch(m, place, a.soc, mean_A)
    before = left_by_load(m, place, mean_A, a.soc)
    for i in (V3,):
        gone = risen(since * p.gain[i])
        past = past_of(p.r[i], gone, mean_A, before, m.constant.past_A)
        d = column_of_slow_branch(a)
        variance = a.p[i, i] + past.variance_V2
        off = past.held_V - a.state[i]
        k = scaled(d, 1.0 / variance)
        a.cost = a.cost + cost_of_past(off, variance)
        move(a, k, off)
        narrow(a, k, d)
    hold_within(a)


@part
@noinline
@unrolled_by_option
def know_past_better(m: Model, a: State, since: float, mean_A: float, before_A: float) -> None:
    """A longer mean of the load says more of the past: what that moves in the slow branch.

    What has been taken for the branch's and was not is the SOC's, as far as they go together.
    """
    place = place_now(m, a)
    p = slow_branch(m, place, a.soc, mean_A)
    taken = left_by_load(m, place, before_A, a.soc)
    more = left_by_load(m, place, mean_A, a.soc) - taken
    for i in (V3,):
        gone = risen(since * p.gain[i])
        past = past_of(p.r[i], gone, 0.0, taken, m.constant.past_A)
        d = column_of_slow_branch(a)
        k = scaled(d, 1.0 / at_least(a.p[i, i], past.variance_V2))
        move(a, k, (1.0 - gone) * more)
    hold_within(a)


@part
@unrolled_by_option
def open_slow_branch(m: Model, a: State) -> None:
    """What flowed for hours no first sample shows; it is looked at once more is known."""
    place = place_now(m, a)
    p = slow_branch(m, place, a.soc, a.current_A)
    for i in (V3,):
        wide_V = m.constant.bank_A * p.r[i]
        a.p[i, i] = a.p[i, i] + (wide_V * wide_V)


@part
@noinline
def look_back(m: Model, b: Bank, of: States, count: int, elapsed: float, lost: bool) -> None:
    """The mean of the load since a start under load, and what it says of the past, three times.

    ``elapsed`` since the last sample, 0 for a repeated one; ``lost`` where more may have flowed.
    """
    current_A = of[U(b.likeliest)].current_A
    if b.looks == NEVER_LOOKED:
        b.looks = LOOKS
        if not size_below(current_A, m.constant.rest_A):
            b.looks = U(0)
            b.next_look = m.constant.look_steps
            for k in range(count):
                open_slow_branch(m, of[k + 1])
    elif lost:  # nobody knows what flowed
        b.looks = LOOKS
    elif b.looks < LOOKS and elapsed > 0.0:
        b.since = b.since + elapsed
        b.mean_A = b.mean_A + ((current_A - b.mean_A) * (elapsed / b.since))
        if b.since >= b.next_look:
            for k in range(count):
                if of[k + 1].cost < GIVEN_UP:
                    if b.looks == U(0):
                        know_past(m, of[k + 1], b.since, b.mean_A)
                    else:
                        know_past_better(m, of[k + 1], b.since, b.mean_A, b.looked_A)
            b.looked_A = b.mean_A
            b.looks = U(b.looks + 1)
            b.next_look = b.next_look * LOOK_FACTOR


@part
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
        k = U(b.likeliest)
        if turn > 0:
            k = U(turn) if U(turn) <= U(b.likeliest) - U(1) else U(turn + 1)
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


@part
def likeliest_of(b: Bank, of: States, count: int) -> float:
    """The cost of the likeliest component."""
    least = of[U(b.likeliest)].cost
    for k in range(count):
        if of[k + 1].cost < least:
            least = of[k + 1].cost
            b.likeliest = U(k + 1)
    return F(least)


@part
def step_spread(
    m: Model,
    b: Bank,
    of: States,
    count: int,
    sample: Sample,
    out: Output,
    elapsed: float,
    lost: bool,
) -> int:
    """One time step of components that do not agree yet: the status."""
    status = step_components(m, b, of, count, sample, out)
    look_back(m, b, of, count, elapsed, lost)
    if has_voltage(of[U(b.likeliest)]):
        weigh_components(of, count, likeliest_of(b, of, count))
        gather(b, of, count)
    else:  # as it was stated
        status = step(m, of[0], sample, out)
    return status

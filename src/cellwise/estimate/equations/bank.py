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
from cellwise.cell.description import BRANCHES, CELL, V3, triangle
from cellwise.cell.equations.double import (
    add,
    magnitude,
    positive_above,
    risen,
    root,
    size_below,
    vanishing,
)
from cellwise.cell.equations.scalar import at_least, at_most, clip
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.components import (
    component_from,
    component_update,
    cost_of_past,
    evidence_share,
    kept_cost,
    mixture_variance,
    parts_before,
    past_of,
    soc_on_way,
)
from cellwise.estimate.equations.constants import (
    FIRST_LOOK,
    GIVEN_UP,
    LARGE,
    LOOK_FACTOR,
    LOOKS,
    NEVER_LOOKED,
    NEXT_LOOK,
    NO_LOOK,
    OPENED,
    PAST_PART,
    WIDE_VARIANCE,
)
from cellwise.estimate.equations.covariance import (
    Point,
    Slopes,
    add_variance,
    column_of,
    column_of_slow_branch,
    explained,
    fade_hysteresis,
    forget_correlations,
    move,
    narrow,
    relax,
    scaled,
    tilt,
)
from cellwise.estimate.equations.evidence import (
    as_shown,
    bent_variance,
    lately_shown,
    persistent_step,
    persistent_V,
    share_of,
    shared_evidence,
    single_variance,
    unknown_square,
)
from cellwise.estimate.equations.start import guess_branches
from cellwise.estimate.equations.weighing import voltage_at
from cellwise.estimate.filters.component_kernels import (
    beyond_data,
    coast,
    has_voltage,
    hold_within,
    is_new,
    look_up,
    no_slopes,
    place_now,
    slopes_of,
    slow_branch,
    stand_alone,
    stand_in_bank,
    time_of_evidence,
    unmeasured,
    uses_voltage,
)
from cellwise.estimate.status import INNOVATION_REJECTED

F, U = float, int  # kinds of numbers; those of the fixed step are of four bytes
SLOW = HYSTERESIS = True  # states that a fixed step may do without
AT_ONCE = True  # a target has no time for every component in one sample
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
@unrolled_by_option
def note_estimate(b: Bank, x: State) -> None:
    """Where the estimate is as a block begins."""
    for i in CELL:
        b.state[i] = x.state[i]
    b.ss = x.ss


@part
def begin_block(b: Bank, x: State) -> None:
    """Nothing seen yet; where the estimate ``x`` is now."""
    note_estimate(b, x)
    b.known = U(1) if has_voltage(x) else U(0)
    b.steps = 0.0
    b.samples = 0.0
    b.readings = 0.0
    b.off_V = 0.0
    b.block_A = 0.0
    b.unknown_A2 = 0.0
    b.first_V2 = 0.0


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
    of[0].error_V2 = 0.0
    begin_block(b, of[0])
    b.spread = U(1)
    b.turn = U(0)
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
    """The estimate: mean and covariance of the whole bank.

    Where the components agree, however unsure each is, it goes on alone.
    """
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
def know_past(m: Model, place: Place, a: State, since: float, mean_A: float) -> None:
    """A load under which a log begins was there before: what it has left in the slow branch.

    Half of that, and a twentieth of a rate, may be otherwise. It is knowledge of the start that
    comes late: the slow branch has been followed from nothing known.
    """
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
def know_past_better(
    m: Model, place: Place, a: State, since: float, mean_A: float, before_A: float
) -> None:
    """A longer mean of the load says more of the past: what that moves in the slow branch.

    What has been taken for the branch's and was not is the SOC's, as far as they go together.
    """
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
def open_slow_branch(m: Model, place: Place, a: State, current_A: float) -> None:
    """What flowed for hours no first sample shows; it is looked at once more is known."""
    p = slow_branch(m, place, a.soc, current_A)
    for i in (V3,):
        wide_V = m.constant.bank_A * p.r[i]
        a.p[i, i] = a.p[i, i] + (wide_V * wide_V)


@part
@noinline
def look_back(m: Model, b: Bank, place: Place, a: State) -> None:
    """What the load since a start under load says of the past, three times: to one component."""
    if b.look == OPENED:
        open_slow_branch(m, place, a, b.said_A)
    elif b.look == FIRST_LOOK:
        know_past(m, place, a, b.since, b.mean_A)
    else:
        know_past_better(m, place, a, b.since, b.mean_A, b.looked_A)


@part
def ask_for_look(m: Model, b: Bank) -> None:
    """The mean of the load since a start under load, and whether the past is looked at now."""
    b.look = NO_LOOK
    if b.looks == NEVER_LOOKED:
        if not size_below(b.block_A, m.constant.rest_A):
            b.look = OPENED
    elif b.unknown_A2 > 0.0:  # nobody knows what flowed
        b.looks = LOOKS
    elif b.looks < LOOKS and b.steps > 0.0:
        b.since = b.since + b.steps
        b.mean_A = b.mean_A + ((b.block_A - b.mean_A) * (b.steps / b.since))
        if b.since >= b.next_look:
            b.look = NEXT_LOOK
            if b.looks == U(0):
                b.look = FIRST_LOOK


@part
def note_look(m: Model, b: Bank) -> None:
    """Every component has looked at it, or the first sample has gone by."""
    if b.look == OPENED:
        b.looks = U(0)
        b.next_look = m.constant.look_steps
    elif b.look != NO_LOOK:
        b.looked_A = b.mean_A
        b.looks = U(b.looks + 1)
        b.next_look = b.next_look * LOOK_FACTOR
    elif b.looks == NEVER_LOOKED:
        b.looks = LOOKS


@part
def collect_sample(
    m: Model, b: Bank, x: State, out: Output, elapsed: float, lost: bool, before_A: float
) -> None:
    """A sample into its block; ``before_A`` is the current of the one before."""
    unmeasured_A2 = unmeasured(m, x)
    current_A = 0.0 if unmeasured_A2 > 0.0 else x.current_A
    b.steps = b.steps + elapsed
    b.samples = b.samples + 1.0
    b.block_A = b.block_A + ((current_A - b.block_A) / b.samples)
    if uses_voltage(x, out):
        b.readings = b.readings + 1.0
        b.off_V = b.off_V + ((out.innovation_V - b.off_V) / b.readings)
    b.unknown_A2 = at_least(b.unknown_A2, unmeasured_A2)
    if lost:
        b.unknown_A2 = at_least(b.unknown_A2, (current_A * current_A) + (before_A * before_A))


@part
@unrolled_by_option
def note_movement(m: Model, b: Bank, x: State, p: Point) -> None:
    """What the block has done to the estimate ``x``, so it does to every component.

    Charge has moved the SOC, and its variance has grown. Each branch has followed a constant
    current, by its gain; what is not known of that has a mean square. Of h a share is left, and
    some has come. ``p`` are the tables where the estimate is now.
    """
    b.moved = x.soc - b.soc
    b.grown = at_least(x.ss - b.ss, 0.0)
    for i in BRANCHES:
        b.gain[i] = risen(b.steps * p.gain[i])
        b.current[i] = b.block_A
        if p.r[i] > 0.0 and b.gain[i] > 0.0:
            constant_A = (b.state[i] + ((x.state[i] - b.state[i]) / b.gain[i])) / p.r[i]
            b.current[i] = clip(constant_A, -LARGE, LARGE)
    b.square_A2 = unknown_square(share_of(m.constant, b.block_A), b.block_A, b.unknown_A2)
    if HYSTERESIS:
        b.keep_h = 1.0 - risen((m.constant.hysteresis_per_A * magnitude(b.block_A)) * b.steps)
        b.rise_h = x.h - (b.keep_h * b.h)


@part
@unrolled_by_option
def note_voltage(m: Model, b: Bank, x: State, likeliest_soc: float, place: Place, p: Point) -> None:
    """What the voltages of a block say, as one under its mean current, beside the estimate ``x``.

    Its variance is that at the likeliest component, for all: one whose tables state a larger error
    must not explain everything. ``share`` of it is new, 0 where there is none.
    """
    c = m.constant
    here = look_up(m, place, likeliest_soc, b.block_A)
    held_V = magnitude(here.r0_ohm * b.block_A)
    for i in BRANCHES:
        held_V = held_V + magnitude(x.state[i])
    beyond_V = beyond_data(m, x, b.block_A, held_V)
    b.error_V2 = single_variance(
        c, here.noise_V2, b.block_A, held_V, unmeasured(m, x), here.r0_ohm
    ) + (beyond_V * beyond_V)
    alone = b.known == U(0) and size_below(b.block_A, c.rest_A)
    since = time_of_evidence(x)
    shared = shared_evidence(c, since, 1.0 if alone else b.steps, alone)
    b.said_V = voltage_at(x, p, p.r0_ohm * b.block_A) + b.off_V
    b.said_A = b.block_A
    least = shared.below / at_least(b.readings, 1.0)  # a mean of readings that share nothing
    b.weight_V2 = as_shown(b.error_V2 * at_least(shared.above, least), b.mismatch)
    b.below = shared.below
    b.share = 0.0
    if b.readings > 0.0 and shared.below > 0.0:
        b.share = evidence_share(c.fades, c.stays, c.shared, since)
    b.lately = at_most(c.lately * b.steps, 1.0)


@part
@unrolled_by_option
def carry_on(x: State, b: Bank, p: Point, slopes: Slopes) -> None:
    """A state over a block, its SOC apart: what the estimate has done, by its own tables."""
    gain: dict[Any, float] = {}
    current: dict[Any, float] = {}
    for i in BRANCHES:
        gain[i] = b.gain[i] if THERE else 0.0
        current[i] = b.current[i] if THERE else 0.0
    relax(x, p, *(gain[i] for i in BRANCHES), *(current[i] for i in BRANCHES), b.square_A2)  # type: ignore[call-arg]
    if HYSTERESIS:
        x.h = clip((b.keep_h * x.h) + b.rise_h, -1.0, 1.0)
        fade_hysteresis(x, b.keep_h)
    if slopes.spread > 0.0:
        tilt(x, slopes, *(gain[i] * current[i] for i in BRANCHES))
    if positive_above(1.0, x.ss):
        add_variance(x, b.grown)


@part
@unrolled_by_option
def weigh_block(m: Model, x: State, b: Bank, p: Point, slopes: Slopes) -> None:
    """The voltage of a block to a component: none is rejected, each moves by what the gate lets.

    What all of them have expected is kept for the mixture, and what of it is left for the next.
    """
    c = m.constant
    column = column_of(x, slopes.slope_V, p.m_V)
    explained_V2 = bent_variance(explained(column, slopes.slope_V, p.m_V), slopes.bend_V)
    off_V = b.said_V - voltage_at(x, p, p.r0_ohm * b.said_A)
    variance_V2 = explained_V2 + b.error_V2
    b.mean_off_V = b.mean_off_V + (x.weight * off_V)
    b.square_V2 = b.square_V2 + (x.weight * (off_V * off_V))
    b.own_V2 = b.own_V2 + (x.weight * variance_V2)
    left_V2 = explained_V2
    left_V = off_V
    if b.share > 0.0:
        used = component_update(
            off_V, variance_V2, c.gate_square, explained_V2, b.weight_V2, b.below, b.share
        )
        gain = scaled(column, used.inverse)
        x.cost = x.cost + used.cost
        move(x, gain, used.off_V)
        narrow(x, gain, column)
        error_V = persistent_V(c.persistent, p.noise_V2 - c.fixed_V2, b.mismatch)
        persistent = persistent_step(gain.s, slopes.slope_V, x.persistent, error_V)
        x.persistent = clip(persistent, -1.0, 1.0)
        taken = explained_V2 * used.inverse
        left_V2 = explained_V2 - (taken * explained_V2)
        left_V = off_V - (taken * used.off_V)
    x.error_V2 = left_V2 + b.error_V2
    b.left_V = b.left_V + (x.weight * left_V)
    b.left_V2 = b.left_V2 + (x.weight * (left_V * left_V))
    hold_within(x)


@part
def step_component(m: Model, b: Bank, x: State, place: Place) -> None:
    """A component over a block: what the estimate has done, at its own SOC, then the voltage."""
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, b.moved)
    p = look_up(m, place, x.soc, b.said_A)
    if b.looks == NEVER_LOOKED:
        guess_branches(m.constant, x, p, b.said_A)
    slopes = no_slopes(p)
    if x.ss > WIDE_VARIANCE:
        slopes = slopes_of(m, place, x.soc, root(x.ss), b.said_A, p)
    carry_on(x, b, p, slopes)
    weigh_block(m, x, b, p, slopes)
    if b.look != NO_LOOK:
        look_back(m, b, place, x)


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
def next_turn(of: States, count: int, first: int) -> int:
    """The first component from ``first`` on that is not given up; behind the last one: none."""
    due = first
    while due <= count and of[due].cost >= GIVEN_UP:
        due = U(due + 1)
    return due


@part
def end_block(m: Model, b: Bank, of: States, count: int) -> None:
    """What a block has been, for the components whose turns come; the next one begins."""
    place = place_now(m, of[0])
    p = look_up(m, place, of[0].soc, b.block_A)
    note_movement(m, b, of[0], p)
    note_voltage(m, b, of[0], of[U(b.likeliest)].soc, place, p)
    ask_for_look(m, b)
    b.mean_off_V = 0.0
    b.square_V2 = 0.0
    b.own_V2 = 0.0
    b.left_V = 0.0
    b.left_V2 = 0.0
    b.turn = next_turn(of, count, U(1))
    begin_block(b, of[0])


@part
def carry_estimate(m: Model, b: Bank, x: State, place: Place, before_V: float) -> None:
    """The estimate from where the last block ended to now; ``before_V`` is what it expected.

    The mean of the innovations of the block that is open is taken beside the new one.
    """
    x.soc, x.soc_carry = add(x.soc, x.soc_carry, b.moved)
    p = look_up(m, place, x.soc, b.block_A)
    slopes = no_slopes(p)
    carry_on(x, b, p, slopes)
    hold_within(x)
    b.off_V = b.off_V + (before_V - voltage_at(x, p, p.r0_ohm * b.block_A))


@part
def expect_together(b: Bank, of: States, count: int) -> None:
    """Variance of the next innovation: that of each by its weight, and how far they lie apart."""
    own_V2 = 0.0
    for k in range(count):
        if of[k + 1].cost < GIVEN_UP:
            own_V2 = own_V2 + (of[k + 1].weight * of[k + 1].error_V2)
    of[0].error_V2 = mixture_variance(own_V2, b.left_V, b.left_V2)


@part
def use_block(m: Model, b: Bank, of: States, count: int, place: Place) -> None:
    """Every component has had its turn: their weights, and the estimate as it is now."""
    c = m.constant
    if b.share > 0.0:
        variance_V2 = mixture_variance(b.own_V2, b.mean_off_V, b.square_V2)
        most = at_most((b.mean_off_V * b.mean_off_V) / variance_V2, c.mismatch_cap)
        b.mismatch = lately_shown(b.mismatch, most, b.lately)
    note_look(m, b)
    b.turn = U(0)
    if has_voltage(of[0]):  # else it is as it was stated
        p = look_up(m, place, of[0].soc, b.block_A)
        before_V = voltage_at(of[0], p, p.r0_ohm * b.block_A)
        note_movement(m, b, of[0], p)
        weigh_components(of, count, likeliest_of(b, of, count))
        expect_together(b, of, count)
        gather(b, of, count)
        note_estimate(b, of[0])
        carry_estimate(m, b, of[0], place, before_V)


@part
def follow_at_once(m: Model) -> bool:
    """Whether every component follows in the sample that ends a block: where each one does."""
    at_once = m.constant.block_steps <= 1.0
    if AT_ONCE:
        at_once = True
    return at_once  # type: ignore[no-any-return]


@part
def take_turns(m: Model, b: Bank, of: States, count: int) -> None:
    """The components over the block that has ended: one with every sample, or all at once."""
    place = place_now(m, of[0])
    if follow_at_once(m):
        while b.turn <= count:
            step_component(m, b, of[U(b.turn)], place)
            b.turn = next_turn(of, count, U(b.turn + 1))
        use_block(m, b, of, count, place)
    elif b.turn <= count:
        step_component(m, b, of[U(b.turn)], place)
        b.turn = next_turn(of, count, U(b.turn + 1))
    else:
        use_block(m, b, of, count, place)


@part
def is_over(m: Model, b: Bank, x: State) -> bool:
    """Whether a block is: at the first sample, the first voltage, a gap, or after its time."""
    over = b.unknown_A2 > 0.0 or b.steps >= m.constant.block_steps
    if b.looks == NEVER_LOOKED or (has_voltage(x) and b.known == U(0)):
        over = True
    return over  # type: ignore[no-any-return]


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
    """One time step of components that do not agree yet: the status.

    The estimate goes on by the current. The components follow in blocks of samples: their voltages
    share one error of the model, and say together what each would.
    """
    begins = is_new(of[0])
    before_A = of[0].current_A
    status = coast(m, of[0], sample, out)
    if not (b.samples > 0.0):
        b.first_V2 = out.innovation_variance_V2
    if of[0].error_V2 > 0.0:  # that of the components, and by what it has grown since
        grown_V2 = at_least(out.innovation_variance_V2 - b.first_V2, 0.0)
        out.innovation_variance_V2 = of[0].error_V2 + grown_V2
    if begins or elapsed > 0.0:
        collect_sample(m, b, of[0], out, 0.0 if begins else elapsed, lost, before_A)
        if b.turn > U(0):
            take_turns(m, b, of, count)
        elif is_over(m, b, of[0]):
            end_block(m, b, of, count)
            if follow_at_once(m):
                take_turns(m, b, of, count)
        if uses_voltage(of[0], out):
            square = out.innovation_V * out.innovation_V
            if square > m.constant.gate_square * out.innovation_variance_V2:
                status = U(status | INNOVATION_REJECTED)
    return status

"""A bank of components in float32: what its memory may be, a start, one step.

The bank itself is :mod:`cellwise.estimate.equations.bank`, as in the filters of float64.
"""

from __future__ import annotations

from cellwise.cell.description import BRANCHES, CELL
from cellwise.cell.unrolled import unrolled_by_option
from cellwise.estimate.equations.bank import begin_bank, spread_again, step_spread
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.sensing import variance_of
from cellwise.estimate.fixed.state import is_sound, start
from cellwise.estimate.fixed.step import begin_at, step
from cellwise.estimate.status import STATE_RESET


def is_lost(x: State) -> bool:
    """Whether nobody knows what flowed, one filter is not enough, and a voltage is there."""
    lost = False
    if x.in_bank == UNCOUNTED and x.evidence >= FIRST_VOLTAGE and x.no_voltage == U(0):
        lost = x.ss > SPREAD_VARIANCE
    return lost


@unrolled_by_option
def is_block_sound(b: Bank) -> bool:
    """The numbers of a block in their range."""
    good = size_within(b.off_V, LARGE) and size_within(b.block_A, LARGE)
    for i in CELL:
        if not size_within(b.state[i], LARGE):
            good = False
    if not not_negative(b.first_V2, SINCE_MOST):
        good = False
    if not not_negative(b.ss, LARGE) or not not_negative(b.unknown_A2, LARGE):
        good = False
    if not not_negative(b.steps, SINCE_MOST) or not not_negative(b.samples, SINCE_MOST):
        good = False
    if not not_negative(b.readings, SINCE_MOST):
        good = False
    return good


@unrolled_by_option
def is_past_block_sound(b: Bank) -> bool:
    """Those of the block that the components follow."""
    good = size_within(b.moved, LARGE) and not_negative(b.grown, LARGE)
    for i in BRANCHES:
        if not not_negative(b.gain[i], 1.0) or not size_within(b.current[i], LARGE):
            good = False
    if not not_negative(b.square_A2, LARGE) or not not_negative(b.lately, 1.0):
        good = False
    if HYSTERESIS and not (not_negative(b.keep_h, 1.0) and size_within(b.rise_h, LARGE)):
        good = False
    if not size_within(b.said_V, LARGE) or not size_within(b.said_A, LARGE):
        good = False
    if not not_negative(b.error_V2, SINCE_MOST) or not not_negative(b.weight_V2, SINCE_MOST):
        good = False
    if not not_negative(b.below, SINCE_MOST) or not not_negative(b.share, 1.0):
        good = False
    if not size_within(b.mean_off_V, LARGE) or not not_negative(b.square_V2, LARGE):
        good = False
    if not size_within(b.left_V, LARGE) or not not_negative(b.left_V2, LARGE):
        good = False
    if not not_negative(b.own_V2, LARGE):
        good = False
    return good


def bank_is_sound(c: Constants, b: Bank, of: States, count: int) -> bool:
    """Every number of a bank in its range: memory that lost its content is noticed."""
    good = within(b.mean_A, -LARGE, LARGE) and within(b.looked_A, -LARGE, LARGE)
    if not is_block_sound(b) or b.turn > count + U(1) or b.known > U(1) or b.look > NEXT_LOOK:
        good = False
    if b.turn > U(0) and not is_past_block_sound(b):
        good = False
    if not not_negative(b.mismatch, LARGE) or not not_negative(b.since, SINCE_MOST):
        good = False
    if not not_negative(b.next_look, SINCE_MOST):
        good = False
    if b.likeliest < U(1) or b.likeliest > count:
        good = False
    for k in range(count):
        if not not_negative(of[k + 1].cost, GIVEN_UP) or not not_negative(of[k + 1].weight, 2.0):
            good = False
        if of[k + 1].cost < GIVEN_UP and of[k + 1].in_bank != COMPONENT:
            good = False
        now = b.turn == U(k + 1) or b.turn > count or b.likeliest == U(k + 1)
        if now and of[k + 1].cost < GIVEN_UP and not is_sound(c, of[k + 1]):
            good = False
    return good


def know_nothing(m: Model, b: Bank, of: States, count: int) -> int:
    """A bank whose memory is damaged begins over all of the SOC."""
    start(m.constant, of[0], KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
    begin_bank(b, of, count)
    return U(STATE_RESET)


def start_bank(m: Model, b: Bank, of: States, count: int, soc: float, soc_variance: float) -> int:
    """A cell at rest at ``soc``, known with ``soc_variance``; ``of`` has count + 1 states.

    Arguments that are no such numbers give a state that knows nothing. Returns 0 or
    CELLWISE_STATE_RESET.
    """
    status = begin_at(m, of[0], soc, soc_variance)
    begin_bank(b, of, count)
    b.sequence = U(0)
    return status


def step_bank(m: Model, b: Bank, of: States, count: int, sample: Sample, out: Output) -> int:
    """One time step of a bank of ``count`` components; the estimate is in ``of[0]``.

    Returns the status bits, which are in ``out`` too.
    """
    status = U(0)
    damaged = U(0)
    elapsed = U(sample.sequence - b.sequence)
    b.sequence = sample.sequence
    if b.spread != U(0) and not bank_is_sound(m.constant, b, of, count):
        damaged = know_nothing(m, b, of, count)
    if b.spread == U(0):
        of[0].in_bank = ALONE
        status = step(m, of[0], sample, out)
    else:
        status = step_spread(m, b, of, count, sample, out, F(elapsed), elapsed > U(1))
    if of[0].in_bank == CONTRADICTED or is_lost(of[0]):
        spread_again(b, of, count)
    status = U(status | damaged)
    out.soc = of[0].soc
    out.soc_variance = variance_of(of[0], of[0].ss)
    out.status = status
    return status

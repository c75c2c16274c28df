"""One fixed step: predict over the interval that ends now, then use the voltage read now."""

from __future__ import annotations

from cellwise.estimate.fixed.arithmetic import (
    INTERVAL,
    KNOW_NOTHING_SOC,
    KNOW_NOTHING_VARIANCE,
    NO_VOLTAGE_YET,
    NOT_BEGUN,
    ONE,
    SOC_VARIANCE_MOST,
    VARIANCE_FLOOR,
    WIDE_VARIANCE,
    ZERO,
    Constants,
    Count,
    Float,
    Output,
    Sample,
    State,
    U,
    not_negative,
    positive_within,
    root,
)
from cellwise.estimate.fixed.covariance import Column, move, narrow
from cellwise.estimate.fixed.gain import rejudge
from cellwise.estimate.fixed.innovation import Innovation, innovate, judge
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    Place,
    Point,
    Slopes,
    look_up,
    no_slopes,
    place_of,
    slopes_of,
)
from cellwise.estimate.fixed.options import HEATING, WARM, WIDE
from cellwise.estimate.fixed.predict import cross_gap, heat, predict
from cellwise.estimate.fixed.search import look_anew, widen
from cellwise.estimate.fixed.sensing import Reading, count_charge, finish, see
from cellwise.estimate.fixed.state import guess_branches, is_sound, start
from cellwise.estimate.status import STATE_RESET


def correct(
    m: Model, place: Place, x: State, p: Point, w: Slopes, s: Reading, i: Innovation, voltage: Float
) -> Count:
    """What a voltage that is looked at changes; what it led to."""
    c = m.constant
    j = judge(c, x, w, i, s.seen, s.news)
    if j.anew:
        if WIDE:
            look_anew(m, place, x, s.seen, voltage, i.one_V2, i.polarisation_V)
        else:
            widen(c, x, p, s.seen)
    if j.inverse > ZERO:
        learnt = True
        if WIDE and w.spread > ZERO:
            learnt = rejudge(m, place, x, p, w, i.column, j.inverse, i.value_V, s.seen)
        move(c, x, i.column, j.inverse, i.value_V)
        if learnt:
            narrow(x, i.column, j.inverse)
    return j.status


def init(m: Model, x: State, soc: Float, soc_variance: Float) -> Count:
    """A cell at rest at ``soc``, known with ``soc_variance``.

    Arguments that are no such numbers give a state that knows nothing. Returns 0 or
    CELLWISE_STATE_RESET.
    """
    positive = soc + ZERO  # never -0
    status = U(0)
    known = positive_within(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST)
    if not_negative(positive, ONE) and known:
        start(m.constant, x, positive, soc_variance)
    else:
        start(m.constant, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
        status = U(STATE_RESET)
    return status


def step(m: Model, x: State, sample: Sample, out: Output) -> Count:
    """One time step: predict over the interval that ends now, then use the voltage read now.

    Returns the status bits, which are in ``out`` too.
    """
    c = m.constant
    status = U(0)
    if not is_sound(c, x):
        start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
        status = U(STATE_RESET)
    s = see(c, x, sample)
    if WARM:
        place = place_of(m, s.temperature_C)
    else:
        place = place_of(m, ZERO)
    charge = count_charge(c, x, s)
    p = look_up(m, place, x.soc, s.seen)
    if x.evidence == NOT_BEGUN:
        guess_branches(c, x, p.r1_ohm, p.r2_ohm, p.r3_ohm, s.seen)
        x.evidence = NO_VOLTAGE_YET
    if charge.missing != U(0):
        cross_gap(c, x, p, charge.missing, s.current, charge.bridge)
    w = no_slopes(p)
    if WIDE and x.ss > WIDE_VARIANCE:
        w = slopes_of(m, place, x.soc, root(x.ss), s.seen, p)
    if s.news == INTERVAL:
        predict(c, x, p, w, s.flow, s.unmeasured_A2)
        if HEATING:
            heat(c, x, p.r0_ohm, s.seen, s.flow)
    i = innovate(c, x, p, w, s, sample.voltage_V, out)
    status = U(status | s.status | charge.status | i.status)
    if i.looked_at:
        status = U(status | correct(m, place, x, p, w, s, i, sample.voltage_V))
    status = U(status | finish(x, s, charge.missing, sample.sequence, out))
    out.status = status
    return status

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
from cellwise.estimate.fixed.correct import correct
from cellwise.estimate.fixed.innovation import outside
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    aged,
    look_up,
    no_slopes,
    place_of,
    slopes_of,
    under_surface,
)
from cellwise.estimate.fixed.options import HEALTH, HEATING, SURFACE, VALIDITY, WARM, WIDE
from cellwise.estimate.fixed.predict import cross_gap, heat, predict
from cellwise.estimate.fixed.sensing import count_charge, finish, follow, see
from cellwise.estimate.fixed.state import guess_branches, is_sound, start
from cellwise.estimate.status import STATE_RESET


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
    s = see(c, x, sample, status)
    place = place_of(m, s.temperature_C) if WARM else place_of(m, ZERO)
    charge = count_charge(c, x, s)
    if SURFACE:
        follow(c, x, s, charge)
        place = under_surface(c, x, place, s.temperature_C)
    if HEALTH:
        place = aged(x, place)
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
    beyond = outside(c, x, s) if VALIDITY else U(0)
    status = U(charge.status | correct(m, place, x, p, w, s, sample.voltage_V, out))
    status = U(status | finish(x, s, charge.missing, sample.sequence, out))
    status = U(status | beyond)
    out.status = status
    return status

"""One fixed step: predict over the interval that ends now, then use the voltage read now.

:func:`step` is `filter_step` of the float64 filters in float32, in place: ``see`` checks a sample,
``count_charge``, ``look_up`` and ``predict`` take the state over the interval, ``correct`` uses the
voltage (``innovate``, then ``weigh``: gate, recovery, weight, ``fuse``), ``finish`` keeps the
sample. The equations are the same functions (:mod:`cellwise.estimate.equations`).
"""

from __future__ import annotations

from cellwise.estimate.equations.covariance import Point, Slopes, move, narrow, scaled
from cellwise.estimate.equations.evidence import as_shown
from cellwise.estimate.equations.start import guess_branches
from cellwise.estimate.equations.weighing import (
    Innovation,
    contradicted_after,
    judge,
    persistent_after,
    weight_of,
)
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.innovation import (
    ask_for_offset,
    count_offset,
    innovate,
    outside,
    shared_by,
    time_of_evidence,
    watch_current,
    watch_voltage,
)
from cellwise.estimate.fixed.layout import Model
from cellwise.estimate.fixed.lookup import (
    aged,
    look_up,
    no_slopes,
    place_of,
    slopes_of,
    under_surface,
)
from cellwise.estimate.fixed.sensing import (
    Reading,
    count_charge,
    cross_gap,
    finish,
    follow,
    see,
)
from cellwise.estimate.fixed.state import (
    forget_offset,
    heat,
    is_sound,
    open_up,
    predict,
    start,
)
from cellwise.estimate.status import STATE_RESET, VOLTAGE_INVALID, VOLTAGE_LOST


def recover(c: Constants, x: State, p: Point, delayed_current_A: float) -> None:
    """After too long a time of rejected voltages in a row: the SOC is open.

    With CELLWISE_BANK the state asks for a bank, which begins again over all of the SOC.
    """
    if WIDE:
        x.contradicted = 0.0
        x.persistent = 0.0
    if BANK:
        x.in_bank = CONTRADICTED
    x.evidence = FIRST_VOLTAGE
    open_up(c, x, p, delayed_current_A)
    if OFFSET:
        forget_offset(x)


def contradict(
    c: Constants, x: State, innovation: Innovation, innovation_V: float, beyond: int
) -> None:
    """What the voltages say against the count. Beyond the model's data they confirm nothing."""
    now = contradicted_after(c, x, innovation, innovation_V, time_of_evidence(x))
    confirms = beyond != U(0) and magnitude(now) < magnitude(x.contradicted)
    if size_within(now, 1.0) and not confirms:  # a number
        x.contradicted = now


def persist(c: Constants, x: State, p: Point, innovation: Innovation, gain: float) -> None:
    """SOC error by a persistent error of the model, after a voltage with a gain."""
    now = persistent_after(c, x, innovation, p.noise_V2 - c.fixed_V2, x.mismatch, gain)
    if not size_within(now, 1.0):
        now = 1.0
    x.persistent = now


def fuse(
    c: Constants, x: State, p: Point, innovation: Innovation, innovation_V: float, inverse: float
) -> None:
    """State and covariance after a voltage, by one over the variance that weighs it."""
    gain = scaled(innovation.column, inverse)
    move(x, gain, innovation_V)
    narrow(x, gain, innovation.column)
    if WIDE:
        persist(c, x, p, innovation, gain.s)
    if OFFSET:
        ask_for_offset(x, innovation, innovation_V, gain.s, inverse)


def begin_evidence(x: State) -> None:
    """A voltage has been used."""
    if x.evidence < FIRST_VOLTAGE:
        x.evidence = FIRST_VOLTAGE


def weigh(
    c: Constants,
    x: State,
    p: Point,
    reading: Reading,
    innovation: Innovation,
    innovation_V: float,
    beyond: int,
) -> int:
    """A voltage that is looked at: rejected, or used.

    A first sample under load says more of the load than of the SOC.
    """
    status = U(0)
    if BANK and x.in_bank == COMPONENT:  # its components use it
        begin_evidence(x)
    else:
        lately = c.lately if reading.news == INTERVAL else 0.0
        verdict = judge(c, x, innovation, innovation_V, lately, U(1))
        status = verdict.status
        x.rejections = verdict.rejections
        x.mismatch = verdict.mismatch
        if verdict.accepted:
            shared = shared_by(c, x, reading.delayed_current_A)
            if reading.news == INTERVAL or shared.above <= shared.below:
                fuse(
                    c,
                    x,
                    p,
                    innovation,
                    innovation_V,
                    weight_of(innovation, verdict.shown, verdict.unit, shared),
                )
                if WIDE:
                    contradict(c, x, innovation, innovation_V, beyond)
            begin_evidence(x)
        elif verdict.recovers:
            recover(c, x, p, reading.delayed_current_A)
    return status


def shown_unseen(unseen: float, off_V: float, known_V2: float, slope_V: float) -> float:
    """SOC's variance of what has flowed unseen, as far as a voltage shows it, at most ``unseen``.

    The likeliest one (of greatest likelihood): a voltage that is off by no more than ``known_V2``
    says that nothing has flowed, and takes nothing away from what is known of the SOC.
    """
    beyond_V2 = (off_V * off_V) - known_V2
    slope2 = slope_V * slope_V
    shown = unseen
    if not (beyond_V2 > 0.0):
        shown = 0.0
    elif beyond_V2 < unseen * slope2:
        shown = beyond_V2 / slope2
    return shown


def open_up_to(x: State, unseen: float, shown: float) -> None:
    """The variance that a voltage has shown is the SOC's; the rest of it is stated beside P."""
    x.ss = x.ss + shown
    x.persistent = root((x.persistent * x.persistent) + (unseen - shown))


def correct(
    c: Constants,
    x: State,
    p: Point,
    slopes: Slopes,
    reading: Reading,
    voltage: float,
    beyond: int,
    unseen: float,
    out: Output,
) -> int:
    """Predicted voltage, innovation, and what follows from it.

    Of the variance of what has flowed ``unseen`` the SOC gets what the voltage shows, or all of it
    where there is none; this one is weighed without it, so the next ones say how far it moves.
    """
    status = U(0)
    if WIDE:
        away = x.no_voltage
        if reading.news == INTERVAL and away < COUNT_MOST:
            away = U(away + 1)
    shown = unseen
    innovation = innovate(c, x, p, slopes, reading)
    out.voltage_V = innovation.voltage_V
    out.innovation_variance_V2 = innovation.variance_V2
    out.innovation_V = 0.0
    if not positive_within(voltage, c.voltage_low_V, c.voltage_high_V):
        status = U(VOLTAGE_INVALID | out_of_range(voltage))
    else:
        innovation_V = voltage - innovation.voltage_V
        out.innovation_V = innovation_V
        if reading.news != REPEATED:  # a repeated sample is no evidence
            if WIDE:
                watch_current(c, x, voltage)
                status = watch_voltage(
                    c, x, voltage, reading.delayed_current_A, p.r0_ohm, innovation_V
                )
                if status == U(0):
                    away = U(0)
            if status == U(0):
                if WIDE and unseen > 0.0:
                    known_V2 = as_shown(innovation.variance_V2, x.mismatch)
                    shown = shown_unseen(unseen, innovation_V, known_V2, innovation.slope_V)
                status = weigh(c, x, p, reading, innovation, innovation_V, beyond)
    if WIDE:
        if unseen > 0.0:
            open_up_to(x, unseen, shown)
        if reading.news != REPEATED:
            x.no_voltage = away
        if away > c.hold_steps:
            status = U(status | VOLTAGE_LOST)
    return status


def begin_at(m: Model, x: State, soc: float, soc_variance: float) -> int:
    """As :func:`init`, for the estimate of a bank, too."""
    positive = soc + 0.0  # never -0
    status = U(0)
    known = positive_within(soc_variance, VARIANCE_FLOOR, SOC_VARIANCE_MOST)
    if not_negative(positive, 1.0) and known:
        start(m.constant, x, positive, soc_variance)
    else:
        start(m.constant, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
        status = U(STATE_RESET)
    return status


def init(m: Model, x: State, soc: float, soc_variance: float) -> int:
    """A cell at rest at ``soc``, known with ``soc_variance``.

    Arguments that are no such numbers give a state that knows nothing. Returns 0 or
    CELLWISE_STATE_RESET.
    """
    return begin_at(m, x, soc, soc_variance)


def step(m: Model, x: State, sample: Sample, out: Output) -> int:
    """One time step: predict over the interval that ends now, then use the voltage read now.

    Returns the status bits, which are in ``out`` too.
    """
    c = m.constant
    status = U(0)
    if not is_sound(c, x):
        start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE)
        status = U(STATE_RESET)
        if BANK:
            x.in_bank = CONTRADICTED
    reading = see(c, x, sample, status)
    place = place_of(m, reading.temperature_C) if WARM else place_of(m, 0.0)
    charge = count_charge(c, x, reading)
    if SURFACE:
        follow(c, x, reading, charge)
        place = under_surface(c, x, place, reading.temperature_C)
    if HEALTH:
        place = aged(x, place)
    p = look_up(m, place, x.soc, reading.delayed_current_A)
    if x.evidence == NOT_BEGUN:
        guess_branches(c, x, p, reading.delayed_current_A)
        x.evidence = NO_VOLTAGE_YET
    unseen = 0.0
    if charge.missing != U(0):
        unseen = cross_gap(c, x, p, charge.missing, reading.current, charge.bridge)
    slopes = no_slopes(p)
    if WIDE and x.ss > WIDE_VARIANCE and not (BANK and x.in_bank == COMPONENT):
        slopes = slopes_of(m, place, x.soc, root(x.ss), reading.delayed_current_A, p)
    if reading.news == INTERVAL:
        predict(c, x, p, slopes, reading.counted_current_A, reading.unmeasured_A2)
        if HEATING:
            heat(c, x, p.r0_ohm, reading.delayed_current_A, reading.counted_current_A)
        if OFFSET:
            count_offset(c, x, p, reading, charge.missing)
    beyond = outside(c, x, reading) if VALIDITY else U(0)
    status = U(
        charge.status | correct(c, x, p, slopes, reading, sample.voltage_V, beyond, unseen, out)
    )
    status = U(status | finish(x, reading, charge.missing, sample.sequence, out))
    status = U(status | beyond)
    out.status = status
    return status


def coast(m: Model, x: State, sample: Sample, out: Output) -> int:
    """The estimate over an interval, and the voltage it expects, which moves the components."""
    x.in_bank = COMPONENT
    return step(m, x, sample, out)

"""The loop of fixed steps: compiled once for every set of options.

A step predicts over the interval that ends now, then uses the voltage read now. It is written out
in the loop: numba copies the whole of a function that it inlines, for every block of it, so that
one step inlined into a loop takes longer to compile than all the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from numba import njit

from cellwise.estimate.fixed.arithmetic import (
    KNOW_NOTHING_SOC,
    KNOW_NOTHING_VARIANCE,
    NO_VOLTAGE_YET,
    NOT_BEGUN,
    WIDE_VARIANCE,
    ZERO,
    F,
    U,
    root,
)
from cellwise.estimate.fixed.gain import move, narrow, rejudge
from cellwise.estimate.fixed.innovation import innovate, judge
from cellwise.estimate.fixed.layout import Options
from cellwise.estimate.fixed.lookup import (
    Slopes,
    load_of,
    look_up,
    place_of,
    slopes_of,
)
from cellwise.estimate.fixed.predict import cross_gap, predict
from cellwise.estimate.fixed.search import look_anew, widen
from cellwise.estimate.fixed.sensing import count_charge, finish, heat, see
from cellwise.estimate.fixed.state import guess_branches, is_sound, start
from cellwise.estimate.status import STATE_RESET


@lru_cache
def compiled_rows(options: Options) -> Callable[..., None]:
    """The loop ``rows(constants, table, state, samples, outputs)`` for one set of options.

    Every argument is an array of records of :mod:`cellwise.estimate.fixed.layout`; ``state``
    has one element and is stepped in place. Nothing is allocated.
    """
    TEMPERATURES, ARRHENIUS = int(options.temperatures > 1), int(options.arrhenius > 0)
    SLOW, HYSTERESIS, OFFSET = options.slow, options.hysteresis, options.offset
    EFFICIENCY, LEAK, SKEW = options.efficiency, options.leak, options.skew
    RATE, ASYMMETRY, HEATING = options.rate, options.asymmetry, options.heating
    WARM, WIDE, WATCH = int(options.needs_temperature), options.wide, options.watch
    SCALED = int(options.arrhenius > 0 or options.rate or options.asymmetry)

    # fmt: off
    @njit(cache=True, error_model="numpy", fastmath=False, nogil=True)
    def rows(constants: Any, table: Any, state: Any, samples: Any, outputs: Any) -> None:
        c = constants[0]
        t = table
        x = state[0]
        for k in range(samples.size):
            sample = samples[k]
            out = outputs[k]
            status = U(0)
            if not is_sound(c, x, SLOW, HYSTERESIS, OFFSET, HEATING, WARM, WIDE, WATCH):
                start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE, SLOW, HYSTERESIS, OFFSET,
                      HEATING, WARM, WIDE, WATCH)
                status = U(STATE_RESET)
            s = see(c, x, sample, OFFSET, SKEW, HEATING, WARM, WATCH)
            place = place_of(c, s.temperature_C, TEMPERATURES, ARRHENIUS)
            gap, missing, bridge = count_charge(c, x, s, EFFICIENCY, LEAK, WATCH)

            # Tables at the new SOC, and what the branches may hold.
            load = load_of(c, RATE, ASYMMETRY, WIDE)
            p = look_up(t, place, x.soc, s.seen, load, TEMPERATURES, SLOW, HYSTERESIS, SCALED, WIDE)
            if x.evidence == NOT_BEGUN:
                guess_branches(c, x, p, s.seen, SLOW, HYSTERESIS, OFFSET, WIDE)
                x.evidence = NO_VOLTAGE_YET
            if missing != U(0):
                cross_gap(c, x, p, missing, s.current, bridge, SLOW, HYSTERESIS, OFFSET, WIDE)
            spread = ZERO
            if WIDE and x.ss > WIDE_VARIANCE:
                spread = root(x.ss)
            w = Slopes(p.slope_V, ZERO, ZERO, ZERO, ZERO, ZERO)
            if WIDE and spread > ZERO:
                w = slopes_of(t, place, x.soc, spread, s.seen, p, load, SLOW, HYSTERESIS, SCALED)
            if s.news == 2:
                predict(c, x, p, w, s.flow, s.unmeasured_A2, SLOW, HYSTERESIS, OFFSET, WIDE)
            if HEATING and s.news == 2:
                heat(c, x, p.r0_ohm, s.seen, s.flow, SLOW)

            # The voltage.
            i = innovate(c, x, p, w, s, sample.voltage_V, out, SLOW, HYSTERESIS, OFFSET, WATCH)
            status = U(U(status | s.status) | U(gap | i.status))
            if i.looked_at:
                j = judge(c, x, w, i, s.seen, s.news, WIDE)
                status = U(status | j.status)
                if j.anew and WIDE:
                    look_anew(c, t, place, x, s.seen, sample.voltage_V, i.one, i.polarisation, load,
                              SLOW, HYSTERESIS, OFFSET, SCALED)
                if j.anew and not WIDE:
                    widen(c, x, p, s.seen, SLOW, HYSTERESIS, OFFSET)
                if j.inverse > ZERO:
                    learnt = True
                    if WIDE and w.spread > ZERO:
                        learnt = rejudge(t, place, x, p, w, i.column, j.inverse, i.innovation,
                                         s.seen, load, SLOW, HYSTERESIS, OFFSET, SCALED)
                    move(c, x, i.column, j.inverse, i.innovation, SLOW, HYSTERESIS, OFFSET)
                    if learnt:
                        narrow(x, i.column, j.inverse, SLOW, HYSTERESIS, OFFSET, WIDE)
            out.status = U(status | finish(x, s, missing, sample.sequence, out, WATCH))
    # fmt: on

    return rows


@lru_cache
def compiled_start(options: Options) -> Callable[..., None]:
    """``begin(constants, state, soc, soc_variance)`` for one set of options."""
    SLOW, HYSTERESIS, OFFSET = options.slow, options.hysteresis, options.offset
    HEATING, WARM = options.heating, int(options.needs_temperature)
    WIDE, WATCH = options.wide, options.watch

    @njit(cache=True, error_model="numpy", fastmath=False)
    def begin(constants: Any, state: Any, soc: float, soc_variance: float) -> None:
        # fmt: off
        start(constants[0], state[0], F(soc), F(soc_variance), SLOW, HYSTERESIS, OFFSET, HEATING,
              WARM, WIDE, WATCH)
        # fmt: on

    return begin

"""One fixed step, and the loop over many: compiled once for every set of options."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from numba import njit

from cellwise.estimate.fixed_step_correct import correct
from cellwise.estimate.fixed_step_kernels import (
    COUNT_MOST,
    EVIDENCE_MOST,
    FIRST_VOLTAGE,
    HALF,
    HEAT_MOST_K,
    KNOW_NOTHING_SOC,
    KNOW_NOTHING_VARIANCE,
    LONGEST_GAP,
    NO_VOLTAGE_YET,
    NOT_BEGUN,
    ONE,
    WIDE_VARIANCE,
    ZERO,
    F,
    U,
    add,
    clip,
    kernel,
    not_negative,
    out_of_range,
    root,
    within,
)
from cellwise.estimate.fixed_step_kernels import TEMPERATURE_HIGH_C as HIGH_C
from cellwise.estimate.fixed_step_kernels import TEMPERATURE_LOW_C as LOW_C
from cellwise.estimate.fixed_step_layout import Options
from cellwise.estimate.fixed_step_lookup import (
    Slopes,
    load_of,
    look_up,
    place_of,
    slopes_of,
    within_one,
)
from cellwise.estimate.fixed_step_predict import (
    cross_gap,
    predict,
    taken,
)
from cellwise.estimate.fixed_step_state import (
    guess_branches,
    is_sound,
    start,
)
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    CURRENT_LOST,
    DUPLICATE,
    SEQUENCE_GAP,
    STATE_RESET,
    TEMPERATURE_INVALID,
)


@kernel
def step(
    c: Any,
    t: Any,
    x: Any,
    sample: Any,
    out: Any,
    TEMPERATURES: int,
    SLOW: int,
    HYSTERESIS: int,
    OFFSET: int,
    ARRHENIUS: int,
    EFFICIENCY: int,
    LEAK: int,
    SKEW: int,
    RATE: int,
    ASYMMETRY: int,
    HEATING: int,
    WARM: int,
    WIDE: int,
    SCALED: int,
    WATCH: int,
) -> None:
    """One time step: predict over the interval that ends now, then use the voltage read now."""
    status = U(0)
    news = 1
    missing = U(0)
    silent = U(0)  # no current that could be used
    current = sample.current_A
    unmeasured_A2 = ZERO

    if not is_sound(c, x, SLOW, HYSTERESIS, OFFSET, HEATING, WARM, WIDE, WATCH):
        # fmt: off
        start(c, x, KNOW_NOTHING_SOC, KNOW_NOTHING_VARIANCE, SLOW, HYSTERESIS, OFFSET, HEATING,
              WARM, WIDE, WATCH)
        # fmt: on
        status = U(status | U(STATE_RESET))
    # The first sample ends no interval; a sequence number that was taken before ends none either.
    if x.evidence != NOT_BEGUN:
        elapsed = U(sample.sequence - x.sequence)
        if elapsed == U(0):
            news = 0
            status = U(status | U(DUPLICATE))
        else:
            news = 2
            missing = U(elapsed - U(1))
    if not within(current, -c.current_limit_A, c.current_limit_A):
        status = U(status | U(U(CURRENT_INVALID) | out_of_range(sample.current_A)))
        silent = U(1)
    if silent != U(0) or news == 0:
        current = x.current_A
    temperature = ZERO
    if WARM:
        if not within(sample.temperature_C, LOW_C, HIGH_C):
            status = U(status | U(TEMPERATURE_INVALID))
        elif news != 0:
            x.temperature_C = sample.temperature_C
        temperature = x.temperature_C
        if HEATING:
            temperature = x.temperature_C + x.heat_K
    place = place_of(c, temperature, TEMPERATURES, ARRHENIUS)
    seen = current
    if SKEW and news == 2:
        seen = current + (c.skew_share * (x.current_A - current))
    flow = seen
    if OFFSET:
        flow = seen - x.offset_A
    bridge = ZERO
    if WATCH:
        # Held for a while; then whatever was held is no guide any more: nothing is counted, and as
        # much as half a rate may flow either way.
        if silent != U(0) or news == 0:
            silent = x.no_current
            if news == 2 and silent < COUNT_MOST:
                silent = U(silent + U(1))
        if silent > c.hold_steps:
            status = U(status | U(CURRENT_LOST))
            seen = ZERO
            flow = ZERO
            unmeasured_A2 = c.lost_A2
    elif silent != U(0):
        unmeasured_A2 = c.lost_A2

    # Charge first, then the branches at the new SOC.
    if news == 2:
        used = taken(c, flow, EFFICIENCY, LEAK)
        if missing != U(0):
            status = U(status | U(SEQUENCE_GAP))
            if missing <= c.gap_steps:
                if not WATCH or silent <= c.hold_steps:
                    bridge = HALF * (current + x.current_A)
                used = used + (taken(c, bridge, EFFICIENCY, LEAK) * F(missing))
            else:  # nobody knows what flowed
                missing = missing if missing < U(LONGEST_GAP) else U(LONGEST_GAP)
        x.soc, x.soc_carry = add(x.soc, x.soc_carry, -used)
        if WATCH and unmeasured_A2 > ZERO:
            # It may keep one sign for as long as it is away: the deviation grows, not the variance.
            drift = root(x.ss) + c.lost_soc
            x.ss = drift * drift
        if not WATCH and unmeasured_A2 > ZERO:
            x.ss = x.ss + c.lost_walk
    load = load_of(c, RATE, ASYMMETRY, WIDE)
    point = look_up(t, place, x.soc, seen, load, TEMPERATURES, SLOW, HYSTERESIS, SCALED, WIDE)
    if x.evidence == NOT_BEGUN:
        guess_branches(c, x, point, seen, SLOW, HYSTERESIS, OFFSET, WIDE)
        x.evidence = NO_VOLTAGE_YET
    if missing != U(0):
        cross_gap(c, x, point, missing, current, bridge, SLOW, HYSTERESIS, OFFSET, WIDE)
    spread = ZERO
    if WIDE and x.ss > WIDE_VARIANCE:
        spread = root(x.ss)
    slopes = Slopes(point.slope_V, ZERO, ZERO, ZERO, ZERO, ZERO)
    if WIDE and spread > ZERO:
        # fmt: off
        slopes = slopes_of(t, place, x.soc, spread, seen, point, load, SLOW, HYSTERESIS, SCALED)
        # fmt: on
    if news == 2:
        predict(c, x, point, slopes, flow, unmeasured_A2, SLOW, HYSTERESIS, OFFSET, WIDE)
    if HEATING and news == 2:
        fall = (point.r0_ohm * seen) + (x.v1_V + x.v2_V)
        if SLOW:
            fall = fall + x.v3_V
        x.heat_K = clip(
            x.heat_K + (c.heat_gain * ((c.heat_K_per_W * (flow * fall)) - x.heat_K)),
            -HEAT_MOST_K,
            HEAT_MOST_K,
        )
    # fmt: off
    status = U(
        status
        | correct(c, t, place, x, point, slopes, seen, unmeasured_A2, sample.voltage_V, news, out,
                  load, SLOW, HYSTERESIS, OFFSET, SCALED, WIDE, WATCH)
    )
    # fmt: on

    if not not_negative(x.soc, ONE):
        x.soc = within_one(x.soc)
        x.soc_carry = ZERO
        status = U(status | U(CLAMPED))
    if news != 0:
        x.current_A = current
        x.sequence = sample.sequence
        if WATCH:
            x.no_current = silent
        if news == 2 and U(x.evidence - FIRST_VOLTAGE) < EVIDENCE_MOST:
            x.evidence = U(x.evidence + U(U(1) + missing))
    out.soc = x.soc
    out.soc_variance = x.ss
    out.status = status


@lru_cache
def compiled_rows(options: Options) -> Callable[..., None]:
    """The loop ``rows(constants, table, state, samples, outputs)`` for one set of options.

    Every argument is an array of records of :mod:`cellwise.estimate.fixed_step_layout`; ``state``
    has one element and is stepped in place. Nothing is allocated.
    """
    TEMPERATURES, ARRHENIUS = int(options.temperatures > 1), int(options.arrhenius > 0)
    SLOW, HYSTERESIS, OFFSET = options.slow, options.hysteresis, options.offset
    EFFICIENCY, LEAK, SKEW = options.efficiency, options.leak, options.skew
    RATE, ASYMMETRY, HEATING = options.rate, options.asymmetry, options.heating
    WARM, WIDE, WATCH = int(options.needs_temperature), options.wide, options.watch
    SCALED = int(options.arrhenius > 0 or options.rate or options.asymmetry)

    @njit(cache=True, error_model="numpy", fastmath=False, nogil=True)
    def rows(constants: Any, table: Any, state: Any, samples: Any, outputs: Any) -> None:
        for k in range(samples.size):
            step(
                constants[0],
                table,
                state[0],
                samples[k],
                outputs[k],
                TEMPERATURES,
                SLOW,
                HYSTERESIS,
                OFFSET,
                ARRHENIUS,
                EFFICIENCY,
                LEAK,
                SKEW,
                RATE,
                ASYMMETRY,
                HEATING,
                WARM,
                WIDE,
                SCALED,
                WATCH,
            )

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

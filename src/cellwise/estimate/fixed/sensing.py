"""What a sample means to the fixed step: numbers missing, a current that is held; the charge.

See ``arithmetic``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from cellwise.estimate.fixed.arithmetic import (
    COUNT_MOST,
    EVIDENCE_MOST,
    FIRST_VOLTAGE,
    HALF,
    HEAT_MOST_K,
    LONGEST_GAP,
    NOT_BEGUN,
    ONE,
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
from cellwise.estimate.fixed.arithmetic import TEMPERATURE_HIGH_C as HIGH_C
from cellwise.estimate.fixed.arithmetic import TEMPERATURE_LOW_C as LOW_C
from cellwise.estimate.fixed.lookup import within_one
from cellwise.estimate.fixed.predict import taken
from cellwise.estimate.status import (
    CLAMPED,
    CURRENT_INVALID,
    CURRENT_LOST,
    DUPLICATE,
    SEQUENCE_GAP,
    TEMPERATURE_INVALID,
)


class Seen(NamedTuple):
    """A sample as the filter takes it.

    ``news`` is 0 where the sample was seen before, 1 where it ends no interval, 2 where time has
    passed since the last one; ``missing`` how many were left out, ``silent`` for how many steps
    there was no current that could be used. ``current`` is the one that is held, ``seen`` what the
    voltage has seen of it, ``flow`` what flows without the sensor's offset.
    """

    status: int
    news: int
    missing: int
    silent: int
    current: float
    seen: float
    flow: float
    unmeasured_A2: float
    temperature_C: float


@kernel
def see(
    c: Any, x: Any, sample: Any, OFFSET: int, SKEW: int, HEATING: int, WARM: int, WATCH: int
) -> Seen:
    """Sequence number, current and temperature of a sample."""
    status = U(0)
    news = 1
    missing = U(0)
    silent = U(0)
    current = sample.current_A
    unmeasured_A2 = ZERO
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
    seen = current
    if SKEW and news == 2:
        seen = current + (c.skew_share * (x.current_A - current))
    flow = seen
    if OFFSET:
        flow = seen - x.offset_A
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
    return Seen(status, news, missing, silent, current, seen, flow, unmeasured_A2, temperature)


@kernel
def count_charge(
    c: Any, x: Any, s: Any, EFFICIENCY: int, LEAK: int, WATCH: int
) -> tuple[int, int, float]:
    """SOC over the interval that ends now: status, samples missing, the current that bridges them.

    Charge comes first, then the branches at the new SOC.
    """
    status = U(0)
    missing = s.missing
    bridge = ZERO
    if s.news == 2:
        used = taken(c, s.flow, EFFICIENCY, LEAK)
        if missing != U(0):
            status = U(SEQUENCE_GAP)
            if missing <= c.gap_steps:
                if not WATCH or s.silent <= c.hold_steps:
                    bridge = HALF * (s.current + x.current_A)
                used = used + (taken(c, bridge, EFFICIENCY, LEAK) * F(missing))
            else:  # nobody knows what flowed
                missing = missing if missing < U(LONGEST_GAP) else U(LONGEST_GAP)
        x.soc, x.soc_carry = add(x.soc, x.soc_carry, -used)
        if WATCH and s.unmeasured_A2 > ZERO:
            # It may keep one sign for as long as it is away: the deviation grows, not the variance.
            drift = root(x.ss) + c.lost_soc
            x.ss = drift * drift
        if not WATCH and s.unmeasured_A2 > ZERO:
            x.ss = x.ss + c.lost_walk
    return status, missing, bridge


@kernel
def heat(c: Any, x: Any, r0_ohm: float, seen: float, flow: float, SLOW: int) -> None:
    """The cell's own warming over one interval."""
    fall = (r0_ohm * seen) + (x.v1_V + x.v2_V)
    if SLOW:
        fall = fall + x.v3_V
    x.heat_K = clip(
        x.heat_K + (c.heat_gain * ((c.heat_K_per_W * (flow * fall)) - x.heat_K)),
        -HEAT_MOST_K,
        HEAT_MOST_K,
    )


@kernel
def finish(x: Any, s: Any, missing: int, sequence: int, out: Any, WATCH: int) -> Any:
    """Hold SOC within its bounds, remember the sample, tell: the status of the clamp."""
    status = U(0)
    if not not_negative(x.soc, ONE):
        x.soc = within_one(x.soc)
        x.soc_carry = ZERO
        status = U(CLAMPED)
    if s.news != 0:
        x.current_A = s.current
        x.sequence = sequence
        if WATCH:
            x.no_current = s.silent
        if s.news == 2 and U(x.evidence - FIRST_VOLTAGE) < EVIDENCE_MOST:
            x.evidence = U(x.evidence + U(U(1) + missing))
    out.soc = x.soc
    out.soc_variance = x.ss
    return status

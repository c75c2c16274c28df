"""The fixed step in float32: the same sentences, in the same order, as firmware_ref/cellwise_ekf.c.

Same bits as the C: full parentheses, no contraction, no exp, pow or sqrt, every constant float32,
every conversion written out. Upper-case arguments are known when a loop is compiled, so that what
is not compiled in costs nothing; an effect's fields exist in the records only where it is.

Constants and small helpers stand here; then follow lookup, state, predict, anew, correct, rows.
State x = [soc, v1, v2, v3, h, offset]; ``c`` are the constants, ``t`` the table of shape
(temperatures, points, fields of a row), ``x`` the state: see ``layout``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from cellwise.estimate.status import OUT_OF_RANGE

# Typed as anything: numba sees float32 and uint32, a type checker should not see more.
F: Any = np.float32
U: Any = np.uint32

ZERO, QUARTER, HALF, ONE, TWO = F(0.0), F(0.25), F(0.5), F(1.0), F(2.0)
THREE, FOUR, SIXTY_FOURTH = F(3.0), F(4.0), F(0.015625)
KNOW_NOTHING_SOC = F(0.5)
KNOW_NOTHING_VARIANCE = F(0.09)
SOC_VARIANCE_MOST = F(1.0)
VARIANCE_FLOOR = F(1e-12)
GROW = F(float.fromhex("0x1.000004p+0"))
BEYOND = F(0.05)
WIDE_VARIANCE = F(4e-4)
SHORTEST_CHORD = F(1e-6)
SMALL_MOVE = F(0.05)
RECOVERY_VARIANCE = F(0.09)
TEMPERATURE_LOW_C, TEMPERATURE_HIGH_C = F(-60.0), F(120.0)
HEAT_MOST_K = F(200.0)
LARGE = F(2.0**20)
CARRY_MOST = F(2.0**-10)
LEAST_FALL = F(0.1)
LONGEST_GAP = 0x100000
NOT_BEGUN, NO_VOLTAGE_YET, FIRST_VOLTAGE, EVIDENCE_MOST = U(0), U(1), U(2), U(0x200000)
SHARED_GROWTH = F(4.0)
START_LOAD_SHARE = F(0.5)
REST_LIMIT_V, LOAD_LIMIT_V = F(0.03), F(0.3)
RESTART_POINTS, RESTART_STEP = 201, F(1.0 / 200.0)
RESTART_ROUNDING = F(1.0 / 200.0**2 / 12.0)
FURTHEST = F(2000.0)
FROZEN_READINGS, FROZEN, COUNT_MOST = U(3), U(0xFFFFFFFF), U(2_000_000_000)
REJECTION, FORGIVEN = U(20_000), U(2_000)
LARGEST_FLOAT = F(float.fromhex("0x1.fffffep+127"))
SIXTH, TWENTY_FOURTH = F(1.0 / 6.0), F(1.0 / 24.0)

helper = njit(cache=True, error_model="numpy", fastmath=False)
kernel = njit(cache=True, error_model="numpy", fastmath=False, inline="always")  # prunes options


@helper
def between(a: float, b: float, f: float) -> Any:
    """From a at f = 0 to b at f = 1."""
    return a + (f * (b - a))


@helper
def clip(x: Any, low: float, high: float) -> Any:
    """Held within low..high."""
    if x < low:
        return low
    if x > high:
        return high
    return x


@helper
def magnitude(x: Any) -> Any:
    """Absolute value, of -0 too."""
    return math.fabs(x)


@helper
def at_least(x: Any, low: float) -> Any:
    """Held above low."""
    return low if x < low else x


@helper
def not_negative(x: Any, limit: float) -> Any:
    """Within 0..limit, and not -0: the C compares bits."""
    return (math.copysign(ONE, x) > ZERO) & (x <= limit)


@helper
def within(x: Any, low: float, high: float) -> Any:
    """False for NaN too."""
    return (x >= low) & (x <= high)


@helper
def out_of_range(x: float) -> Any:
    """Bit for a number that no cell of this kind gives; asked of readings that were refused."""
    if within(x, -LARGEST_FLOAT, LARGEST_FLOAT):
        return U(OUT_OF_RANGE)
    return U(0)


@helper
def add(total: float, carry: float, value: float) -> tuple[float, float]:
    """Compensated sum: what rounding keeps from the total stays in the carry."""
    missed = value - carry
    new = total + missed
    return new, (new - total) - missed


@helper
def risen(z: float) -> Any:
    """1 - exp(-z) for z >= 0, with exp(z) by its first five terms: exact at 0, rises to 1."""
    fourth = SIXTH + (z * TWENTY_FOURTH)
    grown = z * (ONE + (z * (HALF + (z * fourth))))
    return grown / (ONE + grown)


@helper
def root(square: float) -> Any:
    """Square root of a number up to 4 by five Newton steps from 1.

    One below 1/4 is multiplied by 4 until it is not.
    """
    scaled = square
    unit = ONE
    r = ONE
    for _ in range(24):
        if scaled >= QUARTER:
            break
        scaled = FOUR * scaled
        unit = HALF * unit
    for _ in range(5):
        r = HALF * (r + (scaled / r))
    return r * unit

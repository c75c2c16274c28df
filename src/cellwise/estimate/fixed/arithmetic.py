"""The fixed step in float32: its constants and its small helpers.

``firmware_ref/cellwise_ekf.c`` is printed from these modules (:mod:`cellwise.printing`) and gives
the same bits: full parentheses, no contraction, no exp, pow or sqrt, every constant float32, every
conversion written out. What names a type here is C's type there.

State x = [soc, v1, v2, v3, h]; ``m`` is the model, ``c`` its constants, ``x`` the state with its
covariance P, ``p`` the tables at one SOC, ``k`` a gain, ``d`` the column P H': see ``layout``.
Order: lookup, covariance, state, sensing, innovation, step, rows.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias, cast

import numpy as np

from cellwise.cell.compiled import noinline as noinline
from cellwise.cell.equations import BEYOND as GOES_ON
from cellwise.cell.equations.scalar import at_least as at_least
from cellwise.cell.equations.scalar import at_most as at_most
from cellwise.cell.equations.scalar import clip as clip
from cellwise.estimate.equations.constants import *
from cellwise.estimate.status import OUT_OF_RANGE

# To a type checker numbers are Python's; numba sees float32 and uint32. Records are anything.
F = cast("type[float]", np.float32)
U = Count = cast("type[int]", np.uint32)
Constants: TypeAlias = Any
State: TypeAlias = Any
Sample: TypeAlias = Any
Output: TypeAlias = Any
Capability: TypeAlias = Any
Outlook: TypeAlias = Any
PlanResult: TypeAlias = Any
Phase: TypeAlias = Any
Cell: TypeAlias = Any
Bank: TypeAlias = Any
CellOutput: TypeAlias = Any
Soh: TypeAlias = Any
SohOutput: TypeAlias = Any
Sketch: TypeAlias = Any
States: TypeAlias = Any  # arrays: of states, cells, floats, phases, samples, outputs
Cells: TypeAlias = Any
Floats: TypeAlias = Any
Phases: TypeAlias = Any
Samples: TypeAlias = Any
Outputs: TypeAlias = Any
# There where an option is.
SlowFloat: TypeAlias = Any
HysteresisFloat: TypeAlias = Any
WarmFloat: TypeAlias = Any
SurfaceFloat: TypeAlias = Any
OffsetFloat: TypeAlias = Any

# Options: what is compiled in. They are known when numba compiles and when C is printed.
SLOW = HYSTERESIS = 0  # states
EFFICIENCY = LEAK = SKEW = RATE = ASYMMETRY = TRANSFER = SURFACE = HEATING = 0  # effects
TEMPERATURES = ARRHENIUS = DEPTH = 0  # several temperatures, tables over temperature
WARM = SCALED = 0  # any of these, any factor on all resistances
WIDE = 0  # care of a SOC that is badly known, and of sensors
VALIDITY = THERMAL = 0  # beyond the model's SOC and current, beyond its temperature
POWER = REMAINING = 0  # state of power, time and energy to empty: functions beside the step
HEALTH = CELLS = 0  # what a history says, the cells of a pack
BANK = 0  # components for a start that nobody knows
OFFSET = 0  # the hypothesis of a current that is off
SOH = 0  # the capacity that is left, between rests
SKETCH = SKETCH_LARGE = 0  # sums of a residual that stay on the target, all of its causes

SIXTH, TWENTY_FOURTH = F(1.0 / 6.0), F(1.0 / 24.0)
THIRD, FIFTH, SEVENTH = F(1.0 / 3.0), F(1.0 / 5.0), F(1.0 / 7.0)
LINE_OF_ROOT = F(0.68629150)  # 4 (3 - 2 sqrt 2): as far above a root at 1/4 and 1 as below between
LARGEST_FLOAT = F(float.fromhex("0x1.fffffep+127"))

KNOW_NOTHING_SOC = F(0.5)
KNOW_NOTHING_VARIANCE = F(0.09)
SOC_VARIANCE_MOST = F(1.0)  # SOC lies in 0..1: more says nothing
BEYOND = F(GOES_ON)  # how far the OCV goes on outside 0..1
HEAT_MOST_K = F(200.0)
CARRY_MOST = F(2.0**-10)
LEAST_FALL = F(0.1)  # with the current a resistance rises by ten at most
LONGEST_GAP = U(0x100000)  # samples
NOT_BEGUN = U(0)  # evidence before the first sample
NO_VOLTAGE_YET = U(1)
FIRST_VOLTAGE = U(2)
EVIDENCE_MOST = U(0x200000)
REPEATED = U(0)  # a sample that was seen before,
NO_INTERVAL = U(1)  # the first one, which ends no interval,
INTERVAL = U(2)  # and one that ends an interval
ALONE = U(0)  # a state that stands for itself,
COMPONENT = U(1)  # one of a bank,
CONTRADICTED = U(2)  # one whose voltages have contradicted it for long,
UNCOUNTED = U(3)  # and one of whose charge a part is not known
LN_2 = F(math.log(2.0))
FURTHEST = F(2000.0)  # beyond it exp(-z) is nothing
POWER_TRIALS = U(8)
LONGEST = F(1e9)  # remaining seconds, and joules: no cell lasts for more
REMAINING_PARTS = F(64.0)  # of the SOC down to empty
PHASE_PARTS_PER_S = F(1.0 / 30.0)  # of a plan's phase, beside those by its SOC
PHASE_PARTS_MOST = F(4096.0)
PHASE_TURNS = U(3)  # of a power to its current: off by less than 1e-6 then
DEVIATIONS_MOST = F(8.0)  # nothing is beyond
NORMAL_1, NORMAL_2 = F(0.0498673470), F(0.0211410061)
NORMAL_3, NORMAL_4 = F(0.0032776263), F(0.0000380036)
NORMAL_5, NORMAL_6 = F(0.0000488906), F(0.0000053830)
LEAST_SPAN_V = F(1e-9)  # between the ends of a bracket: it is divided by
USUAL_DEGREES = F(25.0)  # of a sketch without a temperature
NOT_SIMULATED = U(0xFFFFFFFF)  # a sketch that waits for a SOC that is known
THREE_CELLS = U(3)  # that may limit a pack's power
CELL_MOST = F(0.9)  # of a cell's capacity or resistance may be missing,
SCALE_MOST = F(19.0)  # and as many times its resistance be added
LEAST_SHARE, MOST_SHARE = F(0.1), F(2.0)  # of the capacity that a history gives
LEAST_SCALE, MOST_SCALE = F(0.1), F(20.0)  # of the resistances
SUSTAINED = F(1.6449)  # one-sided 95 % of a normal distribution
COUNT_MOST = U(2_000_000_000)
REACH_MOST = F(1024.0)  # of an offset: SOC, deviations, and volts
SCORE_MOST = F(1e9)  # of what is known of an offset
SINCE_MOST = F(1e9)  # steps, until the past is looked at
SOH_VARIANCE = F(0.0225)  # of a used cell's share of capacity: 0.15, half of what a life takes
SOH_WALK = F(1e-5)  # and per SOC that flows: 0.1 over 500 cycles of two each
SOH_RESISTANCE = F(0.25)  # of a used cell's resistances: 0.5, half of what a life adds,
SOH_RESISTANCE_WALK = F(2.5e-4)  # and per SOC that flows: 0.5 over 500 cycles of two each
SOH_APART = F(0.3)  # SOC between two rests of a pair
SOH_SOC_VARIANCE = F(0.0025)  # an OCV that says the SOC no better than to 0.05 is none
RESTED, FIRST_LOAD = U(1), U(2)  # what is watched: a long rest, the load after it
SOH_REFUSED = U(3)  # pairs in a row beyond the gate, then the estimate begins again

# ---- tests and operations that C does on the bits of a float: cellwise_float.h ----


def magnitude(x: float) -> float:
    """Absolute value, of -0 too."""
    return math.fabs(x)


def within(x: float, low: float, high: float) -> bool:
    """False for NaN too."""
    return (x >= low) & (x <= high)


def size_within(x: float, limit: float) -> bool:
    """Whether the absolute value is at most the limit; false for NaN."""
    return (x >= -limit) & (x <= limit)


def size_below(x: float, limit: float) -> bool:
    """Whether the absolute value is below the limit; false for NaN."""
    return (x > -limit) & (x < limit)


def not_negative(x: float, limit: float) -> bool:
    """Within 0..limit, and not -0: the C compares bits."""
    return (math.copysign(1.0, x) > 0.0) & (x <= limit)


def positive_within(x: float, low: float, high: float) -> bool:
    """Within low..high, both of them positive."""
    return (x >= low) & (x <= high)


def positive_above(x: float, y: float) -> bool:
    """Whether x > y, neither of them negative or NaN."""
    return x > y


def is_number(x: float) -> bool:
    """Neither infinite nor NaN."""
    return (x >= -LARGEST_FLOAT) & (x <= LARGEST_FLOAT)


def known_fraction(x: float) -> float:
    """What is within 0..1 already: said for analysers of the C."""
    return x


def add(total: float, carry: float, value: float) -> tuple[float, float]:
    """Compensated sum: what rounding keeps from the total stays in the carry."""
    missed = value - carry
    new = total + missed
    return new, (new - total) - missed


# ---- from here on the C is printed ----


def is_same(a: float, b: float) -> bool:
    """Whether two numbers are the same."""
    return a >= b and a <= b


def unit_of(y: float) -> float:
    """The unit in which a ratio over ``y`` goes on: 1, since a product costs more than it saves."""
    return 1.0


def in_units(x: float, y: float) -> float:
    """The ratio x / y in that unit."""
    return x / y


def between(a: float, b: float, f: float) -> float:
    """From a at f = 0 to b at f = 1."""
    return a + (f * (b - a))


@noinline
def out_of_range(x: float) -> int:
    """Bit for a number that no cell of this kind gives; asked of readings that were refused."""
    return U(OUT_OF_RANGE) if is_number(x) else U(0)


@noinline
def risen(z: float) -> float:
    """1 - exp(-z) for z >= 0, with exp(z) by its first five terms: exact at 0, rises to 1."""
    fourth = SIXTH + (z * TWENTY_FOURTH)
    grown = z * (1.0 + (z * (0.5 + (z * fourth))))
    return grown / (1.0 + grown)


def vanishing(z: float) -> float:
    """exp(-z) for z >= 0, to 1e-4 of itself."""
    left = 1.0 - risen((z if z < FURTHEST else FURTHEST) * 0.015625)
    for _ in range(6):
        left = left * left
    return left


@noinline
def root(square: float) -> float:
    """Square root of a number up to 4, to 1e-7 of itself.

    It is brought into 1/4..1 by fours (at first six of them at once), where a straight line is off
    by 3 % at most; a Newton step leaves half the square of that.
    """
    scaled = square
    unit = 1.0
    if scaled > 1.0:
        scaled = 0.25 * scaled
        unit = 2.0
    for _ in range(4):
        if scaled >= 0.000244140625:
            break
        scaled = 4096.0 * scaled
        unit = 0.015625 * unit
    for _ in range(6):
        if scaled >= 0.25:
            break
        scaled = 4.0 * scaled
        unit = 0.5 * unit
    r = LINE_OF_ROOT * (0.5 + scaled)
    for _ in range(2):
        r = 0.5 * (r + (scaled / r))
    return r * unit


@noinline
def log_of_more(z: float) -> float:
    """ln(1 + z) for z >= 0, to 1e-5: halved until it is below 2, then the series of atanh."""
    y = 1.0 + (z if z < LARGE else LARGE)
    whole = 0.0
    for _ in range(21):
        if y <= 2.0:
            break
        y = 0.5 * y
        whole = whole + LN_2
    t = (y - 1.0) / (y + 1.0)
    square = t * t
    series = 1.0 + (square * (THIRD + (square * (FIFTH + (square * SEVENTH)))))
    return whole + ((2.0 * t) * series)

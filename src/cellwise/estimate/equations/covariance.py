"""What a covariance says of a voltage, for every filter and for the C.

``x`` holds the upper triangle of P by its entries: a record of a state, or a named tuple.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, CARRIED, CELL, SOC, V3, H, triangle
from cellwise.cell.equations.double import add
from cellwise.cell.equations.scalar import at_least, clip
from cellwise.cell.unrolled import THERE, unrolled_by_option
from cellwise.estimate.equations.constants import LARGE, VARIANCE_FLOOR
from cellwise.estimate.equations.evidence import covariance_by_soc

SLOW = HYSTERESIS = WIDE = True  # what a fixed step may do without
SlowFloat: TypeAlias = Any
HysteresisFloat: TypeAlias = Any
State: TypeAlias = Any


class Point(NamedTuple):
    """The tables at one SOC and temperature; a gain is 1 - exp(-dt/tau)."""

    ocv_V: float
    slope_V: float
    noise_V2: float
    r0_ohm: float
    m_V: HysteresisFloat
    r1_ohm: float
    r2_ohm: float
    r3_ohm: SlowFloat
    gain1: float
    gain2: float
    gain3: SlowFloat

    @property
    def r(self) -> dict[Any, float]:
        """Resistances by the branch."""
        return dict(zip(BRANCHES, self[5:8], strict=True))

    @property
    def gain(self) -> dict[Any, float]:
        """Gains by the branch."""
        return dict(zip(BRANCHES, self[8:], strict=True))


class Slopes(NamedTuple):
    """Slopes over SOC, while it is badly known: of the voltage, the OCV's bend, of the branches.

    ``spread`` is the standard deviation of SOC, 0 while it is well known.
    """

    slope_V: float
    bend_V: float
    spread: float
    rise1: float
    rise2: float
    rise3: SlowFloat

    @property
    def rise(self) -> dict[Any, float]:
        """Slopes of the resistances by the branch."""
        return dict(zip(BRANCHES, self[3:], strict=True))


class Column(NamedTuple):
    """P H', the covariance of every state with the voltage, or a gain."""

    s: float
    v1: float
    v2: float
    v3: SlowFloat
    h: HysteresisFloat

    @property
    def row(self) -> dict[Any, float]:
        """By the state."""
        return dict(zip(CELL, self, strict=True))


@inline
@unrolled_by_option
def column_of(x: State, slope_V: float, m_V: HysteresisFloat) -> Column:
    """P H' with H = [slope, -1, -1, -1, m]."""
    c: dict[Any, float] = {}
    for i in CELL:
        c[i] = (slope_V * x.p[SOC, i]) if THERE else 0.0
        for j in BRANCHES:
            c[i] = c[i] - x.p[i, j]
        for j in (H,):
            c[i] = c[i] + (m_V * x.p[i, j])
    return Column(*(c[i] for i in CELL))


@inline
@unrolled_by_option
def explained(d: Column, slope_V: float, m_V: HysteresisFloat) -> float:
    """H P H', the variance of the voltage that the state explains [V^2]."""
    variance = slope_V * d.s
    for j in BRANCHES:
        variance = variance - d.row[j]
    for j in (H,):
        variance = variance + (m_V * d.row[j])
    return variance if variance > 0.0 else 0.0


@inline
@unrolled_by_option
def scaled(d: Column, factor: float) -> Column:
    """A column times a number: a gain."""
    return Column(*((d.row[i] * factor) if THERE else 0.0 for i in CELL))


@inline
@unrolled_by_option
def column_of_slow_branch(x: State) -> Column:
    """P H' where the slow branch itself is measured."""
    c: dict[Any, float] = {}
    for i in CELL:
        c[i] = x.p[i, V3] if THERE else 0.0
    return Column(*(c[i] for i in CELL))


@inline
@unrolled_by_option
def forget_correlations(x: State) -> None:
    """Only the diagonal stays."""
    for i, j in triangle(CELL):
        if i != j:
            x.p[i, j] = 0.0


@inline
def followed(now: float, gain: float, end: float) -> float:
    """What goes from where it is towards an end, by a gain."""
    return now + (gain * (end - now))


@inline
def add_variance(x: State, value: float) -> None:
    """A variance of SOC that is large changes by less than rounding keeps of it."""
    if WIDE:
        x.ss, x.ss_carry = add(x.ss, x.ss_carry, value)
    else:
        x.ss = x.ss + value


@inline
@unrolled_by_option
def relax(
    x: State,
    p: Point,
    gain1: float,
    gain2: float,
    gain3: SlowFloat,
    current1: float,
    current2: float,
    current3: SlowFloat,
    square_A2: float,
) -> None:
    """The branches over an interval of a constant current each, exactly, and their covariance.

    A current that is not known to ``square_A2`` drives them too; 1 - a^2 keeps the stationary
    spread independent of the time step. What decays slowly is stated by how much it loses: 1 - 1e-5
    as a float is off by 0.3 % of that.
    """
    gain: dict[Any, float] = {}  # as handed over
    current: dict[Any, float] = {}
    a: dict[Any, float] = {}
    for i in BRANCHES:
        a[i] = 1.0 - gain[i]
        if i in CARRIED:
            x.state[i], x.carry[i] = add(
                x.state[i], x.carry[i], gain[i] * ((p.r[i] * current[i]) - x.state[i])
            )
        else:
            x.state[i] = followed(x.state[i], gain[i], p.r[i] * current[i])
        for j in (SOC, H):
            x.p[i, j] = x.p[i, j] - (gain[i] * x.p[i, j])
        x.p[i, i] = x.p[i, i] + (
            (gain[i] * (1.0 + a[i])) * ((square_A2 * (p.r[i] * p.r[i])) - x.p[i, i])
        )
    for i, j in triangle(BRANCHES):
        if i != j:
            x.p[i, j] = x.p[i, j] - ((gain[i] + (gain[j] * a[i])) * x.p[i, j])


@inline
@unrolled_by_option
def fade_hysteresis(x: State, keep: float) -> None:
    """The row of h where a share of h is kept."""
    for i in (H,):
        for j in (SOC, *BRANCHES):
            x.p[i, j] = keep * x.p[i, j]
        x.p[i, i] = (keep * keep) * x.p[i, i]


@inline
@unrolled_by_option
def tilt(x: State, slopes: Slopes, drive1: float, drive2: float, drive3: SlowFloat) -> None:
    """A SOC that is off drives the branches by the resistances' slopes, as ``drive`` [A] does."""
    drive: dict[Any, float] = {}  # as handed over
    f: dict[Any, float] = {}
    after: dict[Any, float] = {}
    for i in BRANCHES:
        f[i] = slopes.rise[i] * drive[i]
        after[i] = x.p[SOC, i] + (f[i] * x.ss)
    for i, j in triangle(BRANCHES):
        x.p[i, j] = x.p[i, j] + covariance_by_soc(f[i], f[j], x.p[SOC, i], after[j])
    for i in BRANCHES:
        for j in (H,):
            x.p[i, j] = x.p[i, j] + (f[i] * x.p[SOC, j])
        x.p[SOC, i] = after[i]


@inline
@unrolled_by_option
def move(x: State, k: Column, innovation_V: float) -> None:
    """State + K innovation."""
    for i in CELL:
        if i in CARRIED:
            x.state[i], x.carry[i] = add(x.state[i], x.carry[i], k.row[i] * innovation_V)
        else:
            x.state[i] = x.state[i] + (k.row[i] * innovation_V)
    for i in (H,):
        x.state[i] = clip(x.state[i], -1.0, 1.0)


@inline
@unrolled_by_option
def narrow(x: State, k: Column, d: Column) -> None:
    """P - K d', row by row."""
    for i in CELL:
        for j in CELL[CELL.index(i) :]:
            if i == j == SOC:
                add_variance(x, -(k.s * d.s))
                x.ss = clip(x.ss, VARIANCE_FLOOR, LARGE) if WIDE else at_least(x.ss, VARIANCE_FLOOR)
            elif i == j:
                x.p[i, j] = at_least(x.p[i, j] - (k.row[i] * d.row[j]), 0.0)
            else:
                x.p[i, j] = x.p[i, j] - (k.row[i] * d.row[j])

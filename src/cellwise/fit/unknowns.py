"""The unknowns of a fit: named blocks of one vector, their bounds, and the scalars of a cell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.point_kernels import CellScalars
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, spline_count
from cellwise.typing import FloatArray, IndexArray

ACTIVATION_UNIT_K = 1000.0
SKEW_UNIT_S = 0.1
ASINH_UNIT_PER_V = 10.0
LEAST_RATIO = 2.0  # between neighbouring time constants, at every knot
TAU_LIMITS_S = (0.05, 30_000.0)
LEAST_OHM = 1e-7
LARGEST_DROP_V = 10.0  # of one resistance at 1C: where nothing was measured it may run up
LN_CAPACITY_LIMITS = (-0.7, 0.4)  # an aged cell keeps a half
BENDS = 2  # half and whole waves from empty to full


@dataclass(frozen=True)
class FitSettings:
    """Which unknowns a fit has; a deviation of 0 keeps a value.

    Parameters
    ----------
    branches : int              2, or 3 with the slow branch
    hysteresis : bool           M(soc) and gamma
    ln_capacity_std : float     of ln of the capacity that the SOC is counted over
    skew : bool                 a sampling delay of the logs that may have one
    charge_transfer : bool      the asinh law of the fast branch, from ``asinh_per_V`` on
    own_activation_std_K : float      of each resistance and time constant beside the common one
    ln_resistance_std : float   of ln of a factor that all resistances have in common
    """

    branches: int = 3
    hysteresis: bool = False
    ln_capacity_std: float = 0.0
    skew: bool = False
    charge_transfer: bool = False
    own_activation_std_K: float = 0.0
    asinh_per_V: float = 4.0
    ln_resistance_std: float = 0.0


class Layout(NamedTuple):
    """Sizes, then the first place of each block of the vector of unknowns, in its order.

    The OCV's correction (knots_ocv, from 0); ``r0``: ln R0, then ln R and ln tau of each branch
    (temperatures x knots each); ``m`` (temperatures x knots) and ``gamma`` (a logarithm) where
    there is a hysteresis; one number each: ``activation`` [K / 1000], ``skew`` [s / 10], ``asinh``
    [10 / V]; ``own_activation``: what each table of logarithms has beside the common one
    [K / 1000]; ``capacity``: ln of the capacity over what was taken; of every log ``sample``: ln of
    the capacity that its cell has over the others', ``start``: by how much SOC it begins elsewhere
    than was taken, ``past``: what the branches hold at its first row (branches each) [V], ``bend``:
    by how much SOC it runs beside the others' in its middle (BENDS each, see `bends_of`).
    """

    knots_ocv: int
    knots: int
    branches: int
    hysteresis: bool
    temperatures: int
    logs: int
    block: int
    r0: int
    m: int
    gamma: int
    activation: int
    skew: int
    asinh: int
    own_activation: int
    capacity: int
    sample: int
    start: int
    past: int
    bend: int
    size: int

    def r(self, branch: int) -> int:
        """First coefficient of a branch's ln R."""
        return self.r0 + self.block * (1 + 2 * branch)

    def tau(self, branch: int) -> int:
        """First coefficient of a branch's ln tau."""
        return self.r(branch) + self.block

    def tables(self) -> Iterator[int]:
        """First coefficient of every table of logarithms."""
        yield from range(self.r0, self.m, self.block)

    def resistances(self) -> FloatArray:
        """1 where an unknown is ln of a resistance, 0 elsewhere, shape (size,)."""
        found = np.zeros(self.size)
        for at in (self.r0, *map(self.r, range(self.branches))):
            found[at : at + self.block] = 1.0
        return found

    def of_temperatures(self, count: int, logs: int) -> Layout:
        """The layout of some neighbouring temperatures and as many logs."""
        return layout_of(self.branches, self.hysteresis, count, logs)

    def part(self, first: int, count: int, log: int | None = None) -> IndexArray:
        """Places of the unknowns of some neighbouring temperatures, in their layout's order.

        With those of one log, or of all.
        """
        rows = np.arange(first * self.knots, (first + count) * self.knots)
        found = [np.arange(self.r0), *(at + rows for at in self.tables())]
        if self.hysteresis:
            found += [self.m + rows, np.array([self.gamma])]
        found.append(np.arange(self.activation, self.sample))
        if log is None:
            found.append(np.arange(self.sample, self.size))
        else:
            past, bend = self.past + log * self.branches, self.bend + log * BENDS
            found += [
                np.array([self.sample + log, self.start + log]),
                np.arange(past, past + self.branches),
                np.arange(bend, bend + BENDS),
            ]
        return np.concatenate(found)


def layout_of(branches: int, hysteresis: bool, temperatures: int = 1, logs: int = 1) -> Layout:
    """The layout of a fit of so many branches, temperatures with tables of their own, and logs."""
    knots_ocv, knots = spline_count(OCV_KNOTS), spline_count(TABLE_KNOTS)
    block = temperatures * knots
    m = knots_ocv + block * (1 + 2 * branches)
    activation = m + (block + 1 if hysteresis else 0)
    own_activation = activation + 3
    capacity = own_activation + 1 + 2 * branches
    sample = capacity + 1
    start = sample + logs
    past = start + logs
    bend = past + branches * logs
    return Layout(
        knots_ocv, knots, branches, hysteresis, temperatures, logs, block, r0=knots_ocv, m=m,
        gamma=m + block, activation=activation, skew=activation + 1, asinh=activation + 2,
        own_activation=own_activation, capacity=capacity, sample=sample, start=start, past=past,
        bend=bend, size=bend + BENDS * logs,
    )  # fmt: skip


def bends_of(soc: FloatArray) -> FloatArray:
    """What each bend moves at the given SOC, shape (n, BENDS): nothing at the ends."""
    waves = np.arange(1, BENDS + 1)
    return np.asarray(np.sin(np.pi * waves * np.clip(soc, 0.0, 1.0)[:, None]))


def bounds_of(layout: Layout, charge_As: float) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest value of every unknown; a log's start is bounded by what it moves."""
    low, high = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)

    def within(first: int, stop: int, least: float, most: float) -> None:
        low[first:stop], high[first:stop] = least, most

    largest_ohm = LARGEST_DROP_V * 3600.0 / charge_As
    for k, at in enumerate(layout.tables()):
        sizes = TAU_LIMITS_S if k and k % 2 == 0 else (LEAST_OHM, largest_ohm)
        within(at, at + layout.block, *np.log(sizes))
    if layout.hysteresis:
        within(layout.m, layout.gamma, 0.0, 0.5)
    within(layout.activation, layout.skew, -2.0, 15.0)
    within(layout.skew, layout.asinh, 0.0, np.inf)
    within(layout.asinh, layout.own_activation, 0.0, 20.0)
    within(layout.capacity, layout.start, *LN_CAPACITY_LIMITS)
    return low, high


def scalars_of(layout: Layout, theta: FloatArray, charge_As: float, *, skewed: bool) -> CellScalars:
    """Scalars of a vector of unknowns; ``skewed`` logs have its sampling delay, others none."""
    plain = CellScalars(*(0.0 for _ in CellScalars._fields))
    return plain._replace(
        charge_As=charge_As,
        charge_efficiency=1.0,
        charge_scale=1.0,
        activation_K=float(theta[layout.activation]) * ACTIVATION_UNIT_K,
        hysteresis_rate=math.exp(theta[layout.gamma]) if layout.hysteresis else 0.0,
        skew_s=float(theta[layout.skew]) * SKEW_UNIT_S if skewed else 0.0,
        asinh_per_V=float(theta[layout.asinh]) * ASINH_UNIT_PER_V,
    )

"""The parameters of the refinement: how far they may move, where they stand, where they start."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.point_kernels import CellScalars
from cellwise.identify.ocv.curve import LIMITS as BATCH
from cellwise.identify.refinement.splines import OCV_KNOTS, TABLE_KNOTS, spline_count
from cellwise.typing import FloatArray, IndexArray

ACTIVATION_UNIT_K = 1000.0
SKEW_UNIT_S = 0.1
ASINH_UNIT_PER_V = 10.0
LEAST_RATIO = 2.0  # between neighbouring time constants, at every knot
TAU_LIMITS_S = (0.05, 30_000.0)
LEAST_OHM = 1e-7
LARGEST_DROP_V = 10.0  # of one resistance at 1C: where nothing was measured it may run up
GAMMA_LIMITS = (0.5, 5000.0)
OWN_LIMITS = (-6.0, 6.0)  # of a table's own activation, in units of ACTIVATION_UNIT_K


class OwnCapacity(NamedTuple):
    """What is known beforehand of ln of the capacity that a log keeps over the model's.

    Samples of one batch differ by ``batch``, those of others or of another age by ``others``, one
    deviation each. Every log is first taken for one of others, or an aged one would bend the tables
    and stay hidden; found beyond ``same`` it remains one. ``limits``: an aged cell keeps a half;
    ``step`` is that of a difference quotient.
    """

    batch: float = 0.01
    others: float = 0.2
    same: float = BATCH.other_capacity
    limits: tuple[float, float] = (-0.7, 0.4)
    step: float = 1e-4


OWN_CAPACITY = OwnCapacity()


@dataclass(frozen=True)
class RefineSettings:
    """How far the data may pull the tables.

    Parameters
    ----------
    branches : int            2, or 3 with the slow branch
    hysteresis : bool         fit M(soc) and gamma
    charge_transfer : bool    fit the asinh law of the fast branch
    activation_K, activation_std_K : float   prior of the Arrhenius activation; a standard
                              deviation of 0 keeps it; with several temperatures it is not fitted
    own_activation_std_K : float      how far the activation of each resistance and time constant
                              may be from the common one; 0: not fitted
    skew : bool               fit the sampling delay of the logs that may have one
    samples : int             logs that keep a capacity of their own
    smooth : float            weight of the tables' curvature, in units of the residual variance
    straight : float          weight of their curvature over 1/T, where 0 is one activation energy
    ocv_smooth, ocv_size : float      weight of the OCV correction's curvature and size [V^-2]
    hold : float              weight of the start values, for what the data do not determine
    robust : float            residuals beyond this many standard deviations count linearly
    balance : float           0: every log has one weight; 1: one that is fitted worse counts less
    iterations : int
    """

    branches: int = 3
    hysteresis: bool = False
    charge_transfer: bool = False
    activation_K: float = 2000.0
    activation_std_K: float = 1000.0
    own_activation_std_K: float = 0.0
    skew: bool = True
    samples: int = 0
    smooth: float = 0.01
    straight: float = 0.01
    ocv_smooth: float = 1e-3
    ocv_size: float = 1e-6
    hold: float = 1e-3
    robust: float = 10.0
    balance: float = 0.0
    iterations: int = 40


@dataclass(frozen=True, eq=False)
class StartTables:
    """Where refinement starts: base OCV over SOC, and values at the table knots.

    Every table has shape (knots,), or (temperatures, knots).
    """

    ocv: Callable[[FloatArray], FloatArray]
    r0_ohm: FloatArray
    r_ohm: tuple[FloatArray, ...]
    tau_s: tuple[FloatArray, ...]
    m_V: FloatArray | None = None
    gamma: float = 50.0
    asinh_per_V: float = 4.0


class Layout(NamedTuple):
    """Sizes, then the first place of each block of the parameter vector, in its order.

    The OCV's correction (knots_ocv, from 0); ``r0``: ln R0, then ln R and ln tau of each branch
    (temperatures x knots each); ``m`` (temperatures x knots) and ``gamma`` (a logarithm) where
    there is a hysteresis; one number each: ``activation`` [K / 1000], ``skew`` [s / 10], ``asinh``
    [10 / V]; ``own``: the activation that each table of logarithms has beside the common one
    [K / 1000]; ``sample``: ln of the capacity that each of some logs has over the common one
    (samples); ``start``: by how much SOC each of some logs begins elsewhere than was taken,
    ``past``: what its unseen past left in the slow states [V] (starts each).
    """

    knots_ocv: int
    knots: int
    branches: int
    hysteresis: bool
    temperatures: int
    samples: int
    starts: int
    block: int
    r0: int
    m: int
    gamma: int
    activation: int
    skew: int
    asinh: int
    own: int
    sample: int
    start: int
    past: int
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

    def of_temperatures(self, count: int) -> Layout:
        """The layout of some neighbouring temperatures."""
        settings = RefineSettings(self.branches, self.hysteresis, samples=self.samples)
        return layout_of(settings, count, self.starts)

    def part(self, first: int, count: int) -> IndexArray:
        """Places of the parameters of some neighbouring temperatures, in their layout's order."""
        rows = np.arange(first * self.knots, (first + count) * self.knots)
        found = [np.arange(self.r0), *(at + rows for at in self.tables())]
        if self.hysteresis:
            found += [self.m + rows, np.array([self.gamma])]
        return np.concatenate([*found, np.arange(self.activation, self.size)])


def layout_of(settings: RefineSettings, temperatures: int = 1, starts: int = 0) -> Layout:
    """The layout of a fit; of ``starts`` logs nobody knows where they begin."""
    knots_ocv, knots = spline_count(OCV_KNOTS), spline_count(TABLE_KNOTS)
    block = temperatures * knots
    m = knots_ocv + block * (1 + 2 * settings.branches)
    activation = m + (block + 1 if settings.hysteresis else 0)
    own = activation + 3
    sample = own + 1 + 2 * settings.branches
    start = sample + settings.samples
    return Layout(
        knots_ocv, knots, settings.branches, settings.hysteresis, temperatures,
        settings.samples, starts, block, r0=knots_ocv, m=m, gamma=m + block,
        activation=activation, skew=activation + 1, asinh=activation + 2, own=own,
        sample=sample, start=start, past=start + starts, size=start + 2 * starts,
    )  # fmt: skip


def start_vector(
    lay: Layout, start: StartTables, settings: RefineSettings, past_V: Sequence[float] = ()
) -> FloatArray:
    """Start values as a parameter vector; ``past_V`` of each log that begins nobody knows where."""
    theta = np.zeros(lay.size)
    tables = [start.r0_ohm]
    for pair in zip(start.r_ohm, start.tau_s, strict=True):
        tables += pair
    shape = (lay.temperatures, lay.knots)
    for at, values in zip(lay.tables(), tables, strict=False):
        theta[at : at + lay.block] = np.log(np.broadcast_to(values, shape)).ravel()
    if lay.hysteresis:
        m = 0.0 if start.m_V is None else start.m_V
        theta[lay.m : lay.gamma] = np.broadcast_to(m, shape).ravel()
        theta[lay.gamma] = np.log(start.gamma)
    if lay.temperatures == 1:
        theta[lay.activation] = settings.activation_K / ACTIVATION_UNIT_K
    if settings.charge_transfer:
        theta[lay.asinh] = start.asinh_per_V / ASINH_UNIT_PER_V
    theta[lay.past :] = past_V
    return theta


def limits(
    lay: Layout, settings: RefineSettings, charge_As: float, begun: Sequence[FloatArray] = ()
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest value of every parameter.

    ``begun`` is the SOC of each log that begins nobody knows where: nowhere beyond full or empty,
    as far as a counter and a capacity are sure of that.
    """
    low, high = np.full(lay.size, -np.inf), np.full(lay.size, np.inf)

    def within(first: int, stop: int, least: float, most: float) -> None:
        low[first:stop], high[first:stop] = least, most

    largest_ohm = LARGEST_DROP_V * 3600.0 / charge_As
    for k, at in enumerate(lay.tables()):
        sizes = TAU_LIMITS_S if k and k % 2 == 0 else (LEAST_OHM, largest_ohm)
        within(at, at + lay.block, *np.log(sizes))
    if lay.hysteresis:
        within(lay.m, lay.gamma, 0.0, 0.5)
        within(lay.gamma, lay.activation, *np.log(GAMMA_LIMITS))
    within(lay.activation, lay.skew, -2.0, 15.0)
    within(lay.skew, lay.asinh, 0.0, np.inf)
    if settings.charge_transfer:
        within(lay.asinh, lay.own, 0.01, 20.0)
    own = OWN_LIMITS if settings.own_activation_std_K > 0.0 else (0.0, 0.0)
    within(lay.own, lay.sample, *own)
    within(lay.sample, lay.start, *OWN_CAPACITY.limits)
    for k, soc in enumerate(begun):
        within(lay.start + k, lay.start + k + 1, -max(soc.min(), 0.0), 1.0 - soc.max())
    return low, high


def scalars_of(layout: Layout, theta: FloatArray, charge_As: float, *, skewed: bool) -> CellScalars:
    """Scalars of a parameter vector; ``skewed`` logs have its sampling delay, others none."""
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

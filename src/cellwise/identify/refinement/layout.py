"""Where each parameter of the refinement stands in its vector."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cellwise.cell.point_kernels import CellScalars
from cellwise.typing import FloatArray, IndexArray

ACTIVATION_UNIT_K = 1000.0
SKEW_UNIT_S = 0.1
ASINH_UNIT_PER_V = 10.0


class Layout(NamedTuple):
    """Blocks of the parameter vector, in this order.

    ``ocv`` (knots_ocv); ln R0, then ln R and ln tau of each branch (temperatures x knots each);
    M (temperatures x knots) and ln gamma where there is a hysteresis; with several temperatures how
    far the OCV of each is from the common one (temperatures x knots_ocv); then one number each:
    activation [K / 1000], sampling delay [s / 10], asinh law [10 / V]; the activation that each
    table of logarithms has beside the common one [K / 1000]; ln of the capacity that each of some
    logs has over the common one (samples); of each of some logs by how much SOC it begins elsewhere
    than was taken, then what its unseen past left in the slow states [V] (starts each).
    """

    knots_ocv: int
    knots: int
    branches: int
    hysteresis: bool
    temperatures: int = 1
    samples: int = 0
    starts: int = 0

    @property
    def block(self) -> int:
        """Size of one table's block."""
        return self.temperatures * self.knots

    @property
    def r0(self) -> int:
        """First coefficient of ln R0."""
        return self.knots_ocv

    def r(self, branch: int) -> int:
        """First coefficient of a branch's ln R."""
        return self.knots_ocv + self.block * (1 + 2 * branch)

    def tau(self, branch: int) -> int:
        """First coefficient of a branch's ln tau."""
        return self.r(branch) + self.block

    @property
    def m(self) -> int:
        """First coefficient of M."""
        return self.knots_ocv + self.block * (1 + 2 * self.branches)

    @property
    def gamma(self) -> int:
        """Ln of the hysteresis rate."""
        return self.m + self.block

    @property
    def warm(self) -> int:
        """First coefficient of the OCVs' differences between temperatures."""
        return self.m + (self.block + 1 if self.hysteresis else 0)

    @property
    def activation(self) -> int:
        """Arrhenius activation in units of ACTIVATION_UNIT_K."""
        return self.warm + (self.temperatures * self.knots_ocv if self.temperatures > 1 else 0)

    @property
    def skew(self) -> int:
        """Sampling delay in units of SKEW_UNIT_S."""
        return self.activation + 1

    @property
    def asinh(self) -> int:
        """Sharpness of the charge transfer in units of ASINH_UNIT_PER_V."""
        return self.skew + 1

    @property
    def own(self) -> int:
        """First of the tables' own activations, in the order of `tables`."""
        return self.asinh + 1

    @property
    def sample(self) -> int:
        """First of the logs' own capacities."""
        return self.own + 1 + 2 * self.branches

    @property
    def start(self) -> int:
        """First of the logs' own starts."""
        return self.sample + self.samples

    @property
    def past(self) -> int:
        """First of what their unseen pasts left."""
        return self.start + self.starts

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.past + self.starts

    def tables(self) -> Iterator[int]:
        """First coefficient of every table of logarithms."""
        yield self.r0
        for j in range(self.branches):
            yield self.r(j)
            yield self.tau(j)

    def part(self, first: int, count: int) -> IndexArray:
        """Places of the parameters of some neighbouring temperatures, in the order of a layout.

        That layout is ``self._replace(temperatures=count)``; with one temperature it has no OCV
        differences.
        """
        rows = np.arange(first * self.knots, (first + count) * self.knots)
        found = [np.arange(self.knots_ocv)]
        found += [at + rows for at in self.tables()]
        if self.hysteresis:
            found += [self.m + rows, np.array([self.gamma])]
        if count > 1:
            found.append(
                self.warm + np.arange(first * self.knots_ocv, (first + count) * self.knots_ocv)
            )
        found.append(np.arange(self.activation, self.size))
        return np.concatenate(found)


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

"""Functions of SOC for an open-circuit voltage: one interface, three forms.

``log-linear-exp`` has six parameters and a meaning in print, ``spline`` follows any cell,
``table`` is what runs on a microcontroller. All three rise strictly with SOC, because a filter
divides by nothing but relies on the sign of the slope, and all three continue as straight lines
outside 0..1, because a filter's first guesses may lie there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
from scipy.interpolate import BSpline

from cellwise.typing import FloatArray

OcvKind = Literal["log-linear-exp", "spline", "table"]
OCV_KINDS: tuple[OcvKind, ...] = get_args(OcvKind)


class OcvFunction(Protocol):
    """Open-circuit voltage over SOC."""

    @property
    def kind(self) -> OcvKind:
        """Which of the three forms it is."""
        ...

    def evaluate(self, soc: FloatArray | float) -> FloatArray:
        """Open-circuit voltage [V], the shape of ``soc``."""
        ...

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        ...


@dataclass(frozen=True, eq=False)
class MonotoneSpline:
    """OCV as a cubic B-spline whose coefficients increase, so that it does.

    The derivative of a B-spline is a positive combination of the differences of its
    coefficients (de Boor, A Practical Guide to Splines, chapter X): increasing coefficients are
    enough for a strictly rising curve.

    Parameters
    ----------
    knots : (m + 4,) float           never decreasing, the ends four times [SOC]
    coefficients : (m,) float        increasing [V]
    """

    knots: FloatArray
    coefficients: FloatArray

    @property
    def kind(self) -> OcvKind:
        """Name of the form."""
        return "spline"

    def evaluate(self, soc: FloatArray | float) -> FloatArray:
        """Open-circuit voltage [V], the shape of ``soc``."""
        s, outside = inside_of(soc, self.knots[0], self.knots[-1])
        spline = BSpline(self.knots, self.coefficients, 3)
        return np.asarray(spline(s) + outside * spline.derivative()(s))

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        s, _ = inside_of(soc, self.knots[0], self.knots[-1])
        return np.asarray(BSpline(self.knots, self.coefficients, 3).derivative()(s))


@dataclass(frozen=True, eq=False)
class OcvTable:
    """OCV at uniform steps of SOC with straight lines between, as the firmware has it.

    The slope is that of the line; at a grid point that of the line to its right, at the last
    one to its left.

    Parameters
    ----------
    voltage_V : (n,) float        increasing, from ``soc_first`` to ``soc_last``
    soc_first, soc_last : float   SOC of the first and last point
    """

    voltage_V: FloatArray
    soc_first: float = 0.0
    soc_last: float = 1.0

    @property
    def kind(self) -> OcvKind:
        """Name of the form."""
        return "table"

    def evaluate(self, soc: FloatArray | float) -> FloatArray:
        """Open-circuit voltage [V], the shape of ``soc``."""
        k, x = self._cell(soc)
        v = self.voltage_V
        return np.asarray(v[k] + (x - k) * (v[k + 1] - v[k]))

    def slope(self, soc: FloatArray | float) -> FloatArray:
        """dOCV/dsoc [V per unit of SOC], the shape of ``soc``."""
        k, _ = self._cell(soc)
        step = (self.soc_last - self.soc_first) / (self.voltage_V.size - 1)
        return np.asarray((self.voltage_V[k + 1] - self.voltage_V[k]) / step)

    def _cell(self, soc: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        cells = self.voltage_V.size - 1
        x = (np.asarray(soc, dtype=np.float64) - self.soc_first) * (
            cells / (self.soc_last - self.soc_first)
        )
        return np.clip(np.floor(x), 0, cells - 1).astype(np.intp), x


def uniform_grid(function: OcvFunction, intervals: int = 100) -> tuple[FloatArray, FloatArray]:
    """Values of an OCV function at ``intervals + 1`` uniform steps of SOC from 0 to 1.

    Returns
    -------
    soc, voltage_V : (intervals + 1,) float
    """
    soc = np.linspace(0.0, 1.0, intervals + 1)
    return soc, function.evaluate(soc)


def inside_of(soc: FloatArray | float, first: float, last: float) -> tuple[FloatArray, FloatArray]:
    """SOC moved into [first, last], and how far outside it was."""
    s = np.asarray(soc, dtype=np.float64)
    inside = np.clip(s, first, last)
    return inside, s - inside

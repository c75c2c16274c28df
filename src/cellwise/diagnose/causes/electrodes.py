r"""An OCV as the difference of two electrodes, and what it becomes when they have aged.

.. math:: OCV(z) = U_p(y_0 - z (y_0 - y_{100})) - U_n(x_0 + z (x_{100} - x_0)) + rest(z)

The window of each electrode is fitted to a model's OCV with published half cells; what they leave
stays as it is. A loss of lithium or of an electrode's material moves both windows: full and empty
are where the cell comes to the same voltages as before. Source: Dubarry et al. 2012,
10.1016/j.jpowsour.2012.07.016; Mohtat et al. 2019, 10.1016/j.jpowsour.2019.03.104.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.optimize import brentq, least_squares

from cellwise.typing import FloatArray


class HalfCell:
    """The open-circuit potential of an electrode over its stoichiometry [V], as published.

    ``window`` is the stoichiometry at SOC 0 and 1 that cells of its source have.

    Parameters
    ----------
    terms : mapping     of `half_cells.toml`, which says what they are
    """

    def __init__(self, terms: Mapping[str, Any]) -> None:
        self.window: tuple[float, float] = tuple(terms["window"])
        self._scale, self._polynomial = terms.get("scale", 1.0), terms["polynomial"]
        steps = [(a, -k * x0, k) for a, k, x0 in terms.get("tanh", ())]
        steps += [(a, -x0 / w, 1.0 / w) for a, x0, w in terms.get("step", ())]
        self._steps = [*steps, *terms.get("line", ())]
        self._ends = terms.get("exp", ())

    def __call__(self, x: FloatArray) -> FloatArray:
        """The potential at a stoichiometry from 0 to 1 [V]."""
        x = self._scale * x
        u = np.polynomial.polynomial.polyval(x, self._polynomial)
        u = u + sum(a * np.tanh(b + c * x) for a, b, c in self._steps)
        return np.asarray(u + sum(a * np.exp(b + c * x**n) for a, b, c, n in self._ends))


_KNOWN = tomllib.loads((files(__package__) / "half_cells.toml").read_text(encoding="utf-8"))
NEGATIVE, POSITIVE = (
    {name: HalfCell(terms) for name, terms in _KNOWN[side].items()}
    for side in ("negative", "positive")
)


# Samples of one chemistry lie so far apart: half cells that leave more are of another one.
MOST_MISFIT_V = 0.010
# The steep ends say little about the windows and much about how they were measured.
FITTED_SOC = (0.03, 0.98)
LEAST_CAPACITY = 1e-3  # share of the old one that is held where losses leave no window
LOWEST_WINDOW = (0.0, 0.5, 0.56, 0.0)  # x_0, x_100, y_0, y_100 of a fit, at least
HIGHEST_WINDOW = (0.3, 1.0, 1.0, 0.55)  # at most


@dataclass(frozen=True, eq=False)
class Electrodes:
    """Two electrodes that make an OCV; capacities in units of the model's.

    ``window`` is x at SOC 0 and 1, y at SOC 0 and 1; ``misfit_V`` the root mean square of what the
    two leave of the OCV.
    """

    negative: str
    positive: str
    window: tuple[float, float, float, float]
    misfit_V: float

    @property
    def capacities(self) -> tuple[float, float]:
        """Of the negative and the positive electrode, between empty and full of lithium."""
        x0, x1, y0, y1 = self.window
        return 1.0 / (x1 - x0), 1.0 / (y0 - y1)

    @property
    def lithium(self) -> float:
        """Charge of the lithium in both."""
        x, y = self.window[1], self.window[3]
        negative, positive = self.capacities
        return negative * x + positive * y

    def ocv(self, soc: FloatArray) -> FloatArray:
        """What the two make of the OCV [V]."""
        return self._between(soc, self.window)

    def aged(
        self, soc: FloatArray, lithium: float, negative: float, positive: float
    ) -> tuple[FloatArray, float]:
        """Change of the OCV [V], and the capacity over the old one, after losses (shares).

        Material that was lost was empty of lithium, so that a loss of lithium is none of material.
        """
        window = _aged_window(self, lithium, negative, positive)
        change = self._between(soc, window) - self.ocv(soc)
        held = self.capacities[0] * (1.0 - negative) * (window[1] - window[0])
        return change, max(held, LEAST_CAPACITY)

    def _between(self, soc: FloatArray, window: tuple[float, float, float, float]) -> FloatArray:
        x0, x1, y0, y1 = window
        u_n, u_p = NEGATIVE[self.negative], POSITIVE[self.positive]
        return u_p(y0 + soc * (y1 - y0)) - u_n(x0 + soc * (x1 - x0))


@lru_cache(maxsize=256)
def _aged_window(
    electrodes: Electrodes, lithium: float, negative: float, positive: float
) -> tuple[float, float, float, float]:
    """Windows after losses (shares)."""
    before = electrodes.capacities
    q_n, q_p = before[0] * (1.0 - negative), before[1] * (1.0 - positive)
    left = electrodes.lithium * (1.0 - lithium)
    u_n, u_p = NEGATIVE[electrodes.negative], POSITIVE[electrodes.positive]

    def in_positive(x: float) -> float:
        # At the end of the span it is 0 to the last bit, and may be below: no power of that exists.
        return min(max((left - q_n * x) / q_p, 0.0), 1.0)

    def voltage(x: float) -> float:
        return _value(u_p, in_positive(x)) - _value(u_n, x)

    span = (max(0.0, (left - q_p) / q_n), min(1.0, left / q_n))
    empty_V, full_V = electrodes.ocv(np.array([0.0, 1.0]))
    x0, x1 = (_crossing(voltage, float(v), span) for v in (empty_V, full_V))
    return x0, x1, in_positive(x0), in_positive(x1)


def _value(half_cell: HalfCell, x: float) -> float:
    return float(half_cell(np.float64(x)))  # type: ignore[arg-type]


def _crossing(voltage: Callable[[float], float], at_V: float, span: tuple[float, float]) -> float:
    """Where a rising voltage comes to a value; the end of the span where it does not."""
    low, high = voltage(span[0]) - at_V, voltage(span[1]) - at_V
    if low >= 0.0:
        return span[0]
    if high <= 0.0:
        return span[1]
    return float(brentq(lambda x: voltage(x) - at_V, *span, xtol=1e-13))


def electrodes_of(soc: FloatArray, ocv_V: FloatArray) -> Electrodes | None:
    """The published half cells that come nearest to an OCV; None where none comes near.

    Parameters
    ----------
    soc, ocv_V : (n,) array       SOC 0..1 and open-circuit voltage [V]
    """
    return _electrodes_of(tuple(map(float, soc)), tuple(map(float, ocv_V)))


@lru_cache(maxsize=32)
def _electrodes_of(soc: tuple[float, ...], ocv_V: tuple[float, ...]) -> Electrodes | None:
    z, v = np.array(soc), np.array(ocv_V)
    used = (z >= FITTED_SOC[0]) & (z <= FITTED_SOC[1])
    z, v = z[used], v[used]
    best: Electrodes | None = None
    for negative in NEGATIVE:
        for positive in POSITIVE:
            found = _fitted(z, v, negative, positive)
            if best is None or found.misfit_V < best.misfit_V:
                best = found
    return best if best is not None and best.misfit_V <= MOST_MISFIT_V else None


def _fitted(soc: FloatArray, ocv_V: FloatArray, negative: str, positive: str) -> Electrodes:
    """Windows that come nearest to an OCV."""
    start = (*NEGATIVE[negative].window, *POSITIVE[positive].window)

    def made(window: FloatArray) -> Electrodes:
        x0, x1, y0, y1 = (float(w) for w in window)
        return Electrodes(negative, positive, (x0, x1, y0, y1), 0.0)

    def off(window: FloatArray) -> FloatArray:
        return np.asarray(made(window).ocv(soc) - ocv_V)

    found = least_squares(off, start, bounds=(LOWEST_WINDOW, HIGHEST_WINDOW), max_nfev=60)
    misfit = float(np.sqrt(np.mean(found.fun**2)))
    return Electrodes(negative, positive, made(found.x).window, misfit)

r"""An OCV as the difference of two electrodes, and what it becomes when they have aged.

.. math:: OCV(z) = U_p(y_0 - z (y_0 - y_{100})) - U_n(x_0 + z (x_{100} - x_0)) + rest(z)

The window of each electrode is fitted to a model's OCV with published half cells; what they leave
stays as it is. A loss of lithium or of an electrode's material moves both windows: full and empty
are where the cell comes to the same voltages as before. Source: Dubarry et al. 2012,
10.1016/j.jpowsour.2012.07.016; Mohtat et al. 2019, 10.1016/j.jpowsour.2019.03.104.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, least_squares

from cellwise.typing import FloatArray

HalfCell = Callable[[FloatArray], FloatArray]


def graphite_silicon(x: FloatArray) -> FloatArray:
    """Graphite with 10 % SiOx: Chen et al. 2020, eq. 9, 10.1149/1945-7111/ab9050 [V]."""
    steps = -0.0909 * np.tanh(29.8538 * (x - 0.1234))
    steps = steps - 0.04478 * np.tanh(14.9159 * (x - 0.2769))
    steps = steps - 0.0205 * np.tanh(30.4444 * (x - 0.6103))
    return np.asarray(1.9793 * np.exp(-39.3631 * x) + 0.2482 + steps)


def graphite_mcmb(x: FloatArray) -> FloatArray:
    """Mesocarbon graphite MCMB 2528: Dualfoil, in Marquis et al. 2019, 10.1149/2.0341915jes [V]."""
    u = 0.194 + 1.5 * np.exp(-120.0 * x) + 0.0351 * np.tanh((x - 0.286) / 0.083)
    u = u - 0.0045 * np.tanh((x - 0.849) / 0.119) - 0.035 * np.tanh((x - 0.9233) / 0.05)
    u = u - 0.0147 * np.tanh((x - 0.5) / 0.034) - 0.102 * np.tanh((x - 0.194) / 0.142)
    u = u - 0.022 * np.tanh((x - 0.9) / 0.0164) - 0.011 * np.tanh((x - 0.124) / 0.0226)
    return np.asarray(u + 0.0155 * np.tanh((x - 0.105) / 0.029))


def graphite_stages(x: FloatArray) -> FloatArray:
    """Graphite with sharp stages: Mohtat et al. 2020, 10.1149/1945-7111/aba5d1 [V]."""
    u = 0.063 + 0.8 * np.exp(-75.0 * (x + 0.001)) - 0.0120 * np.tanh((x - 0.127) / 0.016)
    u = u - 0.0118 * np.tanh((x - 0.155) / 0.016) - 0.0035 * np.tanh((x - 0.220) / 0.020)
    u = u - 0.0095 * np.tanh((x - 0.190) / 0.013) - 0.0145 * np.tanh((x - 0.490) / 0.020)
    return np.asarray(u - 0.0800 * np.tanh((x - 1.030) / 0.055))


def nmc_811(y: FloatArray) -> FloatArray:
    """LiNi0.8Mn0.1Co0.1O2: Chen et al. 2020, eq. 8, 10.1149/1945-7111/ab9050 [V]."""
    u = -0.8090 * y + 4.4875 - 0.0428 * np.tanh(18.5138 * (y - 0.5542))
    u = u - 17.7326 * np.tanh(15.7890 * (y - 0.3117))
    return np.asarray(u + 17.5842 * np.tanh(15.9308 * (y - 0.3120)))


def nmc_532(y: FloatArray) -> FloatArray:
    """LiNi0.5Mn0.3Co0.2O2: Mohtat et al. 2020, 10.1149/1945-7111/aba5d1 [V]."""
    u = 4.3452 + y * (-1.6518 + y * (1.6225 + y * (-2.0843 + y * (3.5146 - 2.2166 * y))))
    return np.asarray(u - 0.5623e-4 * np.exp(109.451 * y - 100.006))


def nca(y: FloatArray) -> FloatArray:
    """LiNi0.8Co0.15Al0.05O2: Kim et al. 2011, table IV, 10.1149/1.3597614 [V]."""
    powers = (1.638, -2.222, 15.056, -23.488, 81.246, -344.566, 621.3475, -554.774, 264.427,
              -66.3691, 11.8058)  # fmt: skip
    return np.asarray(np.polyval(powers, y) - 0.61386 * np.exp(5.8201 * y**136.4))


def lco(y: FloatArray) -> FloatArray:
    """LiCoO2: Dualfoil, in Marquis et al. 2019, 10.1149/2.0341915jes [V]."""
    z = 1.062 * y
    u = 2.16216 + 0.07645 * np.tanh(30.834 - 54.4806 * z)
    u = u + 2.1581 * np.tanh(52.294 - 50.294 * z) - 0.14169 * np.tanh(11.0923 - 19.8543 * z)
    u = u + 0.2051 * np.tanh(1.4684 - 5.4888 * z) + 0.2531 * np.tanh((0.56478 - z) / 0.1316)
    return np.asarray(u - 0.02167 * np.tanh((z - 0.525) / 0.006))


def lfp(y: FloatArray) -> FloatArray:
    """LiFePO4: Afshar, Morris, Khajepour 2017, arXiv:1709.03970 [V]."""
    ends = 0.5 * np.exp(-150.0 * y) - 0.9 * np.exp(-30.0 * (1.0 - y))
    return np.asarray(3.4077 - 0.020269 * y + ends)


# With each the stoichiometry at SOC 0 and 1 that cells of its source have.
NEGATIVE: dict[str, tuple[HalfCell, tuple[float, float]]] = {
    "graphite": (graphite_mcmb, (0.10, 0.90)),
    "graphite, sharp stages": (graphite_stages, (0.01, 0.83)),
    "graphite with SiOx": (graphite_silicon, (0.03, 0.91)),
}
POSITIVE: dict[str, tuple[HalfCell, tuple[float, float]]] = {
    "NMC 811": (nmc_811, (0.85, 0.27)),
    "NMC 532": (nmc_532, (0.89, 0.05)),
    "NCA": (nca, (0.98, 0.34)),
    "LCO": (lco, (0.95, 0.50)),
    "LFP": (lfp, (0.70, 0.01)),
}


class Windows(NamedTuple):
    """How half cells are fitted to an OCV.

    ``most_misfit_V``: samples of one chemistry lie so far apart, half cells that leave more are of
    another one. ``soc``: between which they are fitted, since the steep ends say little about the
    windows and much about how they were measured. ``least_capacity``: share of the old one that is
    held at least, where losses leave no window. ``low`` and ``high`` bound x_0, x_100, y_0, y_100.
    """

    most_misfit_V: float = 0.010
    soc: tuple[float, float] = (0.03, 0.98)
    least_capacity: float = 1e-3
    low: tuple[float, ...] = (0.0, 0.5, 0.56, 0.0)
    high: tuple[float, ...] = (0.3, 1.0, 1.0, 0.55)


WINDOWS = Windows()


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
        return change, max(held, WINDOWS.least_capacity)

    def _between(self, soc: FloatArray, window: tuple[float, float, float, float]) -> FloatArray:
        x0, x1, y0, y1 = window
        u_n, u_p = NEGATIVE[self.negative][0], POSITIVE[self.positive][0]
        return u_p(y0 + soc * (y1 - y0)) - u_n(x0 + soc * (x1 - x0))


@lru_cache(maxsize=256)
def _aged_window(
    electrodes: Electrodes, lithium: float, negative: float, positive: float
) -> tuple[float, float, float, float]:
    """Windows after losses (shares)."""
    before = electrodes.capacities
    q_n, q_p = before[0] * (1.0 - negative), before[1] * (1.0 - positive)
    left = electrodes.lithium * (1.0 - lithium)
    u_n, u_p = NEGATIVE[electrodes.negative][0], POSITIVE[electrodes.positive][0]

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
    used = (z >= WINDOWS.soc[0]) & (z <= WINDOWS.soc[1])
    z, v = z[used], v[used]
    best: Electrodes | None = None
    for negative in NEGATIVE:
        for positive in POSITIVE:
            found = _fitted(z, v, negative, positive)
            if best is None or found.misfit_V < best.misfit_V:
                best = found
    return best if best is not None and best.misfit_V <= WINDOWS.most_misfit_V else None


def _fitted(soc: FloatArray, ocv_V: FloatArray, negative: str, positive: str) -> Electrodes:
    """Windows that come nearest to an OCV."""
    start = (*NEGATIVE[negative][1], *POSITIVE[positive][1])

    def made(window: FloatArray) -> Electrodes:
        x0, x1, y0, y1 = (float(w) for w in window)
        return Electrodes(negative, positive, (x0, x1, y0, y1), 0.0)

    def off(window: FloatArray) -> FloatArray:
        return np.asarray(made(window).ocv(soc) - ocv_V)

    found = least_squares(off, start, bounds=(WINDOWS.low, WINDOWS.high), max_nfev=60)
    misfit = float(np.sqrt(np.mean(found.fun**2)))
    return Electrodes(negative, positive, made(found.x).window, misfit)

"""Published open-circuit potentials of electrodes over how far they are filled with lithium.

Each is the fit of its source, against lithium at 25 degC, over the stoichiometry 0..1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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

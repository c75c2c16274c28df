"""What a pulse fit returns: parameters, their standard errors, and what is identified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

IDENTIFIED = 0.3  # standard error over value, up to which a parameter is known


class PulseParameters(NamedTuple):
    """Six numbers, one per parameter of a pulse; values, errors or flags alike.

    Resistances [ohm], time constants [s], OCV at the pulse's mean SOC [V].
    """

    r0_ohm: float
    r1_ohm: float
    tau1_s: float
    r2_ohm: float
    tau2_s: float
    ocv_V: float


@dataclass(frozen=True)
class PulseFit:
    """Parameters of one pulse at its mean SOC, by whatever method; ``r0_ohm`` is its value's.

    Parameters
    ----------
    method : str              ``varpro``, ``segments`` or ``pso``
    soc : float               mean SOC of the pulse [0..1]
    current_A : float         mean current of the pulse [A], positive = discharge
    duration_s : float        of the pulse [s]
    value : PulseParameters
    error : PulseParameters   standard error of each; inf where the data do not show it, NaN where
                              the method has none
    rmse_V : float            weighted root mean square of the residual [V]
    rows : int                rows of the window that were compared
    at_bound : tuple of str   parameters that ended at a bound
    """

    method: str
    soc: float
    current_A: float
    duration_s: float
    value: PulseParameters
    error: PulseParameters
    rmse_V: float
    rows: int
    at_bound: tuple[str, ...] = ()

    def __getattr__(self, name: str) -> float:
        if name in PulseParameters._fields:
            return float(getattr(self.value, name))
        raise AttributeError(name)

    @property
    def c1_F(self) -> float:
        """Capacitance of the fast branch, tau1 / R1 [F]; inf without such a branch."""
        return self.tau1_s / self.r1_ohm if self.r1_ohm > 0.0 else float("inf")

    @property
    def c2_F(self) -> float:
        """Capacitance of the slow branch, tau2 / R2 [F]; inf without such a branch."""
        return self.tau2_s / self.r2_ohm if self.r2_ohm > 0.0 else float("inf")

    @property
    def identified(self) -> PulseParameters:
        """Whether each parameter is known well enough to enter a table (1.0) or not (0.0).

        Not when it sits at a bound, when its standard error is above three tenths of it, or when it
        has none (the time constants of ``segments``).
        """
        known = [
            float(np.isfinite(error) and error <= IDENTIFIED * abs(x) and n not in self.at_bound)
            for n, x, error in zip(self.value._fields, self.value, self.error, strict=True)
        ]
        return PulseParameters(*known)

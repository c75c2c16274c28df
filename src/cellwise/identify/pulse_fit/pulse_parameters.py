"""What a pulse fit returns: parameters, their standard errors, and what is identified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class _Identified(NamedTuple):
    """Standard errors of what is identified: a part of its value; of an OCV slope V per SOC."""

    part: float = 0.3
    slope_V: float = 0.3


IDENTIFIED = _Identified()


class PulseParameters(NamedTuple):
    """Seven numbers, one per parameter of a pulse; values, errors or flags alike.

    Resistances [ohm], time constants [s], OCV at the pulse's mean SOC [V], its slope [V per unit
    SOC].
    """

    r0_ohm: float
    r1_ohm: float
    tau1_s: float
    r2_ohm: float
    tau2_s: float
    ocv_V: float
    ocv_slope_V: float


@dataclass(frozen=True)
class PulseFit:
    """Parameters of one pulse at its mean SOC, by whatever method; ``r0_ohm`` is its value's.

    Parameters
    ----------
    method : str              ``varpro``, ``segments`` or ``pso``
    soc : float               mean SOC of the pulse [0..1]; NaN if unknown
    current_A : float         mean current of the pulse [A], positive = discharge
    duration_s : float        length of the pulse [s]
    value : PulseParameters   the parameters
    error : PulseParameters   standard error of each; inf where the data do not show it, NaN where
                              the method has none
    rmse_V : float            weighted root mean square of the residual [V]
    noise_V : float           root mean square of the residual over all rows that were used [V]
    rows, left_out : int      rows of the window; rows left out while the voltage settled
    rows_per_residual : float     rows that share one independent residual [-], 1 for white noise
    at_bound : tuple of str   parameters that ended at a bound
    """

    method: str
    soc: float
    current_A: float
    duration_s: float
    value: PulseParameters
    error: PulseParameters
    rmse_V: float
    noise_V: float
    rows: int
    left_out: int = 0
    rows_per_residual: float = 1.0
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

        Not when it sits at a bound, when its standard error is above three tenths of it, or
        when it has none (the time constants of ``segments``). A fitted OCV slope counts only with
        a known tau2: a slow branch that the window does not see passes for slope.
        """
        flags = {}
        for name, value, error in zip(self.value._fields, self.value, self.error, strict=True):
            limit = IDENTIFIED.part * abs(value)
            if name == "ocv_slope_V":
                limit = max(limit, IDENTIFIED.slope_V)
            flags[name] = bool(np.isfinite(error)) and error <= limit and name not in self.at_bound
        if self.error.ocv_slope_V > 0.0:
            flags["ocv_slope_V"] = flags["ocv_slope_V"] and flags["tau2_s"]
        return PulseParameters(**{name: float(flag) for name, flag in flags.items()})

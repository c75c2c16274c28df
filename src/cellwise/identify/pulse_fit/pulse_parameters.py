"""What a pulse fit returns: parameters, their standard errors, and what is identified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

# A resistance or time constant is called identified when its standard error is below this part
# of its value, an OCV slope when it is below this many volts per unit SOC.
IDENTIFIED_PART = 0.3
IDENTIFIED_SLOPE_V = 0.3


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
    """Parameters of one pulse at its mean SOC, by whatever method.

    Parameters
    ----------
    method : str              ``varpro``, ``segments`` or ``pso``
    soc : float               mean SOC of the pulse [0..1]; NaN if unknown
    current_A : float         mean current of the pulse [A], positive = discharge
    duration_s, window_s : float      length of the pulse, and of all rows [s]
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
    window_s: float
    value: PulseParameters
    error: PulseParameters
    rmse_V: float
    noise_V: float
    rows: int
    left_out: int = 0
    rows_per_residual: float = 1.0
    at_bound: tuple[str, ...] = ()

    @property
    def r0_ohm(self) -> float:
        """Ohmic resistance [ohm]."""
        return self.value.r0_ohm

    @property
    def r1_ohm(self) -> float:
        """Resistance of the fast branch [ohm]."""
        return self.value.r1_ohm

    @property
    def tau1_s(self) -> float:
        """Time constant of the fast branch [s]."""
        return self.value.tau1_s

    @property
    def r2_ohm(self) -> float:
        """Resistance of the slow branch [ohm]."""
        return self.value.r2_ohm

    @property
    def tau2_s(self) -> float:
        """Time constant of the slow branch [s]."""
        return self.value.tau2_s

    @property
    def ocv_V(self) -> float:
        """Open-circuit voltage at the pulse's mean SOC [V]."""
        return self.value.ocv_V

    @property
    def ocv_slope_V(self) -> float:
        """Slope of the OCV at the pulse's mean SOC [V per unit SOC]."""
        return self.value.ocv_slope_V

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

        Not when it sits at a bound, when its standard error is above `IDENTIFIED_PART` of it, or
        when it has none (the time constants of ``segments``). A fitted OCV slope counts only with
        a known tau2: a slow branch that the window does not see passes for slope.
        """
        flags = {}
        for name, value, error in zip(self.value._fields, self.value, self.error, strict=True):
            limit = IDENTIFIED_PART * abs(value)
            if name == "ocv_slope_V":
                limit = max(limit, IDENTIFIED_SLOPE_V)
            flags[name] = bool(np.isfinite(error)) and error <= limit and name not in self.at_bound
        if self.error.ocv_slope_V > 0.0:
            flags["ocv_slope_V"] = flags["ocv_slope_V"] and flags["tau2_s"]
        return PulseParameters(**{name: float(flag) for name, flag in flags.items()})

    @property
    def notices(self) -> tuple[str, ...]:
        """What a person should know before using the numbers."""
        lines = []
        for name, value, error, known in zip(
            self.value._fields, self.value, self.error, self.identified, strict=True
        ):
            if known or name == "ocv_V" or np.isnan(error):
                continue
            symbol, unit = name.rsplit("_", 1)
            why = "at its bound" if name in self.at_bound else f"+- {error:.3g}"
            lines.append(
                f"{symbol} = {value:.3g} {unit} ({why}) is not seen by a pulse of "
                f"{self.duration_s:.3g} s in a window of {self.window_s:.4g} s"
            )
        if self.left_out:
            lines.append(f"{self.left_out} rows left out while the voltage settled after an edge")
        return tuple(lines)

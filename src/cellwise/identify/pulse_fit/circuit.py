r"""A pulse window as a circuit with two branches: its parameters, and what a fit of it leaves.

.. math::

    v = OCV - R_0 I - R_1 u_1 - R_2 u_2

with u_j the response of a branch of one ohm, exact for current that is constant over an interval.
A tabulated OCV keeps a pulse at the ends of the SOC range from bending tau2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.equations.states import decay, relaxed
from cellwise.errors import InputError
from cellwise.fit.problem import independent_samples
from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.typing import FloatArray

# Sampling intervals closer than this share one exponential: float64 stamps of a log that runs
# for days jitter in the last digits.
SAME_INTERVAL = 1e-7
FASTEST_S = 0.5  # a pulse is searched down to it, where sampling allows
FOLD = 1e-3  # of ln tau, for a derivative
IDENTIFIED = 0.3  # standard error over value, up to which a parameter is known
APART = 1.5  # ratio of neighbouring time constants, at least
FEWEST_ROWS = 10  # that count, for six unknowns


class PulseParameters(NamedTuple):
    """Six numbers, one per parameter of a pulse; values, errors or flags alike.

    ``r0_ohm``, ``r1_ohm``, ``r2_ohm`` [ohm], ``tau1_s``, ``tau2_s`` [s], ``ocv_V`` at the pulse's
    mean SOC [V].
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


class TauBounds(NamedTuple):
    """Search range of the time constants [s].

    ``ratio`` keeps the branches apart: tau2 >= ratio * tau1, so they can never be swapped.
    """

    fastest_s: float
    slowest_s: float
    ratio: float = APART


class Circuit:
    """One window, ready to be fitted.

    ``known`` (n,) is the voltage without what the tabulated OCV moved from the pulse's mean SOC
    [V], ``weight`` (n,) that of each row.

    Raises
    ------
    InputError        fewer rows that count than unknowns
    """

    def __init__(self, data: PulseData) -> None:
        self.data, self.weight = data, data.weight
        settled = np.count_nonzero(self.weight)
        if settled < FEWEST_ROWS:
            raise InputError(
                f"{settled} settled rows of {data.time_s.size} in pulse '{data.name}'",
                f"at least {FEWEST_ROWS} rows for 6 unknowns",
                "Log the pulse faster or longer, or leave it out.",
            )
        self.dt_s, self.current_A = data.interval_s, data.current_A
        order = np.argsort(data.soc, kind="stable")
        middle_V = np.interp(data.mean_soc, data.soc[order], data.ocv_V[order])
        self.known = data.voltage_V - data.ocv_V + middle_V

    def responses(self, tau_s: FloatArray) -> FloatArray:
        """Voltage of branches of one ohm [V], shape (tau, n)."""
        response = np.empty((tau_s.size, self.dt_s.size))
        respond(self.dt_s, self.current_A, tau_s, response)
        return response

    def tau_bounds(self) -> TauBounds:
        """Time constants that the window can show.

        From two sampling intervals (at most half a second, where sampling allows) to the time
        from the pulse's start to the window's end, or twice the pulse where no relaxation follows.
        """
        data = self.data
        sampling = float(np.median(self.dt_s[data.start : data.stop]))
        fastest = max(min(2.0 * sampling, FASTEST_S), 0.5 * sampling, 1e-3)
        seen = float(data.time_s[-1] - data.time_s[max(data.start - 1, 0)])
        return TauBounds(fastest, max(seen, 2.0 * data.pulse_duration_s, 4.0 * fastest))

    def rmse_V(self, value: PulseParameters) -> float:
        """Weighted root mean square of the residual [V]."""
        return float(np.sqrt(np.average(self._residual_V(value) ** 2, weights=self.weight)))

    def _residual_V(self, value: PulseParameters) -> FloatArray:
        """Measured minus modelled voltage [V], shape (n,)."""
        u1, u2 = self.responses(np.array([value.tau1_s, value.tau2_s]))
        model = value.ocv_V - value.r0_ohm * self.current_A - value.r1_ohm * u1 - value.r2_ohm * u2
        return np.asarray(self.known - model)

    def described(
        self, method: str, value: PulseParameters, free: Sequence[str], at_bound: Sequence[str]
    ) -> PulseFit:
        """A fit with its residual and the standard errors of the ``free`` parameters.

        The noise is equal in all rows, whatever weight they have, and as many rows count as
        residuals are independent. A time constant whose branch has no resistance is not seen: inf.
        What was not free: 0.
        """
        used = self.weight > 0.0
        root = np.sqrt(self.weight[used])
        residual = self._residual_V(value)[used]
        jacobian = self._jacobian(value)[used] * root[:, None]
        names = value._fields
        shown = [k for k, n in enumerate(names) if n in free and np.any(jacobian[:, k])]
        size = np.linalg.norm(jacobian[:, shown], axis=0)
        inverse = np.linalg.pinv(jacobian[:, shown] / size) / size[:, None]
        variance = float(residual @ residual) / max(residual.size - len(free), 1)
        variance *= residual.size / independent_samples(root * residual)
        error = np.array([np.inf if n in free else 0.0 for n in names])
        error[shown] = np.sqrt(variance) * np.linalg.norm(inverse * root, axis=1)
        return PulseFit(
            method=method,
            soc=self.data.mean_soc,
            current_A=self.data.pulse_current_A,
            duration_s=self.data.pulse_duration_s,
            value=value,
            error=PulseParameters(*error.tolist()),
            rmse_V=self.rmse_V(value),
            rows=used.size - self.data.first,
            at_bound=tuple(at_bound),
        )

    def _jacobian(self, value: PulseParameters) -> FloatArray:
        """Change of the modelled voltage with each parameter, shape (n, 6)."""
        tau, fold = np.array([value.tau1_s, value.tau2_s]), np.exp(FOLD)
        u1, u2, up1, up2, down1, down2 = self.responses(
            np.concatenate((tau, tau * fold, tau / fold))
        )
        per_s = 1.0 / (2.0 * FOLD * tau)
        return np.column_stack(
            (
                -self.current_A,
                -u1,
                value.r1_ohm * per_s[0] * (down1 - up1),
                -u2,
                value.r2_ohm * per_s[1] * (down2 - up2),
                np.ones(u1.size),
            )
        )


@cached()
def respond(dt_s: FloatArray, current_A: FloatArray, tau_s: FloatArray, out_V: FloatArray) -> None:
    """Voltage of branches of one ohm [V], result of shape (tau, n)."""
    for j in range(tau_s.size):
        u = a = 0.0
        last = -1.0
        for k in range(dt_s.size):
            if abs(dt_s[k] - last) > SAME_INTERVAL * dt_s[k]:
                last = dt_s[k]
                a = decay(last, tau_s[j])
            u = relaxed(u, a, 1.0 - a, current_A[k])
            out_V[j, k] = u

r"""A pulse window as a circuit with two branches, and what a fit of it leaves.

.. math::

    v = OCV + s x - R_0 I - R_1 u_1 - R_2 u_2

with x the SOC minus the pulse's mean SOC and u_j the response of a branch of one ohm, exact for
current that is constant over an interval. The slope s is what keeps a pulse at the ends of the SOC
range from bending tau2; a tabulated OCV takes its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.equations.states import decay, relaxed
from cellwise.errors import InputError
from cellwise.identify.pulse_fit.pulse_data import (
    ROWS,
    PulseData,
    row_weights,
)
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseParameters
from cellwise.identify.refinement.problem import independent_samples
from cellwise.typing import FloatArray

# Sampling intervals closer than this share one exponential: float64 stamps of a log that runs
# for days jitter in the last digits.
SAME_INTERVAL = 1e-7


class _Numerics(NamedTuple):
    """Time constants that are searched, and what rounding allows."""

    fastest_s: float = 0.5  # a pulse is searched down to it, where sampling allows
    step: float = 1e-3  # of ln tau, for a derivative
    eigenvalue: float = 1e-15  # of the scaled normal equations: below is rounding
    ridge: float = 1e-13  # of them: two branches may be alike
    at_bound: float = 1e-3  # of the range of ln tau


NUMERICS = _Numerics()


class TauBounds(NamedTuple):
    """Search range of the time constants [s].

    ``ratio`` keeps the branches apart: tau2 >= ratio * tau1, so they can never be swapped.
    """

    fastest_s: float
    slowest_s: float
    ratio: float = 1.5


class Circuit:
    """One window, ready to be fitted.

    ``known`` (n,) is the voltage without what a tabulated OCV says that the OCV moved from the
    pulse's mean SOC [V], ``table_slope_V`` the table's slope over the pulse (None without one),
    ``weight`` (n,) that of each row, ``x`` (n,) the SOC minus the pulse's mean SOC.

    Raises
    ------
    InputError        fewer rows that count than unknowns
    """

    def __init__(self, data: PulseData) -> None:
        self.data = data
        self.weight = row_weights(data)
        settled = np.count_nonzero(self.weight)
        if settled < ROWS.settled:
            raise InputError(
                f"{settled} settled rows of {len(data)} in pulse '{data.name}'",
                f"at least {ROWS.settled} rows for 7 unknowns",
                "Log the pulse faster or longer, or leave it out.",
            )
        self.dt_s, self.current_A = data.interval_s, data.current_A.copy()
        self.x = data.pulse_centre - data.charge_fraction
        self.known, self.table_slope_V = data.voltage_V, None
        change = data.ocv_change_V
        if change is not None:
            order = np.argsort(self.x, kind="stable")
            self.known = data.voltage_V - change + np.interp(0.0, self.x[order], change[order])
            edges = [max(data.start - 1, 0), data.stop - 1]
            moved = float(np.diff(self.x[edges])[0])
            self.table_slope_V = float(np.diff(change[edges])[0]) / moved if moved else 0.0

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
        fastest = max(min(2.0 * sampling, NUMERICS.fastest_s), 0.5 * sampling, 1e-3)
        seen = float(data.time_s[-1] - data.time_s[max(data.start - 1, 0)])
        return TauBounds(fastest, max(seen, 2.0 * data.pulse_duration_s, 4.0 * fastest))

    def residual_V(self, value: PulseParameters) -> FloatArray:
        """Measured minus modelled voltage [V], shape (n,)."""
        u1, u2 = self.responses(np.array([value.tau1_s, value.tau2_s]))
        slope = value.ocv_slope_V if self.table_slope_V is None else 0.0
        model = value.ocv_V + slope * self.x - value.r0_ohm * self.current_A
        return np.asarray(self.known - model + value.r1_ohm * u1 + value.r2_ohm * u2)

    def rmse_V(self, value: PulseParameters) -> float:
        """Weighted root mean square of the residual [V]."""
        return float(np.sqrt(np.average(self.residual_V(value) ** 2, weights=self.weight)))

    def described(
        self, method: str, value: PulseParameters, free: Sequence[str], at_bound: Sequence[str]
    ) -> PulseFit:
        """A fit with its residual and the standard errors of the ``free`` parameters.

        With A = J'WJ and the noise equal in all rows, cov = s^2 m A^-1 (J'W^2 J) A^-1; s^2 is the
        residual variance and m the rows that share one independent residual. A time constant whose
        branch has no resistance is not seen: inf. What was not free: 0.
        """
        used = self.weight > 0.0
        weight, residual = self.weight[used], self.residual_V(value)[used]
        noise = float(np.sqrt(np.sum(residual**2) / max(residual.size - len(free), 1)))
        memory = residual.size / independent_samples(np.sqrt(weight) * residual)
        jacobian = self._jacobian(value)
        shown = [name for name in free if np.any(jacobian[name] != 0.0)]
        columns = np.column_stack([jacobian[name][used] for name in shown])
        scale = np.sqrt(weight @ columns**2)
        columns /= scale
        size, vectors = np.linalg.eigh(columns.T @ (weight[:, None] * columns))
        inverse = (vectors / np.maximum(size, NUMERICS.eigenvalue * size[-1])) @ vectors.T
        spread = inverse @ (columns.T @ (weight[:, None] ** 2 * columns)) @ inverse
        std = noise * np.sqrt(memory * np.maximum(np.diag(spread), 0.0)) / scale
        error = {name: np.inf if name in free else 0.0 for name in PulseParameters._fields}
        error.update(zip(shown, std.tolist(), strict=True))
        data = self.data
        return PulseFit(
            method=method,
            soc=data.soc,
            current_A=data.pulse_current_A,
            duration_s=data.pulse_duration_s,
            value=value,
            error=PulseParameters(**error),
            rmse_V=self.rmse_V(value),
            noise_V=noise,
            rows=len(data) - data.first,
            left_out=int(np.count_nonzero(~used[data.first :])),
            rows_per_residual=memory,
            at_bound=tuple(at_bound),
        )

    def _jacobian(self, value: PulseParameters) -> dict[str, FloatArray]:
        """Change of the modelled voltage with each parameter, shape (n,) each."""
        tau = np.array([value.tau1_s, value.tau2_s])
        fold = np.exp(NUMERICS.step)
        u1, u2, up1, up2, down1, down2 = self.responses(
            np.concatenate((tau, tau * fold, tau / fold))
        )
        per_s = 1.0 / (2.0 * NUMERICS.step * tau)
        return {
            "r0_ohm": -self.current_A,
            "r1_ohm": -u1,
            "tau1_s": value.r1_ohm * per_s[0] * (down1 - up1),
            "r2_ohm": -u2,
            "tau2_s": value.r2_ohm * per_s[1] * (down2 - up2),
            "ocv_V": np.ones(self.x.size),
            "ocv_slope_V": self.x,
        }


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

"""Simulated voltage and its analytic sensitivities over one log, in one pass of scalar code.

SOC is known here (the tester's counter), so the look-ups do not depend on the parameters and
every sensitivity obeys the branch's own recursion with a source at the knots that are active:

    v'  = a v + R (1 - a) I
    S'  = a S + B R (1 - a) I            with respect to the spline coefficients of ln R
    S'  = a S + B a x (v - R I)          with respect to those of ln tau, x = dt / tau
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from cellwise.typing import BoolArray, FloatArray

SUPPORT = 4  # cubic B-splines: four are active at any SOC


class Layout(NamedTuple):
    """Where each parameter stands in the vector; every block but the OCV's has ``knots`` entries.

    ``ocv`` entries 0..knots_ocv; then ln R0; then (ln R, ln tau) per branch; then M and ln gamma
    (when ``hysteresis``), activation [K / 1000], skew [s / 10].
    """

    knots_ocv: int
    knots: int
    branches: int
    hysteresis: bool

    @property
    def r0(self) -> int:
        """First coefficient of ln R0."""
        return self.knots_ocv

    def r(self, branch: int) -> int:
        """First coefficient of ln R of a branch, 0-based."""
        return self.knots_ocv + self.knots * (1 + 2 * branch)

    def tau(self, branch: int) -> int:
        """First coefficient of ln tau of a branch, 0-based."""
        return self.r(branch) + self.knots

    @property
    def m(self) -> int:
        """First coefficient of the hysteresis voltage M."""
        return self.r(self.branches)

    @property
    def gamma(self) -> int:
        """Ln of the hysteresis rate."""
        return self.m + self.knots

    @property
    def activation(self) -> int:
        """Arrhenius activation in units of ACTIVATION_UNIT_K."""
        return self.m + (self.knots + 1 if self.hysteresis else 0)

    @property
    def skew(self) -> int:
        """Sampling delay in units of SKEW_UNIT_S."""
        return self.activation + 1

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.skew + 1


ACTIVATION_UNIT_K = 1000.0
SKEW_UNIT_S = 0.1


@njit(cache=True, error_model="numpy", nogil=True)
def voltage_and_jacobian(
    dt_s: FloatArray,
    current_A: FloatArray,
    inverse_K: FloatArray,
    charge_As: float,
    h0: float,
    skewed: bool,
    first: FloatArray,
    basis: FloatArray,
    ocv_first: FloatArray,
    ocv_basis: FloatArray,
    base_ocv_V: FloatArray,
    theta: FloatArray,
    knots_ocv: int,
    knots: int,
    branches: int,
    hysteresis: bool,
    evaluate: BoolArray,
    jacobian: FloatArray,
    voltage_V: FloatArray,
) -> None:
    """Fill ``voltage_V`` (rows,) and ``jacobian`` (evaluated rows, parameters)."""
    o_r0 = knots_ocv
    o_m = knots_ocv + knots * (1 + 2 * branches)
    o_gamma = o_m + knots
    o_act = o_m + (knots + 1 if hysteresis else 0)
    o_skew = o_act + 1
    activation = theta[o_act] * ACTIVATION_UNIT_K
    skew = theta[o_skew] * SKEW_UNIT_S if skewed else 0.0
    gamma = math.exp(theta[o_gamma]) if hysteresis else 0.0
    v = np.zeros(branches)
    sens = np.zeros((2 * branches, knots))
    sens_act = np.zeros(branches)
    sens_skew = np.zeros(branches)
    h = h0
    h_gamma = 0.0
    h_skew = 0.0
    previous = current_A[0]
    out = 0
    for k in range(dt_s.size):
        dt = dt_s[k]
        now = current_A[k]
        slope = 0.0
        seen = now
        if skewed and dt > 0.0:
            w = min(skew / dt, 1.0)
            seen = now + w * (previous - now)
            slope = (previous - now) / dt * SKEW_UNIT_S if w < 1.0 else 0.0
        previous = now
        scale = math.exp(activation * inverse_K[k])
        dscale = inverse_K[k] * ACTIVATION_UNIT_K
        f = first[k]
        total = 0.0
        for j in range(branches):
            o_r = knots_ocv + knots * (1 + 2 * j)
            o_t = o_r + knots
            ln_r = 0.0
            ln_tau = 0.0
            for q in range(SUPPORT):
                ln_r += basis[k, q] * theta[o_r + f + q]
                ln_tau += basis[k, q] * theta[o_t + f + q]
            r = scale * math.exp(ln_r)
            x = dt / math.exp(ln_tau)
            a = math.exp(-x)
            gain = r * (1.0 - a)
            by_tau = a * x * (v[j] - r * seen)
            if a < 1.0:
                for q in range(knots):
                    sens[2 * j, q] *= a
                    sens[2 * j + 1, q] *= a
            for q in range(SUPPORT):
                sens[2 * j, f + q] += basis[k, q] * gain * seen
                sens[2 * j + 1, f + q] += basis[k, q] * by_tau
            sens_act[j] = a * sens_act[j] + gain * seen * dscale
            sens_skew[j] = a * sens_skew[j] + gain * slope
            v[j] = a * v[j] + gain * seen
            total += v[j]
        ln_r0 = 0.0
        ocv = base_ocv_V[k]
        m = 0.0
        for q in range(SUPPORT):
            ln_r0 += basis[k, q] * theta[o_r0 + f + q]
            ocv += ocv_basis[k, q] * theta[ocv_first[k] + q]
            if hysteresis:
                m += basis[k, q] * theta[o_m + f + q]
        r0 = scale * math.exp(ln_r0)
        if hysteresis:
            x = gamma * abs(seen) * dt / charge_As
            a = math.exp(-x)
            sign = math.copysign(1.0, seen)
            h_gamma = a * h_gamma - x * a * (h + sign)
            h_skew = a * h_skew - gamma * sign * slope * dt / charge_As * a * (h + sign)
            h = a * (h + sign) - sign
        voltage_V[k] = ocv - r0 * seen - total + m * h
        if evaluate[k]:
            row = jacobian[out]
            row[:] = 0.0
            for q in range(SUPPORT):
                row[ocv_first[k] + q] = ocv_basis[k, q]
                row[o_r0 + f + q] = -basis[k, q] * r0 * seen
                if hysteresis:
                    row[o_m + f + q] = basis[k, q] * h
            act = -r0 * seen * dscale
            skw = -r0 * slope
            for j in range(branches):
                o_r = knots_ocv + knots * (1 + 2 * j)
                for q in range(knots):
                    row[o_r + q] = -sens[2 * j, q]
                    row[o_r + knots + q] = -sens[2 * j + 1, q]
                act -= sens_act[j]
                skw -= sens_skew[j]
            if hysteresis:
                row[o_gamma] = m * h_gamma
                skw += m * h_skew
            row[o_act] = act
            row[o_skew] = skw
            out += 1


@njit(cache=True, error_model="numpy")
def choose_rows(
    time_s: FloatArray,
    current_A: FloatArray,
    threshold_A: float,
    shortest_s: float,
    growth: float,
    keep: BoolArray,
    evaluate: BoolArray,
) -> None:
    """Mark the rows to keep and those to compare with the measurement.

    Compared rows lie evenly on the logarithm of the time since the last change of current
    (at least ``shortest_s`` apart, then ``growth`` times that time), so that hours of rest do not
    outvote seconds of pulse. Between them only rows at which the current changes are kept: merging
    rows of equal current loses nothing, because the branches are solved exactly.
    """
    kept = 0
    edge_s = time_s[0]
    compared_s = time_s[0]
    keep[0] = True
    evaluate[0] = True
    for k in range(1, time_s.size):
        if abs(current_A[k] - current_A[kept]) > threshold_A:
            keep[k - 1] = True
            keep[k] = True
            kept = k
            edge_s = time_s[k - 1]
        spacing = max(shortest_s, growth * (time_s[k] - edge_s))
        if time_s[k] - compared_s >= spacing:
            evaluate[k] = True
            keep[k] = True
            compared_s = time_s[k]
    keep[-1] = True

"""Simulated voltage and its analytic sensitivities over one log, in one pass of scalar code.

SOC is known here (the tester's counter), so the look-ups do not depend on the parameters and
every sensitivity obeys the branch's own recursion with a source at the knots that are active:

    v'  = rc_step(v, I, R, tau, dt)
    S'  = dv'/dv S + B R dv'/dR          with respect to the spline coefficients of ln R
    S'  = dv'/dv S + B tau dv'/dtau      with respect to those of ln tau

The equations are those of the cell, their derivatives are printed from them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from cellwise.cell.equations import (
    hysteresis_decay,
    hysteresis_step,
    loaded_voltage,
    polarisation,
    rc_step,
    seen_current,
    thermal_factor,
)
from cellwise.cell.point_kernels import CellScalars
from cellwise.identify.refinement.derivative_kernels import (
    branch_partials,
    hysteresis_partials,
    seen_partials,
    thermal_partials,
    voltage_partials,
)
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


def scalars_of(layout: Layout, theta: FloatArray, charge_As: float, *, skewed: bool) -> CellScalars:
    """Scalars of a parameter vector; ``skewed`` logs have its sampling delay, others none."""
    plain = CellScalars(*(0.0 for _ in CellScalars._fields))
    return plain._replace(
        charge_As=charge_As,
        charge_efficiency=1.0,
        charge_scale=1.0,
        activation_K=float(theta[layout.activation]) * ACTIVATION_UNIT_K,
        hysteresis_rate=math.exp(theta[layout.gamma]) if layout.hysteresis else 0.0,
        skew_s=float(theta[layout.skew]) * SKEW_UNIT_S if skewed else 0.0,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def voltage_and_jacobian(
    dt_s: FloatArray,
    current_A: FloatArray,
    inverse_K: FloatArray,
    cell: CellScalars,
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
    """Fill ``voltage_V`` (rows,) and ``jacobian`` (evaluated rows, parameters).

    ``cell`` are the scalars of ``theta``, see :func:`scalars_of`.
    """
    o_r0 = knots_ocv
    o_m = knots_ocv + knots * (1 + 2 * branches)
    o_gamma = o_m + knots
    o_act = o_m + (knots + 1 if hysteresis else 0)
    o_skew = o_act + 1
    v = np.zeros(3)
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
        seen = seen_current(cell, current_A[k], previous, dt)
        slope = 0.0
        if skewed:
            slope = seen_partials(cell, current_A[k], previous, dt).seen_by_skew_s * SKEW_UNIT_S
        previous = current_A[k]
        scale = thermal_factor(cell.activation_K, inverse_K[k])
        thermal = thermal_partials(cell.activation_K, inverse_K[k])
        dscale = thermal.factor_by_activation_K * ACTIVATION_UNIT_K
        f = first[k]
        for j in range(branches):
            o_r = knots_ocv + knots * (1 + 2 * j)
            o_t = o_r + knots
            ln_r = 0.0
            ln_tau = 0.0
            for q in range(SUPPORT):
                ln_r += basis[k, q] * theta[o_r + f + q]
                ln_tau += basis[k, q] * theta[o_t + f + q]
            warm_r = math.exp(ln_r)
            r = warm_r * scale
            tau = math.exp(ln_tau)
            by = branch_partials(v[j], seen, r, tau, dt)
            by_ln_r = by.new_by_r_ohm * r
            by_ln_tau = by.new_by_tau_s * tau
            left = by.new_by_v_V
            if left < 1.0:
                for q in range(knots):
                    sens[2 * j, q] *= left
                    sens[2 * j + 1, q] *= left
            for q in range(SUPPORT):
                sens[2 * j, f + q] += basis[k, q] * by_ln_r
                sens[2 * j + 1, f + q] += basis[k, q] * by_ln_tau
            sens_act[j] = left * sens_act[j] + by.new_by_r_ohm * warm_r * dscale
            sens_skew[j] = left * sens_skew[j] + by.new_by_current_A * slope
            v[j] = rc_step(v[j], seen, r, tau, dt)
        ln_r0 = 0.0
        ocv = base_ocv_V[k]
        m = 0.0
        for q in range(SUPPORT):
            ln_r0 += basis[k, q] * theta[o_r0 + f + q]
            ocv += ocv_basis[k, q] * theta[ocv_first[k] + q]
            if hysteresis:
                m += basis[k, q] * theta[o_m + f + q]
        warm_r0 = math.exp(ln_r0)
        r0 = warm_r0 * scale
        if hysteresis:
            of_h = hysteresis_partials(cell, h, seen, dt)
            by_ln_rate = of_h.new_by_hysteresis_rate * cell.hysteresis_rate
            h_gamma = of_h.new_by_h * h_gamma + by_ln_rate
            h_skew = of_h.new_by_h * h_skew + of_h.new_by_current_A * slope
            h = hysteresis_step(h, hysteresis_decay(cell, seen, dt), seen)
        drop = polarisation(r0, seen, v[0], v[1], v[2])
        voltage_V[k] = loaded_voltage(ocv, m, h, drop)
        if evaluate[k]:
            of = voltage_partials(ocv, m, h, r0, seen, v[0], v[1], v[2])
            by_branch = of.voltage_by_v1_V  # all of them alike
            row = jacobian[out]
            row[:] = 0.0
            for q in range(SUPPORT):
                row[ocv_first[k] + q] = of.voltage_by_ocv_V * ocv_basis[k, q]
                row[o_r0 + f + q] = basis[k, q] * of.voltage_by_r0_ohm * r0
                if hysteresis:
                    row[o_m + f + q] = basis[k, q] * of.voltage_by_m_V
            act = of.voltage_by_r0_ohm * warm_r0 * dscale
            skw = of.voltage_by_current_A * slope
            for j in range(branches):
                o_r = knots_ocv + knots * (1 + 2 * j)
                for q in range(knots):
                    row[o_r + q] = by_branch * sens[2 * j, q]
                    row[o_r + knots + q] = by_branch * sens[2 * j + 1, q]
                act += by_branch * sens_act[j]
                skw += by_branch * sens_skew[j]
            if hysteresis:
                row[o_gamma] = of.voltage_by_h * h_gamma
                skw += of.voltage_by_h * h_skew
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

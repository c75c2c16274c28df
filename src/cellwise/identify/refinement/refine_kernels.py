"""Simulated voltage and its analytic sensitivities over one log, in one pass of scalar code.

SOC and temperature are known here (the tester's counter, the sensor), so the look-ups do not depend
on the parameters and every sensitivity obeys the branch's own recursion with a source at the knots
that are active:

    v'  = rc_step(v, I, R, tau, dt)
    S'  = dv'/dv S + B R dv'/dR          with respect to the spline coefficients of ln R
    S'  = dv'/dv S + B tau dv'/dtau      with respect to those of ln tau

Between temperatures ln R and ln tau are straight over 1/T, so that what lies between two of them is
an activation energy. The equations are those of the cell, their derivatives are printed from them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.equations import (
    hysteresis_decay,
    hysteresis_step,
    loaded_voltage,
    polarisation,
    rc_step,
    seen_current,
    thermal_factor,
    transfer_resistance,
)
from cellwise.cell.point_kernels import CellScalars
from cellwise.identify.refinement.derivative_kernels import (
    branch_partials,
    hysteresis_partials,
    seen_partials,
    thermal_partials,
    transfer_partials,
    voltage_partials,
)
from cellwise.identify.refinement.layout import ACTIVATION_UNIT_K, ASINH_UNIT_PER_V, SKEW_UNIT_S
from cellwise.typing import BoolArray, FloatArray, IndexArray

SUPPORT = 4  # cubic B-splines: four are active at any SOC


class LogRows(NamedTuple):
    """What the kernel reads of one log, arrays over its kept rows.

    ``row`` is the number of the first of the two temperatures between which a row lies, ``share``
    how much of the way to the second it is, over 1/T; ``first`` and ``basis`` (rows, 4) are the
    splines of the tables, ``ocv_first`` and ``ocv_basis`` those of the OCV; ``base_ocv_V`` is what
    the OCV's correction is added to; ``evaluate`` marks the compared rows.
    """

    dt_s: FloatArray
    current_A: FloatArray
    inverse_K: FloatArray
    row: IndexArray
    share: FloatArray
    first: IndexArray
    basis: FloatArray
    ocv_first: IndexArray
    ocv_basis: FloatArray
    base_ocv_V: FloatArray
    evaluate: BoolArray


class Blocks(NamedTuple):
    """A layout as numbers for the kernel."""

    knots_ocv: int
    knots: int
    branches: int
    hysteresis: bool
    temperatures: int
    m: int
    gamma: int
    warm: int
    activation: int
    skew: int
    asinh: int
    own: int


@cached(error_model="numpy", inline="always")
def _value(
    theta: FloatArray, at: int, basis: FloatArray, k: int, share: float, knots: int
) -> float:
    """A spline's value at row ``k``; ``at`` is its first active coefficient."""
    here = 0.0
    for q in range(SUPPORT):
        here += basis[k, q] * theta[at + q]
    if share != 0.0:
        there = 0.0
        for q in range(SUPPORT):
            there += basis[k, q] * theta[at + knots + q]
        here += share * (there - here)
    return here


@cached(error_model="numpy", nogil=True)
def voltage_and_jacobian(
    log: LogRows,
    cell: CellScalars,
    lay: Blocks,
    h0: float,
    skewed: bool,
    theta: FloatArray,
    jacobian: FloatArray,
    voltage_V: FloatArray,
) -> None:
    """Fill ``voltage_V`` (rows,) and ``jacobian`` (evaluated rows, parameters).

    ``cell`` are the scalars of ``theta``, see `scalars_of` of the layout.
    """
    knots, branches, hysteresis = lay.knots, lay.branches, lay.hysteresis
    block = lay.temperatures * knots
    v = np.zeros(3)
    sens = np.zeros((2 * branches, block))
    sens_act = np.zeros(branches)
    sens_tau_act = np.zeros(branches)
    sens_skew = np.zeros(branches)
    sens_asinh = 0.0
    h = h0
    h_gamma = 0.0
    h_skew = 0.0
    previous = log.current_A[0]
    out = 0
    for k in range(log.dt_s.size):
        dt = log.dt_s[k]
        seen = seen_current(cell, log.current_A[k], previous, dt)
        slope = 0.0
        if skewed:
            partials = seen_partials(cell, log.current_A[k], previous, dt)
            slope = partials.seen_by_skew_s * SKEW_UNIT_S
        previous = log.current_A[k]
        x = log.inverse_K[k]
        scale = thermal_factor(cell.activation_K, x)
        dscale = thermal_partials(cell.activation_K, x).factor_by_activation_K
        share = log.share[k]
        # Where the active coefficients of this row's temperature stand within a block.
        f = log.row[k] * knots + log.first[k]
        for j in range(branches):
            o_r = lay.knots_ocv + block * (1 + 2 * j)
            o_t = o_r + block
            warm_r = math.exp(_value(theta, o_r + f, log.basis, k, share, knots))
            own = theta[lay.own + 1 + 2 * j] * ACTIVATION_UNIT_K
            own_scale = thermal_factor(own, x) if own != 0.0 else 1.0
            r = warm_r * (scale * own_scale)
            by_act = dscale * own_scale * ACTIVATION_UNIT_K
            tau = math.exp(_value(theta, o_t + f, log.basis, k, share, knots))
            own = theta[lay.own + 2 + 2 * j] * ACTIVATION_UNIT_K
            if own != 0.0:
                tau *= thermal_factor(own, x)
            loaded_r = r
            by_r = 1.0
            by_asinh = 0.0
            by_seen = 0.0
            if j == 0 and cell.asinh_per_V != 0.0:
                loaded_r = transfer_resistance(cell.asinh_per_V, r, seen)
                transfer = transfer_partials(cell.asinh_per_V, r, seen)
                by_r = transfer.new_by_r_ohm
                by_asinh = transfer.new_by_asinh_per_V * ASINH_UNIT_PER_V
                by_seen = transfer.new_by_current_A
            by = branch_partials(v[j], seen, loaded_r, tau, dt)
            by_ln_r = by.new_by_r_ohm * by_r * r
            by_ln_tau = by.new_by_tau_s * tau
            left = by.new_by_v_V
            if left < 1.0:
                for q in range(block):
                    sens[2 * j, q] *= left
                    sens[2 * j + 1, q] *= left
            for q in range(SUPPORT):
                sens[2 * j, f + q] += (1.0 - share) * log.basis[k, q] * by_ln_r
                sens[2 * j + 1, f + q] += (1.0 - share) * log.basis[k, q] * by_ln_tau
                if share != 0.0:
                    sens[2 * j, f + knots + q] += share * log.basis[k, q] * by_ln_r
                    sens[2 * j + 1, f + knots + q] += share * log.basis[k, q] * by_ln_tau
            sens_act[j] = left * sens_act[j] + by.new_by_r_ohm * by_r * warm_r * by_act
            sens_tau_act[j] = left * sens_tau_act[j] + by_ln_tau * (x * ACTIVATION_UNIT_K)
            by_current = by.new_by_current_A + by.new_by_r_ohm * by_seen
            sens_skew[j] = left * sens_skew[j] + by_current * slope
            if j == 0:
                sens_asinh = left * sens_asinh + by.new_by_r_ohm * by_asinh
            v[j] = rc_step(v[j], seen, loaded_r, tau, dt)
        warm_r0 = math.exp(_value(theta, lay.knots_ocv + f, log.basis, k, share, knots))
        ocv = log.base_ocv_V[k]
        of = log.ocv_first[k]
        ocv += _value(theta, of, log.ocv_basis, k, 0.0, 0)
        if lay.temperatures > 1:
            at = lay.warm + log.row[k] * lay.knots_ocv + of
            ocv += _value(theta, at, log.ocv_basis, k, share, lay.knots_ocv)
        m = 0.0
        own = theta[lay.own] * ACTIVATION_UNIT_K
        own_scale = thermal_factor(own, x) if own != 0.0 else 1.0
        r0 = warm_r0 * (scale * own_scale)
        if hysteresis:
            m = _value(theta, lay.m + f, log.basis, k, share, knots)
            of_h = hysteresis_partials(cell, h, seen, dt)
            by_ln_rate = of_h.new_by_hysteresis_rate * cell.hysteresis_rate
            h_gamma = of_h.new_by_h * h_gamma + by_ln_rate
            h_skew = of_h.new_by_h * h_skew + of_h.new_by_current_A * slope
            h = hysteresis_step(h, hysteresis_decay(cell, seen, dt), seen)
        drop = polarisation(r0, seen, v[0], v[1], v[2])
        voltage_V[k] = loaded_voltage(ocv, m, h, drop)
        if log.evaluate[k]:
            by_v = voltage_partials(ocv, m, h, r0, seen, v[0], v[1], v[2])
            by_branch = by_v.voltage_by_v1_V  # all of them alike
            row = jacobian[out]
            row[:] = 0.0
            for q in range(SUPPORT):
                by_ocv = by_v.voltage_by_ocv_V * log.ocv_basis[k, q]
                row[of + q] = by_ocv
                if lay.temperatures > 1:
                    at = lay.warm + log.row[k] * lay.knots_ocv + of + q
                    row[at] = (1.0 - share) * by_ocv
                    if share != 0.0:
                        row[at + lay.knots_ocv] = share * by_ocv
                by_r0 = log.basis[k, q] * by_v.voltage_by_r0_ohm * r0
                by_m = log.basis[k, q] * by_v.voltage_by_m_V
                row[lay.knots_ocv + f + q] = (1.0 - share) * by_r0
                if hysteresis:
                    row[lay.m + f + q] = (1.0 - share) * by_m
                if share != 0.0:
                    row[lay.knots_ocv + f + knots + q] = share * by_r0
                    if hysteresis:
                        row[lay.m + f + knots + q] = share * by_m
            by_act = dscale * own_scale * ACTIVATION_UNIT_K
            act = by_v.voltage_by_r0_ohm * warm_r0 * by_act
            row[lay.own] = act
            skw = by_v.voltage_by_current_A * slope
            for j in range(branches):
                o_r = lay.knots_ocv + block * (1 + 2 * j)
                for q in range(block):
                    row[o_r + q] = by_branch * sens[2 * j, q]
                    row[o_r + block + q] = by_branch * sens[2 * j + 1, q]
                act += by_branch * sens_act[j]
                row[lay.own + 1 + 2 * j] = by_branch * sens_act[j]
                row[lay.own + 2 + 2 * j] = by_branch * sens_tau_act[j]
                skw += by_branch * sens_skew[j]
            if hysteresis:
                row[lay.gamma] = by_v.voltage_by_h * h_gamma
                skw += by_v.voltage_by_h * h_skew
            row[lay.activation] = act
            row[lay.skew] = skw
            row[lay.asinh] = by_branch * sens_asinh
            out += 1


@cached(error_model="numpy")
def choose_rows(
    time_s: FloatArray,
    current_A: FloatArray,
    threshold_A: float,
    shortest_s: float,
    growth: float,
    most_charge_As: float,
    keep: BoolArray,
    evaluate: BoolArray,
) -> None:
    """Mark the rows to keep and those to compare with the measurement.

    Compared rows lie evenly on the logarithm of the time since the last change of current
    (at least ``shortest_s`` apart, then ``growth`` times that time), so that hours of rest do not
    outvote seconds of pulse; under load they are no further apart than ``most_charge_As``, so that
    hours of a low rate show every bend of the OCV. Between them only rows at which the current
    changes are kept: merging rows of equal current loses nothing, because the branches are solved
    exactly.
    """
    kept = 0
    edge_s = time_s[0]
    compared_s = time_s[0]
    moved_As = 0.0
    keep[0] = True
    evaluate[0] = True
    for k in range(1, time_s.size):
        moved_As += abs(current_A[k]) * (time_s[k] - time_s[k - 1])
        if abs(current_A[k] - current_A[kept]) > threshold_A:
            keep[k - 1] = True
            keep[k] = True
            kept = k
            edge_s = time_s[k - 1]
        spacing = max(shortest_s, growth * (time_s[k] - edge_s))
        since_s = time_s[k] - compared_s
        if since_s >= spacing or (since_s >= shortest_s and moved_As >= most_charge_As):
            evaluate[k] = True
            keep[k] = True
            compared_s = time_s[k]
            moved_As = 0.0
    keep[-1] = True

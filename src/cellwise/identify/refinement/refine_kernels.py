"""Simulated voltage and its analytic sensitivities over one log, in one pass of scalar code.

SOC and temperature are known here (the tester's counter, the sensor), so the look-ups do not depend
on the parameters and every sensitivity obeys the branch's own recursion with a source at the knots
that are active:

    v'  = rc_step(v, I, R, tau, dt)
    S'  = dv'/dv S + B R dv'/dR          with respect to the spline coefficients of ln R
    S'  = dv'/dv S + B tau dv'/dtau      with respect to those of ln tau

Between temperatures ln R and ln tau are straight over 1/T, so that what lies between two of them is
an activation energy. The equations are those of the cell, and so are their derivatives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached, inline
from cellwise.cell.equations import (
    charge_transfer,
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
from cellwise.identify.refinement.layout import ACTIVATION_UNIT_K, ASINH_UNIT_PER_V, SKEW_UNIT_S
from cellwise.typing import BoolArray, FloatArray, IndexArray

OVERVOLTAGE_STEP = 1e-4
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


class TransferPartials(NamedTuple):
    """Of the resistance of a charge transfer."""

    new_by_r_ohm: float
    new_by_asinh_per_V: float
    new_by_current_A: float


@inline
def transfer_partials(asinh_per_V: float, r_ohm: float, current_A: float) -> TransferPartials:
    """Chain rule through `charge_transfer`, whose slope over the overvoltage is a difference."""
    overvoltage = asinh_per_V * r_ohm * current_A
    near = OVERVOLTAGE_STEP * (1.0 + abs(overvoltage))
    above, below = charge_transfer(overvoltage + near), charge_transfer(overvoltage - near)
    by_overvoltage = r_ohm * (above - below) / (2.0 * near)
    return TransferPartials(
        charge_transfer(overvoltage) + by_overvoltage * asinh_per_V * current_A,
        by_overvoltage * r_ohm * current_A,
        by_overvoltage * asinh_per_V * r_ohm,
    )


class BranchPartials(NamedTuple):
    """Of a branch's voltage after an interval."""

    new_by_v_V: float
    new_by_current_A: float
    new_by_r_ohm: float
    new_by_tau_s: float


@inline
def branch_partials(
    v_V: float, current_A: float, r_ohm: float, tau_s: float, dt_s: float
) -> BranchPartials:
    """Chain rule through `rc_step`."""
    a = math.exp(-dt_s / tau_s)
    new_by_tau_s = dt_s / tau_s / tau_s * a * (v_V - r_ohm * current_A)
    return BranchPartials(a, r_ohm * (1.0 - a), current_A * (1.0 - a), new_by_tau_s)


class HysteresisPartials(NamedTuple):
    """Of the hysteresis state after an interval."""

    new_by_h: float
    new_by_hysteresis_rate: float
    new_by_current_A: float


@inline
def hysteresis_partials(
    cell: CellScalars, h: float, current_A: float, dt_s: float
) -> HysteresisPartials:
    """Chain rule through `hysteresis_decay` and `hysteresis_step`."""
    per_A = dt_s / cell.charge_As
    folds = -cell.hysteresis_rate * abs(current_A) * per_A
    ah = math.exp(folds)
    new_by_ah = h + math.copysign(1.0, current_A)
    new_by_folds = new_by_ah * ah
    new_by_hysteresis_rate = -(abs(current_A) * per_A * new_by_folds)
    new_by_current_A = -(
        cell.hysteresis_rate * math.copysign(1.0, current_A) * per_A * new_by_folds
    )
    return HysteresisPartials(ah, new_by_hysteresis_rate, new_by_current_A)


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
        if skewed and dt > 0.0 and cell.skew_s < dt:
            slope = (previous - log.current_A[k]) / dt * SKEW_UNIT_S
        previous = log.current_A[k]
        x = log.inverse_K[k]
        scale = thermal_factor(cell.activation_K, x)
        dscale = scale * x
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
        drop = polarisation(r0, seen, v[0], v[1] + v[2])
        voltage_V[k] = loaded_voltage(ocv, m, h, drop)
        if log.evaluate[k]:
            row = jacobian[out]
            row[:] = 0.0
            for q in range(SUPPORT):
                by_ocv = log.ocv_basis[k, q]
                row[of + q] = by_ocv
                if lay.temperatures > 1:
                    at = lay.warm + log.row[k] * lay.knots_ocv + of + q
                    row[at] = (1.0 - share) * by_ocv
                    if share != 0.0:
                        row[at + lay.knots_ocv] = share * by_ocv
                by_r0 = -log.basis[k, q] * seen * r0
                by_m = log.basis[k, q] * h
                row[lay.knots_ocv + f + q] = (1.0 - share) * by_r0
                if hysteresis:
                    row[lay.m + f + q] = (1.0 - share) * by_m
                if share != 0.0:
                    row[lay.knots_ocv + f + knots + q] = share * by_r0
                    if hysteresis:
                        row[lay.m + f + knots + q] = share * by_m
            by_act = dscale * own_scale * ACTIVATION_UNIT_K
            act = -seen * warm_r0 * by_act
            row[lay.own] = act
            skw = -r0 * slope
            for j in range(branches):
                o_r = lay.knots_ocv + block * (1 + 2 * j)
                for q in range(block):
                    row[o_r + q] = -sens[2 * j, q]
                    row[o_r + block + q] = -sens[2 * j + 1, q]
                act -= sens_act[j]
                row[lay.own + 1 + 2 * j] = -sens_act[j]
                row[lay.own + 2 + 2 * j] = -sens_tau_act[j]
                skw -= sens_skew[j]
            if hysteresis:
                row[lay.gamma] = m * h_gamma
                skw += m * h_skew
            row[lay.activation] = act
            row[lay.skew] = skw
            row[lay.asinh] = -sens_asinh
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

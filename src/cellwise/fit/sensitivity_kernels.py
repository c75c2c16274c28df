"""Simulated voltage and its analytic sensitivities over one log, in one pass of scalar code.

Every sensitivity obeys the branch's own recursion with a source at the knots that are active:

    v'  = rc_step(v, I, R, tau, dt)
    S'  = a S + B R (1 - a) I              with respect to the spline coefficients of ln R
    S'  = a S + B a dt/tau (v - R I)       with respect to those of ln tau
    S'  = a S + (d ln R R (1 - a) I + d ln tau a dt/tau (v - R I)) ds       to the SOC of the row

A start moves every row by as much (ds = 1), a larger capacity by what has flowed (ds = s_0 - s).

Between temperatures ln R and ln tau are straight over 1/T, so that what lies between two of them is
an activation energy. The equations are those of the cell, and so are their derivatives.

Tables change little from row to row: they are looked up at the end of a run of rows, as those of an
interval are at its end. Within a run a source has the same knots, so that two sums take it up; and
all S of a branch fade alike, so that they are kept over what has remained since they were last
written out (``kept``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.equations import (
    branch_gain,
    charge_transfer,
    decay,
    delayed_current,
    hysteresis_decay,
    hysteresis_step,
    loaded_voltage,
    polarisation,
    relaxed,
)
from cellwise.cell.equations.exponential import exponential
from cellwise.cell.point_kernels import CellScalars
from cellwise.fit.splines import SplineRows
from cellwise.fit.unknowns import (
    ACTIVATION_UNIT_K,
    ASINH_UNIT_PER_V,
    SKEW_UNIT_S,
    Layout,
)
from cellwise.typing import BoolArray, FloatArray, IndexArray

OVERVOLTAGE_STEP = 1e-4
SUPPORT = 4  # cubic B-splines: four are active at any SOC
FADED, NOTHING_V = 1e-6, 1e-12  # when what fades is written out, and what is then none of it


class FittedRows(NamedTuple):
    """What the kernel reads of one log, arrays over its kept rows.

    ``row`` is the number of the first of the two temperatures between which a row lies, ``share``
    how much of the way to the second it is, over 1/T; ``used_soc`` what has flowed out, as SOC;
    ``evaluate`` marks the compared rows. Of these alone are ``ocv``, and ``base_V`` and
    ``base_slope_V`` of the OCV that is corrected. ``ends`` (runs,) are the last rows of runs, of
    which ``tables`` are; each compared row is one.
    """

    dt_s: FloatArray
    current_A: FloatArray
    inverse_K: FloatArray
    row: IndexArray
    share: FloatArray
    tables: SplineRows
    ocv: SplineRows
    base_V: FloatArray
    base_slope_V: FloatArray
    used_soc: FloatArray
    evaluate: BoolArray
    ends: IndexArray


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
    log: FittedRows,
    cell: CellScalars,
    layout: Layout,
    h0: float,
    skewed: bool,
    theta: FloatArray,
    jacobian: FloatArray,
    voltage_V: FloatArray,
) -> None:
    """Fill ``voltage_V`` (compared rows,) and ``jacobian`` (compared rows, unknowns) of one log.

    ``cell`` are the scalars of ``theta``, see `scalars_of`; without rows in ``jacobian`` none is
    computed.
    """
    knots, branches, hysteresis = layout.knots, layout.branches, layout.hysteresis
    block = layout.block
    wanted = jacobian.shape[0] > 0
    v = np.zeros(3)
    for j in range(branches):
        v[j] = theta[layout.past + j]
    r, tau, left, turned = np.zeros((4, branches))
    # Of a run: what remains of what was before, and the sources by ln R and ln tau.
    remains, of_r, of_tau = np.zeros((3, branches))
    left_of_past = np.ones(branches)
    sens_start, sens_capacity, sens_act, sens_tau_act, sens_skew = np.zeros((5, branches))
    sens = np.zeros((2 * branches, block))
    kept = np.ones(branches)
    sens_asinh = 0.0
    h = h0
    h_gamma = 0.0
    h_skew = 0.0
    delayed_A = 0.0
    slope = 0.0
    previous = log.current_A[0]
    first = 0
    out = 0
    for run in range(log.ends.size):
        end = log.ends[run]
        x = log.inverse_K[end]
        by_own_activation = x * ACTIVATION_UNIT_K
        share = log.share[end]
        # Where the active coefficients of this run's temperature stand within a block.
        f = log.row[end] * knots + log.tables.first[run]
        for j in range(branches):
            o_r = layout.r0 + block * (1 + 2 * j)
            own_activation = layout.own_activation + 1 + 2 * j
            ln_r = _value(theta, o_r + f, log.tables.values, run, share, knots)
            r[j] = exponential(
                ln_r + cell.activation_K * x + theta[own_activation] * by_own_activation
            )
            ln_tau = _value(theta, o_r + block + f, log.tables.values, run, share, knots)
            tau[j] = exponential(ln_tau + theta[own_activation + 1] * by_own_activation)
            remains[j] = 1.0
            of_r[j] = 0.0
            of_tau[j] = 0.0
        same = -1.0  # the interval that `left` is of
        for k in range(first, end + 1):
            dt = log.dt_s[k]
            delayed_A = delayed_current(cell, log.current_A[k], previous, dt)
            slope = 0.0
            if skewed and dt > 0.0 and cell.skew_s < dt:
                slope = (previous - log.current_A[k]) / dt * SKEW_UNIT_S
            previous = log.current_A[k]
            if dt != same:
                for j in range(branches):
                    left[j] = decay(dt, tau[j])
                    turned[j] = dt / tau[j] * left[j]
                same = dt
            for j in range(branches):
                loaded_r = r[j]
                by_r = 1.0
                by_asinh = 0.0
                by_delayed = 0.0
                if j == 0 and cell.asinh_per_V != 0.0:
                    # Chain rule through `charge_transfer`, whose slope is a difference.
                    u = cell.asinh_per_V * r[j] * delayed_A
                    near = OVERVOLTAGE_STEP * (1.0 + abs(u))
                    steep = (charge_transfer(u + near) - charge_transfer(u - near)) / (2.0 * near)
                    by_r = charge_transfer(u)
                    loaded_r = r[j] * by_r
                    by_r += steep * u
                    by_asinh = steep * r[j] * r[j] * delayed_A * ASINH_UNIT_PER_V
                    by_delayed = steep * r[j] * r[j] * cell.asinh_per_V
                by_loaded = delayed_A * (1.0 - left[j])
                remains[j] *= left[j]
                of_r[j] = left[j] * of_r[j] + by_loaded * by_r * r[j]
                of_tau[j] = left[j] * of_tau[j] + turned[j] * (v[j] - loaded_r * delayed_A)
                by_current = loaded_r * (1.0 - left[j]) + by_loaded * by_delayed
                sens_skew[j] = left[j] * sens_skew[j] + by_current * slope
                if j == 0:
                    sens_asinh = left[j] * sens_asinh + by_loaded * by_asinh
                v[j] = relaxed(v[j], left[j], branch_gain(loaded_r, left[j]), delayed_A)
            if hysteresis:
                ah = hysteresis_decay(cell, delayed_A, dt)
                side = math.copysign(1.0, delayed_A)
                by_current = -cell.hysteresis_rate * side * dt / cell.charge_As * ah * (h + side)
                h_gamma = ah * h_gamma + by_current * delayed_A
                h_skew = ah * h_skew + by_current * slope
                h = hysteresis_step(h, ah, delayed_A)
        first = end + 1
        if wanted:
            for j in range(branches):
                o_r = layout.r0 + block * (1 + 2 * j)
                by_soc = of_r[j] * _value(theta, o_r + f, log.tables.slopes, run, share, knots)
                by_soc += of_tau[j] * _value(
                    theta, o_r + block + f, log.tables.slopes, run, share, knots
                )
                sens_start[j] = remains[j] * sens_start[j] + by_soc
                sens_capacity[j] = remains[j] * sens_capacity[j] + by_soc * log.used_soc[end]
                sens_act[j] = remains[j] * sens_act[j] + of_r[j] * by_own_activation
                sens_tau_act[j] = remains[j] * sens_tau_act[j] + of_tau[j] * by_own_activation
                left_of_past[j] *= remains[j]
                if left_of_past[j] < NOTHING_V:
                    left_of_past[j] = 0.0
                kept[j] *= remains[j]
                if kept[j] < FADED:
                    for i in range(2 * j, 2 * j + 2):
                        for q in range(block):
                            faded = sens[i, q] * kept[j]
                            sens[i, q] = faded if abs(faded) > NOTHING_V else 0.0
                    kept[j] = 1.0
                for q in range(SUPPORT):
                    basis = log.tables.values[run, q] / kept[j]
                    sens[2 * j, f + q] += (1.0 - share) * basis * of_r[j]
                    sens[2 * j + 1, f + q] += (1.0 - share) * basis * of_tau[j]
                    if share != 0.0:
                        sens[2 * j, f + knots + q] += share * basis * of_r[j]
                        sens[2 * j + 1, f + knots + q] += share * basis * of_tau[j]
        if not log.evaluate[end]:
            continue
        ln_r0 = _value(theta, layout.r0 + f, log.tables.values, run, share, knots)
        r0 = exponential(
            ln_r0 + cell.activation_K * x + theta[layout.own_activation] * by_own_activation
        )
        of = log.ocv.first[out]
        ocv = log.base_V[out] + _value(theta, of, log.ocv.values, out, 0.0, 0)
        m = 0.0
        if hysteresis:
            m = _value(theta, layout.m + f, log.tables.values, run, share, knots)
        drop = polarisation(r0, delayed_A, v[0], v[1] + v[2])
        voltage_V[out] = loaded_voltage(ocv, m, h, drop)
        if wanted:
            row = jacobian[out]
            row[:] = 0.0
            for q in range(SUPPORT):
                row[of + q] = log.ocv.values[out, q]
                by_r0 = -log.tables.values[run, q] * delayed_A * r0
                by_m = log.tables.values[run, q] * h
                row[layout.r0 + f + q] = (1.0 - share) * by_r0
                if hysteresis:
                    row[layout.m + f + q] = (1.0 - share) * by_m
                if share != 0.0:
                    row[layout.r0 + f + knots + q] = share * by_r0
                    if hysteresis:
                        row[layout.m + f + knots + q] = share * by_m
            act = -delayed_A * r0 * by_own_activation
            row[layout.own_activation] = act
            skw = -r0 * slope
            for j in range(branches):
                o_r = layout.r0 + block * (1 + 2 * j)
                for q in range(block):
                    row[o_r + q] = -sens[2 * j, q] * kept[j]
                    row[o_r + block + q] = -sens[2 * j + 1, q] * kept[j]
                act -= sens_act[j]
                row[layout.own_activation + 1 + 2 * j] = -sens_act[j]
                row[layout.own_activation + 2 + 2 * j] = -sens_tau_act[j]
                skw -= sens_skew[j]
            if hysteresis:
                row[layout.gamma] = m * h_gamma
                skw += m * h_skew
            row[layout.activation] = act
            row[layout.skew] = skw
            row[layout.asinh] = -sens_asinh
            along = log.base_slope_V[out] + _value(theta, of, log.ocv.slopes, out, 0.0, 0)
            along -= (
                delayed_A * r0 * _value(theta, layout.r0 + f, log.tables.slopes, run, share, knots)
            )
            if hysteresis:
                along += h * _value(theta, layout.m + f, log.tables.slopes, run, share, knots)
            start, capacity = along, along * log.used_soc[end]
            for j in range(branches):
                start -= sens_start[j]
                capacity -= sens_capacity[j]
                row[layout.past + j] = -left_of_past[j]
            row[layout.start] = start
            row[layout.capacity] = capacity
            row[layout.sample] = capacity
        out += 1


@cached(error_model="numpy", nogil=True)
def add_block(matrix: FloatArray, places: IndexArray, block: FloatArray) -> None:
    """Add a square block to a matrix, in the rows and columns at the places."""
    for i in range(places.size):
        row = matrix[places[i]]
        for j in range(places.size):
            row[np.uint64(places[j])] += block[i, j]

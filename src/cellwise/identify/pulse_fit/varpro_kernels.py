"""Compiled kernels of the pulse fit: sums over samples, and nothing that allocates per sample.

One pass over a pulse window advances the two RC branches exactly (zero-order hold), together
with their derivatives to log tau, and adds every product of two columns that the normal
equations need. What comes out is one small symmetric matrix; all algebra happens on it.

Columns of a window, in this order (`COLUMNS`):

    0 y    measured voltage, minus what a tabulated OCV says changed [V]
    1      1: the open-circuit voltage
    2      x: SOC minus the pulse's mean SOC; its factor is the OCV slope
    3      -I f0: ohmic drop per ohm
    4, 5   -u1, -u2: branch voltages per ohm
    6, 7   -d u1 / d log tau1, -d u2 / d log tau2
    8-10   x^2, x^3, x^4: the OCV bends inside the pulse
    11, 12 -e1, -e2: decay of what the branches held at the window's first row
    13, 14 -d e1 / d log tau1, -d e2 / d log tau2
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.typing import BoolArray, FloatArray

COLUMNS = 15
LINEAR = 10  # unknowns that enter linearly: OCV, slope, R0, R1, R2, three bends, V1(0), V2(0)
BENDS = 3
TILE = 128
# The columns of the linear unknowns, in the order of the unknowns.
COLUMN_OF = np.array([1, 2, 3, 4, 5, 8, 9, 10, 11, 12], dtype=np.int64)
# Sampling intervals closer than this share one exponential: float64 stamps of a log that runs
# for days jitter in the last digits.
SAME_INTERVAL = 1e-7

_FAST = {"reassoc", "contract", "nsz", "arcp"}


class Window(NamedTuple):
    """Rows of a pulse and its relaxation, shape (n,) each where nothing else is said."""

    dt: FloatArray  # intervals [s]
    current: FloatArray  # their currents [A]
    known: FloatArray  # voltage to explain [V]
    dq: FloatArray  # charge over capacity [-]
    weight: FloatArray  # of a row [-]
    trend: FloatArray  # (5,) d log(R0, R1, R2, tau1, tau2) / d SOC
    centre: float  # ``dq`` at the pulse's mean SOC


@cached()
def trend_factor(slope: float, soc_offset: float) -> float:
    """Value of a parameter at a SOC offset over its value at the pulse's mean SOC [-].

    exp(slope * offset) to second order: positive for every slope, one multiply cheaper.
    """
    x = slope * soc_offset
    return 1.0 + x * (1.0 + 0.5 * x)


@cached()
def columns_used(include: BoolArray) -> int:
    """Leading columns that a set of unknowns needs; see the module's list."""
    if include[8] or include[9]:
        return COLUMNS
    for bend in range(BENDS, 0, -1):
        if include[4 + bend]:
            return 8 + bend
    return 8


@cached(fastmath=_FAST)
def _add_tile(tile: FloatArray, weight: FloatArray, rows: int, used: int, gram: FloatArray) -> None:
    """Add the weighted products of one tile's columns to the lower triangle of ``gram``."""
    for i in range(used):
        for j in range(i + 1):
            total = 0.0
            for k in range(rows):
                total += weight[k] * tile[i, k] * tile[j, k]
            gram[i, j] += total


@cached()
def accumulate(
    window: Window,
    tau1: float,
    tau2: float,
    used: int,
    tile: FloatArray,
    tile_weight: FloatArray,
    gram: FloatArray,
) -> None:
    """Normal equations of one window at given time constants, in one pass.

    Parameters
    ----------
    window : Window
    tau1, tau2 : float        time constants at the pulse's mean SOC [s]
    used : int                number of leading columns to sum, see `columns_used`
    tile : (15, TILE) float, tile_weight : (TILE,) float      scratch
    gram : (15, 15) float     result, both triangles
    """
    dt, current, known, dq, weight, trend, centre = window
    gram[:, :] = 0.0
    u1 = u2 = du1 = du2 = 0.0
    e1 = e2 = 1.0
    de1 = de2 = 0.0
    a1 = a2 = l1 = l2 = 0.0
    last_dt = last_offset = -1.0
    row = 0
    before = dq[0]
    for k in range(dt.size):
        # The state of charge halfway through the interval; SOC falls as dq grows.
        offset = centre - 0.5 * (dq[k] + before)
        before = dq[k]
        if abs(dt[k] - last_dt) > SAME_INTERVAL * dt[k] or offset != last_offset:
            last_dt = dt[k]
            last_offset = offset
            l1 = dt[k] / (tau1 * trend_factor(trend[3], offset))
            l2 = dt[k] / (tau2 * trend_factor(trend[4], offset))
            a1 = math.exp(-l1)
            a2 = math.exp(-l2)
        drive1 = current[k] * trend_factor(trend[1], offset)
        drive2 = current[k] * trend_factor(trend[2], offset)
        du1 = a1 * (du1 + l1 * (u1 - drive1))
        du2 = a2 * (du2 + l2 * (u2 - drive2))
        u1 = drive1 + a1 * (u1 - drive1)
        u2 = drive2 + a2 * (u2 - drive2)
        x = centre - dq[k]
        tile[0, row] = known[k]
        tile[1, row] = 1.0
        tile[2, row] = x
        tile[3, row] = -current[k] * trend_factor(trend[0], x)
        tile[4, row] = -u1
        tile[5, row] = -u2
        tile[6, row] = -du1
        tile[7, row] = -du2
        tile[8, row] = x * x
        tile[9, row] = x * x * x
        tile[10, row] = x * x * x * x
        if used > 8 + BENDS:
            de1 = a1 * (de1 + l1 * e1)
            de2 = a2 * (de2 + l2 * e2)
            e1 *= a1
            e2 *= a2
            tile[11, row] = -e1
            tile[12, row] = -e2
            tile[13, row] = -de1
            tile[14, row] = -de2
        tile_weight[row] = weight[k]
        row += 1
        if row == TILE:
            _add_tile(tile, tile_weight, row, used, gram)
            row = 0
    if row > 0:
        _add_tile(tile, tile_weight, row, used, gram)
    for i in range(used):
        for j in range(i):
            gram[j, i] = gram[i, j]


@cached()
def predict(
    window: Window,
    tau1: float,
    tau2: float,
    coefficients: FloatArray,
    voltage: FloatArray,
) -> None:
    """Voltage of the model, without what a tabulated OCV adds [V]; same recursion, one pass."""
    dt, current, _, dq, _, trend, centre = window
    u1 = u2 = 0.0
    e1 = e2 = 1.0
    a1 = a2 = 0.0
    last_dt = last_offset = -1.0
    before = dq[0]
    c6 = coefficients[6]
    for k in range(dt.size):
        offset = centre - 0.5 * (dq[k] + before)
        before = dq[k]
        if abs(dt[k] - last_dt) > SAME_INTERVAL * dt[k] or offset != last_offset:
            last_dt = dt[k]
            last_offset = offset
            a1 = math.exp(-dt[k] / (tau1 * trend_factor(trend[3], offset)))
            a2 = math.exp(-dt[k] / (tau2 * trend_factor(trend[4], offset)))
        drive1 = current[k] * trend_factor(trend[1], offset)
        drive2 = current[k] * trend_factor(trend[2], offset)
        u1 = drive1 + a1 * (u1 - drive1)
        u2 = drive2 + a2 * (u2 - drive2)
        e1 *= a1
        e2 *= a2
        x = centre - dq[k]
        voltage[k] = (
            coefficients[0]
            + x * (coefficients[1] + x * (coefficients[5] + x * (c6 + x * coefficients[7])))
            - coefficients[2] * current[k] * trend_factor(trend[0], x)
            - coefficients[3] * u1
            - coefficients[4] * u2
            - coefficients[8] * e1
            - coefficients[9] * e2
        )


@cached()
def thin(
    dt: FloatArray,
    current: FloatArray,
    known: FloatArray,
    dq: FloatArray,
    weight: FloatArray,
    part: float,
    step_A: float,
    out: FloatArray,
) -> int:
    """Average neighbouring rows into few: all that the search for the minimum needs to see.

    A group of rows grows to ``part`` of the time since the last current step; the rows on either
    side of a step stay alone. A group carries its mean time, voltage and charge and its summed
    weight, so against the rows that it replaces it errs by the square of ``part`` only.

    Parameters
    ----------
    dt, current, known, dq, weight : (n,) float       as in `accumulate`
    part : float              longest group over the time since the last step [-]
    step_A : float            change of current that counts as a step [A]
    out : (5, n) float        result: the same five channels, leading columns filled

    Returns
    -------
    int           number of rows in ``out``
    """
    count = rows = 0
    time = last_time = step_time = first_time = 0.0
    moment = charge = voltage = fraction = summed = 0.0
    for k in range(dt.size):
        time += dt[k]
        if k > 0 and abs(current[k] - current[k - 1]) > step_A:
            step_time = time - dt[k]
        if rows == 0:
            first_time = time
        rows += 1
        moment += time
        charge += current[k]
        fraction += dq[k]
        voltage += known[k] * weight[k]
        summed += weight[k]
        closes = k + 1 == dt.size
        for ahead in range(1, 3):  # the next row, or the one after it, is the first of a step
            if k + ahead < dt.size:
                closes = closes or abs(current[k + ahead] - current[k + ahead - 1]) > step_A
        closes = closes or (k > 0 and abs(current[k] - current[k - 1]) > step_A)
        length = time - first_time + dt[k]
        if closes or length >= part * (time - step_time):
            mean_time = moment / rows
            out[0, count] = mean_time - last_time
            out[1, count] = charge / rows
            out[2, count] = voltage / summed if summed > 0.0 else known[k]
            out[3, count] = fraction / rows
            out[4, count] = summed
            last_time = mean_time
            count += 1
            rows = 0
            moment = charge = voltage = fraction = summed = 0.0
    return count


@cached(fastmath=_FAST)
def autocorrelation_time(residual: FloatArray, longest: int) -> float:
    """How many rows share one independent residual: 1 + 2 sum of autocorrelations, at least 1.

    Summed over pairs of lags until a pair is not positive (initial positive sequence of Geyer,
    doi:10.1214/ss/1177011137), at most ``longest`` lags; a longer memory counts as that long.
    """
    n = residual.size
    mean = 0.0
    for k in range(n):
        mean += residual[k]
    mean /= max(n, 1)
    variance = 0.0
    for k in range(n):
        variance += (residual[k] - mean) ** 2
    if variance <= 0.0:
        return 1.0
    total = 1.0
    pair = 0.0
    for lag in range(1, min(longest, n - 1) + 1):
        s = 0.0
        for k in range(n - lag):
            s += (residual[k] - mean) * (residual[k + lag] - mean)
        pair += s / variance
        if lag % 2 == 0:
            if pair <= 0.0:
                break
            total += 2.0 * pair
            pair = 0.0
    return max(total, 1.0)


LONGEST_BOOST = 32.0


@cached()
def _inside(p1: float, p2: float, limits: FloatArray) -> bool:
    """Whether (log tau1, log tau2) keeps the limits, to rounding."""
    slack = 1e-9
    return bool(
        p1 >= limits[0] - slack
        and p1 <= limits[1] + slack
        and p2 >= limits[2] - slack
        and p2 <= limits[3] + slack
        and p2 - p1 >= limits[4] - slack
    )


@cached()
def bounded_step(
    h11: float,
    h12: float,
    h22: float,
    g1: float,
    g2: float,
    p1: float,
    p2: float,
    limits: FloatArray,
    step: FloatArray,
) -> None:
    """Minimum of the quadratic model within the limits, exactly: inside, on a side, or a corner.

    ``limits`` = (min, max of log tau1; min, max of log tau2; min of log tau2 - log tau1).
    """
    determinant = max(h11 * h22 - h12 * h12, 1e-14 * h11 * h22, 1e-300)
    step[0] = (h22 * g1 - h12 * g2) / determinant
    step[1] = (h11 * g2 - h12 * g1) / determinant
    if _inside(p1 + step[0], p2 + step[1], limits):
        return
    best = math.inf
    for side in range(5):
        # A side is the line base + s * direction; find its part that keeps the other limits.
        if side < 2:
            base1, base2, d1, d2 = limits[side] - p1, 0.0, 0.0, 1.0
        elif side < 4:
            base1, base2, d1, d2 = 0.0, limits[side] - p2, 1.0, 0.0
        else:
            base1, base2, d1, d2 = 0.0, p1 + limits[4] - p2, 1.0, 1.0
        low, high = -math.inf, math.inf
        if d1 != 0.0:
            low, high = max(low, limits[0] - p1 - base1), min(high, limits[1] - p1 - base1)
        if d2 != 0.0:
            low, high = max(low, limits[2] - p2 - base2), min(high, limits[3] - p2 - base2)
        gap = p2 + base2 - p1 - base1 - limits[4]
        if d2 > d1:
            low = max(low, -gap)
        elif d1 > d2:
            high = min(high, gap)
        if low > high + 1e-12:
            continue
        curve = h11 * d1 * d1 + 2.0 * h12 * d1 * d2 + h22 * d2 * d2
        pull = (g1 - h11 * base1 - h12 * base2) * d1 + (g2 - h12 * base1 - h22 * base2) * d2
        s = min(max(pull / curve if curve > 0.0 else 0.0, low), high)
        t1, t2 = base1 + s * d1, base2 + s * d2
        value = 0.5 * (h11 * t1 * t1 + 2 * h12 * t1 * t2 + h22 * t2 * t2) - g1 * t1 - g2 * t2
        if value < best:
            best = value
            step[0], step[1] = t1, t2


@cached()
def within(x: float, low: float, high: float) -> float:
    """``x`` limited to [low, high]."""
    return min(max(x, low), high)


@cached()
def next_boost(boost: float, step: FloatArray, last1: float, last2: float) -> float:
    """Factor on the next step: longer while steps follow each other, half where they alternate.

    Where a real cell is no 2-RC circuit the residual is large, and Gauss-Newton creeps along the
    valley by nearly equal steps, or swings across it by nearly opposite ones.
    """
    length = math.hypot(step[0], step[1])
    last = math.hypot(last1, last2)
    if length <= 0.5 * last:
        return 1.0
    along = step[0] * last1 + step[1] * last2
    if along > 0.9 * length * last:
        return min(2.0 * boost, LONGEST_BOOST)
    return 0.5 if along < -0.9 * length * last else 1.0

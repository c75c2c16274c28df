"""Residuals whitened: a scalar Kalman filter for white noise and two slow parts.

The error of a model is correlated in time, so a thousand rows may hold the evidence of ten. Two
exponentially correlated parts and a white one describe it; the filter's innovations are white,
and the same gains turn every column of a Jacobian into what the innovations see of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.typing import BoolArray, FloatArray

TINY = 1e-60
BLOCK_ROWS = 256


class NoiseLevel(NamedTuple):
    """Standard deviations [V] and correlation times [s] of what no cause explains."""

    white_V: float
    fast_V: float
    fast_s: float
    slow_V: float
    slow_s: float


@cached(error_model="numpy", nogil=True)
def whiten(
    columns: FloatArray, dt_s: FloatArray, known: BoolArray, noise: NoiseLevel, ln_S: FloatArray
) -> None:
    """Replace every column of (rows, P) by its normalised innovations; ``ln_S`` is ln variance.

    ``dt_s`` is the time since the row before; a NaN in it (a new log) forgets everything. Rows
    that are not ``known`` are left at zero and carry no information.
    """
    rows, many = columns.shape
    one = np.zeros(many)
    two = np.zeros(many)
    v1 = noise.fast_V * noise.fast_V
    v2 = noise.slow_V * noise.slow_V
    w = noise.white_V * noise.white_V
    p11, p12, p22 = v1, 0.0, v2
    last, a1, a2 = -1.0, 1.0, 1.0
    for k in range(rows):
        if not math.isfinite(dt_s[k]):
            p11, p12, p22 = v1, 0.0, v2
            one[:] = 0.0
            two[:] = 0.0
        else:
            if dt_s[k] != last:  # most intervals are alike
                last = dt_s[k]
                a1 = math.exp(-last / noise.fast_s)
                a2 = math.exp(-last / noise.slow_s)
            p11 = a1 * a1 * p11 + (1.0 - a1 * a1) * v1
            p12 = a1 * a2 * p12
            p22 = a2 * a2 * p22 + (1.0 - a2 * a2) * v2
            for c in range(many):
                one[c] *= a1
                two[c] *= a2
        if not known[k]:
            columns[k, :] = 0.0
            ln_S[k] = 0.0
            continue
        s = p11 + 2.0 * p12 + p22 + w
        g1 = (p11 + p12) / s
        g2 = (p12 + p22) / s
        scale = 1.0 / math.sqrt(s)
        for c in range(many):
            e = columns[k, c] - one[c] - two[c]
            one[c] += g1 * e
            two[c] += g2 * e
            # What has died away is zero: subnormal numbers would slow everything after it.
            columns[k, c] = e * scale if abs(e) > TINY else 0.0
            if abs(one[c]) < TINY:
                one[c] = 0.0
            if abs(two[c]) < TINY:
                two[c] = 0.0
        b1 = p11 + p12
        b2 = p12 + p22
        p11 -= g1 * b1
        p12 -= g1 * b2
        p22 -= g2 * b2
        ln_S[k] = math.log(s)


@cached(error_model="numpy", nogil=True)
def minus_log_likelihood(
    residual: FloatArray, dt_s: FloatArray, known: BoolArray, noise: NoiseLevel, clip: float
) -> float:
    """Half of sum (e^2 / S + ln S), single terms of e^2 / S held at ``clip`` squared."""
    v1 = noise.fast_V * noise.fast_V
    v2 = noise.slow_V * noise.slow_V
    w = noise.white_V * noise.white_V
    p11, p12, p22 = v1, 0.0, v2
    one = 0.0
    two = 0.0
    total = 0.0
    last, a1, a2 = -1.0, 1.0, 1.0
    for k in range(residual.size):
        if not math.isfinite(dt_s[k]):
            p11, p12, p22 = v1, 0.0, v2
            one = 0.0
            two = 0.0
        else:
            if dt_s[k] != last:
                last = dt_s[k]
                a1 = math.exp(-last / noise.fast_s)
                a2 = math.exp(-last / noise.slow_s)
            p11 = a1 * a1 * p11 + (1.0 - a1 * a1) * v1
            p12 = a1 * a2 * p12
            p22 = a2 * a2 * p22 + (1.0 - a2 * a2) * v2
            one *= a1
            two *= a2
        if not known[k]:
            continue
        s = p11 + 2.0 * p12 + p22 + w
        e = residual[k] - one - two
        g1 = (p11 + p12) / s
        g2 = (p12 + p22) / s
        one += g1 * e
        two += g2 * e
        total += 0.5 * (min(e * e / s, clip * clip) + math.log(s))
        b1 = p11 + p12
        b2 = p12 + p22
        p11 -= g1 * b1
        p12 -= g1 * b2
        p22 -= g2 * b2
    return total


@cached(error_model="numpy", nogil=True, fastmath={"reassoc", "contract"})
def normal_equations(
    white: FloatArray, used: BoolArray, clip: float, normal: FloatArray, gradient: FloatArray
) -> None:
    """Add J' W J and J' W e of whitened rows [e, J]; W holds residuals beyond ``clip`` (Huber).

    Rows are gathered in blocks that fit the cache, one column after the other: a product that
    needs no threads of a linear algebra library beside those of the model comparison.
    """
    rows, many = white.shape
    block = np.empty((many, BLOCK_ROWS))
    filled = 0
    for k in range(rows):
        if used[k]:
            size = abs(white[k, 0])
            w = 1.0 if size <= clip else math.sqrt(clip / size)
            for c in range(many):
                block[c, filled] = w * white[k, c]
            filled += 1
        if filled == BLOCK_ROWS or (k == rows - 1 and filled > 0):
            for i in range(1, many):
                total = 0.0
                for r in range(filled):
                    total += block[i, r] * block[0, r]
                gradient[i - 1] += total
                for j in range(i, many):
                    total = 0.0
                    for r in range(filled):
                        total += block[i, r] * block[j, r]
                    normal[i - 1, j - 1] += total
            filled = 0
    for i in range(many - 1):
        for j in range(i):
            normal[i, j] = normal[j, i]

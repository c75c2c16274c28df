"""Normal equations of robust least squares over many rows."""

from __future__ import annotations

import math

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.typing import BoolArray, FloatArray

BLOCK_ROWS = 256


@cached(error_model="numpy", nogil=True, fastmath={"reassoc", "contract"})
def normal_equations(
    white: FloatArray, used: BoolArray, clip: float, normal: FloatArray, gradient: FloatArray
) -> None:
    """Add J' W J and J' W e of scaled rows [e, J]; W holds residuals beyond ``clip`` (Huber).

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

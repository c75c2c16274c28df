"""Root mean square of a residual."""

from __future__ import annotations

import numpy as np

from cellwise.typing import BoolArray, FloatArray


def rmse(residual: FloatArray, rows: BoolArray) -> float:
    """Root mean square over the rows [V]."""
    return float(np.sqrt(np.mean(residual[rows] ** 2))) if rows.any() else float("nan")

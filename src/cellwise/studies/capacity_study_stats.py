"""Intervals for the difference of two RMSE, and how much of an error is the SOC scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.typing import FloatArray

BLOCKS_PER_LOG = 20
DRAWS = 2000
SEED = 1


@dataclass(frozen=True)
class Difference:
    """RMSE of the other less RMSE of the best, with its 95 % interval."""

    value: float
    low: float
    high: float


def difference(
    other: Sequence[FloatArray],
    best: Sequence[FloatArray],
    rng: np.random.Generator | None = None,
) -> Difference:
    """How much larger one RMSE is than another on the same logs.

    The logs are cut into blocks that hold an error for longer than it is remembered, and the blocks
    are drawn again, for both errors together: errors that go up and down together leave a narrow
    interval (paired block bootstrap; H. R. Kuensch, Ann. Statist. 17 (1989) 1217,
    doi:10.1214/aos/1176347265).

    Parameters
    ----------
    other, best : of (rows,) float     errors, one array per log
    """
    rng = np.random.default_rng(SEED) if rng is None else rng
    a, b, n = _blocks(other), _blocks(best), _counts(other)
    drawn = rng.integers(0, n.size, (DRAWS, n.size))
    rows = n[drawn].sum(axis=1)
    differences = np.sqrt(a[drawn].sum(axis=1) / rows) - np.sqrt(b[drawn].sum(axis=1) / rows)
    low, high = np.quantile(differences, (0.025, 0.975))
    value = np.sqrt(a.sum() / n.sum()) - np.sqrt(b.sum() / n.sum())
    return Difference(float(value), float(low), float(high))


def axis_share(errors: Sequence[FloatArray], axis: Sequence[FloatArray]) -> float:
    """Part of a squared SOC error that goes when the choice's own SOC scale is the reference.

    ``axis`` is what the choice's scale reads on the counter less the reference. 1: the error is
    nothing but the scale; 0: the scale has no part in it; negative: the scale made up for another
    error.
    """
    e, a = np.concatenate(errors), np.concatenate(axis)
    known = np.isfinite(e) & np.isfinite(a)
    whole = float(np.sum(e[known] ** 2))
    rest = float(np.sum((e[known] - a[known]) ** 2))
    return 1.0 - rest / whole if whole > 0.0 else 0.0


def _cuts(error: FloatArray) -> list[FloatArray]:
    return list(np.array_split(error, min(BLOCKS_PER_LOG, max(error.size, 1))))


def _blocks(errors: Sequence[FloatArray]) -> FloatArray:
    """Sum of squares of every block."""
    return np.array([np.nansum(part * part) for error in errors for part in _cuts(error)])


def _counts(errors: Sequence[FloatArray]) -> FloatArray:
    return np.array([float(np.isfinite(part).sum()) for error in errors for part in _cuts(error)])

"""What one simulation gains over another on measured rows, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.cell.metrics import drawn_sums
from cellwise.diagnose.fit.rows import FITTED, HELD, Evidence
from cellwise.typing import BoolArray, FloatArray


@dataclass(frozen=True)
class Gain:
    """RMSE [V] with and without a cause, and 1 - after / before with its 95 % interval.

    Those ``in_size`` count every row by how wrong the model may be there, on held-out rows: near
    empty a few rows, hundreds of mV off, would drown all others.
    """

    train_before_V: float
    train_after_V: float
    held_before_V: float
    held_after_V: float
    gain: float
    low: float
    high: float
    before_in_size_V: float
    after_in_size_V: float
    low_in_size: float

    @property
    def gain_in_size(self) -> float:
        """1 - after / before, every row by how wrong the model may be there."""
        if self.before_in_size_V <= 0.0:
            return 0.0
        return 1.0 - self.after_in_size_V / self.before_in_size_V


def rmse(residual: FloatArray, rows: BoolArray) -> float:
    """Root mean square over the rows [V]."""
    return float(np.sqrt(np.mean(residual[rows] ** 2))) if rows.any() else float("nan")


def gain_of(
    evidence: Evidence,
    before_V: FloatArray,
    after_V: FloatArray,
    size: FloatArray,
    rng: np.random.Generator,
) -> Gain:
    """What a cause gains, from simulated voltages before and after; blocks are drawn whole.

    ``size`` (rows,) is the relative size of the model's error.
    """
    b = evidence.voltage_V - before_V
    a = evidence.voltage_V - after_V
    held = (evidence.role == HELD) & evidence.known
    train = (evidence.role == FITTED) & evidence.known
    squares = np.column_stack((b, a, b / size, a / size))[held] ** 2
    totals = drawn_sums(evidence.block[held], squares, rng)
    gains = 1.0 - np.sqrt(totals[:, 1::2] / np.maximum(totals[:, ::2], 1e-30))
    low, high = np.quantile(gains[:, 0], (0.025, 0.975))
    before, after = rmse(b, held), rmse(a, held)
    return Gain(
        rmse(b, train),
        rmse(a, train),
        before,
        after,
        1.0 - after / before if before > 0 else 0.0,
        float(low),
        float(high),
        rmse(b / size, held),
        rmse(a / size, held),
        float(np.quantile(gains[:, 1], 0.025)),
    )

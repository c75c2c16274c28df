"""Candidates side by side: how much each explains on held-out data, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.diagnose.causes import Cause
from cellwise.diagnose.evidence import FITTED, HELD, Evidence
from cellwise.diagnose.fit import Fit
from cellwise.diagnose.noise import Noise
from cellwise.typing import BoolArray, FloatArray, IntArray

RESAMPLES = 1000


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause, fitted on the fitted rows on top of what was accepted before.

    ``score`` is ln of how much more likely all rows are than without it: the evidence of the
    fitted ones plus the prediction of the held-out ones. ``terms`` are each row's part;
    ``held_low`` the lower end of a 95 % interval of the held-out rows' part, over blocks of time.
    """

    cause: Cause
    fit: Fit
    noise: Noise
    score: float
    held_score: float
    terms: FloatArray
    held_low: float

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.cause.name


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
    sums = block_sums(evidence.block[held], squares)
    totals = sums[rng.integers(0, len(sums), (RESAMPLES, len(sums)))].sum(axis=1)
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


def held_interval_low(evidence: Evidence, more: FloatArray, rng: np.random.Generator) -> float:
    """Lower end of the 95 % interval of a sum over held-out rows [nats]; blocks drawn whole."""
    held = (evidence.role == HELD) & evidence.known
    sums = block_sums(evidence.block[held], more[held][:, None])[:, 0]
    drawn = rng.integers(0, sums.size, (RESAMPLES, sums.size))
    return float(np.quantile(sums[drawn].sum(axis=1), 0.025))


def block_sums(block: IntArray, values: FloatArray) -> FloatArray:
    """Sums of the values (rows, m) over each block, shape (blocks, m)."""
    _, place = np.unique(block, return_inverse=True)
    sums = np.zeros((int(place.max()) + 1, values.shape[1]))
    np.add.at(sums, place, values)
    return sums


def difference(one: Candidate, other: Candidate, evidence: Evidence) -> tuple[float, float]:
    """By how much one explains the rows better than another, and its standard error [nats]."""
    used = ((evidence.role == HELD) | (evidence.role == FITTED)) & evidence.known
    terms = (one.terms - other.terms)[used]
    sums = block_sums(evidence.block[used], terms[:, None])[:, 0]
    error = float(np.sqrt(sums.size * np.var(sums, ddof=1))) if sums.size > 1 else float("inf")
    return one.score - other.score, error


def clearly_ahead(
    evidence: Evidence, voltages: Sequence[FloatArray], size: FloatArray, seed: int
) -> int | None:
    """Which of several simulations is nearer to the held-out rows than each other; None if none is.

    Nearer: the 95 % interval of the one's gain over the other excludes zero, plainly or with every
    row by how wrong the model may be there, and neither measure says the opposite.
    """
    for k, one in enumerate(voltages):
        over = [
            gain_of(evidence, other, one, size, np.random.default_rng(seed))
            for j, other in enumerate(voltages)
            if j != k
        ]
        if all(max(g.low, g.low_in_size) > 0.0 < min(g.gain, g.gain_in_size) for g in over):
            return k
    return None

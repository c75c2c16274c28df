"""Candidates side by side: how much each explains on held-out data, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwise.cell.metrics import RESAMPLES, block_sums
from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.decision.posterior import Hypothesis
from cellwise.diagnose.fit.gain import gain_of
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.likelihood import Prediction
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.fit.rows import FITTED, HELD, Evidence
from cellwise.typing import FloatArray


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

    def hypothesis(self, before: Sequence[str], none: Prediction) -> Hypothesis:
        """The set that it makes with the causes ``before`` it, ``none`` being those alone."""
        return Hypothesis((*before, self.name), none.total + self.score, self.terms)


def held_interval_low(evidence: Evidence, more: FloatArray, rng: np.random.Generator) -> float:
    """Lower end of the 95 % interval of a sum over held-out rows [nats]; blocks drawn whole."""
    held = (evidence.role == HELD) & evidence.known
    sums = block_sums(evidence.block[held], more[held][:, None])[:, 0]
    drawn = rng.integers(0, sums.size, (RESAMPLES, sums.size))
    return float(np.quantile(sums[drawn].sum(axis=1), 0.025))


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

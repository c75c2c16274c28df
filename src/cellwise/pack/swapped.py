"""Two cells whose voltages have changed places: a harness, or columns of an export."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellwise.pack.belief import CellBelief
from cellwise.pack.evidence import PackEvidence
from cellwise.pack.parameters import SIZE
from cellwise.pack.suspicion import Suspicion

MOST_SUSPECTS = 8
BETTER = 10.0  # log likelihood by which the exchange has to be more probable than two changes
REMAINING = 0.005  # of two large misfits, after an exchange that explains them


def swapped_cells(
    belief: CellBelief, evidence: PackEvidence, suspects: Sequence[Suspicion]
) -> tuple[int, int] | None:
    """The pair, one a suspect, of which each is what the other was; None: no such pair."""
    cells = sorted({s.cell for s in suspects})
    if not 1 <= len(cells) <= MOST_SUSPECTS:
        return None
    there = np.flatnonzero(evidence.rows > 0).tolist()
    own = {k: _misfit(belief, evidence, k, k) for k in there}
    usual = float(np.median(list(own.values())))
    best: float = BETTER
    pair = None
    for i in cells:
        for j in there:
            if j == i:
                continue
            crossed = _misfit(belief, evidence, i, j) + _misfit(belief, evidence, j, i)
            gain = own[i] + own[j] - crossed
            # Each has to be as usual a cell in the other's place, not only less odd than here. What
            # is far off is so in the regression's own error, too: a share of it may remain.
            most = 2.0 * usual + BETTER + REMAINING * (own[i] + own[j])
            if gain > best and crossed < most:
                best, pair = gain, (min(i, j), max(i, j))
    return pair


def with_swapped(evidence: PackEvidence, i: int, j: int) -> PackEvidence:
    """The evidence with two cells' places exchanged."""
    order = np.arange(evidence.rows.size)
    order[[i, j]] = order[[j, i]]
    return replace(
        evidence,
        matrix=evidence.matrix[order],
        vector=evidence.vector[order],
        rows=evidence.rows[order],
        rmse_V=evidence.rmse_V[order],
    )


def _misfit(belief: CellBelief, evidence: PackEvidence, cell: int, source: int) -> float:
    """Minus log likelihood of one column's evidence under what is known of a cell."""
    a, p = evidence.matrix[source], belief.covariance[cell]
    surprise = evidence.vector[source] - a @ belief.mean[cell]
    pull = np.linalg.solve(np.eye(SIZE) + a @ p, surprise)
    # surprise' (A + A P A)^-1 surprise, of an A that may say nothing of some parameters
    return float(0.5 * pull @ np.linalg.lstsq(a, surprise, rcond=1e-10)[0])

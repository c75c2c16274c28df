"""Sets of causes weighed against each other: how probable each cause is.

Evidence is summed over blocks of time, and the blocks are weighted at random (Bayesian bootstrap):
where the noise is what the likelihood takes it for, that changes little; where a model is wrong
otherwise, what rests on a few blocks is no longer certain. The weights are those of
pseudo-Bayesian model averaging (Yao et al., 2018, doi:10.1214/17-BA1091).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.cell.metrics import block_sums
from cellwise.diagnose.fit.rows import FITTED, HELD, Evidence
from cellwise.typing import FloatArray

DRAWS = 1000
# A cause is named from this probability on.
NAMED = 0.9
NAMED_NATS = math.log(NAMED / (1.0 - NAMED))
# Explanations below this are not worth a line.
LEAST_WEIGHT = 0.02


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of causes, ln p of all rows with them estimated, each row's part of it, its rarity."""

    causes: tuple[str, ...]
    total: float
    terms: FloatArray
    rarity: float = 0.0


@dataclass(frozen=True)
class Weighed:
    """A set of causes and its probability among all that were weighed."""

    causes: tuple[str, ...]
    probability: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {"causes": list(self.causes), "probability": self.probability}


def weigh(
    hypotheses: Sequence[Hypothesis], evidence: Evidence, rng: np.random.Generator
) -> tuple[Weighed, ...]:
    """Probability of every set, most probable first; of the same set the best fit counts."""
    best: dict[frozenset[str], Hypothesis] = {}
    for one in hypotheses:
        known = best.get(frozenset(one.causes))
        if known is None or one.total > known.total:
            best[frozenset(one.causes)] = one
    sets = list(best.values())
    if not sets:
        return ()
    used = ((evidence.role == HELD) | (evidence.role == FITTED)) & evidence.known
    blocks = block_sums(evidence.block[used], np.column_stack([h.terms[used] for h in sets]))
    rest = np.array([h.total for h in sets]) - blocks.sum(axis=0)
    rest -= np.array([h.rarity for h in sets])
    many = len(blocks)
    draws = many * rng.dirichlet(np.ones(many), DRAWS)
    score = draws @ blocks + rest
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    share = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
    found = [Weighed(h.causes, float(p)) for h, p in zip(sets, share, strict=True)]
    return tuple(sorted(found, key=lambda w: -w.probability))


def probability_of(name: str, weighed: Sequence[Weighed]) -> float:
    """What the sets that hold a cause weigh together."""
    return float(sum(w.probability for w in weighed if name in w.causes))

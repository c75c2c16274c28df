"""Probabilities of sets of causes: what they must be whatever the numbers."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cellwise.diagnose.fit.rows import FITTED
from cellwise.diagnose.odds import (
    NAMING,
    probability_of,
    weigh,
)

BLOCKS, ROWS = 20, 50


def rows():
    many = BLOCKS * ROWS
    return SimpleNamespace(
        role=np.full(many, FITTED),
        known=np.ones(many, dtype=bool),
        block=np.repeat(np.arange(BLOCKS), ROWS),
    )


def hypothesis(*names, per_block, rarity=0.0):
    """A set whose evidence in each block is given [nats]."""
    terms = np.repeat(np.asarray(per_block, dtype=float) / ROWS, ROWS)
    return names, float(np.sum(per_block)) - rarity, terms


def weights(*sets, seed=0):
    return weigh(sets, rows(), np.random.default_rng(seed))


def test_even_evidence_gives_the_odds_of_bayes():
    """Where every block says the same, weighting blocks at random changes nothing."""
    ahead = 1.5
    one = hypothesis("a", per_block=np.full(BLOCKS, ahead / BLOCKS))
    other = hypothesis("b", per_block=np.zeros(BLOCKS))
    a, b = weights(one, other)
    assert a.probability / b.probability == pytest.approx(math.exp(ahead), rel=1e-6)


def test_a_set_costs_its_rarity():
    one = hypothesis("a", per_block=np.zeros(BLOCKS), rarity=2.0)
    both = hypothesis("a", "b", per_block=np.zeros(BLOCKS), rarity=5.0)
    found = weights(one, both)
    ratio = found[0].probability / found[1].probability
    assert ratio == pytest.approx(math.exp(3.0), rel=1e-6)
    assert probability_of("a", found) == pytest.approx(1.0)
    assert probability_of("b", found) == found[1].probability


def test_what_rests_on_one_block_is_never_certain():
    """All evidence in one block of twenty, against a little in every other."""
    lone = np.full(BLOCKS, -2.0)
    lone[7] = 200.0
    spread = np.full(BLOCKS, (200.0 - 2.0 * (BLOCKS - 1)) / BLOCKS)
    none = hypothesis(per_block=np.zeros(BLOCKS))
    assert weights(none, hypothesis("a", per_block=lone))[0].probability < NAMING.least
    assert weights(none, hypothesis("a", per_block=spread))[0].probability > 0.999

"""What is free beside the filter's states: weights of the hypotheses, and what they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.estimate.adaptive import AdaptiveSettings
from cellwise.estimate.filters.capacity_kernels import (
    forgotten,
    likelihood,
    nothing_known,
    weighed,
)
from cellwise.estimate.filters.offset_kernels import no_drift

RULES = AdaptiveSettings().rules()
ODDS = np.array([RULES.offset_odds, RULES.capacity_odds])


def told(information, score):
    """Capacity and offset of which the voltages have said so much, per prior deviation."""
    d = no_drift()._replace(score=score[0], information=information[0, 0])
    c = nothing_known(RULES).capacity._replace(
        score=score[1], information=information[1, 1], cross=information[0, 1]
    )
    return c, d


def drawn(seed):
    a = np.random.default_rng(seed).normal(size=(2, 2)) * 3.0
    information = np.eye(2) + a @ a.T
    return information, information @ np.random.default_rng(seed + 9).normal(size=2)


@pytest.mark.parametrize("seed", range(4))
def test_mean_and_covariance_are_those_of_four_hypotheses(seed):
    information, score = drawn(seed)
    best = float(score @ np.linalg.solve(information, score))
    weights, parts = [1.0], [(np.zeros(2), np.zeros((2, 2)))]
    for free in ([0], [1], [0, 1]):
        inner = information[np.ix_(free, free)]
        mean, cov = np.zeros(2), np.zeros((2, 2))
        mean[free] = np.linalg.solve(inner, score[free])
        cov[np.ix_(free, free)] = np.linalg.inv(inner)
        square = float(score[free] @ mean[free])
        weights.append(np.prod(ODDS[free]) * likelihood(square, best, float(np.linalg.det(inner))))
        parts.append((mean, cov))
    weight = np.array(weights) / np.sum(weights)
    mean = sum(w * m for w, (m, _) in zip(weight, parts, strict=True))
    square = sum(w * (c + np.outer(m, m)) for w, (m, c) in zip(weight, parts, strict=True))
    cov = square - np.outer(mean, mean)
    c, d = weighed(*told(information, score), RULES)
    np.testing.assert_allclose((d.believed, c.believed), mean, rtol=1e-9)
    np.testing.assert_allclose((d.unsure, c.unsure, c.shared), (cov[0, 0], cov[1, 1], cov[0, 1]))
    assert c.offset_chance == pytest.approx(weight[1] + weight[3])
    assert c.chance == pytest.approx(weight[2] + weight[3])


def test_what_wanders_is_forgotten_down_to_what_was_known_before():
    """All evidence by the same factor, so that none of it changes sides."""
    information, score = drawn(2)
    before = told(information, score)
    c, d = before
    for _ in range(100):
        c, d = forgotten(c, d, RULES, 3.6e6)
    np.testing.assert_allclose((c.information, d.information, c.score, d.score), (1, 1, 0, 0),
                               atol=1e-3)  # fmt: skip
    c, d = forgotten(*before, RULES, 3600.0)
    keep = (c.information - 1.0) / (information[1, 1] - 1.0)
    assert 0.0 < keep < 1.0
    assert d.information - 1.0 == pytest.approx(keep * (information[0, 0] - 1.0))
    left = c.cross, c.score, d.score
    assert left == pytest.approx(keep * np.array([information[0, 1], score[1], score[0]]))

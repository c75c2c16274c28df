"""The adaptive filter's parameters: hypotheses, rests, what is known once they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellwise.estimate.adaptive.covariance_kernels import AdaptiveCovariance
from cellwise.estimate.adaptive.mixture_kernels import Before, mix
from cellwise.estimate.adaptive.predict_kernels import forgotten
from cellwise.estimate.adaptive.settings import AdaptiveSettings
from cellwise.estimate.adaptive.state_kernels import Persistent, Rest, settled_variance
from cellwise.estimate.adaptive.watch_kernels import watch_rest

SOC, B, Q = 0, 5, 6
STATES = 7


def covariance(seed: int, n: int = STATES) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def upper(p: np.ndarray) -> AdaptiveCovariance:
    """P as the kernels take it."""
    return AdaptiveCovariance(*(float(v) for v in p[np.triu_indices(STATES)]))


@pytest.mark.parametrize("known", [(), (B,), (Q,), (B, Q)])
def test_settled_variance_is_the_conditional_one(known):
    p = covariance(6)
    for j in known:
        p[j, :] = p[:, j] = 0.0
    free = [j for j in (B, Q) if j not in known]
    want = p[SOC, SOC]
    if free:
        cross = p[SOC, free]
        want -= cross @ np.linalg.solve(p[np.ix_(free, free)], cross)
    assert settled_variance(upper(p)) == pytest.approx(want)


def test_what_wanders_leaves_the_hypotheses_that_fix_it_alone():
    p = covariance(8)
    after = forgotten(upper(p), 0.3, 0.2)
    found = np.zeros((STATES, STATES))
    found[np.triu_indices(STATES)] = after
    found += np.triu(found, 1).T
    assert found[B, B] > p[B, B] + 0.29
    assert found[Q, Q] == pytest.approx(
        p[Q, Q] * (1.0 + 0.3 * p[B, Q] ** 2 / p[B, B] ** 2 / p[Q, Q]) + 0.2
    )
    free = [B, Q]
    rest = [j for j in range(STATES) if j not in free]

    def fixed(c):
        """Covariance of the other states, given both; and by how much they go with both."""
        by = np.linalg.solve(c[np.ix_(free, free)], c[np.ix_(free, rest)])
        return c[np.ix_(rest, rest)] - c[np.ix_(rest, free)] @ by, by

    for now, before in zip(fixed(found), fixed(p), strict=True):
        np.testing.assert_allclose(now, before, atol=1e-9)


class TestMixture:
    """Four linear models of the same data, each with its own evidence, in closed form."""

    prior = np.diag([0.04, 0.09, 0.0064])  # soc, b, q
    rng = np.random.default_rng(7)
    design = rng.normal(size=(12, 3))
    noise = 0.05

    def posterior(self, y, free):
        """Mean, covariance and log evidence where only ``free`` columns may differ from 0."""
        a, s = self.design[:, free], self.prior[np.ix_(free, free)]
        c = a @ s @ a.T + self.noise * np.eye(len(y))
        gain = s @ a.T @ np.linalg.inv(c)
        log = -0.5 * (y @ np.linalg.solve(c, y) + np.linalg.slogdet(c)[1])
        return gain @ y, s - gain @ a @ s, log

    @pytest.mark.parametrize("truth", [(0.1, 0, 0), (0.1, 0.3, 0), (0.1, 0, 0.1), (0, 0.3, -0.1)])
    @pytest.mark.parametrize("log_odds", [0.0, 1.5])
    def test_it_is_bayes_over_four_models(self, truth, log_odds):
        y = self.design @ truth + np.sqrt(self.noise) * self.rng.normal(size=12)
        models = {(0, 1, 2): 0.0, (0, 2): log_odds, (0, 1): log_odds, (0,): 2 * log_odds}
        logs, parts = [], []
        for free, odds in models.items():
            mean, cov, log = self.posterior(y, list(free))
            full, full_cov = np.zeros(3), np.zeros((3, 3))
            full[list(free)] = mean
            full_cov[np.ix_(free, free)] = cov
            logs.append(log + odds)
            parts.append((full, full_cov))
        weight = np.exp(np.array(logs) - max(logs))
        weight /= weight.sum()
        mean = sum(w * m for w, (m, _) in zip(weight, parts, strict=True))
        square = sum(w * (c + np.outer(m, m)) for w, (m, c) in zip(weight, parts, strict=True))
        variance = np.diag(square - np.outer(mean, mean))
        m, p, _ = self.posterior(y, [0, 1, 2])
        told = mix(m[0], p[0, 0], m[1], m[2], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2],
                   Before(self.prior[1, 1], self.prior[2, 2], *2 * (math.exp(log_odds),)),
                   Persistent(0.0, 0.0, 0.0))  # fmt: skip
        np.testing.assert_allclose((told.soc, told.offset_A, told.charge), mean, rtol=1e-6)
        found = (told.soc_variance, told.offset_variance, told.charge_variance)
        np.testing.assert_allclose(found, variance, rtol=1e-6)
        assert told.offset_probability == pytest.approx(weight[0] + weight[2])
        assert told.charge_probability == pytest.approx(weight[0] + weight[1])

    @pytest.mark.parametrize("learnt", [1, 2])
    def test_a_parameter_without_prior_is_out_of_the_question(self, learnt):
        y = self.design @ (0.1, 0.3, -0.1)
        free = [0, learnt]
        m, p, log1 = self.posterior(y, free)
        m0, p0, log0 = self.posterior(y, [0])
        w = 1.0 / (1.0 + math.exp(log0 - log1))
        two = np.zeros(3), np.zeros((3, 3))
        two[0][free] = m
        two[1][np.ix_(free, free)] = p
        prior = [self.prior[j, j] if j == learnt else 0.0 for j in range(3)]
        x, c = two
        told = mix(x[0], c[0, 0], x[1], x[2], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2],
                   Before(prior[1], prior[2], 1.0, 1.0), Persistent(0.0, 0.0, 0.0))  # fmt: skip
        mean = w * m[0] + (1 - w) * m0[0]
        assert told.soc == pytest.approx(mean)
        square = w * (p[0, 0] + m[0] ** 2) + (1 - w) * (p0[0, 0] + m0[0] ** 2)
        assert told.soc_variance == pytest.approx(square - mean**2)
        assert (told.offset_A, told.charge)[2 - learnt] == 0.0
        assert (told.offset_A, told.charge)[learnt - 1] == pytest.approx(w * m[1])


class TestRest:
    learn = AdaptiveSettings(rest_s=100.0, rest_limit_C=0.05, rest_band_C=0.01).scalars(2.0)

    def rests(self, current):
        rest, found = Rest(0.0, 0.0, False), []
        for i in current:
            rest, shows = watch_rest(self.learn, rest, float(i), 1.0)
            found.append(shows)
        return found

    def test_a_still_small_current_is_a_rest_once(self):
        told = self.rests(np.full(500, 0.08))
        assert sum(told) == 1
        assert told.index(True) in (100, 101)

    def test_every_rest_counts(self):
        drive = np.full(50, 1.0)
        still = np.full(200, 0.08)
        assert sum(self.rests(np.concatenate((still, drive, still)))) == 2

    @pytest.mark.parametrize(
        "current",
        [np.full(500, 0.2), np.tile([0.08, 0.03], 250), np.tile(np.r_[np.full(60, 0.05), 1.0], 8)],
    )
    def test_loads_moving_currents_and_short_stops_are_none(self, current):
        assert not any(self.rests(current))

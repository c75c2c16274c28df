"""The adaptive filter's algebra against the matrix formulas that it stands for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellwise.estimate.filters.adaptive_mixture_kernels import mix
from cellwise.estimate.filters.adaptive_settings import AdaptiveSettings
from cellwise.estimate.filters.adaptive_state_kernels import (
    MEMORY,
    SOC,
    STATES,
    V1,
    V2,
    V3,
    B,
    H,
    Q,
    correct,
    flatten,
    lean,
    observe,
    settled_variance,
    spread,
)
from cellwise.estimate.filters.adaptive_watch_kernels import watch_rest


def upper(p: np.ndarray) -> np.ndarray:
    """P as the kernels take it: row by row, nothing below the diagonal."""
    return np.triu(p).ravel()


def whole(flat: np.ndarray) -> np.ndarray:
    """And back."""
    p = flat.reshape(STATES, STATES)
    return np.triu(p) + np.triu(p, 1).T


def covariance(seed: int, n: int = STATES) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def test_spread_is_f_p_f_transposed():
    p = covariance(1)
    a1, a2, a3, ah, sb, sq, g1, g2, g3 = 0.9, 0.8, 0.99, 0.7, 0.3, -0.2, 0.05, 0.06, 0.02
    f = np.diag([1.0, a1, a2, a3, ah, 1.0, 1.0])
    f[SOC, B], f[SOC, Q] = sb, sq
    f[V1, B], f[V2, B], f[V3, B] = -g1, -g2, -g3
    found = upper(p)
    spread(found, a1, a2, a3, ah, sb, sq, g1, g2, g3)
    np.testing.assert_allclose(whole(found), f @ p @ f.T, rtol=1e-12)


def test_lean_is_f_p_f_transposed():
    p = covariance(2)
    f = np.eye(STATES)
    f[V1, SOC], f[V2, SOC], f[V3, SOC] = 0.1, -0.2, 0.3
    found = upper(p)
    lean(found, 0.1, -0.2, 0.3)
    np.testing.assert_allclose(whole(found), f @ p @ f.T, rtol=1e-12)


def test_observe_is_p_h_transposed():
    p, d = covariance(3), np.empty(STATES)
    slope, m, r, w, r0 = 0.8, 0.02, 1.2, 0.7, 0.03
    h = np.zeros(STATES)
    h[[SOC, V1, V2, V3, H, B]] = slope, -r, -w, -w, m, r * r0
    variance = observe(upper(p), d, slope, m, r, w, r0)
    np.testing.assert_allclose(d, p @ h, rtol=1e-12)
    assert variance == pytest.approx(h @ p @ h)


@pytest.mark.parametrize("hold_b", [False, True])
@pytest.mark.parametrize("hold_q", [False, True])
def test_correction_is_the_consider_filters(hold_b, hold_q):
    """Any gain K gives (I - K h') P (I - K h')' + K R K'; held rows of K are zero."""
    p, h, noise, innovation = covariance(4), np.zeros(STATES), 0.5, 0.03
    h[[SOC, V1, V2, V3, H, B]] = 0.8, -1.0, -1.0, -1.0, 0.02, 0.03
    x = np.array([0.5, 0.01, 0.0, 0.0, 0.2, 0.1, 1.0])
    d = p @ h
    inverse = 1.0 / (h @ d + noise)
    k = d * inverse
    k[B] *= not hold_b
    k[Q] *= not hold_q
    a = np.eye(STATES) - np.outer(k, h)
    want_p = a @ p @ a.T + noise * np.outer(k, k)
    want_x = x + k * innovation
    found = upper(p)
    correct(x, found, d, inverse, innovation, hold_b, hold_q)
    np.testing.assert_allclose(x, want_x, rtol=1e-12)
    np.testing.assert_allclose(whole(found), want_p, atol=1e-12)


def test_flatten_then_correct_is_the_steep_slopes_gain_on_the_flat_one():
    p, noise = covariance(5), 0.5
    p[B:, :] = p[:, B:] = 0.0  # offset and capacity known: all states are corrected
    h = np.zeros(STATES)
    h[[SOC, V1, V2, V3, H]] = 0.8, -1.0, -1.0, -1.0, 0.02
    flat = h.copy()
    flat[SOC] = 0.7
    d, c = p @ h, np.empty(STATES)
    inverse = 1.0 / (h @ d + noise)
    k = d * inverse
    a = np.eye(STATES) - np.outer(k, flat)
    want = a @ p @ a.T + noise * np.outer(k, k)
    found = upper(p)
    assert want[SOC, SOC] < p[SOC, SOC]  # something was learnt
    assert flatten(found, d, c, inverse, flat[SOC] - h[SOC])
    correct(np.zeros(STATES) + 0.5, found, d, inverse, 0.0, True, True)
    np.testing.assert_allclose(whole(found), want, atol=1e-9)


@pytest.mark.parametrize("flat_V", [0.0, 0.1, 0.3, 0.45])
def test_a_plateau_teaches_nothing_and_unteaches_nothing(flat_V):
    """A gain of a steep slope that leads onto a flat one never makes the SOC less known."""
    slope, soc_variance = 0.5, 0.0225
    noise = slope**2 * soc_variance
    p = np.zeros((STATES, STATES))
    p[SOC, SOC] = soc_variance
    d, c = np.zeros(STATES), np.empty(STATES)
    d[SOC] = slope * soc_variance
    inverse = 1.0 / (slope * d[SOC] + noise)
    gain = d[SOC] * inverse
    want = (1.0 - gain * flat_V) ** 2 * soc_variance + gain**2 * noise
    found = upper(p)
    learnt = flatten(found, d, c, inverse, flat_V - slope)
    assert learnt == (want < soc_variance)
    if learnt:
        correct(np.zeros(STATES) + 0.5, found, d, inverse, 0.0, True, True)
        assert found[0] == pytest.approx(want)
    else:
        np.testing.assert_array_equal(found, upper(p))


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
                   self.prior[1, 1], self.prior[2, 2], math.exp(log_odds))  # fmt: skip
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
                   prior[1], prior[2], 1.0)  # fmt: skip
        mean = w * m[0] + (1 - w) * m0[0]
        assert told.soc == pytest.approx(mean)
        square = w * (p[0, 0] + m[0] ** 2) + (1 - w) * (p0[0, 0] + m0[0] ** 2)
        assert told.soc_variance == pytest.approx(square - mean**2)
        assert (told.offset_A, told.charge)[2 - learnt] == 0.0
        assert (told.offset_A, told.charge)[learnt - 1] == pytest.approx(w * m[1])


class TestRest:
    learn = AdaptiveSettings(rest_s=100.0, rest_limit_C=0.05, rest_band_C=0.01).scalars(2.0)

    def rests(self, current):
        memory = np.zeros(MEMORY)
        return [watch_rest(self.learn, memory, float(i), 1.0) for i in current]

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

"""The printed covariance algebra against the matrix formulas that it stands for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cellwise.cell.description import ADAPTIVE, CELL, entry, triangle
from cellwise.cell.equations import Transition
from cellwise.estimate.adaptive import covariance_kernels as seven
from cellwise.estimate.filters import covariance_kernels as five

T = Transition(a1=0.9, a2=0.8, a3=0.99, ah=0.7, gs=-1e-3, g1=0.05, g2=0.06, g3=0.02)
CASES = [
    pytest.param(
        SimpleNamespace(k=five, P=five.Covariance, D=five.Column, states=CELL, h=(0.8, 0.02)),
        id="ekf",
    ),
    pytest.param(
        SimpleNamespace(
            k=seven, P=seven.AdaptiveCovariance, D=seven.AdaptiveColumn, states=ADAPTIVE,
            h=(0.8, 0.02, 1.2, 0.036),
        ),
        id="adaptive",
    ),
]  # fmt: skip
both = pytest.mark.parametrize("case", CASES)


def matrix(case, p):
    """A record of the upper triangle as a symmetric matrix."""
    n = len(case.states)
    found = np.zeros((n, n))
    for (a, b), value in zip(triangle(case.states), p, strict=True):
        found[case.states.index(a), case.states.index(b)] = value
    return found + np.triu(found, 1).T


def record(case, p):
    """And back."""
    return case.P(*(float(v) for v in p[np.triu_indices(len(case.states))]))


def drawn(case, seed):
    n = len(case.states)
    a = np.random.default_rng(seed).normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def row_of_derivatives(case):
    """H of the voltage."""
    if len(case.h) == 2:
        return np.array([case.h[0], -1.0, -1.0, -1.0, case.h[1]])
    slope, m, fast, r0 = case.h
    return np.array([slope, -fast, -1.0, -1.0, m, r0, 0.0])


@both
def test_fields_are_the_upper_triangle_row_by_row(case):
    assert case.P._fields == tuple(entry(a, b) for a, b in triangle(case.states))


@both
def test_decayed_is_a_p_a_transposed(case):
    p = drawn(case, 1)
    n = len(case.states)
    a = np.diag([1.0, T.a1, T.a2, T.a3, T.ah, 1.0, 1.0][:n])
    np.testing.assert_allclose(matrix(case, case.k.decayed(record(case, p), T)), a @ p @ a)


@both
def test_leaned_is_f_p_f_transposed(case):
    p = drawn(case, 2)
    f = np.eye(len(case.states))
    f[1, 0], f[2, 0], f[3, 0] = 0.1, -0.2, 0.3
    found = case.k.leaned(record(case, p), 0.1, -0.2, 0.3)
    np.testing.assert_allclose(matrix(case, found), f @ p @ f.T, rtol=1e-12)


def test_offset_and_capacity_drive_what_they_drive():
    case = CASES[1].values[0]
    p = drawn(case, 3)
    f = np.eye(7)
    f[0, 5], f[1, 5], f[2, 5], f[3, 5], f[0, 6] = 0.3, -0.05, -0.06, -0.02, -0.2
    found = seven.offset_driven(record(case, p), 0.3, -0.05, -0.06, -0.02)
    found = seven.charge_driven(found, -0.2)
    np.testing.assert_allclose(matrix(case, found), f @ p @ f.T, rtol=1e-12)


@both
def test_noise_of_the_current_drives_soc_and_branches_together(case):
    p = drawn(case, 4)
    g = np.zeros(len(case.states))
    g[:4] = T.gs, T.g1, T.g2, T.g3
    want = p + 0.5 * np.outer(g, g)
    want[np.diag_indices(4)] += 0.1, 0.2, 0.3, 0.4
    found = case.k.noisy(record(case, p), T, 0.5, 0.5, 0.1, 0.2, 0.3, 0.4)
    np.testing.assert_allclose(matrix(case, found), want, rtol=1e-12)


@both
def test_column_is_p_h_transposed(case):
    p, h = drawn(case, 5), row_of_derivatives(case)
    d = case.k.column(record(case, p), *case.h)
    np.testing.assert_allclose(d, p @ h, rtol=1e-12)
    assert case.k.explained(d, *case.h) == pytest.approx(h @ p @ h)


@both
def test_corrected_is_the_kalman_update(case):
    p, h = drawn(case, 6), row_of_derivatives(case)
    d = p @ h
    gain = d / (h @ d + 0.5)
    found = case.k.corrected(record(case, p), case.D(*gain), case.D(*d))
    np.testing.assert_allclose(matrix(case, found), p - np.outer(gain, d), atol=1e-12)


@both
def test_rejudged_then_corrected_is_the_steep_slopes_gain_on_the_flat_one(case):
    """Joseph's form with the gain of one slope and the row of another."""
    p, noise = drawn(case, 7), 0.5
    p[5:, :] = p[:, 5:] = 0.0  # offset and capacity known: all other states are corrected
    h = row_of_derivatives(case)
    h[5:] = 0.0
    flat = h.copy()
    flat[0] = 0.7
    d = p @ h
    k = d / (h @ d + noise)
    a = np.eye(len(h)) - np.outer(k, flat)
    want = a @ p @ a.T + noise * np.outer(k, k)
    less = flat[0] - h[0]
    e = less * (2.0 * d[0] + less * p[0, 0])
    start = record(case, p)
    found = case.k.rejudged(start, case.D(*k), case.k.soc_row(start, less), e)
    found = case.k.corrected(found, case.D(*k), case.D(*d))
    np.testing.assert_allclose(matrix(case, found), want, atol=1e-9)


@pytest.mark.parametrize("flat_V", [0.0, 0.1, 0.3, 0.45])
def test_a_plateau_teaches_nothing_and_loses_nothing(flat_V):
    """A gain of a steep slope that leads onto a flat one never makes the SOC less known."""
    case = CASES[0].values[0]
    slope, variance = 0.5, 0.0225
    noise = slope**2 * variance
    p = five.uncorrelated(variance, 0.0, 0.0, 0.0, 0.0)
    d = five.column(p, slope, 0.0)
    k = five.scaled(d, 1.0 / (slope * d.s + noise))
    less = flat_V - slope
    e = less * (2.0 * d.s + less * p.ss)
    c = five.soc_row(p, less)
    learnt = k.s * (k.s * e - 2.0 * c.s) < k.s * d.s
    want = (1.0 - k.s * flat_V) ** 2 * variance + k.s**2 * noise
    assert learnt == (want < variance)
    after = five.corrected(five.rejudged(p, k, c, e), k, d)
    assert matrix(case, after)[0, 0] == pytest.approx(want)


def test_given_the_soc_and_back():
    """P less the outer product of its first column over its root has no SOC left in it."""
    case = CASES[0].values[0]
    p = drawn(case, 8)
    along = p[0] / np.sqrt(p[0, 0])
    found = matrix(case, five.without_outer(record(case, p), five.Column(*along)))
    want = p - np.outer(along, along)
    np.testing.assert_allclose(found[1:, 1:], want[1:, 1:], rtol=1e-12)
    none = five.Column(0.0, 0.0, 0.0, 0.0, 0.0)
    back = five.with_outer(record(case, found), five.Column(*along), 1.0, none)
    np.testing.assert_allclose(matrix(case, back)[1:, 1:], p[1:, 1:], rtol=1e-12)
    row = five.with_soc_row(record(case, p), 2.0, five.Column(*along), 3.0)
    np.testing.assert_allclose(matrix(case, row)[0], [2.0, *(3.0 * along[1:])])


@pytest.mark.parametrize("hold_b", [False, True])
@pytest.mark.parametrize("hold_q", [False, True])
def test_held_parameters_are_the_consider_filters(hold_b, hold_q):
    """Any gain K gives (I - K h') P (I - K h')' + K R K'; held rows of K are zero."""
    from cellwise.estimate.adaptive.step_kernels import consider

    case = CASES[1].values[0]
    p, noise, h = drawn(case, 9), 0.5, row_of_derivatives(case)
    d = p @ h
    full = d / (h @ d + noise)
    k = full.copy()
    k[5] *= not hold_b
    k[6] *= not hold_q
    a = np.eye(7) - np.outer(k, h)
    want = a @ p @ a.T + noise * np.outer(k, k)
    gain, after = consider(
        seven.AdaptiveColumn(*full), seven.AdaptiveColumn(*d), record(case, p), hold_b, hold_q
    )
    np.testing.assert_allclose(gain, k)
    np.testing.assert_allclose(matrix(case, after), want, atol=1e-12)

"""The printed covariance algebra against the matrix formulas that it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.description import CELL, entry, triangle
from cellwise.cell.equations import Transition
from cellwise.estimate.equations.covariance import Column, column_of, explained
from cellwise.estimate.filters import covariance_kernels as five

T = Transition(a1=0.9, a2=0.8, a3=0.99, ah=0.7, gs=-1e-3, g1=0.05, g2=0.06, g3=0.02)
H = np.array([0.8, -1.0, -1.0, -1.0, 0.02])  # slope, branches, M
OUTPUT = (0.8, 0.02)


def matrix(p):
    """A record of the upper triangle as a symmetric matrix."""
    n = len(CELL)
    found = np.zeros((n, n))
    for (a, b), value in zip(triangle(CELL), p, strict=True):
        found[CELL.index(a), CELL.index(b)] = value
    return found + np.triu(found, 1).T


def record(p):
    """And back."""
    return five.Covariance(*(float(v) for v in p[np.triu_indices(len(CELL))]))


def drawn(seed):
    n = len(CELL)
    a = np.random.default_rng(seed).normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def test_fields_are_the_upper_triangle_row_by_row():
    assert five.Covariance._fields == tuple(entry(a, b) for a, b in triangle(CELL))


def test_decayed_is_a_p_a_transposed():
    p = drawn(1)
    a = np.diag([1.0, T.a1, T.a2, T.a3, T.ah])
    np.testing.assert_allclose(matrix(five.decayed(record(p), T)), a @ p @ a)


def test_a_soc_that_drives_the_branches_is_f_p_f_transposed():
    p = drawn(2)
    f = np.eye(len(CELL))
    f[1, 0], f[2, 0], f[3, 0] = 0.1, -0.2, 0.3
    found = five.driven_by_soc(record(p), five.Branches(0.1, -0.2, 0.3))
    np.testing.assert_allclose(matrix(found), f @ p @ f.T, rtol=1e-12)


def test_noise_of_the_current_drives_soc_and_branches_together():
    p = drawn(4)
    g = np.zeros(len(CELL))
    g[:4] = T.gs, T.g1, T.g2, T.g3
    want = p + 0.5 * np.outer(g, g)
    want[np.diag_indices(4)] += 0.1, 0.2, 0.3, 0.4
    found = five.noisy(record(p), T, 0.5, 0.5, 0.1, five.Branches(0.2, 0.3, 0.4))
    np.testing.assert_allclose(matrix(found), want, rtol=1e-12)


def test_column_is_p_h_transposed():
    p, h = drawn(5), H
    d = column_of(record(p), *OUTPUT)
    np.testing.assert_allclose(d, p @ h, rtol=1e-12)
    assert explained(d, *OUTPUT) == pytest.approx(h @ p @ h)


def test_corrected_is_the_kalman_update():
    p, h = drawn(6), H
    d = p @ h
    gain = d / (h @ d + 0.5)
    found = five.corrected(record(p), Column(*gain), Column(*d))
    np.testing.assert_allclose(matrix(found), p - np.outer(gain, d), atol=1e-12)


def test_given_the_soc_and_back():
    """P less the outer product of its first column over its root has no SOC left in it."""
    p = drawn(8)
    along = p[0] / np.sqrt(p[0, 0])
    found = matrix(five.without_outer(record(p), Column(*along)))
    want = p - np.outer(along, along)
    np.testing.assert_allclose(found[1:, 1:], want[1:, 1:], rtol=1e-12)
    none = Column(0.0, 0.0, 0.0, 0.0, 0.0)
    back = five.with_outer(record(found), Column(*along), 1.0, none)
    np.testing.assert_allclose(matrix(back)[1:, 1:], p[1:, 1:], rtol=1e-12)
    row = five.with_soc_row(record(p), 2.0, Column(*along), 3.0)
    np.testing.assert_allclose(matrix(row)[0], [2.0, *(3.0 * along[1:])])

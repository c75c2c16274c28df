"""The solver: what a linear problem has in closed form, and other people's solvers as oracles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import multivariate_normal

from cellwise.fit.solver import Normal, Prior, SolverSettings, bounded_step, minimise

ALL = np.ones(4, dtype=bool)
PRIOR = Prior(
    np.array([0.5, -1.0, 0.0, 2.0]), np.linalg.inv(0.3 * np.eye(4) + 0.7 * np.ones((4, 4))), ALL
)
EXACT = SolverSettings(iterations=60, least_gain=1e-14, least_share=0.0, damping=0.0)


def linear(seed=1, rows=12):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, 4)), rng.normal(size=rows)


def solved(prior, residual_of, jacobian_of, theta, search=EXACT):
    """Normal errors of variance one."""

    def cost_of(at):
        r = residual_of(at)
        return 0.5 * float(r @ r), r

    def normal_of(at, r):
        j = jacobian_of(at)
        return j.T @ r, j.T @ j

    return minimise(prior, cost_of, normal_of, theta, search)


def test_a_linear_problem_ends_in_one_step_at_its_posterior_and_its_marginal_likelihood():
    a, y = linear()
    found = solved(PRIOR, lambda x: y - a @ x, lambda _: a, PRIOR.mean)
    precision = a.T @ a + PRIOR.precision
    right = np.linalg.solve(precision, a.T @ y + PRIOR.precision @ PRIOR.mean)
    np.testing.assert_allclose(found.theta, right, rtol=1e-9)
    np.testing.assert_allclose(PRIOR.covariance(found.normal.matrix), np.linalg.inv(precision))
    marginal = multivariate_normal(a @ PRIOR.mean, np.eye(y.size) + a @ PRIOR.covariance() @ a.T)
    evidence = PRIOR.ln_kept(found.normal.matrix) - found.cost - 0.5 * y.size * np.log(2.0 * np.pi)
    assert evidence == pytest.approx(marginal.logpdf(y), rel=1e-9)
    # Known from any point: the quadratic is exact.
    away = PRIOR.mean + 1.0
    here = PRIOR.with_data(away, 0.5 * float(np.sum((y - a @ away) ** 2)), a.T @ (y - a @ away),
                           a.T @ a)  # fmt: skip
    assert here.lowest(ALL)[0] == pytest.approx(found.cost, rel=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_within_bounds_it_ends_where_bounded_least_squares_does(seed):
    a, y = linear(seed)
    low, high = np.full(4, -0.3), np.full(4, 0.4)
    prior = Prior(np.zeros(4), np.eye(4), ALL, low, high)
    found = solved(prior, lambda x: 3.0 * y - a @ x, lambda _: a, np.zeros(4))
    right = lsq_linear(np.vstack((a, np.eye(4))), [*(3.0 * y), 0, 0, 0, 0], (low, high), tol=1e-12)
    np.testing.assert_allclose(found.theta, right.x, atol=1e-5)


def test_a_bent_valley_ends_where_another_solver_does():
    """Rosenbrock's, held by a wide prior; far off, where the first full step climbs."""
    prior = Prior(np.zeros(2), 1e-2 * np.eye(2), ALL[:2])

    def residual_of(x):
        return -np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def jacobian_of(x):
        return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])

    found = solved(prior, residual_of, jacobian_of, np.array([-1.2, 1.0]))
    right = least_squares(lambda x: np.append(residual_of(x), 0.1 * x), [-1.2, 1.0], xtol=1e-12)
    np.testing.assert_allclose(found.theta, right.x, atol=1e-6)


def test_what_is_not_free_keeps_its_mean_and_is_known():
    a, y = linear()
    free = np.array([True, False, True, True])
    prior = Prior(PRIOR.mean, PRIOR.precision, free)
    found = solved(prior, lambda x: y - a @ x, lambda _: a, prior.mean)
    assert found.theta[1] == prior.mean[1]
    covariance = prior.covariance(found.normal.matrix)
    assert np.all(covariance[1] == 0.0)
    assert np.all(np.diag(covariance)[free] > 0.0)


def test_what_a_bound_cuts_off_the_others_no_longer_make_up_for():
    """x - y = 2 with x held at 1: y is -1 with the same pull on both, not what x = 5 had it be."""
    matrix = np.array([[1.0, -1.0], [-1.0, 1.0 + 1e-3]])
    pull = Normal(0.0, np.array([2.0, -1.9]), matrix)
    step = bounded_step(pull, ALL[:2], np.full(2, -1e9), np.array([1.0, 1e9]), 0.0)
    assert step[0] == 1.0
    assert step[1] == pytest.approx((-1.9 + 1.0) / (1.0 + 1e-3))


def test_what_an_order_puts_beyond_a_bound_stays_there_and_the_others_are_fitted():
    """As a slow branch that must be slower than another one at its own bound."""
    a, y = linear(7)
    high = np.array([np.inf, 0.3, np.inf, np.inf])
    mean = np.array([0.5, 9.0, 0.0, 2.0])  # the second would go further up
    prior = Prior(mean, PRIOR.precision, ALL, -np.inf, high)

    def inside(theta):
        theta = prior.inside(theta)
        theta[1] = max(theta[1], 0.5)
        return theta

    def cost_of(at):
        r = y - a @ at
        return 0.5 * float(r @ r), r

    found = minimise(prior, cost_of, lambda _, r: (a.T @ r, a.T @ a), inside(prior.mean), EXACT,
                     inside)  # fmt: skip
    assert found.theta[1] == 0.5
    others = [0, 2, 3]
    left = a.T @ (y - a @ found.theta) - PRIOR.precision @ (found.theta - mean)
    assert left[1] > 0.0
    assert left[others] == pytest.approx(0.0, abs=1e-6)

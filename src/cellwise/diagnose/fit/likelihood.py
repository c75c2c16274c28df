"""How likely all rows are under a cause, fitted and held-out ones, and what that leaves open.

A held-out log visits states that the fitted ones never saw. What was never measured there is
uncertain, not wrong: so the prediction is averaged over what the fitted rows leave open, which is
the density p(held-out | fitted), instead of taking the most likely point for the truth.

How good the laboratory was is not known either. A cause under which everything else falls into
place speaks for a better laboratory than one that needs a little help everywhere: the tolerances
are tried at several shares of themselves (hierarchical Bayes), each as likely as the next.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.fit.least_squares import Fit, Objective, Prior, normal_of
from cellwise.diagnose.fit.rows import FITTED, IGNORED
from cellwise.typing import BoolArray, FloatArray

# Shares of the stated tolerances that are tried.
SHARES = (0.3, 0.55, 1.0)


class Prediction(NamedTuple):
    """Ln p(all rows), of which ln p(held-out rows | fitted rows), and each row's part.

    ``terms`` (rows,) are ln likelihoods at the point that all rows together would choose: their
    differences between two fits show where one explains more.
    """

    total: float
    held: float
    terms: FloatArray


def predict(
    objective: Objective, found: Fit, prior: Prior, free: set[str] | None = None
) -> Prediction:
    """Density of all rows to second order about the fit.

    With A and b the normal matrix and gradient of the rows, W the prior's precision at a share of
    the tolerances and d the way from its mean: ln p = T - d' W d / 2 + g' x / 2
    - (ln det(A + W) - ln det W) / 2, (A + W) x = g = b - W d. The coordinates in ``free`` keep
    their width; those at their bounds stay there.
    """
    evidence = objective.evidence
    names = list(found.names)
    residual = np.nan_to_num(evidence.voltage_V - found.voltage_V)
    jacobian = evidence.jacobian(found.coordinates, found.z, names)
    white = objective.scaled(np.column_stack((residual, jacobian)))
    x = np.array([found.z[n] for n in names])
    low = np.array([prior.low.get(n, -np.inf) for n in names])
    high = np.array([prior.high.get(n, np.inf) for n in names])
    away = x - np.array([prior.mean.get(n, 0.0) for n in names])
    inside = (x > low) & (x < high)
    kept = free or set()
    scalable = np.array([n not in kept and ":" not in n for n in names])
    plain = objective.terms(residual)
    used = evidence.known & (evidence.role != IGNORED)
    fitted = evidence.known & (evidence.role == FITTED)
    sums = [
        (float(np.sum(plain[rows])), *normal_of(white, rows, objective.clip))
        for rows in (used, fitted)
    ]
    weight = prior.precision()
    totals: list[float] = []
    best: tuple[float, float, FloatArray] | None = None
    for share in SHARES:
        scale = np.where(scalable, 1.0 / share, 1.0)
        w = weight * np.outer(scale, scale)
        every, step = _density(*sums[0], w, away, inside)
        totals.append(every)
        if best is None or every > best[0]:
            best = every, every - _density(*sums[1], w, away, inside)[0], step
    if best is None:
        raise ValueError("no share of the tolerances to try")
    total = float(np.logaddexp.reduce(totals)) - math.log(len(totals))
    return Prediction(total, best[1], objective.terms(residual - jacobian @ best[2]))


def _density(
    plain: float,
    normal: FloatArray,
    gradient: FloatArray,
    weight: FloatArray,
    away: FloatArray,
    inside: BoolArray,
) -> tuple[float, FloatArray]:
    """Ln density of rows and prior, integrated over the coordinates inside their bounds."""
    both = (normal + weight)[np.ix_(inside, inside)]
    pull = (gradient - weight @ away)[inside]
    step = np.zeros(away.size)
    step[inside] = np.linalg.solve(both, pull)
    value = plain - 0.5 * float(away @ weight @ away) + 0.5 * float(pull @ step[inside])
    value -= 0.5 * float(np.linalg.slogdet(both)[1])
    value += 0.5 * float(np.linalg.slogdet(weight[np.ix_(inside, inside)])[1])
    return value, step

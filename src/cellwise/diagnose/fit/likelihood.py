"""How likely all rows are under a set of causes, and what that leaves open.

What was fitted is uncertain, not known: so rows are averaged over what they leave open of every
coordinate (to second order), instead of taking the most likely point for the truth. Two things
more are not known and averaged over:

how good the laboratory was: a cause under which everything else falls into place speaks for a
better laboratory than one that needs a little help everywhere, so the tolerances are tried at
several shares of themselves;

how far the model's statement of its error is off (:class:`cellwise.diagnose.fit.noise.KnownScale`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.fit.least_squares import Fit, Objective, Prior, normal_of
from cellwise.diagnose.fit.noise import KnownScale
from cellwise.diagnose.fit.rows import IGNORED
from cellwise.typing import BoolArray, FloatArray


class Averaged(NamedTuple):
    """What is averaged over.

    ``shares`` of the stated tolerances; scales of the stated error in logarithmic steps of
    ``scale_step``, up to ``beyond`` times the fit's own.
    """

    shares: tuple[float, ...] = (0.3, 0.55, 1.0)
    scale_step: float = 0.15
    beyond: float = 1.3


OVER = Averaged()


class Prediction(NamedTuple):
    """Ln p(all rows), and each row's part.

    ``terms`` (rows,) are ln likelihoods at the point that all rows together would choose: their
    differences between two fits show where one explains more.
    """

    total: float
    terms: FloatArray


def predict(
    objective: Objective,
    found: Fit,
    prior: Prior,
    known: KnownScale,
    scale: float,
    free: set[str] | None = None,
) -> Prediction:
    """Density of all rows to second order about the fit.

    With A and b the normal matrix and gradient of the rows, W the prior's precision at a share of
    the tolerances and d the way from its mean: ln p = T - d' W d / 2 + g' x / 2
    - (ln det(A + W) - ln det W) / 2, (A + W) x = g = b - W d. The coordinates in ``free`` keep
    their width; those at their bounds stay there.

    Parameters
    ----------
    objective, scale : what the fit was judged by, and the scale of its noise
    known : what is known of that scale
    """
    evidence = objective.evidence
    names = list(found.names)
    residual = np.nan_to_num(evidence.voltage_V - found.voltage_V)
    jacobian = evidence.jacobian(found.coordinates, found.z, names)
    used = evidence.known & (evidence.role != IGNORED)
    white = objective.scaled(np.column_stack((residual, jacobian)))
    normal, gradient = normal_of(white, used, objective.clip)
    squares = float(np.sum(objective.squares(residual)[used]))
    plain = float(np.sum(objective.terms(residual)[used])) + 0.5 * squares
    count = float(np.sum(objective.errors[used]))
    x = np.array([found.z[n] for n in names])
    low = np.array([prior.low.get(n, -np.inf) for n in names])
    high = np.array([prior.high.get(n, np.inf) for n in names])
    away = x - np.array([prior.mean.get(n, 0.0) for n in names])
    inside = (x > low) & (x < high)
    kept = free or set()
    scalable = np.array([n not in kept and ":" not in n for n in names])
    precision = prior.precision()
    weights = [
        precision * np.outer(w, w) for w in (np.where(scalable, 1 / s, 1) for s in OVER.shares)
    ]
    totals: list[float] = []
    best = -math.inf, 1.0, jacobian[:, 0]
    for times in _times(known, scale):
        r = times**-2.0
        here = plain - 0.5 * r * squares - count * math.log(times) + known.ln_density(times * scale)
        for weight in weights:
            value, step = _density(here, r * normal, r * gradient, weight, away, inside)
            totals.append(value)
            if value > best[0]:
                best = value, times, jacobian @ step
    every = float(np.logaddexp.reduce(totals))
    total = every + math.log(OVER.scale_step / len(OVER.shares))
    return Prediction(total, objective.times(best[1]).terms(residual - best[2]))


def _times(known: KnownScale, scale: float) -> FloatArray:
    """Scales to try, in units of the one that the fit leaves: from the least that is known."""
    least = 1.0  # what is stated
    most = OVER.beyond * max(scale, least)
    steps = np.arange(0.0, math.log(most / least), OVER.scale_step)
    return np.asarray(least / scale * np.exp(steps))


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

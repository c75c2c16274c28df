"""How likely all rows are under a set of causes, and what that leaves open.

What was fitted is uncertain, not known: so rows are averaged over what they leave open of every
coordinate (to second order), instead of taking the most likely point for the truth. Three things
more are not known and averaged over:

how good the laboratory was: a cause under which everything else falls into place speaks for a
better laboratory than one that needs a little help everywhere, so the tolerances are tried at
several shares of themselves;

how far the model's statement of its error is off (:class:`cellwise.diagnose.fit.noise.KnownScale`);

how far the causes' shapes are from nature's, a little everywhere along the SOC: a film on an
electrode is not quite an ohmic resistance, a loss of material not quite a shift of the OCV. What
the right cause leaves of its effect is of no use as evidence for a second cause, unless that
explains more than wrong shapes would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.fit.least_squares import Fit, Objective, Prior, normal_of
from cellwise.diagnose.fit.noise import KnownScale
from cellwise.diagnose.fit.rows import IGNORED, Evidence
from cellwise.typing import BoolArray, FloatArray

# Shares of the stated tolerances that are tried.
SHARES = (0.3, 0.55, 1.0)
# Scales of the stated error that are tried: in logarithmic steps, up to beyond the fit's own.
SCALE_STEP, BEYOND = 0.15, 1.3
# Standard deviations that are tried, as shares of an effect, and how likely each is. Exact shapes
# first, so that a small effect is not lost for it; on simulated physics, where the right causes
# leave 0.05 to 0.5 of their effects, the logs overrule that by tens of nats.
SHAPE_SHARES = {0.001: 0.9, 0.05: 0.025, 0.1: 0.025, 0.2: 0.025, 0.4: 0.025}
# Over the SOC a wrong shape changes within a tenth of the range.
LEVELS = 10


class Prediction(NamedTuple):
    """Ln p(all rows), and each row's part.

    ``terms`` (rows,) are ln likelihoods at the point that all rows together would choose: their
    differences between two fits show where one explains more.
    """

    total: float
    terms: FloatArray


@dataclass(frozen=True, eq=False)
class _Rows:
    """Sums over the used rows at one scale of the noise.

    ``plain``: ln likelihood of the fit's residual but for its squares, ``squares`` these, ``count``
    of independent errors; ``normal`` (P, P) and ``gradient`` (P,) by the coordinates. Of the wrong
    shapes, turned so that they are independent of each other: ``size`` (K,) their information,
    ``cross`` (P, K) and ``pull`` (K,); ``turned`` (K, K) leads back to them.
    """

    plain: float
    squares: float
    count: float
    normal: FloatArray
    gradient: FloatArray
    size: FloatArray
    cross: FloatArray
    pull: FloatArray
    turned: FloatArray

    def at(self, times: float, share: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Ln likelihood, normal matrix and gradient with the noise ``times`` as large.

        The sizes of the wrong shapes, normal about zero with a deviation of ``share``, are
        integrated out; the last array is the information about them.
        """
        r = times**-2.0
        plain = self.plain - 0.5 * r * self.squares - self.count * math.log(times)
        inner = 1.0 / (self.size + 1.0 / (r * share**2))
        plain += 0.5 * r * float(np.sum(inner * self.pull**2))
        plain -= 0.5 * float(np.sum(np.log1p(r * share**2 * self.size)))
        normal = r * (self.normal - (self.cross * inner) @ self.cross.T)
        return plain, normal, r * (self.gradient - self.cross @ (inner * self.pull)), inner


def predict(
    objective: Objective,
    found: Fit,
    prior: Prior,
    known: KnownScale,
    scale: float,
    effects_V: FloatArray,
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
    effects_V : (rows, causes) by how much each cause moves the voltage [V]
    """
    evidence = objective.evidence
    names = list(found.names)
    residual = np.nan_to_num(evidence.voltage_V - found.voltage_V)
    jacobian = evidence.jacobian(found.coordinates, found.z, names)
    wrong = wrong_shapes(evidence, effects_V, found.soc)
    rows = _sums(objective, residual, jacobian, wrong)
    x = np.array([found.z[n] for n in names])
    low = np.array([prior.low.get(n, -np.inf) for n in names])
    high = np.array([prior.high.get(n, np.inf) for n in names])
    away = x - np.array([prior.mean.get(n, 0.0) for n in names])
    inside = (x > low) & (x < high)
    kept = free or set()
    scalable = np.array([n not in kept and ":" not in n for n in names])
    precision = prior.precision()
    weights = [precision * np.outer(w, w) for w in (np.where(scalable, 1 / s, 1) for s in SHARES)]
    shapes = SHAPE_SHARES if wrong.shape[1] else {1.0: 1.0}  # none: nothing depends on it
    totals: list[float] = []
    best = -math.inf, 1.0, jacobian[:, 0]
    for times, (share, odds) in product(_times(known, scale), shapes.items()):
        plain, normal, gradient, inner = rows.at(times, share)
        plain += known.ln_density(times * scale) + math.log(odds)
        for weight in weights:
            value, step = _density(plain, normal, gradient, weight, away, inside)
            totals.append(value)
            if value > best[0]:
                sizes = rows.turned @ (inner * (rows.pull - rows.cross.T @ step))
                best = value, times, jacobian @ step + wrong @ sizes
    every = float(np.logaddexp.reduce(totals))
    total = every + math.log(SCALE_STEP / len(SHARES))
    return Prediction(total, objective.times(best[1]).terms(residual - best[2]))


def _times(known: KnownScale, scale: float) -> FloatArray:
    """Scales to try, in units of the one that the fit leaves: from the least that is known."""
    least = 1.0  # what is stated
    most = BEYOND * max(scale, least)
    steps = np.arange(0.0, math.log(most / least), SCALE_STEP)
    return np.asarray(least / scale * np.exp(steps))


def _sums(
    objective: Objective, residual: FloatArray, jacobian: FloatArray, wrong: FloatArray
) -> _Rows:
    used = objective.evidence.known & (objective.evidence.role != IGNORED)
    white = objective.scaled(np.column_stack((residual, jacobian, wrong)))
    normal, gradient = normal_of(white, used, objective.clip)
    many = jacobian.shape[1]
    size, turned = np.linalg.eigh(normal[many:, many:])
    squares = float(np.sum(objective.squares(residual)[used]))
    return _Rows(
        float(np.sum(objective.terms(residual)[used])) + 0.5 * squares,
        squares,
        float(np.sum(objective.errors[used])),
        normal[:many, :many],
        gradient[:many],
        np.maximum(size, 0.0),
        normal[:many, many:] @ turned,
        turned.T @ gradient[many:],
        turned,
    )


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


def wrong_shapes(evidence: Evidence, effects_V: FloatArray, soc: FloatArray) -> FloatArray:
    """Columns that wrong shapes may be made of, for sizes that are shares of the effects.

    Around every level of SOC each effect may be larger or smaller, and what all causes explain
    together may be off by a share of its root mean square in the log.

    Parameters
    ----------
    effects_V : (rows, causes) by how much each cause moves the voltage [V]
    soc : (rows,)

    Returns
    -------
    (rows, LEVELS * (causes + 1)) [V]; without a cause (rows, 0)
    """
    if effects_V.shape[1] == 0:
        return np.zeros((evidence.rows, 0))
    together = np.zeros(evidence.rows)
    for _, rows in evidence.each():
        together[rows] = np.sqrt(np.mean(effects_V[rows].sum(axis=1) ** 2))
    sizes = np.column_stack((effects_V, together))
    place = np.clip(np.nan_to_num(soc), 0.0, 1.0) * (LEVELS - 1)
    near = np.clip(1.0 - np.abs(place[:, None] - np.arange(LEVELS)), 0.0, 1.0)
    return np.asarray(near[:, :, None] * sizes[:, None, :]).reshape(evidence.rows, -1)

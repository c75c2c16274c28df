"""Fits of one diagnosis: a cause estimated, its noise, and how likely all rows are with it.

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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.extension import MEASURED_NAMES
from cellwise.diagnose.fit.least_squares import (
    NOTHING_KNOWN,
    SOLVING,
    Fit,
    Frozen,
    Objective,
    Prior,
    complete,
    fit,
    freeze,
    normal_of,
)
from cellwise.diagnose.fit.noise import (
    STATED,
    KnownScale,
    Noise,
    fast_part,
    row_weights,
    stated_V,
    with_shape,
)
from cellwise.diagnose.fit.priors import calibrated, ln_size, widened_for
from cellwise.diagnose.fit.rests import RestVoltages
from cellwise.diagnose.fit.rows import IGNORED, Evidence, rmse
from cellwise.typing import BoolArray, FloatArray


@dataclass(eq=False)
class CauseFits:
    """What every fit of a diagnosis shares.

    ``prior`` are the tolerances, no cause estimated. ``known`` is what is known beforehand of how
    many times the model's stated error is left; ``stated_V`` (rows,) that error, ``weight`` (rows,)
    how much each row counts. ``rests`` are the voltages at rest; ``same_age`` says that a
    good log of the same cell is known.
    """

    evidence: Evidence
    coordinates: Coordinates
    prior: Prior
    rests: RestVoltages
    seed: int
    known: KnownScale = field(default_factory=KnownScale)
    same_age: bool = False
    stated_V: FloatArray = field(default_factory=lambda: np.ones(1))
    weight: FloatArray = field(default_factory=lambda: np.ones(1))
    fast_V: FloatArray = field(default_factory=lambda: np.ones(1))
    fast_weight: FloatArray = field(default_factory=lambda: np.ones(1))
    _frozen: tuple[Fit, Frozen] | None = field(default=None, repr=False)

    def calibrate(self, good: CauseFits) -> None:
        """Move the tolerances to what logs show that are known to be good, of the same cell.

        The noise that these leave is the least that is assumed.
        """
        found, _ = good.base(good.prior)
        self.prior = calibrated(self.prior, found)
        self.known = self.known.with_more(*good.squares(found))
        self.same_age = True

    def base(self, prior: Prior) -> tuple[Fit, Noise]:
        """The fit within the tolerances, no cause estimated, and the noise that it leaves."""
        model = self.coordinates.model
        start = {**prior.mean, **dict.fromkeys(self.evidence.starts(), 0.0)}
        voltage, soc = self.evidence.simulate(self.coordinates, start)
        stated = stated_V(model, self.evidence, soc, voltage)
        weight = row_weights(self.evidence, model.error, soc)
        self.weight, self.stated_V, noise = weight, stated, Noise()
        self.fast_V, self.fast_weight = fast_part(model, self.evidence, soc, voltage)
        found = self.fit(noise, self.coordinates, prior, start, 5)
        for _ in range(2):
            found = complete(self.objective(noise), found, prior)
            left = self.evidence.voltage_V - found.voltage_V
            shape_V = STATED.shape * rmse(left, self._used())
            self.stated_V, self.weight = with_shape(self.evidence, stated, weight, shape_V)
            noise = self.noise(found, prior)
            found = self.fit(noise, self.coordinates, prior, found.z, 4)
        return complete(self.objective(noise), found, prior), noise

    def _used(self) -> BoolArray:
        return np.asarray(self.evidence.known & (self.evidence.role != IGNORED))

    def fit(
        self,
        noise: Noise,
        coordinates: Coordinates,
        prior: Prior,
        start: Mapping[str, float],
        iterations: int,
        frozen: Frozen | None = None,
        moving: Sequence[str] = (),
    ) -> Fit:
        """The most likely point under a noise (:func:`cellwise.diagnose.fit.least_squares.fit`)."""
        objective = self.objective(noise)
        return fit(objective, coordinates, prior, start, iterations, None, frozen, moving)

    def fit_causes(self, causes: Sequence[Cause], near: Fit, noise: Noise) -> Fit:
        """A thorough fit of all causes together, from a point nearby."""
        known = tuple(causes)
        prior = self.widened_for(known, near.coordinates)
        if self._frozen is None or self._frozen[0] is not near:
            every = freeze(self.objective(noise), near.coordinates, near.names, near.z)
            self._frozen = near, every
        # The point is nearby: what is no cause keeps its derivatives.
        moving = [*kept_coordinates(known), *self.evidence.starts()]
        frozen = self._frozen[1]
        found = self.fit(noise, near.coordinates, prior, near.z, SOLVING.iterations, frozen, moving)
        return complete(self.objective(noise), found, prior)

    def widened_for(self, causes: Iterable[Cause], coordinates: Coordinates) -> Prior:
        """The tolerances, widened for all of the causes."""
        prior = self.prior
        for cause in causes:
            prior = widened_for(prior, cause, coordinates, self.evidence)
        return prior

    def noise(self, found: Fit, prior: Prior) -> Noise:
        """How many times the stated error a fit leaves on all rows."""
        plain = self.objective(Noise())
        found = complete(plain, found, prior)
        square, errors = self.squares(found)
        return Noise(self.known.scale(square, errors))

    def squares(self, found: Fit) -> tuple[float, float]:
        """Sum of squares of the used rows in units of the stated error, and how many errors."""
        rows, plain = self._used(), self.objective(Noise())
        left = plain.squares(self.evidence.voltage_V - found.voltage_V)
        return float(np.sum(left[rows])), float(np.sum(plain.errors[rows]))

    def objective(self, noise: Noise) -> Objective:
        """What a fit is judged by under a noise."""
        plain = Objective(self.evidence, self.stated_V, self.weight, self.fast_V, self.fast_weight)
        return plain.times(noise.scale)

    def explained(
        self,
        found: Fit,
        noise: Noise,
        prior: Prior,
        causes: Iterable[Cause],
        near: Frozen = NOTHING_KNOWN,
    ) -> Prediction:
        """How likely all rows are with the causes estimated, and what the logs read at rest.

        ``near`` are the derivatives that the fit was made with: those by causes and starts are
        taken again.
        """
        kept = kept_coordinates(causes)
        moving = [*kept, *self.evidence.starts()]
        jacobian = near.jacobian_near(found, self.evidence, moving)
        objective = self.objective(noise)
        found_so = predict(objective, found, jacobian, prior, self.known, noise.scale, kept)
        more = self.at_rest(found) + ln_size(found.z, kept, prior)
        return found_so._replace(total=found_so.total + more)

    def at_rest(self, found: Fit) -> float:
        """Ln likelihood of what voltage and current sensor read at rest."""
        voltage = self.rests.ln_likelihood(found.coordinates, found.z)
        return voltage + self.evidence.rest.ln_likelihood(found.z)

    def point(self, found: Fit, keep: set[str]) -> dict[str, float]:
        """The causes' coordinates as found, the cell's as calibrated on a baseline, nothing else.

        Not what the fit made of them since: there a cause that is not named might hide. What a
        baseline makes of its instruments and of the charge is no news of the cell.
        """
        of_cell = [n for n in self.prior.linked if n not in (*MEASURED_NAMES, "ln_capacity")]
        baseline = {n: self.prior.mean[n] for n in of_cell}
        return baseline | {n: v for n, v in found.z.items() if n in keep}


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
    jacobian: FloatArray,
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
    jacobian : (rows, names) derivatives at the fit
    known : what is known of that scale
    """
    evidence = objective.evidence
    names = list(found.names)
    residual = np.nan_to_num(evidence.voltage_V - found.voltage_V)
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

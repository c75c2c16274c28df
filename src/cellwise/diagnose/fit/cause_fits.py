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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import MEASURED_NAMES, Coordinates
from cellwise.diagnose.fit.coordinate_fit import (
    NOTHING_KNOWN,
    Fit,
    Frozen,
    Tolerances,
    complete,
    fit,
)
from cellwise.diagnose.fit.noise import STATED, KnownScale, Objective, stated_objective
from cellwise.diagnose.fit.priors import calibrated, ln_size, tolerances, widened_for
from cellwise.diagnose.fit.rests import RestVoltages, rest_voltages
from cellwise.diagnose.fit.rows import ScoredRows
from cellwise.typing import FloatArray


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


@dataclass(eq=False)
class CauseFits:
    """What every fit of a diagnosis shares; a scale is how many times the stated error is left.

    ``prior`` are the tolerances, no cause estimated. ``known`` is what is known beforehand of the
    scale; ``stated`` the rows under the stated error, there from :meth:`base` on. ``rests`` are the
    voltages at rest; ``same_age`` says that a good log of the same cell is known.
    """

    evidence: ScoredRows
    coordinates: Coordinates
    prior: Tolerances
    rests: RestVoltages
    seed: int
    known: KnownScale = field(default_factory=KnownScale)
    same_age: bool = False
    stated: Objective = field(init=False)

    @classmethod
    def of(cls, evidence: ScoredRows, coordinates: Coordinates, seed: int) -> CauseFits:
        """Fits with the tolerances of a good laboratory."""
        model, prior = coordinates.model, tolerances(coordinates, evidence)
        rests = rest_voltages(evidence.logs, model.capacity_Ah, model.charge_efficiency)
        return cls(evidence, coordinates, prior, rests, seed)

    def calibrate(self, good: CauseFits) -> None:
        """Move the tolerances to what logs show that are known to be good, of the same cell.

        The noise that these leave is the least that is assumed.
        """
        found, _ = good.base()
        self.prior = calibrated(self.prior, found)
        self.known = self.known.with_more(*good.squares(found))
        self.same_age = True

    def base(self) -> tuple[Fit, float]:
        """The fit within the tolerances, no cause estimated, and the scale that it leaves."""
        start = {**self.prior.mean, **dict.fromkeys(self.evidence.starts(), 0.0)}
        voltage, soc = self.evidence.simulate(self.coordinates, start)
        plain = stated_objective(self.coordinates.model, self.evidence, soc, voltage)
        self.stated = plain
        scale, found = 1.0, fit(plain, self.coordinates, self.prior, start, 5)
        for _ in range(2):
            left = self.evidence.voltage_V - self.complete(found, scale, self.prior).voltage_V
            size_V = float(np.sqrt(np.mean(left[self.evidence.known] ** 2)))
            self.stated = plain.with_shape(STATED.shape * size_V)
            scale = self.scale(found, self.prior)
            found = fit(self.stated.times(scale), self.coordinates, self.prior, found.z, 4)
        return self.complete(found, scale, self.prior), scale

    def complete(self, found: Fit, scale: float, prior: Tolerances) -> Fit:
        """The fit with the held-out logs simulated from where their first part says."""
        return complete(self.stated.times(scale), found, prior)

    def frozen(self, found: Fit, prior: Tolerances) -> Frozen:
        """Derivatives at a fit, for those that stay near it."""
        names = tuple(prior.names)
        return Frozen(names, self.evidence.jacobian(found.coordinates, found.z, names))

    def fit_causes(self, causes: Sequence[Cause], near: Fit, scale: float) -> Fit:
        """A thorough fit of all causes together, from a point nearby."""
        prior = self.widened_for(causes, near.coordinates)
        # The point is nearby: what is no cause keeps its derivatives.
        moving = [*kept_coordinates(causes), *self.evidence.starts()]
        frozen = Frozen(near.names, self.evidence.jacobian(near.coordinates, near.z, near.names))
        found = fit(
            self.stated.times(scale), near.coordinates, prior, near.z, frozen=frozen, moving=moving
        )
        return self.complete(found, scale, prior)

    def widened_for(self, causes: Iterable[Cause], coordinates: Coordinates) -> Tolerances:
        """The tolerances, widened for all of the causes."""
        prior = self.prior
        for cause in causes:
            prior = widened_for(prior, cause, coordinates, self.evidence)
        return prior

    def scale(self, found: Fit, prior: Tolerances) -> float:
        """How many times the stated error a fit leaves on all rows."""
        return self.known.scale(*self.squares(self.complete(found, 1.0, prior)))

    def squares(self, found: Fit) -> tuple[float, float]:
        """Sum of squares of the known rows in units of the stated error, and how many errors."""
        known, left = self.evidence.known, self.evidence.voltage_V - found.voltage_V
        squares = self.stated.squares(left)[known]
        return float(np.sum(squares)), float(np.sum(self.stated.errors[known]))

    def explained(
        self,
        found: Fit,
        scale: float,
        prior: Tolerances,
        causes: Iterable[Cause],
        near: Frozen = NOTHING_KNOWN,
    ) -> Prediction:
        """How likely all rows are with the causes estimated, and what the logs read at rest.

        To second order about the fit. With A and b the normal matrix and gradient of the rows, W
        the prior's precision at a share of the tolerances and d the way from its mean:
        ln p = T - d' W d / 2 + g' x / 2 - (ln det(A + W) - ln det W) / 2, (A + W) x = g = b - W d.
        The causes' coordinates keep their width; those at their bounds stay there. ``near`` are the
        derivatives that the fit was made with: those by causes and starts are taken again.
        """
        evidence, free, objective = (
            self.evidence,
            kept_coordinates(causes),
            self.stated.times(scale),
        )
        jacobian = near.jacobian_near(found, evidence, [*free, *evidence.starts()])
        rows, residual = evidence.known, evidence.voltage_V - found.voltage_V
        gradient, normal = objective.normal(found.voltage_V, jacobian)
        squares = float(np.sum(objective.squares(residual)[rows]))
        plain = float(np.sum(objective.terms(residual)[rows])) + 0.5 * squares
        count = float(np.sum(objective.errors[rows]))
        x, known = prior.point(found.z), prior.prior()
        inside = (x > known.low) & (x < known.high)
        scalable = np.array([n not in free and ":" not in n for n in prior.names])
        widths = [np.where(scalable, 1.0 / s, 1.0) for s in OVER.shares]
        priors = [
            replace(known, free=inside, precision=known.precision * np.outer(w, w)) for w in widths
        ]
        totals: list[float] = []
        best = -math.inf, 1.0, jacobian[:, 0]
        for times in _times(scale):
            r, ln_scale = times**-2.0, self.known.ln_density(times * scale)
            here = plain - 0.5 * r * squares - count * math.log(times) + ln_scale
            for one in priors:
                both = one.with_data(x, -here, r * gradient, r * normal)
                cost, step = both.lowest(inside)
                value = one.ln_kept(both.matrix) - cost
                totals.append(value)
                if value > best[0]:
                    best = value, times, jacobian @ step
        total = float(np.logaddexp.reduce(totals)) + math.log(OVER.scale_step / len(OVER.shares))
        total += self.at_rest(found) + ln_size(found.z, free, prior)
        return Prediction(total, objective.times(best[1]).terms(residual - best[2]))

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


def _times(scale: float) -> FloatArray:
    """Scales to try, in units of the one that the fit leaves: from what is stated on."""
    most = OVER.beyond * max(scale, 1.0)
    return np.asarray(np.exp(np.arange(0.0, math.log(most), OVER.scale_step)) / scale)

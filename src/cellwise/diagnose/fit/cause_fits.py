"""Fits of one diagnosis: a cause estimated, its noise, its likelihood, what it gains alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.extension import MEASURED_NAMES
from cellwise.diagnose.fit.least_squares import (
    ITERATIONS,
    Fit,
    Frozen,
    Objective,
    Prior,
    complete,
    fit,
    freeze,
)
from cellwise.diagnose.fit.likelihood import Prediction, predict
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
        found = self.fit(noise, near.coordinates, prior, near.z, ITERATIONS, frozen, moving)
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
        self, found: Fit, noise: Noise, prior: Prior, causes: Iterable[Cause]
    ) -> Prediction:
        """How likely all rows are with the causes estimated, and what the logs read at rest."""
        kept = kept_coordinates(causes)
        found_so = predict(self.objective(noise), found, prior, self.known, noise.scale, kept)
        more = self.at_rest(found) + ln_size(found.z, kept, prior, self.same_age)
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

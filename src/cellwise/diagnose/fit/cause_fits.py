"""Fits of one diagnosis: a cause estimated, its noise, its likelihood, what it gains alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.gain import Gain, gain_of
from cellwise.diagnose.fit.least_squares import (
    Fit,
    Frozen,
    Objective,
    Prior,
    complete,
    fit,
    freeze,
)
from cellwise.diagnose.fit.likelihood import Prediction, predict
from cellwise.diagnose.fit.noise import Noise, at_least, estimate_noise, log_scales
from cellwise.diagnose.fit.priors import widened_for
from cellwise.diagnose.fit.rest_voltages import RestVoltages
from cellwise.diagnose.fit.rows import IGNORED, Evidence
from cellwise.diagnose.fit.whitening_kernels import NoiseLevel
from cellwise.typing import BoolArray, FloatArray

# From this ratio on logs are not alike in what they leave.
LOGS_DIFFER = 1.15
# Iterations where everything moves at once.
THOROUGH = 7


@dataclass(eq=False)
class CauseFits:
    """What every fit of a diagnosis shares.

    ``prior`` are the tolerances, no cause estimated. ``floor`` is a noise below which nothing
    counts; ``most_slow_V`` is the slow error that the model states: persistent error beyond it
    is to be explained, or noise would explain all. ``rests`` are the voltages at rest.
    """

    evidence: Evidence
    coordinates: Coordinates
    prior: Prior
    floor: NoiseLevel
    most_slow_V: float
    rests: RestVoltages
    seed: int
    amplitude: FloatArray = field(default_factory=lambda: np.ones(1))
    _frozen: tuple[Fit, Frozen] | None = field(default=None, repr=False)

    def base(self, prior: Prior) -> tuple[Fit, Noise]:
        """The fit within the tolerances, no cause estimated, and the noise that it leaves."""
        _, soc = self.evidence.simulate(self.coordinates, prior.mean)
        self.amplitude = self.evidence.amplitude(self.coordinates.model, soc)
        noise = Noise(NoiseLevel(1e-3, 1e-3, 20.0, min(1e-2, self.most_slow_V), 600.0))
        found = self.fit(noise, self.coordinates, prior, prior.mean, 5)
        for _ in range(2):
            noise = self.noise(found, prior)
            found = self.fit(noise, self.coordinates, prior, found.z, 4)
        return complete(self.objective(noise), found, prior), noise

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
        found = self.fit(noise, near.coordinates, prior, near.z, THOROUGH, frozen, moving)
        return complete(self.objective(noise), found, prior)

    def widened_for(self, causes: Iterable[Cause], coordinates: Coordinates) -> Prior:
        """The tolerances, widened for all of the causes."""
        prior = self.prior
        for cause in causes:
            prior = widened_for(prior, cause, coordinates, self.evidence)
        return prior

    def noise(self, found: Fit, prior: Prior, other: Noise | None = None) -> Noise:
        """The noise that a fit leaves on all rows; ``other`` if that describes it better.

        Held-out logs may ask more of the cell than those that were fitted: what a model gets
        wrong there is expected there. And some logs ask more than others.
        """
        found = complete(self.objective(other or Noise(self.floor)), found, prior)
        rows = self.evidence.known & (self.evidence.role != IGNORED)
        residual = np.nan_to_num(self.evidence.voltage_V - found.voltage_V)
        noise = Noise(self._level(residual, rows, Noise(self.floor)))
        white, _ = self.objective(noise).whitened(residual[:, None])
        scale = log_scales(white[:, 0], rows, [g.scored for g in self.evidence.logs])
        if max(scale) > LOGS_DIFFER * min(scale):
            noise = Noise(self._level(residual, rows, Noise(self.floor, scale)), scale)
        if other is None:
            return noise

        def explained(noise: Noise) -> float:
            return float(np.sum(self.objective(noise).terms(residual)[rows]))

        return max((noise, other), key=explained)

    def _level(self, residual_V: FloatArray, rows: BoolArray, noise: Noise) -> NoiseLevel:
        """Most likely level on the rows, each log at its scale."""
        scaled = residual_V / self.objective(noise).amplitude
        level = estimate_noise(scaled, self.evidence.dt_s, rows)
        level = level._replace(slow_V=min(level.slow_V, self.most_slow_V))
        return at_least(level, self.floor)

    def objective(self, noise: Noise) -> Objective:
        """What a fit is judged by under a noise."""
        if not noise.scale:
            return Objective(self.evidence, noise.level, self.amplitude)
        times = np.repeat(noise.scale, [g.scored for g in self.evidence.logs])
        return Objective(self.evidence, noise.level, self.amplitude * times)

    def explained(
        self, found: Fit, noise: Noise, prior: Prior, causes: Iterable[Cause]
    ) -> Prediction:
        """How likely all rows are with the causes estimated, and what the logs read at rest."""
        found_so = predict(self.objective(noise), found, prior, kept_coordinates(causes))
        return found_so._replace(total=found_so.total + self.at_rest(found))

    def at_rest(self, found: Fit) -> float:
        """Ln likelihood of what voltage and current sensor read at rest."""
        voltage = self.rests.ln_likelihood(found.coordinates, found.z)
        return voltage + self.evidence.rest.ln_likelihood(found.z)

    def alone(self, found: Fit, causes: Iterable[Cause]) -> Fit:
        """The causes' coordinates as found, tolerances at neutral.

        Starts that were given stay as given, unless a cause moves them; those that were found are
        found again.
        """
        named = dict(zip(self.evidence.starts(), self.evidence.logs, strict=True))
        known = tuple(causes)
        moved = any(c.kind == "start" for c in known)
        estimated = [n for n, g in named.items() if moved or g.start.how != "given"]
        fixed = self.point(found, kept_coordinates(known))
        fixed |= {n: 0.0 for n in named if n not in estimated}
        if moved:
            fixed |= {n: found.z[n] for n in estimated}
            estimated = []
        std = {n: self.prior.std[n] for n in estimated}
        low = {n: self.prior.low[n] for n in estimated}
        high = {n: self.prior.high[n] for n in estimated}
        objective = Objective(
            self.evidence, NoiseLevel(2e-3, 1e-3, 20.0, 3e-3, 600.0), self.amplitude
        )
        start = {n: found.z[n] for n in estimated}
        prior = Prior(std, {}, low, high)
        one = fit(objective, found.coordinates, prior, start, 4, fixed)
        return complete(objective, one, prior)

    def point(self, found: Fit, keep: set[str]) -> dict[str, float]:
        """The causes' coordinates as found, the cell's as calibrated on a baseline, nothing else.

        Not what the fit made of them since: there a cause that is not named might hide.
        """
        baseline = {n: self.prior.mean[n] for n in self.prior.linked}
        return baseline | {n: v for n, v in found.z.items() if n in keep}

    def gain(self, before_V: FloatArray, after_V: FloatArray) -> Gain:
        """What one simulation gains over another; every call draws the same blocks."""
        rng = np.random.default_rng(self.seed)
        return gain_of(self.evidence, before_V, after_V, self.amplitude, rng)

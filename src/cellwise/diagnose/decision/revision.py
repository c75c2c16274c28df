"""Accepted causes revised: those that later ones made unnecessary, and an aged cell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.decision.acceptance import AGED_GAIN, LEAST_SCORE, SIMPLER
from cellwise.diagnose.decision.candidates import Candidate
from cellwise.diagnose.decision.outcome import Accepted, Stage
from cellwise.diagnose.fit.cause_fits import THOROUGH, CauseFits
from cellwise.diagnose.fit.least_squares import Fit, Prior, complete
from cellwise.diagnose.fit.noise import Noise

AGE = ("capacity", "resistance_scale")


def aged(fits: CauseFits, ranked: Sequence[Candidate], stage: Stage) -> Stage | None:
    """What looks like a sensor's gain, explained by an aged cell instead, if that is possible.

    Also where the gain explains most and a lower capacity was put before it. Not beside a
    baseline of the same cell: no cell ages so much between one log and the next.
    """
    if fits.prior.linked:
        return None
    best = ranked[0]
    tried = {c.name: c for c in ranked}
    new = [tried[n] for n in AGE if n in tried]
    sensor = tried.get("current_gain")
    if sensor is None or len(new) < len(AGE) or best not in (sensor, new[0]):
        return None
    ln_gain = sensor.fit.z["ln_gain"]
    if sensor.score < best.score or ln_gain > math.log(AGED_GAIN):
        return None
    causes = (*stage.causes, *(c.cause for c in new))
    coordinates, noise = stage.fit.coordinates, sensor.noise
    wide = fits.widened_for(causes, coordinates)
    start = {**sensor.fit.z, "ln_gain": 0.0, "ln_capacity": ln_gain, "ln_scale": -ln_gain}
    found = _fitted(fits, noise, coordinates, start, wide)
    both = fits.explained(found, noise, wide, causes).total
    none = fits.explained(stage.fit, stage.noise, stage.prior, stage.causes).total
    # The sensor's one number counts for SIMPLER; so does a capacity's that is all there is.
    least = sensor.score - SIMPLER if best is sensor else best.score + SIMPLER
    if both - none <= least:
        return None
    gain = fits.gain(stage.fit.voltage_V, found.voltage_V)
    entries = (Accepted(c.cause, gain, c.score, ("current_gain",)) for c in new)
    return Stage((*stage.accepted, *entries), wide, found, noise)


def unnecessary(fits: CauseFits, stage: Stage) -> str | None:
    """The cause before the last whose absence would cost least, if that is next to nothing."""
    causes = stage.causes
    if len(causes) < 2:
        return None
    every = fits.explained(stage.fit, stage.noise, stage.prior, causes).total
    costs: dict[str, float] = {}
    for cause in causes[:-1]:
        others = [c for c in causes if c is not cause]
        prior = fits.widened_for(others, stage.fit.coordinates)
        found = _fitted(fits, stage.noise, stage.fit.coordinates, stage.fit.z, prior)
        costs[cause.name] = every - fits.explained(found, stage.noise, prior, others).total
    name = min(costs, key=lambda n: costs[n])
    return name if costs[name] < LEAST_SCORE else None


def refitted(fits: CauseFits, accepted: Sequence[Accepted], base: Fit, last: Fit) -> Stage:
    """The same causes fitted again from a point nearby, and what each gains on top of those before.

    ``base`` is the fit without any cause.
    """
    causes = [a.cause for a in accepted]
    entries: list[Accepted] = []
    prior = fits.prior
    before, noise = base, fits.noise(base, prior)
    before_ln = fits.explained(base, noise, prior, ()).total
    for k, one in enumerate(accepted):
        known = causes[: k + 1]
        prior = fits.widened_for(known, last.coordinates)
        noise = fits.noise(last, prior)
        tried = [_fitted(fits, noise, last.coordinates, near.z, prior) for near in (last, before)]
        found = max(tried, key=lambda f: f.log_evidence)
        noise = fits.noise(found, prior)
        found = _fitted(fits, noise, last.coordinates, found.z, prior)
        gain = fits.gain(
            fits.alone(before, causes[:k]).voltage_V, fits.alone(found, known).voltage_V
        )
        now = fits.explained(found, noise, prior, known).total
        entries.append(replace(one, gain=gain, score=now - before_ln))
        before, before_ln = found, now
    return Stage(tuple(entries), prior, before, noise)


def _fitted(
    fits: CauseFits,
    noise: Noise,
    coordinates: Coordinates,
    start: Mapping[str, float],
    prior: Prior,
) -> Fit:
    """A thorough fit of all logs; a start outside the prior's bounds is taken to them."""
    found = fits.fit(noise, coordinates, prior, start, THOROUGH)
    return complete(fits.objective(noise), found, prior)

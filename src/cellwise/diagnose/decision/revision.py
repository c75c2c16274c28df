"""What was accepted, seen again: causes that later ones made needless, and a cell that has aged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.decision.acceptance import AGED_GAIN, LEAST_SCORE, SIMPLER
from cellwise.diagnose.decision.candidates import Candidate
from cellwise.diagnose.decision.outcome import Accepted, Stage
from cellwise.diagnose.fit.cause_fits import THOROUGH, Fitter
from cellwise.diagnose.fit.least_squares import Fit, Prior, complete
from cellwise.diagnose.fit.noise import Noise

AGE = ("capacity", "resistance_scale")


def aged(fitter: Fitter, ranked: Sequence[Candidate], stage: Stage) -> Stage | None:
    """What looks like a sensor's gain told as the loss of a cell that has aged, if it can be.

    Also where the gain explains most and a lower capacity was put before it. Not beside a good log
    of the same cell: between one log and the next none ages so much.
    """
    if fitter.prior.linked:
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
    wide = fitter.freed(causes, coordinates)
    start = {**sensor.fit.z, "ln_gain": 0.0, "ln_capacity": ln_gain, "ln_scale": -ln_gain}
    found = _fitted(fitter, noise, coordinates, start, wide)
    both = fitter.explained(found, noise, wide, causes).total
    none = fitter.explained(stage.fit, stage.noise, stage.prior, stage.causes).total
    # The sensor's one number counts for SIMPLER; so does a capacity's that is all there is.
    least = sensor.score - SIMPLER if best is sensor else best.score + SIMPLER
    if both - none <= least:
        return None
    gain = fitter.gain(stage.fit.voltage_V, found.voltage_V)
    entries = (Accepted(c.cause, gain, c.score, ("current_gain",)) for c in new)
    return Stage((*stage.accepted, *entries), wide, found, noise)


def needless(fitter: Fitter, stage: Stage) -> str | None:
    """The cause before the last whose absence would cost least, if that is next to nothing."""
    causes = stage.causes
    if len(causes) < 2:
        return None
    every = fitter.explained(stage.fit, stage.noise, stage.prior, causes).total
    costs: dict[str, float] = {}
    for cause in causes[:-1]:
        others = [c for c in causes if c is not cause]
        prior = fitter.freed(others, stage.fit.coordinates)
        found = _fitted(fitter, stage.noise, stage.fit.coordinates, stage.fit.z, prior)
        costs[cause.name] = every - fitter.explained(found, stage.noise, prior, others).total
    name = min(costs, key=lambda n: costs[n])
    return name if costs[name] < LEAST_SCORE else None


def refitted(fitter: Fitter, accepted: Sequence[Accepted], base: Fit, last: Fit) -> Stage:
    """The same causes fitted anew from a point nearby, and what each gains on top of those before.

    ``base`` is the fit without any cause.
    """
    causes = [a.cause for a in accepted]
    entries: list[Accepted] = []
    prior = fitter.prior
    before, noise = base, fitter.noise(base, prior)
    told = fitter.explained(base, noise, prior, ()).total
    for k, one in enumerate(accepted):
        known = causes[: k + 1]
        prior = fitter.freed(known, last.coordinates)
        noise = fitter.noise(last, prior)
        tried = [_fitted(fitter, noise, last.coordinates, near.z, prior) for near in (last, before)]
        found = max(tried, key=lambda f: f.log_evidence)
        noise = fitter.noise(found, prior)
        found = _fitted(fitter, noise, last.coordinates, found.z, prior)
        gain = fitter.gain(
            fitter.alone(before, causes[:k]).voltage_V, fitter.alone(found, known).voltage_V
        )
        now = fitter.explained(found, noise, prior, known).total
        entries.append(replace(one, gain=gain, score=now - told))
        before, told = found, now
    return Stage(tuple(entries), prior, before, noise)


def _fitted(
    fitter: Fitter, noise: Noise, coordinates: Coordinates, start: Mapping[str, float], prior: Prior
) -> Fit:
    """A thorough fit of all logs; a start outside the prior's bounds is taken to them."""
    found = fitter.fit(noise, coordinates, prior, start, THOROUGH)
    return complete(fitter.objective(noise), found, prior)

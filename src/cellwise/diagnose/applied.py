"""Accepted causes as a user applies them: an extended model that simulates, or a corrected log.

The likelihood forgives what is correlated, a simulation does not: so the estimates are taken
in the way that leaves the fitted rows the smallest error in `simulate`, and causes that leave the
held-out rows no better off are not kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwise.diagnose.causes.catalogue import Cause, kept_coordinates
from cellwise.diagnose.decision.outcome import Outcome
from cellwise.diagnose.extension import MEASURED_NAMES
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.noise import Noise
from cellwise.diagnose.log_runs import (
    Explanation,
    GivenLog,
    LogRun,
    Step,
    explanation,
    log_runs,
    step_between,
)


@dataclass(frozen=True, eq=False)
class Applied:
    """Causes, the fit that they are taken from, and every log before and after."""

    causes: tuple[Cause, ...]
    fit: Fit
    explained: Explanation
    runs: tuple[LogRun, ...]
    step: Step


def apply(
    fits: CauseFits, causes: Sequence[Cause], near: Fit, noise: Noise, given: Sequence[GivenLog]
) -> Applied:
    """The causes applied to all logs, of several estimates that which leaves the fitted rows least.

    Estimates: the likeliest under the noise, and under one without memory; each with the cell's
    tolerances at neutral, and with what they were estimated to be at the same time.
    """
    before = log_runs(fits.coordinates.model, given)
    tried = []
    for found in (near,):
        for whole in (False, True):
            explained = _explained(fits, causes, found, whole)
            runs = log_runs(fits.coordinates.model, given, found, explained)
            step = step_between(
                fits.evidence,
                [r.before for r in before],
                [r.explained for r in runs],
                np.random.default_rng(fits.seed),
            )
            tried.append(Applied(tuple(causes), found, explained, runs, step))
    return min(tried, key=lambda a: a.step.train_after_V)


def applied(fits: CauseFits, outcome: Outcome, given: Sequence[GivenLog]) -> Applied | None:
    """The accepted causes applied; those that leave held-out rows no better off, the last first.

    None where nothing is left.
    """
    causes = [a.cause for a in outcome.accepted]
    near = outcome.fit
    while causes:
        found = apply(fits, causes, near, outcome.noise, given)
        if found.step.held_after_V < found.step.held_before_V:
            return found
        causes = causes[:-1]
        if causes:
            near = fits.fit_causes(causes, near, outcome.noise)
    return None


def kept(outcome: Outcome, found: Applied | None) -> Outcome:
    """The outcome with the causes that were kept."""
    known = () if found is None else found.causes
    return replace(outcome, accepted=tuple(a for a in outcome.accepted if a.cause in known))


def _explained(fits: CauseFits, causes: Sequence[Cause], found: Fit, whole: bool) -> Explanation:
    """Causes as a user applies them; ``whole``: with what else of the cell was estimated.

    Only where the cell is corrected at all; else the model stays as it was.
    """
    keep = kept_coordinates(causes)
    if whole and any(c.kind == "cell" for c in causes):
        keep |= {n for n in found.z if n not in MEASURED_NAMES and ":" not in n}
    point = fits.point(found, keep)
    note = {"causes": [c.name for c in causes]}
    return explanation(found, point, [c.kind for c in causes], fits.evidence, note)

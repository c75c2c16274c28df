"""The outcome of a model comparison: accepted causes, the last fit, what stayed undecided."""

from __future__ import annotations

from dataclasses import dataclass

from cellwise.diagnose.causes.catalogue import Cause
from cellwise.diagnose.decision.candidates import Candidate
from cellwise.diagnose.decision.posterior import Weighed
from cellwise.diagnose.fit.gain import Gain
from cellwise.diagnose.fit.least_squares import Fit, Prior
from cellwise.diagnose.fit.noise import Noise


@dataclass(frozen=True, eq=False)
class Accepted:
    """A cause that was accepted, with what it gained when it was, and what made that sure."""

    cause: Cause
    gain: Gain
    score: float
    alternatives: tuple[str, ...]
    sure: str = ""


@dataclass(frozen=True, eq=False)
class Stage:
    """How far a diagnosis has come: the causes accepted so far, widened in the prior and fitted."""

    accepted: tuple[Accepted, ...]
    prior: Prior
    fit: Fit
    noise: Noise

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The causes, in the order in which they were accepted."""
        return tuple(a.cause for a in self.accepted)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Accepted causes, the last fit, all candidates of the first round.

    ``open_between`` are the candidates that could not be separated where the search stopped,
    ``weighed`` the sets of causes that were compared with the accepted one.
    """

    accepted: tuple[Accepted, ...]
    fit: Fit
    base: Fit
    first: tuple[Candidate, ...]
    open_between: tuple[Candidate, ...]
    noise: Noise
    prior: Prior
    reasons: tuple[str, ...]
    weighed: tuple[Weighed, ...] = ()

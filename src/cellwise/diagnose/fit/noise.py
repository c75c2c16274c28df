"""How wrong a model may be where nothing is the matter: its own statement, and how many times that.

What a model states of its error (:class:`cellwise.cell.model.ModelError`) stays for about
``correlation_s``: that is what the right explanation leaves, however quickly an error changes that
it explains. A log of length t over a SOC range s holds 1 + t / (2 tau) + s / (2 l) independent
errors, however many rows it has, with l the model's ``correlation_soc`` where it states one. How
far the statement itself is off is not known: its scale has an inverse-gamma prior, as sure as so
many errors, and what causes leave unexplained counts less the more of it there is.

No cause has the shape of nature: a share of what is to be explained stays, with as few independent
errors in a log as such a shape has features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.diagnose.fit.rows import IGNORED, SPLIT, Evidence
from cellwise.identify.refinement.sustained import charged_for_minutes
from cellwise.typing import BoolArray, FloatArray


class Stated(NamedTuple):
    """What a model's statement of its error counts as, and what it cannot say.

    ``errors``: as many independent errors as some drives hold; ``shape``: share of a model's whole
    error that no cause explains, since no cause has the shape of nature, with ``shape_errors``
    independent errors in a log; ``least_V``: no voltage is known better.
    """

    errors: float = 10.0
    shape: float = 0.1
    shape_errors: float = 10.0
    least_V: float = 1e-4


STATED = Stated()


class Noise(NamedTuple):
    """How many times what the model states is left."""

    scale: float = 1.0


@dataclass(frozen=True)
class KnownScale:
    """What is known of the scale beforehand: sum of squares over the statement's, and how many."""

    square: float = STATED.errors
    errors: float = STATED.errors

    def scale(self, square: float, errors: float) -> float:
        """Most likely scale of rows with a sum of squares; never below what is stated."""
        return max(1.0, math.sqrt((self.square + square) / (self.errors + errors)))

    def with_more(self, square: float, errors: float) -> KnownScale:
        """The same with rows that are known to be good.

        They may show that more is left than is stated; a load that suits the model shows nothing of
        others.
        """
        return KnownScale(self.square + max(square, errors), self.errors + errors)

    def gained(self, left: float, taken: float, errors: float) -> float:
        """Nats that a sum of squares ``left`` counts less once so much of it is ``taken`` off."""
        after = max(self.square + left - taken, self.square)
        return 0.5 * (self.errors + errors) * math.log((self.square + left) / after)

    def ln_density(self, scale: float) -> float:
        """Ln of how likely a scale is, up to a constant."""
        return -self.errors * math.log(scale) - 0.5 * self.square / scale**2


def slow_scales(error: ModelError) -> tuple[int, ...]:
    """Processes of an error that outlast a window; the slowest in any case."""
    last = len(error.scales_s) - 1
    return tuple(k for k, s in enumerate(error.scales_s) if s >= SPLIT.window_s or k == last)


def lasting_V(
    error: ModelError, soc: FloatArray, temperature_C: float, drop_V: FloatArray, charged: BoolArray
) -> FloatArray:
    """All that is stated of an error that lasts for minutes [V]."""
    slow = slow_scales(error)
    own = np.sum([error.variance_V2(k, soc, temperature_C) for k in slow], axis=0)
    out, into = (math.hypot(*(error.shares(sign)[k] for k in slow)) for sign in (1.0, -1.0))
    hidden = np.where(charged, error.hidden_share(-1.0), 0.0)
    share = np.where(drop_V >= 0.0, out, np.hypot(into, hidden))
    return np.asarray(np.sqrt(own + (share * drop_V) ** 2))


def independent_errors(error: ModelError, span_s: float, span_soc: float) -> float:
    """How many slow errors of a model a log of a length [s] over a range of SOC holds."""
    slow, weights = slow_scales(error), error.weights
    whole = sum(weights[k] for k in slow) or 1.0
    memory_s = sum(weights[k] * error.scales_s[k] for k in slow) / whole
    by_soc = 0.0
    if error.correlation_soc is not None:
        by_soc = span_soc / (2.0 * error.correlation_soc)
    return 1.0 + span_s / (2.0 * max(memory_s, 1e-3)) + by_soc


def row_weights(evidence: Evidence, error: ModelError, soc: FloatArray) -> FloatArray:
    """How much every scored row counts: the used rows of a log sum up to its independent errors.

    ``soc`` is that of every scored row.
    """
    weights = []
    for log, rows in evidence.each():
        used = evidence.known[rows] & (evidence.role[rows] != IGNORED)
        span_s = float(log.clock_s[-1] - log.clock_s[0])
        span_soc = float(np.ptp(soc[rows][used])) if used.any() else 0.0
        errors = independent_errors(error, span_s, span_soc)
        weights.append(np.full(log.scored, min(errors / max(int(used.sum()), 1), 1.0)))
    return np.concatenate(weights)


def with_shape(
    evidence: Evidence, size_V: FloatArray, weight: FloatArray, shape_V: float
) -> tuple[FloatArray, FloatArray]:
    """Size and weight of the model's error at every row with that of the shapes of causes.

    What a mean over many rows leaves uncertain adds up: size^2 over weight.
    """
    both = size_V**2 + shape_V**2
    mean = size_V**2 / weight
    for _, rows in evidence.each():
        used = evidence.known[rows] & (evidence.role[rows] != IGNORED)
        mean[rows] += shape_V**2 * max(int(used.sum()), 1) / STATED.shape_errors
    return np.sqrt(both), np.minimum(weight, both / mean)


def share_claimed(error: ModelError, drop_V: FloatArray, charged: BoolArray) -> FloatArray:
    """Share of the polarisation at every row that a diagnosis does not hold against a model.

    What its tests did show to be wrong: what they could not show is for the diagnosis to find. Of
    charges that last (``charged``) also what none of them could show: a healthy cell meets other
    concentrations there than on discharge, and no cause has that shape.
    """
    charge = np.where(charged, error.whole_share(-1.0), error.shown_share(-1.0))
    return np.where(drop_V >= 0.0, error.shown_share(1.0), charge)


def stated_V(
    model: CellModel, evidence: Evidence, soc: FloatArray, voltage_V: FloatArray
) -> FloatArray:
    """What the model states at every scored row of an error that lasts for minutes [V].

    ``soc`` and ``voltage_V`` are as simulated.
    """
    size = np.empty(evidence.rows)
    for g, rows in evidence.each():
        warm = float(np.median(g.temperature_C))
        at = np.clip(soc[rows], 0.0, 1.0)
        drop = np.interp(at, model.soc, model.at_temperature(warm).ocv_V[0]) - voltage_V[rows]
        charged = charged_for_minutes(g.log)[:: g.stride]
        lasts = lasting_V(model.error, at, warm, drop, charged)
        size[rows] = np.sqrt(lasts**2 + STATED.least_V**2)
    return size


def fast_part(
    model: CellModel, evidence: Evidence, soc: FloatArray, voltage_V: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Size [V] and weight at every row of what changes within a window of the model's error.

    No larger than all that is stated of it on any time scale. It comes back with every pulse:
    however many of these there are, all logs together hold as few errors of it as such a shape has
    features.
    """
    size = np.empty(evidence.rows)
    for g, rows in evidence.each():
        warm = float(np.median(g.temperature_C))
        at = np.clip(soc[rows], 0.0, 1.0)
        drop = np.interp(at, model.soc, model.at_temperature(warm).ocv_V[0]) - voltage_V[rows]
        share = share_claimed(model.error, drop, charged_for_minutes(g.log)[:: g.stride])
        own = np.hypot(model.error.at(at, warm), share * drop)
        size[rows] = np.sqrt(own**2 + model.error.white_V**2 + STATED.least_V**2)
    used = evidence.known & (evidence.role != IGNORED)
    return size, np.full(evidence.rows, min(STATED.shape_errors / max(int(used.sum()), 1), 1.0))

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
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.diagnose.fit.rows import SPLIT, ScoredRows
from cellwise.fit.model_error import charged_for_minutes, polarisation_of
from cellwise.typing import BoolArray, FloatArray


class StatedError(NamedTuple):
    """What a model's statement of its error counts as, and what it cannot say.

    ``errors``: as many independent errors as some drives hold; ``shape``: share of a model's whole
    error that no cause explains, since no cause has the shape of nature, with ``shape_errors``
    independent errors in a log; ``least_V``: no voltage is known better. From ``clip`` standard
    deviations of an error on a residual counts in proportion (Huber).
    """

    errors: float = 10.0
    shape: float = 0.1
    shape_errors: float = 10.0
    least_V: float = 1e-4
    clip: float = 6.0


STATED = StatedError()


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


@dataclass(frozen=True, eq=False)
class Objective:
    """Rows, how wrong the model may be at each of them, and how much each counts.

    ``size_V`` (rows,) is the standard deviation of what no cause explains. It stays for minutes, so
    that thousands of rows hold as few errors as ``weight`` (rows,) sums up to. What changes within
    a window of :attr:`Evidence.windows` has a size of its own, ``fast_V``, and more errors.
    """

    evidence: ScoredRows
    size_V: FloatArray
    weight: FloatArray
    fast_V: FloatArray
    fast_weight: FloatArray

    @property
    def fitted(self) -> Objective:
        """The same over the logs that have rows to fit."""
        part = self.evidence.fitted
        rows = slice(0, part.rows)
        fast = self.fast_V[rows], self.fast_weight[rows]
        return Objective(part, self.size_V[rows], self.weight[rows], *fast)

    def times(self, scale: float) -> Objective:
        """The same with what may be wrong so many times as large."""
        return replace(self, size_V=scale * self.size_V, fast_V=scale * self.fast_V)

    def with_shape(self, shape_V: float) -> Objective:
        """The same with an error of the shapes of causes.

        What a mean over many rows leaves uncertain adds up: size^2 over weight.
        """
        both = self.size_V**2 + shape_V**2
        mean = self.size_V**2 / self.weight
        for _, rows in self.evidence.each():
            known = int(self.evidence.known[rows].sum())
            mean[rows] += shape_V**2 * max(known, 1) / STATED.shape_errors
        return replace(self, size_V=np.sqrt(both), weight=np.minimum(self.weight, both / mean))

    @property
    def clip(self) -> float:
        """Where a residual in these units is wilder than the rest (Huber)."""
        return STATED.clip * math.sqrt(float(np.mean(self.errors)))

    @property
    def errors(self) -> FloatArray:
        """How many independent errors every row counts for."""
        return self.weight + self.fast_weight

    def scaled(self, columns: FloatArray) -> FloatArray:
        """What is slow of columns (rows, P), and what is fast, in units of what may be wrong.

        Each row as much as it counts. Within a window the fast part adds up to zero: the squares
        of both together are those of their sum.
        """
        known = self.evidence.known
        with np.errstate(over="ignore", invalid="ignore"):  # a step too far is refused by its cost
            mean = self.evidence.window_means(columns)
            slow = mean * (known * np.sqrt(self.weight) / self.size_V)[:, None]
            fast = (columns - mean) * (np.sqrt(self.fast_weight) / self.fast_V)[:, None]
        fast[~known] = 0.0
        slow += fast
        return slow

    def squares(self, residual_V: FloatArray) -> FloatArray:
        """Squared residuals in these units; beyond :attr:`clip` they grow in proportion (Huber)."""
        size, clip = np.abs(self.scaled(np.nan_to_num(residual_V)[:, None])[:, 0]), self.clip
        with np.errstate(over="ignore"):
            return np.where(size < clip, size * size, clip * (2.0 * size - clip))

    def terms(self, residual_V: FloatArray) -> FloatArray:
        """Ln likelihood of every row."""
        terms = -0.5 * self.squares(residual_V) - self.weight * np.log(self.size_V)
        terms -= self.fast_weight * np.log(self.fast_V)
        return np.where(self.evidence.known, terms, 0.0)

    def normal(
        self, simulated_V: FloatArray, jacobian: FloatArray, rows: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Gradient (P,) and normal matrix (P, P) of the known ``rows`` about a simulation."""
        residual = np.nan_to_num(self.evidence.voltage_V - simulated_V)
        white = self.scaled(np.column_stack((residual, jacobian)))
        known = self.evidence.known if rows is None else rows & self.evidence.known
        return normal_of(white, known, self.clip)


def normal_of(white: FloatArray, rows: BoolArray, clip: float) -> tuple[FloatArray, FloatArray]:
    """Gradient and normal matrix of scaled rows [e, J], residuals beyond ``clip`` held (Huber)."""
    used = white[rows]
    size = np.maximum(np.abs(used[:, :1]), clip)
    used *= np.sqrt(clip / size)
    every = used.T @ used
    return every[1:, 0], every[1:, 1:]


def stated_objective(
    model: CellModel, evidence: ScoredRows, soc: FloatArray, voltage_V: FloatArray
) -> Objective:
    """What the model states of its error at every scored row; SOC and voltage as simulated.

    What lasts for minutes counts as the independent errors that a log holds. What changes within a
    window is no larger than all that is stated on any time scale, and comes back with every pulse:
    however many of these there are, all logs together hold as few errors of it as such a shape has
    features.
    """
    error = model.error
    size, fast, weight = (np.empty(evidence.rows) for _ in range(3))
    for g, rows in evidence.each():
        warm = float(np.median(g.temperature_C))
        at = np.clip(soc[rows], 0.0, 1.0)
        drop = polarisation_of(model, at, np.full(at.size, warm), voltage_V[rows])
        charged = charged_for_minutes(g.log)[:: g.stride]
        size[rows] = np.hypot(lasting_V(error, at, warm, drop, charged), STATED.least_V)
        own = np.hypot(error.at(at, warm), share_claimed(error, drop, charged) * drop)
        fast[rows] = np.sqrt(own**2 + error.white_V**2 + STATED.least_V**2)
        known = evidence.known[rows]
        span_soc = float(np.ptp(soc[rows][known])) if known.any() else 0.0
        errors = independent_errors(error, float(g.clock_s[-1] - g.clock_s[0]), span_soc)
        weight[rows] = min(errors / max(int(known.sum()), 1), 1.0)
    every = max(int(evidence.known.sum()), 1)
    fast_weight = np.full(evidence.rows, min(STATED.shape_errors / every, 1.0))
    return Objective(evidence, size, weight, fast, fast_weight)


def slow_scales(error: ModelError) -> tuple[int, ...]:
    """Processes of an error that outlast a window; the slowest in any case."""
    last = len(error.scales_s) - 1
    return tuple(k for k, s in enumerate(error.scales_s) if s >= SPLIT.window_s or k == last)


def lasting_V(
    error: ModelError,
    soc: FloatArray,
    temperature_C: float,
    polarisation_V: FloatArray,
    charged: BoolArray,
) -> FloatArray:
    """All that is stated of an error that lasts for minutes [V]."""
    slow = slow_scales(error)
    own = np.sum([error.variance_V2(k, soc, temperature_C) for k in slow], axis=0)
    out, into = (math.hypot(*(error.shares(sign)[k] for k in slow)) for sign in (1.0, -1.0))
    hidden = np.where(charged, error.hidden_share(-1.0), 0.0)
    share = np.where(polarisation_V >= 0.0, out, np.hypot(into, hidden))
    return np.asarray(np.sqrt(own + (share * polarisation_V) ** 2))


def independent_errors(error: ModelError, span_s: float, span_soc: float) -> float:
    """How many slow errors of a model a log of a length [s] over a range of SOC holds."""
    slow, weights = slow_scales(error), error.weights
    whole = sum(weights[k] for k in slow) or 1.0
    memory_s = sum(weights[k] * error.scales_s[k] for k in slow) / whole
    by_soc = 0.0
    if error.correlation_soc is not None:
        by_soc = span_soc / (2.0 * error.correlation_soc)
    return 1.0 + span_s / (2.0 * max(memory_s, 1e-3)) + by_soc


def share_claimed(error: ModelError, polarisation_V: FloatArray, charged: BoolArray) -> FloatArray:
    """Share of the polarisation at every row that a diagnosis does not hold against a model.

    What its tests did show to be wrong: what they could not show is for the diagnosis to find. Of
    charges that last (``charged``) also what none of them could show: a healthy cell meets other
    concentrations there than on discharge, and no cause has that shape.
    """
    charge = np.where(charged, error.whole_share(-1.0), error.shown_share(-1.0))
    return np.where(polarisation_V >= 0.0, error.shown_share(1.0), charge)

"""How wrong a model may be where nothing is the matter: its own statement, and how many times that.

What a model states of its error (:class:`cellwise.cell.model.ModelError`) stays for about
``correlation_s``: that is what the right explanation leaves, however quickly an error changes that
it explains. A log of length t over a SOC range s holds 1 + t / (2 tau) + s / (2 l) independent
errors, however many rows it has, with l the model's ``correlation_soc`` where it states one. How
far the statement itself is off is not known: its scale has an inverse-gamma prior, worth so many
errors, and what causes leave unexplained counts less the more of it there is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.diagnose.fit.rows import IGNORED, Evidence
from cellwise.typing import FloatArray

# What a statement of a model's error is worth: as many independent errors as some drives hold.
STATED_ERRORS = 10.0
# Of a model's whole error so much stays unexplained: no cause has the shape of nature.
SHAPE_SHARE = 0.1


class Noise(NamedTuple):
    """How many times what the model states is left."""

    scale: float = 1.0


@dataclass(frozen=True)
class KnownScale:
    """What is known of the scale beforehand: sum of squares over the statement's, and how many."""

    square: float = STATED_ERRORS
    errors: float = STATED_ERRORS

    def scale(self, square: float, errors: float) -> float:
        """Most likely scale of rows with a sum of squares; never below what is known."""
        least = min(1.0, math.sqrt(self.square / self.errors))
        return max(least, math.sqrt((self.square + square) / (self.errors + errors)))

    def with_more(self, square: float, errors: float) -> KnownScale:
        """The same with rows that are known to be good."""
        return KnownScale(self.square + square, self.errors + errors)

    def gained(self, left: float, taken: float, errors: float) -> float:
        """Nats that a sum of squares ``left`` is worth less once so much of it is ``taken`` off."""
        after = max(self.square + left - taken, self.square)
        return 0.5 * (self.errors + errors) * math.log((self.square + left) / after)

    def ln_density(self, scale: float) -> float:
        """Ln of how likely a scale is, up to a constant."""
        return -self.errors * math.log(scale) - 0.5 * self.square / scale**2


def row_weights(
    evidence: Evidence,
    memory_s: float,
    soc: FloatArray | None = None,
    memory_soc: float | None = None,
) -> FloatArray:
    """How much every scored row counts: the used rows of a log sum up to its independent errors.

    ``memory_soc`` is how far along the SOC an error stays the same, None: not known; ``soc`` the
    SOC of every scored row.
    """
    weights = []
    for log, rows in evidence.each():
        used = evidence.known[rows] & (evidence.role[rows] != IGNORED)
        span = float(log.clock_s[-1] - log.clock_s[0])
        errors = 1.0 + span / (2.0 * memory_s)
        if soc is not None and memory_soc is not None and used.any():
            errors += float(np.ptp(soc[rows][used])) / (2.0 * memory_soc)
        weights.append(np.full(log.scored, min(errors / max(int(used.sum()), 1), 1.0)))
    return np.concatenate(weights)


def stated_V(
    model: CellModel, evidence: Evidence, soc: FloatArray, voltage_V: FloatArray
) -> FloatArray:
    """Error that the model states at every scored row: slow, a share of the polarisation, noise.

    ``soc`` and ``voltage_V`` are as simulated.
    """
    size = np.empty(evidence.rows)
    for g, rows in evidence.each():
        warm = float(np.median(g.temperature_C))
        at = np.clip(soc[rows], 0.0, 1.0)
        drop = np.interp(at, model.soc, model.at_temperature(warm).ocv_V[0]) - voltage_V[rows]
        share = np.where(drop >= 0.0, model.error.share(1.0), model.error.share(-1.0))
        size[rows] = np.hypot(model.error.at(at, warm), share * drop)
    return np.asarray(np.hypot(size, model.error.white_V))

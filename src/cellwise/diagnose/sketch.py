"""Causes named from a sketch alone: what a target kept of weeks of use, in less than a kilobyte.

A sketch (:mod:`cellwise.estimate.fixed.sketch`) holds the score h and the information L of ten
causes, to first order all that a log says of their sizes theta, a unit each:

.. math:: \\hat\\theta = L^{-1} h, \\qquad \\hat\\theta \\sim N(\\theta, s L^{-1} + M)

s is how much larger the innovations were than stated. M is what the model itself is off by: it
looks like causes, too, and does not average out. It is what the model states of its error, and
what the sketches of logs of a good cell (a baseline) show of it. Sets of causes are weighed by
their evidence and by how rare they are, as in a diagnosis of logs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.odds import NAMING, RESISTANCE as KINDS, Rarity, Weighed, probability_of
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.typing import FloatArray


class SketchedCause(NamedTuple):
    """One unknown of a sketch: the cause that it is of, its number's name and unit."""

    cause: str
    parameter: str
    unit: str


# In the order of the sums (``arithmetic``).
SKETCHED = (
    SketchedCause("current_offset", "offset_A", "A"),
    SketchedCause("current_gain", "gain", "1"),
    SketchedCause("voltage_offset", "offset_V", "V"),
    SketchedCause("time_skew", "skew_s", "s"),
    SketchedCause("ohmic_resistance", "added_ohm", "ohm"),
    SketchedCause("resistance_scale", "scale", "1"),
    SketchedCause("slow_diffusion", "slow_scale", "1"),
    SketchedCause("slow_diffusion", "r3_ohm", "ohm"),
    SketchedCause("hysteresis", "m_V", "V"),
    SketchedCause("capacity", "capacity_Ah", "Ah"),
)
OFFSET, GAIN, VOLTAGE, LATE, OHMIC, RESISTANCE, SLOWER, DIFFUSION, REVERSAL, CAPACITY = range(10)
FACTORS = (GAIN, RESISTANCE, SLOWER, CAPACITY)  # of which the sketch has the logarithm
MOST_CAUSES = 3
ROUNDING = 1e-6  # of the largest direction of float32 sums: below it nothing is known
BASELINE_WEIGHT = 3.0  # logs of a good cell that say as much of the model's error as it states


@dataclass(frozen=True, eq=False)
class SketchSums:
    """The sums of one sketch, or of several together.

    ``score`` (10,) and ``information`` (10, 10) in the units of the causes, ``mismatch`` the mean
    square of the innovations over their variance, ``hours`` of use and ``charge_Ah`` moved.
    """

    score: FloatArray
    information: FloatArray
    mismatch: float
    hours: float
    charge_Ah: float

    @classmethod
    def of(cls, record: NDArray[Any]) -> SketchSums:
        """From a record as the step keeps it, blocks that are not full included."""
        one = record[0]
        many = len(SKETCHED)
        lower = np.zeros((many, many))
        lower[np.tril_indices(many)] = one["information"].astype(float) + one["information_now"]
        count = float(one["count"]) + float(one["count_now"])
        squares = float(one["squares"]) + float(one["squares_now"])
        return cls(
            one["score"].astype(float) + one["score_now"],
            lower + np.tril(lower, -1).T,
            squares / count if count > 0.0 else 1.0,
            float(one["hours"]),
            float(one["charge_Ah"]),
        )


@dataclass(frozen=True)
class SketchedParameter:
    """What a sketch says of one number of a cause: value and standard deviation."""

    cause: str
    name: str
    unit: str
    value: float
    std: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return dict(vars(self))


@dataclass(frozen=True)
class SketchDiagnosis:
    """What sketches show.

    ``verdict`` is the likeliest cause that is named, or "none"; ``causes`` those named with their
    probability; ``parameters`` their numbers; ``competing`` the sets that were weighed, likeliest
    first; ``limits`` what these sketches cannot tell.
    """

    verdict: str
    causes: tuple[Weighed, ...]
    parameters: tuple[SketchedParameter, ...]
    competing: tuple[Weighed, ...]
    limits: tuple[str, ...]
    hours: float
    charge_Ah: float

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "verdict": self.verdict,
            "causes": [
                {
                    "name": one.causes[0],
                    "probability": one.probability,
                    "parameters": [
                        p.to_dict() for p in self.parameters if p.cause == one.causes[0]
                    ],
                }
                for one in self.causes
            ],
            "competing": [one.to_dict() for one in self.competing],
            "limits": list(self.limits),
            "hours": self.hours,
            "charge_Ah": self.charge_Ah,
        }


def diagnose_sketch(
    model: CellModel, sketches: Sequence[SketchSums], baseline: Sequence[SketchSums] = ()
) -> SketchDiagnosis:
    """Causes from sketches of one cell, or of what many cells have in common.

    Parameters
    ----------
    model : CellModel         that the target ran
    sketches                  of what is to be explained
    baseline                  of logs of a good cell of this model, each its own: by them is known
                              what the model's own error looks like

    Raises
    ------
    InputError        no sketch, or none in which a voltage was weighed
    """
    weighed_rows = [s for s in sketches if np.trace(s.information) > 0.0]
    if not weighed_rows:
        raise InputError(
            f"{len(sketches)} sketches without a voltage that was used",
            "at least one of a target that has run with a known SOC",
            "Let it run, and read the sketch again.",
        )
    information = np.sum([s.information for s in weighed_rows], axis=0)
    score = np.sum([s.score for s in weighed_rows], axis=0)
    mismatch = float(np.mean([s.mismatch for s in weighed_rows]))
    prior = prior_std(model)
    unit = prior  # every number in deviations of its prior
    problem = _Problem(
        score * unit / mismatch,
        information * np.outer(unit, unit) / mismatch,
        own_error(model, baseline) / np.outer(unit, unit),
    )
    sets = problem.weighed()
    named = tuple(
        sorted(
            (
                Weighed((name,), p)
                for name in dict.fromkeys(c.cause for c in SKETCHED)
                if (p := probability_of(name, sets)) >= NAMING.least
            ),
            key=lambda w: -w.probability,
        )
    )
    names = {w.causes[0] for w in named}
    return SketchDiagnosis(
        named[0].causes[0] if named else "none",
        named,
        tuple(problem.parameters(names, model, unit)),
        tuple(w for w in sets if w.probability >= NAMING.shown),
        tuple(problem.limits(unit)),
        float(sum(s.hours for s in sketches)),
        float(sum(s.charge_Ah for s in sketches)),
    )


def prior_std(model: CellModel) -> FloatArray:
    """How large causes are where they are there: of the catalogue, in the units of the sketch."""
    typical_ohm = float(np.median(model.r0_ohm))
    wide = {
        (c.name, p.name): p.wide * (model.capacity_Ah if p.per == "capacity" else 1.0)
        for c in CAUSES.values()
        for one in (c, *c.forms)
        for p in one.parameters
    }
    slower = CAUSES["slow_diffusion"].forms[0].parameters[0].wide
    std = [wide.get((c.cause, c.parameter), slower) for c in SKETCHED]
    std[OHMIC] *= typical_ohm
    std[DIFFUSION] = CAUSES["slow_diffusion"].parameters[0].wide * typical_ohm
    return np.array(std)


def own_error(model: CellModel, baseline: Sequence[SketchSums] = ()) -> FloatArray:
    """Covariance of what the model's own error looks like, (10, 10), in the units of the causes.

    By what the model states of its error that comes back in every log, and of its capacity; and by
    what the logs of a baseline show.
    """
    noise = Noise.of_model(model)
    back = math.sqrt(noise.lasting_share)
    error_V = back * float(np.sqrt(np.mean(model.slow_error_tables_V() ** 2)))
    share = noise.branch_share
    typical_ohm = float(np.median(model.r0_ohm))
    # Over a discharge an error of the OCV looks like a charge that is missing.
    slope_V = float(np.ptp(model.ocv_V[0]))
    charge = math.hypot(error_V / slope_V, noise.capacity_share)
    std = np.zeros(len(SKETCHED))
    std[[VOLTAGE, REVERSAL]] = error_V
    std[[RESISTANCE, SLOWER]] = share
    std[[OHMIC, DIFFUSION]] = share * typical_ohm
    # Loads that last, which no test showed.
    slow_ohm = float(np.median(sum(np.asarray(r) for r in (model.r1_ohm, model.r2_ohm)))) + typical_ohm
    lasting = model.error.hidden_share()
    std[SLOWER] = math.hypot(std[SLOWER], 2.0 * lasting)
    std[DIFFUSION] = math.hypot(std[DIFFUSION], lasting * slow_ohm)
    std[[GAIN, CAPACITY]] = charge
    stated = np.diag(std**2)
    if not baseline:
        return np.asarray(stated)
    inverse = np.diag(1.0 / prior_std(model) ** 2)
    shown = np.zeros_like(stated)
    for one in baseline:
        scale = one.mismatch
        theta = np.linalg.solve(one.information / scale + inverse, one.score / scale)
        shown += np.outer(theta, theta)
    total = shown + BASELINE_WEIGHT * stated
    return np.asarray(total / (len(baseline) + BASELINE_WEIGHT))


class _Problem:
    """Sums in deviations of the priors: what sets of causes they could be of."""

    def __init__(self, score: FloatArray, information: FloatArray, own: FloatArray) -> None:
        # What float32 sums do not hold stays open.
        size, axes = np.linalg.eigh(information)
        size = np.maximum(size, ROUNDING * size[-1])
        inverse = (axes / size) @ axes.T
        self.theta = inverse @ score
        self.inverse = np.linalg.inv(inverse + own)
        self.information = information

    def weighed(self) -> tuple[Weighed, ...]:
        """Every set and its probability, likeliest first."""
        odds: dict[tuple[str, ...], float] = {}
        for at in self._sets():
            names = tuple(sorted({SKETCHED[k].cause for k in at}))
            nats = self._gain(at) - Rarity().nats(names)
            odds[names] = max(odds.get(names, -math.inf), nats)  # of forms of a cause the likelier
        most = max(odds.values())
        weight = {names: math.exp(o - most) for names, o in odds.items()}
        whole = sum(weight.values())
        found = [Weighed(names, w / whole) for names, w in weight.items()]
        return tuple(sorted(found, key=lambda w: -w.probability))

    def _sets(self) -> Iterator[tuple[int, ...]]:
        for size in range(MOST_CAUSES + 1):
            for at in combinations(range(len(SKETCHED)), size):
                names = {SKETCHED[k].cause for k in at}
                if len(names) == size and len(names & KINDS) < 2:
                    yield at

    def _gain(self, at: tuple[int, ...]) -> float:
        """Ln of the evidence with some causes over that without [nats]."""
        if not at:
            return 0.0
        k = list(at)
        seen = (self.inverse @ self.theta)[k]
        inner = self.inverse[np.ix_(k, k)] + np.eye(len(k))
        _, size = np.linalg.slogdet(inner)
        return 0.5 * float(seen @ np.linalg.solve(inner, seen) - size)

    def parameters(
        self, names: set[str], model: CellModel, unit: FloatArray
    ) -> Iterator[SketchedParameter]:
        """Numbers of the causes that are named, with what is not known of them."""
        forms = [at for at in self._sets() if {SKETCHED[k].cause for k in at} == names]
        if not names or not forms:
            return
        k = list(max(forms, key=self._gain))
        covariance = np.linalg.inv(self.inverse[np.ix_(k, k)] + np.eye(len(k)))
        value = covariance @ (self.inverse @ self.theta)[k]
        for n, index in enumerate(k):
            size, std = value[n] * unit[index], math.sqrt(covariance[n, n]) * unit[index]
            if index in FACTORS:
                whole = model.capacity_Ah if index == CAPACITY else 1.0
                size, std = whole * math.exp(size), whole * math.exp(size) * std
            c = SKETCHED[index]
            yield SketchedParameter(c.cause, c.parameter, c.unit, float(size), float(std))

    def limits(self, unit: FloatArray) -> Iterator[str]:
        """What could be there unseen: the smallest size of each cause that would be named."""
        needed = math.sqrt(2.0 * (Rarity().nats(("current_gain",)) + NAMING.nats))
        for index, c in enumerate(SKETCHED):
            std = 1.0 / math.sqrt(self.inverse[index, index])
            least = needed * std * unit[index]
            if std * needed > 1.0:
                yield f"{c.cause}: {c.parameter} below {least:.2g} {c.unit} would not be seen"

"""Causes from sketches alone: how the parameters of a later one differ from those of an earlier.

A sketch holds the normal equations of all causes (:mod:`cellwise.estimate.sketch`). The parameters
that they give are far from zero in a healthy cell, too, since no model is exact; what they differ
by between two sketches of one cell is compared with what clean sketches differ by (decision 0015).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.sketch.stored import SketchSums
from cellwise.typing import FloatArray

# In the order of the sums. A size of one: what is usual in the field.
ORDER = (
    "current_offset", "current_gain", "voltage_offset", "time_skew", "ohmic_resistance",
    "resistance_scale", "slow_diffusion", "hysteresis", "capacity", "initial_soc",
)  # fmt: skip
NAMED = ORDER[:-1]
NO_PAST = (
    "one sketch alone names next to nothing: its parameters hold the model's own error, which is "
    "as large as a cause; only an earlier sketch of the same cell shows that error"
)


class SketchPrior(NamedTuple):
    """What is assumed before a sketch is read; measured in decision 0015."""

    ridge: float = 1.0  # of every parameter, in its size
    odds: float = 20.0  # of no cause against one
    unknown: float = 1000.0  # of what is known against an error of another kind,
    wider: float = 9.0  # which has so many times the variance
    misfit: float = 0.25  # of a cause: how far it looks from its linear picture
    sizes: tuple[float, float] = (0.7, 1.5)  # of a cause
    name_at: float = 0.9  # probability


PRIOR = SketchPrior()


@dataclass(frozen=True)
class SketchCause:
    """A cause with its ``probability``, its ``parameters`` and their 95 % intervals ``ci95``."""

    name: str
    probability: float
    parameters: Mapping[str, float]
    ci95: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class SketchDiagnosis:
    """What sketches show.

    ``verdict`` as of :class:`~cellwise.diagnose.result.Diagnosis`; ``causes`` the one that is
    named; ``candidates`` every cause with its probability; ``limits`` the smallest size that these
    sketches would name, by cause, and None where they would name it at no size; ``reasons``.
    """

    verdict: str
    causes: tuple[SketchCause, ...] = ()
    candidates: tuple[SketchCause, ...] = ()
    limits: Mapping[str, Mapping[str, float] | None] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "verdict": self.verdict,
            "causes": [vars(c) for c in self.causes],
            "candidates": [vars(c) for c in self.candidates],
            "limits": dict(self.limits),
            "reasons": list(self.reasons),
        }


def diagnose_sketch(
    model: CellModel, baseline: SketchSums | None, later: Sequence[SketchSums]
) -> SketchDiagnosis:
    """What has come to a cell between sketches.

    Parameters
    ----------
    baseline : SketchSums or None    of the same cell, when it was known to be good
    later : sequence of SketchSums   together

    Raises
    ------
    InputError        no later sketch; of other tables than the baseline
    """
    if baseline is None:
        return SketchDiagnosis("undetermined", reasons=(NO_PAST,))
    if not later or {s.model_crc for s in later} != {baseline.model_crc}:
        raise InputError(
            "sketches of other tables" if later else "a baseline alone",
            "a baseline and later sketches of one firmware",
            "Give what one target has kept.",
        )
    sizes = _sizes(model)
    looks, late = _parameters(later, sizes)
    off = late - _parameters([baseline], sizes)[1]
    pictures = {n: looks[:, ORDER.index(n)] for n in NAMED}
    share = odds_of(off, pictures)
    found = sorted(
        (_cause(model, n, share[n], off, pictures[n]) for n in NAMED), key=lambda c: -c.probability
    )
    first = max(share, key=lambda n: share[n])
    sure = share[first] >= PRIOR.name_at
    verdict = {"none": "none", "unknown": "unexplained"}.get(first, first) if sure else ""
    limits = {n: _limit(model, n, pictures) for n in NAMED}
    unseen = [n for n in NAMED if limits[n] is None]
    reasons = (f"at no size would these sketches name: {', '.join(unseen)}",) if unseen else ()
    named = tuple(c for c in found if c.name == verdict)
    return SketchDiagnosis(verdict or "undetermined", named, tuple(found), limits, reasons)


def odds_of(off: FloatArray, pictures: Mapping[str, FloatArray]) -> dict[str, float]:
    """Probability of no cause (``none``), of an unknown error (``unknown``) and of every cause."""
    clean, p = spread(), PRIOR
    log = {"none": _ln(off, clean), "unknown": _ln(off, p.wider * clean) - np.log(p.unknown)}
    for name, look in pictures.items():
        own = np.outer(look, look) + p.misfit**2 * (look @ look) * np.eye(look.size)
        ways = [clean + size**2 * own for size in p.sizes]
        wide = [more + (p.wider - 1.0) * clean for more in ways]
        terms = [_ln(off, c) for c in ways] + [_ln(off, c) - np.log(p.unknown) for c in wide]
        log[name] = float(np.logaddexp.reduce(terms)) - np.log(p.odds * len(p.sizes))
    most = np.logaddexp.reduce(list(log.values()))
    return {name: float(np.exp(value - most)) for name, value in log.items()}


@lru_cache
def spread() -> FloatArray:
    """Covariance (10, 10) of what clean sketches of one cell differ by."""
    text = Path(__file__).with_name("sketch_spread.json").read_text(encoding="utf-8")
    return np.array(json.loads(text)["covariance"]) + 0.05**2 * np.eye(len(ORDER))


def _ln(off: FloatArray, covariance: FloatArray) -> float:
    log_det = float(np.linalg.slogdet(covariance)[1])
    return -0.5 * (float(off @ np.linalg.solve(covariance, off)) + log_det)


def _parameters(of: Sequence[SketchSums], sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How every cause looks in the parameters, a column each, and the parameters themselves."""
    products = np.outer(sizes, sizes) * np.mean([s.products for s in of], axis=0)
    inverse = np.linalg.inv(products + PRIOR.ridge * np.eye(sizes.size))
    right = sizes * np.mean([s.with_residual for s in of], axis=0)
    return inverse @ products, inverse @ right


def _sizes(model: CellModel) -> FloatArray:
    """Of one of every cause: 3 % of 1C, 5 %, 20 mV, 0.5 s, 0.3 R0 and 30 %, R0, 30 mV, 5 %, 2 %."""
    ohm = float(np.median(model.r0_ohm))
    return np.array(
        [0.03 * model.capacity_Ah, 0.05, 0.02, 0.5, 0.3 * ohm, 0.3, ohm, 0.03, -0.05, -0.02]
    )


def _values(model: CellModel, name: str, size: float) -> dict[str, float]:
    """The parameter of a cause at a size, by its name in the vocabulary."""
    x = size * float(_sizes(model)[ORDER.index(name)])
    return {
        "current_offset": {"offset_A": x},
        "current_gain": {"gain": float(np.exp(x))},
        "voltage_offset": {"offset_V": x},
        "time_skew": {"skew_s": x},
        "ohmic_resistance": {"added_ohm": x},
        "resistance_scale": {"scale": 1.0 + x},
        "slow_diffusion": {"r3_ohm": x},
        "hysteresis": {"m_V": x},
        "capacity": {"capacity_Ah": model.capacity_Ah * float(np.exp(x))},
    }[name]


def _cause(
    model: CellModel, name: str, probability: float, off: FloatArray, look: FloatArray
) -> SketchCause:
    """A cause with its size, were it the only one."""
    seen = np.linalg.solve(spread(), look)
    size, std = float(seen @ off / (seen @ look)), float(1.0 / np.sqrt(seen @ look))
    ends = [_values(model, name, size + k * std) for k in (-1.96, 1.96)]
    ci95 = {n: (min(e[n] for e in ends), max(e[n] for e in ends)) for n in ends[0]}
    return SketchCause(name, probability, _values(model, name, size), ci95)


def _limit(
    model: CellModel, name: str, pictures: Mapping[str, FloatArray]
) -> dict[str, float] | None:
    """The smallest size, by quarters up to four, that would be named; None: at no size."""
    for size in np.arange(0.25, 4.25, 0.25):
        if odds_of(size * pictures[name], pictures)[name] >= PRIOR.name_at:
            return _values(model, name, float(size))
    return None

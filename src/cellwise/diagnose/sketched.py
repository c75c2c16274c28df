"""Causes from sketches alone: how the parameters of a later one differ from those of an earlier.

A sketch holds the normal equations of its derivatives (:mod:`cellwise.estimate.sketch`). The
parameters that they give are far from zero in a healthy cell, too, since no model is exact. What
they differ by, from an earlier sketch of the cell or from its fleet, is compared with what clean
sketches of one cell differ by and with how each cause looks in the model's own logs
(:mod:`cellwise.diagnose.sketch_pictures`); decision 0015 has what was measured.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.diagnose.sketch_pictures import NAMED, Pictures, parameters_of, pictures_in, usual
from cellwise.errors import InputError
from cellwise.estimate.sketch.stored import SketchSums
from cellwise.typing import FloatArray

NO_PAST = (
    "one sketch of a target names next to nothing: it holds the model's own error, which is as "
    "large as a cause; give an earlier sketch of the same target before it, or those of a fleet"
)


APART = (
    "sketches at {:.0f} and {:.0f} degC: a model errs otherwise at another temperature; those "
    "within {:g} K of one another compare"
)


class Off(NamedTuple):
    """What parameters differ by: as causes are named by, and ``linear`` in a cause for its size."""

    parameters: FloatArray
    linear: FloatArray


class SketchPrior(NamedTuple):
    """What is assumed before a sketch is read; chosen in decision 0015."""

    odds: float = 20.0  # of no cause against one
    unknown: float = 1000.0  # of what is known against an error of another kind,
    wider: float = 9.0  # which has so many times the variance
    misfit: float = 0.2  # of a cause: how far it looks from its picture
    sizes: tuple[float, float] = (0.7, 1.5)  # of a cause, in its usual size
    name_at: float = 0.9  # probability
    apart_K: float = 10.0  # mean temperatures of sketches that compare
    fleet: int = 5  # targets, of which the middle one stands for all
    healthy: float = 0.75  # share of a fleet, by which the others are judged


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


@dataclass(frozen=True)
class FleetDiagnosis:
    """What all targets have (``common``: table, class of sensors), and by its number what one has.

    ``common`` is None where there are too few targets to say.
    """

    common: SketchDiagnosis | None
    units: Mapping[int, SketchDiagnosis]


def diagnose_sketch(
    model: CellModel,
    past: SketchSums | None,
    later: Sequence[SketchSums],
    without_lineage: str = "",
) -> SketchDiagnosis:
    """What has come to a cell between sketches.

    Parameters
    ----------
    past : SketchSums or None        of the same cell, when it was known to be good
    later : sequence of SketchSums   together
    without_lineage : str            cells that are left out of what clean sketches differ by

    Raises
    ------
    InputError        no later sketch; of another size or other tables than the past; a model
                      without pictures
    """
    known = pictures_in(model)
    if past is None:
        return SketchDiagnosis("undetermined", reasons=(NO_PAST,))
    check_alike([past, *later], len(later) > 0)
    pictures = known[past.with_residual.size]
    clean = spread(past.with_residual.size, without_lineage)
    return _compared(model, past, later, pictures, clean)


def diagnose_fleet(
    model: CellModel, units: Mapping[int, Sequence[SketchSums]], without_lineage: str = ""
) -> FleetDiagnosis:
    """What all targets of one firmware have, and what each of them has beside it.

    Of a target with several sketches the first is its past; one alone is compared with the fleet.

    Parameters
    ----------
    units : mapping of sequences of SketchSums    by the number of the target, in order of time
    without_lineage : str    as of :func:`diagnose_sketch`

    Raises
    ------
    InputError        no sketch; of several sizes or other tables; a model without pictures
    """
    known = pictures_in(model)
    every = [s for of in units.values() for s in of]
    check_alike(every, bool(every))
    size = every[0].with_residual.size
    pictures, clean = known[size], spread(size, without_lineage)
    at, linear = (
        {unit: parameters_of(model, of[-1:], excess) for unit, of in units.items()}
        for excess in (None, pictures.excess)
    )
    common, scatter = None, clean
    middle, linear_middle = (np.median(list(p.values()), axis=0) for p in (at, linear))
    warm_C = float(np.median([of[-1].temperature_C for of in units.values()]))
    if len(units) >= PRIOR.fleet:
        off = Off(middle - pictures.clean, linear_middle - pictures.clean)
        common = _near(warm_C, pictures.temperature_C) or _judged(model, off, pictures, clean)
        scatter = 0.5 * (clean + _scatter(np.array(list(at.values())) - middle, clean))
    found = {}
    for unit, of in units.items():
        if len(of) > 1:
            found[unit] = _compared(model, of[0], of[1:], pictures, clean)
        elif common is not None:
            off = Off(at[unit] - middle, linear[unit] - linear_middle)
            near = _near(of[0].temperature_C, warm_C)
            found[unit] = near or _judged(model, off, pictures, scatter)
        else:
            found[unit] = SketchDiagnosis("undetermined", reasons=(NO_PAST,))
    return FleetDiagnosis(common, found)


def check_alike(sketches: Sequence[SketchSums], given: bool) -> None:
    """Refuse sketches that do not compare.

    Raises
    ------
    InputError        none; of several sizes or of other tables
    """
    kinds = {(s.model_crc, s.with_residual.size) for s in sketches}
    if not given or len(kinds) > 1:
        raise InputError(
            "sketches of other tables or sizes" if given else "no sketch to explain",
            "sketches of one firmware",
            "Give what targets of one export have kept.",
        )


def odds_of(
    off: FloatArray, pictures: Mapping[str, FloatArray], clean: FloatArray
) -> dict[str, float]:
    """Probability of no cause (``none``), of an unknown error (``unknown``) and of every cause."""
    p = PRIOR
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
def spread(size: int, without_lineage: str = "") -> FloatArray:
    """Covariance (size, size) of what clean sketches of one cell differ by, a lineage's mean each.

    Raises
    ------
    InputError        a lineage that is not among them
    """
    text = Path(__file__).with_name("sketch_spread.json").read_text(encoding="utf-8")
    of = json.loads(text)["covariance"][str(size)]
    if without_lineage and without_lineage not in of:
        raise InputError(f"lineage '{without_lineage}'", f"one of {', '.join(of)}", "Name one.")
    taken = [np.array(m) for name, m in of.items() if name != without_lineage]
    return np.asarray(np.mean(taken, axis=0) + 0.05**2 * np.eye(size))


def _scatter(off: FloatArray, clean: FloatArray) -> FloatArray:
    """Covariance of the targets of a fleet that are nearest to its middle."""
    far = np.einsum("ki,ij,kj->k", off, np.linalg.inv(clean), off)
    near = off[far <= np.quantile(far, PRIOR.healthy)]
    return np.asarray(near.T @ near / len(near))


def _ln(off: FloatArray, covariance: FloatArray) -> float:
    log_det = float(np.linalg.slogdet(covariance)[1])
    return -0.5 * (float(off @ np.linalg.solve(covariance, off)) + log_det)


def _near(one_C: float, other_C: float) -> SketchDiagnosis | None:
    """What is said where two temperatures do not compare."""
    if abs(one_C - other_C) <= PRIOR.apart_K:
        return None
    return SketchDiagnosis("undetermined", reasons=(APART.format(one_C, other_C, PRIOR.apart_K),))


def _compared(
    model: CellModel,
    past: SketchSums,
    later: Sequence[SketchSums],
    pictures: Pictures,
    clean: FloatArray,
) -> SketchDiagnosis:
    warm_C = float(np.mean([s.temperature_C for s in later]))
    apart = _near(past.temperature_C, warm_C)
    off = Off(
        *(
            parameters_of(model, later, excess) - parameters_of(model, [past], excess)
            for excess in (None, pictures.excess)
        )
    )
    return apart or _judged(model, off, pictures, clean)


def _judged(model: CellModel, off: Off, pictures: Pictures, clean: FloatArray) -> SketchDiagnosis:
    share = odds_of(off.parameters, pictures.causes, clean)
    found = sorted(
        (_cause(model, n, share[n], off.linear, pictures.sizes[n], clean) for n in NAMED),
        key=lambda c: -c.probability,
    )
    first = max(share, key=lambda n: share[n])
    sure = share[first] >= PRIOR.name_at
    verdict = {"none": "none", "unknown": "unexplained"}.get(first, first) if sure else ""
    limits = _limits(model, pictures, clean)
    unseen = [n for n in NAMED if limits[n] is None]
    reasons = (f"at no size would these sketches name: {', '.join(unseen)}",) if unseen else ()
    named = tuple(c for c in found if c.name == verdict)
    return SketchDiagnosis(verdict or "undetermined", named, tuple(found), limits, reasons)


def _values(model: CellModel, name: str, size: float) -> dict[str, float]:
    """The parameter of a cause at so many usual sizes, by its name in the vocabulary."""
    x = size * usual(model)[name]
    return {
        "current_offset": {"offset_A": x},
        "current_gain": {"gain": 1.0 + x},
        "voltage_offset": {"offset_V": x},
        "time_skew": {"skew_s": x},
        "ohmic_resistance": {"added_ohm": x},
        "slow_diffusion": {"r3_ohm": x},
        "hysteresis": {"m_V": x},
    }[name]


def _cause(
    model: CellModel,
    name: str,
    probability: float,
    off: FloatArray,
    look: FloatArray,
    clean: FloatArray,
) -> SketchCause:
    """A cause with its size, were it the only one."""
    seen = np.linalg.solve(clean, look)
    size = float(seen @ off / (seen @ look))
    std = float(np.hypot(1.0 / np.sqrt(seen @ look), PRIOR.misfit * size))
    ends = [_values(model, name, size + k * std) for k in (-1.96, 1.96)]
    ci95 = {n: (min(e[n] for e in ends), max(e[n] for e in ends)) for n in ends[0]}
    return SketchCause(name, probability, _values(model, name, size), ci95)


def _limits(
    model: CellModel, pictures: Pictures, clean: FloatArray
) -> dict[str, Mapping[str, float] | None]:
    """The smallest size, by quarters up to four, that would be named; None: at no size."""
    found: dict[str, Mapping[str, float] | None] = dict.fromkeys(NAMED)
    for name, look in pictures.causes.items():
        for size in np.arange(0.25, 4.25, 0.25):
            if odds_of(size * look, pictures.causes, clean)[name] >= PRIOR.name_at:
                found[name] = _values(model, name, float(size))
                break
    return found


def without_details(found: SketchDiagnosis) -> SketchDiagnosis:
    """The same without its limits, which are those of the fleet."""
    return replace(found, limits={})

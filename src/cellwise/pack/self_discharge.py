"""Which cell discharges itself: it drifts in every period, where balancing moves a cell in some."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from cellwise.pack.differences import SELF_DISCHARGE, usual_spread
from cellwise.pack.evidence import PackEvidence, robust_std
from cellwise.pack.pack_state import CellDeltas, Drift, posterior
from cellwise.pack.suspicion import ALARM, EXPLANATIONS, Suspicion, scale_of
from cellwise.typing import FloatArray

APART = ("resistance_scale", "time_skew")  # seen under load alone
CAUSE = next(one for one in EXPLANATIONS if one.cause == "self_discharge")
DRIFT_PER_DAY = 3e-3  # what balancing may do to a cell, and more
SIZES = 200  # of a self-discharge that are tried, up to the largest drift
# Standard deviations of a drift in one period: worth a notice; enough for whatever else is found of
# the cell to be uncertain.
WORTH_SAYING, ALSO_DRIFTING = 5.0, 2.0


def drift_of(spread: FloatArray, evidence: PackEvidence) -> Drift | None:
    """What a period shows; None where its logs are of one day, or nobody knows of which."""
    if evidence.days <= 0.0:
        return None
    start = CellDeltas.unknown(evidence.rows.size, spread)
    start.covariance[:, SELF_DISCHARGE, SELF_DISCHARGE] = DRIFT_PER_DAY**2
    mean, covariance = posterior(start.mean, start.covariance, evidence)
    per_day = mean[:, SELF_DISCHARGE] - np.median(mean[:, SELF_DISCHARGE])
    own = covariance[:, SELF_DISCHARGE, SELF_DISCHARGE]
    least = usual_spread().cells[SELF_DISCHARGE] ** 2
    return Drift(per_day, np.sqrt(np.maximum(own, float(robust_std(per_day)) ** 2) + least))


def self_discharging(drifts: Sequence[Drift]) -> list[Suspicion]:
    """Cells that lose charge in one period after the other.

    Notes
    -----
    Likelihood ratio of a constant drift from some period on against none. What balancing does to a
    cell in one period has no usual size: the drift's error is Cauchy's, of which a single period,
    however far off, says little, and several that agree say much.
    """
    if len(drifts) < 2:
        return []
    v, std = (np.stack(x) for x in zip(*drifts, strict=True))  # (periods, cells)
    sizes = np.linspace(0.0, max(float(np.max(v)), 1e-12), SIZES)[:, None, None]
    ratio = np.log1p((v / std) ** 2) - np.log1p(((v - sizes) / std) ** 2)
    # Of the last two periods, three, ...: (sizes, starts, cells), then the best of each cell.
    gains = np.cumsum(ratio[:, ::-1], axis=1)[:, 1:] - math.log(len(drifts) - 1)
    best = np.argmax(gains.reshape(-1, v.shape[1]), axis=0)
    size_of, start_of = np.unravel_index(best, gains.shape[:2])
    gain = np.maximum(gains[size_of, start_of, np.arange(best.size)], 0.0)
    gain /= scale_of(2.0 * gain, 1)
    allowed = ALARM.false_alarms / (gain.size * len(EXPLANATIONS))
    found = []
    for cell in np.flatnonzero(chi2.sf(2.0 * gain, 1) < allowed).tolist():
        chance = math.exp(ALARM.penalty - math.log(allowed) - float(gain[cell]))
        found.append(
            Suspicion(
                cell=cell,
                explanation=CAUSE,
                size=float(sizes[size_of[cell], 0, 0]),
                std=float(np.sum(std[-2 - start_of[cell] :, cell] ** -2.0) ** -0.5),
                gain=float(gain[cell]),
                probability=1.0 / (1.0 + chance),
                others=(),
                changed=False,
            )
        )
    return found


def also_drifting(found: Sequence[Suspicion], drift: Drift) -> list[Suspicion]:
    """The suspicions, at most half as probable where the cell drifts as well.

    What moves all the time is fitted by a capacity or an offset nearly as well.
    """
    times = drift.per_day / drift.std
    return [
        one
        if one.explanation.cause in APART or times[one.cell] < ALSO_DRIFTING
        else replace(
            one,
            probability=min(one.probability, 0.5),
            others=tuple(dict.fromkeys((CAUSE.cause, *one.others))),
        )
        for one in found
    ]


def drifting(drift: Drift) -> int | None:
    """The cell whose drift in one period is worth saying; None: there is none."""
    times = drift.per_day / drift.std
    return int(np.argmax(times)) if float(np.max(times)) > WORTH_SAYING else None

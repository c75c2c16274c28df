"""Which cell is not like the others, or not as it was, and of what it is: cell, sensor, polling.

Two cells whose voltages have changed places (a harness, columns of an export) are found here, too;
and a cell that discharges itself: it drifts in every period, where balancing moves one in some.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from cellwise.pack.differences import (
    CAPACITY,
    LAG,
    LEAD,
    OFFSET,
    RESISTANCE,
    SELF_DISCHARGE,
    SIZE,
    SOC,
    usual_spread,
)
from cellwise.pack.evidence import USUAL, PackEvidence, robust_std
from cellwise.pack.pack_state import CellDeltas, Drift, posterior
from cellwise.typing import FloatArray


class Alarm(NamedTuple):
    """When a cell is named.

    ``false_alarms``: share of packs and periods with a false one, over all cells and causes;
    ``odd_share`` of the cells, one at least, may be odd themselves; ``penalty``: log likelihood
    that one more parameter costs; ``confusable``: within which two explanations are;
    ``tail_shares`` of the cells, at which their ratios are compared with theory's.
    """

    false_alarms: float = 0.01
    odd_share: float = 0.05
    penalty: float = 2.0
    confusable: float = 3.0
    tail_shares: tuple[float, ...] = (0.5, 0.8, 0.9, 0.94)


class Exchange(NamedTuple):
    """When two cells have changed places.

    ``better``: log likelihood by which that has to be more probable than two changes;
    ``remaining``: share of two large misfits that may be left once it explains them.
    """

    better: float = 10.0
    remaining: float = 0.005


class Drifting(NamedTuple):
    """When a cell discharges itself.

    ``balancing_per_day``: what balancing may do to a cell's SOC, and more; ``sizes`` of a
    self-discharge that are tried, up to the largest drift. Standard deviations of a drift in one
    period: ``worth_saying`` in a notice; from ``uncertain`` on whatever else is found of the cell
    is, but for what is ``apart`` from it, seen under load alone.
    """

    balancing_per_day: float = 3e-3
    sizes: int = 200
    worth_saying: float = 5.0
    uncertain: float = 2.0
    apart: tuple[str, ...] = ("resistance_scale", "time_skew")


ALARM, EXCHANGE, DRIFTING = Alarm(), Exchange(), Drifting()


@dataclass(frozen=True)
class Explanation:
    """A cause: its name as `cellwise diagnose` has it, and the differences that it moves."""

    cause: str
    moves: tuple[int, ...]
    shown: int
    parameter: str
    negligible: float
    sign: int = 0
    sensor: bool = False


# Smaller differences nobody would act on. A cell may only lose capacity, gain resistance and lose
# charge of its own: the other way round it is no fault.
EXPLANATIONS = (
    Explanation("capacity", (CAPACITY, SOC), CAPACITY, "capacity_Ah", 0.003, sign=-1),
    Explanation("resistance_scale", (RESISTANCE,), RESISTANCE, "scale", 0.010, sign=1),
    Explanation("initial_soc", (SOC,), SOC, "soc0", 0.002),
    Explanation("self_discharge", (SELF_DISCHARGE, SOC), SELF_DISCHARGE, "leak_A", 2e-5, sign=1),
    Explanation("voltage_offset", (OFFSET,), OFFSET, "offset_V", 0.0005, sensor=True),
    Explanation("time_skew", (LAG, LEAD), LAG, "skew_s", 0.05, sensor=True),
)


@dataclass(frozen=True)
class Suspicion:
    """One cell and its most probable cause.

    ``size`` and ``std`` are the difference of ``explanation.shown`` (for polling: lag plus lead)
    from the other cells or from the cell's own past; ``gain`` the log likelihood that it explains,
    ``probability`` that of the cause against the other causes and against none, which any one cell
    has but for ``false_alarms`` of packs; ``others`` what explains nearly as much; ``changed``:
    against its own past.
    """

    cell: int
    explanation: Explanation
    size: float
    std: float
    gain: float
    probability: float
    others: tuple[str, ...]
    changed: bool


def suspicions(
    prior_mean: FloatArray, prior_covariance: FloatArray, evidence: PackEvidence, *, changed: bool
) -> list[Suspicion]:
    """Cells whose evidence is not what is expected of them.

    Parameters
    ----------
    prior_mean : (cells, SIZE) float                what is expected: zero and the spread between
    prior_covariance : (cells, SIZE, SIZE) float    cells, or the cell's own past and its drift
    changed : bool                                  which of the two it is

    Notes
    -----
    Generalised likelihood ratio of a shift along each explanation's directions. What all cells
    have in common is no cell's; and the cells are each other's reference: where their usual ratio
    is larger than theory has it, all ratios are scaled down by as much.
    """
    there = np.flatnonzero(evidence.rows > 0)
    if there.size < 3:
        return []
    a = evidence.matrix[there]
    p = prior_covariance[there] + np.diag(_negligible() ** 2)
    mean = prior_mean[there]
    after, _ = posterior(prior_mean, prior_covariance, evidence)
    common = np.median(after[there] - mean, axis=0)
    surprise = evidence.vector[there] - np.einsum("cij,cj->ci", a, mean + common)
    eye = np.eye(SIZE)
    precision = np.asarray(
        np.linalg.solve(eye + a @ p, a), dtype=np.float64
    )  # of the evidence about a shift
    pull = np.asarray(np.linalg.solve(eye + a @ p, surprise[..., None])[..., 0])
    gains, shifts, stds = [], [], []
    for one in EXPLANATIONS:
        gain, shift, std = _along(precision, pull, one)
        scale = scale_of(2.0 * gain, len(one.moves))
        gains.append(gain / scale)
        shifts.append(shift)
        stds.append(std * np.sqrt(scale))
    found = []
    allowed = ALARM.false_alarms / (there.size * len(EXPLANATIONS))
    for k, cell in enumerate(there.tolist()):
        ratio = np.array([g[k] for g in gains])
        tail = [
            float(chdtrc(len(e.moves), 2.0 * max(g, 0.0)))
            for g, e in zip(ratio, EXPLANATIONS, strict=True)
        ]
        if min(tail) >= allowed:
            continue
        suspect = _named(cell, k, ratio, shifts, stds, changed, allowed)
        # From day to day balancing moves a cell as self-discharge does: several periods decide.
        if evidence.days == 0.0 or suspect.explanation.shown != SELF_DISCHARGE:
            found.append(suspect)
    return found


def _along(
    precision: FloatArray, pull: FloatArray, one: Explanation
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log likelihood ratio, size and deviation of a shift along an explanation, (cells,) each."""
    moves = list(one.moves)
    inner = precision[:, moves][:, :, moves] + 1e-12 * np.eye(len(moves))
    right = pull[:, moves]
    covariance = np.linalg.inv(inner)
    shift = np.einsum("cij,cj->ci", covariance, right)
    gain = 0.5 * np.einsum("ci,ci->c", right, shift)
    sums = np.ones(2) if one.shown == LAG else np.eye(len(moves))[moves.index(one.shown)]
    size = shift @ sums
    if one.sign:
        gain = np.where(one.sign * size > 0.0, gain, 0.0)
    return gain, size, np.sqrt(np.einsum("i,cij,j->c", sums, covariance, sums))


def scale_of(ratio: FloatArray, freedom: int) -> float:
    """By how much the cells' ratios are above theory's, at least one; few cells say little.

    At the median and at the tail without the last twentieth, which may be odd themselves.
    """
    cells = float(ratio.size)
    ordered = np.sort(ratio)
    odd = max(int(np.ceil(ALARM.odd_share * cells)), 1)
    found = [
        float(ordered[min(int(share * cells), ratio.size - 1 - odd)])
        / float(chdtri(freedom, 1.0 - share))
        for share in ALARM.tail_shares
    ]
    return max((cells * max(found) + USUAL.weight) / (cells + USUAL.weight), 1.0)


def _negligible() -> FloatArray:
    found = np.zeros(SIZE)
    for one in EXPLANATIONS:
        found[one.shown] = one.negligible
    found[LEAD] = found[LAG]
    return found


def _named(
    cell: int,
    k: int,
    ratio: FloatArray,
    shifts: Sequence[FloatArray],
    stds: Sequence[FloatArray],
    changed: bool,
    allowed: float,
) -> Suspicion:
    scores = ratio - ALARM.penalty * np.array([len(e.moves) for e in EXPLANATIONS])
    best = int(np.argmax(scores))
    near = [
        e.cause
        for j, e in enumerate(EXPLANATIONS)
        if j != best and scores[best] - scores[j] < ALARM.confusable
    ]
    weights = np.exp(scores - scores[best])
    chance = math.exp(-math.log(allowed) - float(scores[best]))
    return Suspicion(
        cell=cell,
        explanation=EXPLANATIONS[best],
        size=float(shifts[best][k]),
        std=float(stds[best][k]),
        gain=float(ratio[best]),
        probability=float(weights[best] / (weights.sum() + chance)),
        others=tuple(near),
        changed=changed,
    )


def against_others(spread: FloatArray, evidence: PackEvidence) -> list[Suspicion]:
    """Cells that are not like the others."""
    start = CellDeltas.unknown(evidence.rows.size, spread)
    return suspicions(start.mean, start.covariance, evidence, changed=False)


def against_past(past: CellDeltas, evidence: PackEvidence) -> list[Suspicion]:
    """Cells that are not as they were."""
    return suspicions(past.mean, past.covariance, evidence, changed=True)


def exchanged_cells(
    deltas: CellDeltas, evidence: PackEvidence, suspects: Sequence[Suspicion]
) -> tuple[int, int] | None:
    """The pair, one a suspect, of which each is what the other was; None: no such pair."""
    cells = sorted({s.cell for s in suspects})
    there = np.flatnonzero(evidence.rows > 0).tolist()
    own = {k: _misfit(deltas, evidence, k, k) for k in there}
    usual = float(np.median(list(own.values())))
    best: float = EXCHANGE.better
    pair = None
    for i in cells:
        for j in there:
            if j == i:
                continue
            crossed = _misfit(deltas, evidence, i, j) + _misfit(deltas, evidence, j, i)
            gain = own[i] + own[j] - crossed
            # Each has to be as usual a cell in the other's place, not only less odd than here. What
            # is far off is so in the regression's own error, too: a share of it may remain.
            most = 2.0 * usual + EXCHANGE.better + EXCHANGE.remaining * (own[i] + own[j])
            if gain > best and crossed < most:
                best, pair = gain, (min(i, j), max(i, j))
    return pair


def with_exchanged(evidence: PackEvidence, i: int, j: int) -> PackEvidence:
    """The evidence with two cells' places exchanged."""
    order = np.arange(evidence.rows.size)
    order[[i, j]] = order[[j, i]]
    return replace(
        evidence,
        matrix=evidence.matrix[order],
        vector=evidence.vector[order],
        rows=evidence.rows[order],
        rmse_V=evidence.rmse_V[order],
    )


def _misfit(deltas: CellDeltas, evidence: PackEvidence, cell: int, source: int) -> float:
    """Minus log likelihood of one column's evidence under what is known of a cell."""
    a, p = evidence.matrix[source], deltas.covariance[cell]
    surprise = evidence.vector[source] - a @ deltas.mean[cell]
    pull = np.linalg.solve(np.eye(SIZE) + a @ p, surprise)
    # surprise' (A + A P A)^-1 surprise, of an A that may say nothing of some parameters
    return float(0.5 * pull @ np.linalg.lstsq(a, surprise, rcond=1e-10)[0])


def drift_of(spread: FloatArray, evidence: PackEvidence) -> Drift | None:
    """What a period shows; None where its logs are of one day, or nobody knows of which."""
    if evidence.days <= 0.0:
        return None
    start = CellDeltas.unknown(evidence.rows.size, spread)
    start.covariance[:, SELF_DISCHARGE, SELF_DISCHARGE] = DRIFTING.balancing_per_day**2
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
    sizes = np.linspace(0.0, max(float(np.max(v)), 1e-12), DRIFTING.sizes)[:, None, None]
    ratio = np.log1p((v / std) ** 2) - np.log1p(((v - sizes) / std) ** 2)
    # Of the last two periods, three, ...: (sizes, starts, cells), then the best of each cell.
    gains = np.cumsum(ratio[:, ::-1], axis=1)[:, 1:] - math.log(len(drifts) - 1)
    best = np.argmax(gains.reshape(-1, v.shape[1]), axis=0)
    size_of, start_of = np.unravel_index(best, gains.shape[:2])
    gain = np.maximum(gains[size_of, start_of, np.arange(best.size)], 0.0)
    gain /= scale_of(2.0 * gain, 1)
    allowed = ALARM.false_alarms / (gain.size * len(EXPLANATIONS))
    cause = next(one for one in EXPLANATIONS if one.cause == "self_discharge")
    found = []
    for cell in np.flatnonzero(chdtrc(1, 2.0 * gain) < allowed).tolist():
        chance = math.exp(ALARM.penalty - math.log(allowed) - float(gain[cell]))
        found.append(
            Suspicion(
                cell=cell,
                explanation=cause,
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
        if one.explanation.cause in DRIFTING.apart or times[one.cell] < DRIFTING.uncertain
        else replace(
            one,
            probability=min(one.probability, 0.5),
            others=tuple(dict.fromkeys(("self_discharge", *one.others))),
        )
        for one in found
    ]


def drifting(drift: Drift) -> int | None:
    """The cell whose drift in one period is worth saying; None: there is none."""
    times = drift.per_day / drift.std
    return int(np.argmax(times)) if float(np.max(times)) > DRIFTING.worth_saying else None

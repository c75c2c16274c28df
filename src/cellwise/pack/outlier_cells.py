"""Which cell is not like the others, or not as it was, and of what it is: cell, sensor, polling.

Two cells whose voltages have changed places (a harness, columns of an export) are found here, too;
and a cell that discharges itself: it drifts in every period, where balancing moves one in some.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from cellwise.cell.model import CellModel
from cellwise.pack import differences as by
from cellwise.pack.differences import SIZE
from cellwise.pack.evidence import WEIGHT, PackEvidence, robust_std
from cellwise.pack.pack_state import CellDeltas, Drift, posterior
from cellwise.typing import FloatArray

# When a cell is named.
FALSE_ALARMS = 0.01  # share of packs and periods with one, over all cells and causes
ODD_SHARE = 0.05  # of the cells, one at least, may be odd themselves
PENALTY = 2.0  # log likelihood that one more parameter costs
CONFUSABLE = 3.0  # log likelihood within which two causes are
# Of the cells, at which their ratios are compared with theory's.
TAIL_SHARES = (0.5, 0.8, 0.9, 0.94)
FEWEST_CELLS = 3

# When two cells have changed places.
EXCHANGE_BETTER = 10.0  # log likelihood by which that is more probable than two changes
EXCHANGE_REMAINING = 0.005  # share of two large misfits that may be left once it explains them

# When a cell discharges itself; standard deviations are those of a drift in one period.
BALANCING_PER_DAY = 3e-3  # what balancing may do to a cell's SOC, and more
DRIFT_SIZES = 200  # of a self-discharge that are tried, up to the largest drift
WORTH_SAYING = 5.0  # standard deviations, in a notice
UNCERTAIN = 2.0  # standard deviations from which on whatever else is found of the cell is uncertain
SEEN_APART = ("resistance_scale", "time_skew")  # but for these, seen under load alone


class CellCause(NamedTuple):
    """A cause by its name in `cellwise diagnose`, and the differences that it ``moves``.

    Of these ``shown`` is the parameter's (of polling: lag and lead together), smaller than
    ``negligible`` nobody would act on it; ``sign`` of a fault, 0: either. ``said``: words before
    and after, what the difference is multiplied by between them, and decimals.
    """

    name: str
    moves: tuple[int, ...]
    shown: int
    parameter: str
    negligible: float
    said: tuple[str, str, float, int]
    sign: int = 0
    sensor: bool = False


# A cell may only lose capacity, gain resistance and lose charge of its own.
CAUSES = (
    CellCause(
        "capacity", (by.CAPACITY, by.SOC), by.CAPACITY, "capacity_Ah", 0.003,
        ("capacity", "%", 100.0, 1), -1,
    ),
    CellCause(
        "resistance_scale", (by.RESISTANCE,), by.RESISTANCE, "scale", 0.010,
        ("resistance", "%", 100.0, 1), 1,
    ),
    CellCause("initial_soc", (by.SOC,), by.SOC, "soc0", 0.002, ("SOC", "points", 100.0, 2)),
    CellCause(
        "self_discharge", (by.SELF_DISCHARGE, by.SOC), by.SELF_DISCHARGE, "leak_A", 2e-5,
        ("loses", "mA", 1e3, 2), 1,
    ),
    CellCause(
        "voltage_offset", (by.OFFSET,), by.OFFSET, "offset_V", 0.0005,
        ("its voltage reads", "mV", 1e3, 1), sensor=True,
    ),
    CellCause(
        "time_skew", (by.LAG, by.LEAD), by.LAG, "skew_s", 0.05,
        ("polled late by", "s", 1.0, 2), sensor=True,
    ),
)  # fmt: skip
LEAK = next(c for c in CAUSES if c.name == "self_discharge")
NEGLIGIBLE = np.zeros(SIZE)
for _cause in CAUSES:
    NEGLIGIBLE[list(_cause.moves if _cause.sensor else (_cause.shown,))] = _cause.negligible


@dataclass(frozen=True)
class Suspicion:
    """One cell and its most probable cause.

    ``size`` and ``std`` are the difference of ``cause.shown`` from the other cells or from the
    cell's own past; ``gain`` the log likelihood that it explains, ``probability`` that of the cause
    against the other causes and against none, which any one cell has but for ``false_alarms`` of
    packs; ``others`` what explains nearly as much; ``changed``: against its own past; ``period``:
    the number of the one in which it was found.
    """

    cell: int
    cause: CellCause
    size: float
    std: float
    gain: float
    probability: float
    others: tuple[str, ...]
    changed: bool
    period: int = 0

    def to_dict(self, name: str, model: CellModel, periods: int) -> dict[str, Any]:
        """One entry of ``causes`` of the cell ``name``, its parameters with 95 % intervals."""
        cause, ends = self.cause, (self.size - 1.96 * self.std, self.size + 1.96 * self.std)
        start, unit = {
            "capacity_Ah": (model.capacity_Ah, model.capacity_Ah),
            "scale": (1.0, 1.0),
            "leak_A": (0.0, model.capacity_Ah / 24.0),  # of the SOC in a day
        }.get(cause.parameter, (0.0, 1.0))
        before, after, factor, digits = cause.said
        factor *= unit if cause is LEAK else 1.0
        value, low, high = (f"{factor * x:+.{digits}f}" for x in (self.size, *ends))
        against = "its own past" if self.changed else "the other cells"
        evidence = [f"{name}: {before} {value} {after} ({low} to {high}) against {against}"]
        if periods > 1:
            evidence.append(f"found in period {self.period + 1} of {periods}")
        return {
            "name": cause.name,
            "cell": name,
            "probability": self.probability,
            "parameters": {cause.parameter: start + unit * self.size},
            "ci95": {cause.parameter: [start + unit * x for x in ends]},
            "of": "sensor" if cause.sensor else "cell",
            "changed": self.changed,
            "period": self.period + 1,
            "gain": self.gain,
            "evidence": evidence,
            "confusable_with": list(self.others),
        }


def suspicions(past: CellDeltas, evidence: PackEvidence, *, changed: bool) -> list[Suspicion]:
    """Cells whose evidence is not what is expected of them.

    Parameters
    ----------
    past : CellDeltas      what is expected: zero and the spread between cells, or the cell's own
                           past and its drift
    changed : bool         which of the two it is

    Notes
    -----
    Generalised likelihood ratio of a shift along each cause's directions. What all cells have in
    common is no cell's; and the cells are each other's reference: where their usual ratio is larger
    than theory has it, all ratios are scaled down by as much.
    """
    there = np.flatnonzero(evidence.rows > 0)
    if there.size < FEWEST_CELLS:
        return []
    a, mean = evidence.matrix[there], past.mean[there]
    after, _ = posterior(past.mean, past.covariance, evidence)
    common = np.median(after[there] - mean, axis=0)
    surprise = evidence.vector[there] - np.einsum("cij,cj->ci", a, mean + common)
    wide = np.eye(SIZE) + a @ (past.covariance[there] + np.diag(NEGLIGIBLE**2))
    precision = np.asarray(np.linalg.solve(wide, a), dtype=np.float64)  # about a shift
    pull = np.asarray(np.linalg.solve(wide, surprise[..., None])[..., 0])
    ratios, shifts, stds = [], [], []
    for one in CAUSES:
        gain, shift, std = _along(precision, pull, one)
        scale = scale_of(2.0 * gain, len(one.moves))
        ratios.append(gain / scale)
        shifts.append(shift)
        stds.append(std * np.sqrt(scale))
    gains, sizes, widths = (np.stack(x, axis=1) for x in (ratios, shifts, stds))
    if evidence.days == 0.0:  # within hours a capacity or a SOC does the same
        gains[:, CAUSES.index(LEAK)] = 0.0
    allowed = FALSE_ALARMS / (there.size * len(CAUSES))
    tails = chdtrc([len(c.moves) for c in CAUSES], 2.0 * np.maximum(gains, 0.0))
    found = [
        named(int(there[k]), gains[k], sizes[k], widths[k], changed, allowed)
        for k in np.flatnonzero(np.min(tails, axis=1) < allowed)
    ]
    # From day to day balancing moves a cell as self-discharge does: several periods decide.
    return [one for one in found if one.cause is not LEAK]


def _along(
    precision: FloatArray, pull: FloatArray, one: CellCause
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log likelihood ratio, size and deviation of a shift along a cause, (cells,) each."""
    moves = list(one.moves)
    inner = precision[:, moves][:, :, moves] + 1e-12 * np.eye(len(moves))
    right = pull[:, moves]
    covariance = np.linalg.inv(inner)
    shift = np.einsum("cij,cj->ci", covariance, right)
    gain = 0.5 * np.einsum("ci,ci->c", right, shift)
    sums = np.ones(2) if one.shown == by.LAG else np.eye(len(moves))[moves.index(one.shown)]
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
    odd = max(int(np.ceil(ODD_SHARE * cells)), 1)
    found = [
        float(ordered[min(int(share * cells), ratio.size - 1 - odd)])
        / float(chdtri(freedom, 1.0 - share))
        for share in TAIL_SHARES
    ]
    return max((cells * max(found) + WEIGHT) / (cells + WEIGHT), 1.0)


def named(
    cell: int, gains: FloatArray, sizes: FloatArray, stds: FloatArray, changed: bool, allowed: float
) -> Suspicion:
    """The likeliest cause of one cell; log likelihoods, sizes and deviations of all causes."""
    scores = gains - PENALTY * np.array([len(c.moves) for c in CAUSES])
    best = int(np.argmax(scores))
    near = np.flatnonzero(scores[best] - scores < CONFUSABLE)
    chance = math.exp(-math.log(allowed) - float(scores[best]))
    return Suspicion(
        cell=cell,
        cause=CAUSES[best],
        size=float(sizes[best]),
        std=float(stds[best]),
        gain=float(gains[best]),
        probability=1.0 / (float(np.exp(scores - scores[best]).sum()) + chance),
        others=tuple(CAUSES[j].name for j in near if j != best),
        changed=changed,
    )


def exchanged_cells(
    deltas: CellDeltas, evidence: PackEvidence, suspects: Sequence[Suspicion]
) -> tuple[int, int] | None:
    """The pair, one a suspect, of which each is what the other was; None: no such pair."""
    there = np.flatnonzero(evidence.rows > 0).tolist()
    own = {k: _misfit(deltas, evidence, k, k) for k in there}
    usual = float(np.median(list(own.values())))
    best: float = EXCHANGE_BETTER
    pair = None
    for i in sorted({s.cell for s in suspects}):
        for j in there:
            if j == i:
                continue
            crossed = _misfit(deltas, evidence, i, j) + _misfit(deltas, evidence, j, i)
            gain = own[i] + own[j] - crossed
            # Each has to be as usual a cell in the other's place, not only less odd than here. What
            # is far off is so in the regression's own error, too: a share of it may remain.
            most = 2.0 * usual + EXCHANGE_BETTER + EXCHANGE_REMAINING * (own[i] + own[j])
            if gain > best and crossed < most:
                best, pair = gain, (min(i, j), max(i, j))
    return pair


def with_exchanged(evidence: PackEvidence, pair: tuple[int, int]) -> PackEvidence:
    """The evidence with two cells' places exchanged."""
    order = np.arange(evidence.rows.size)
    order[list(pair)] = order[list(pair)[::-1]]
    of_cells = ("matrix", "vector", "rows", "rmse_V")
    moved: dict[str, Any] = {k: getattr(evidence, k)[order] for k in of_cells}
    return replace(evidence, **moved)


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
    start.covariance[:, by.SELF_DISCHARGE, by.SELF_DISCHARGE] = BALANCING_PER_DAY**2
    mean, covariance = posterior(start.mean, start.covariance, evidence)
    per_day = mean[:, by.SELF_DISCHARGE] - np.median(mean[:, by.SELF_DISCHARGE])
    own = covariance[:, by.SELF_DISCHARGE, by.SELF_DISCHARGE]
    least = by.CELLS[by.SELF_DISCHARGE] ** 2
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
    sizes = np.linspace(0.0, max(float(np.max(v)), 1e-12), DRIFT_SIZES)[:, None, None]
    ratio = np.log1p((v / std) ** 2) - np.log1p(((v - sizes) / std) ** 2)
    # Of the last two periods, three, ...: (sizes, starts, cells), then the best of each cell.
    gains = np.cumsum(ratio[:, ::-1], axis=1)[:, 1:] - math.log(len(drifts) - 1)
    best = np.argmax(gains.reshape(-1, v.shape[1]), axis=0)
    size_of, start_of = np.unravel_index(best, gains.shape[:2])
    gain = np.maximum(gains[size_of, start_of, np.arange(best.size)], 0.0)
    gain /= scale_of(2.0 * gain, 1)
    allowed = FALSE_ALARMS / (gain.size * len(CAUSES))
    chance = np.exp(PENALTY - math.log(allowed) - gain)
    return [
        Suspicion(
            cell=cell,
            cause=LEAK,
            size=float(sizes[size_of[cell], 0, 0]),
            std=float(np.sum(std[-2 - start_of[cell] :, cell] ** -2.0) ** -0.5),
            gain=float(gain[cell]),
            probability=float(1.0 / (1.0 + chance[cell])),
            others=(),
            changed=False,
        )
        for cell in np.flatnonzero(chdtrc(1, 2.0 * gain) < allowed).tolist()
    ]


def also_drifting(found: Sequence[Suspicion], drift: Drift) -> list[Suspicion]:
    """The suspicions, at most half as probable where the cell drifts as well.

    What moves all the time is fitted by a capacity or an offset nearly as well.
    """
    times = drift.per_day / drift.std
    return [
        one
        if one.cause.name in SEEN_APART or times[one.cell] < UNCERTAIN
        else replace(
            one,
            probability=min(one.probability, 0.5),
            others=tuple(dict.fromkeys((LEAK.name, *one.others))),
        )
        for one in found
    ]


def drifting(drift: Drift) -> int | None:
    """The cell whose drift in one period is worth saying; None: there is none."""
    times = drift.per_day / drift.std
    return int(np.argmax(times)) if float(np.max(times)) > WORTH_SAYING else None

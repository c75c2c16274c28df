"""What logs say of every cell: normal equations with the noise that the cells themselves show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.pack import differences as by
from cellwise.pack.differences import SIZE, OcvSlope, PackDay, Regressors, regressors
from cellwise.typing import BoolArray, FloatArray, IndexArray

# What differences are wrong by before a pack shows it.
ROW_V = 0.003  # a quiet row
CHANGE_SHARE = 0.1  # of the voltage's change between rows, by polling
BLOCK_V = 5e-4  # what stays for a block: relaxation, temperature, the OCV's shape
BLOCK_S = 600.0
BALANCING_SOC = 0.002  # what a cell's SOC moves by from one log to the next
SLOPE_V = 0.2  # of the OCV over SOC, a third of a usual slope
LEAST_V = 1e-4  # no noise is smaller
ROBUST = 4.0  # standard deviations beyond which a reading counts no more
WEIGHT = 10.0  # cells, or cells and blocks, that a usual size counts as beside those that are seen
LEAST_SHARE = 0.2  # of a usual spread: a pack of equal cells is not expected to be more equal
PASSES = 30  # of an expectation-maximisation, which comes near enough in a few
MOST_ROWS = 200_000  # of a period are compared: more say no more


def robust_std(off: FloatArray) -> FloatArray:
    """Standard deviation about zero by the median, along the first axis."""
    return np.asarray(1.4826 * np.median(np.abs(off), axis=0))


@dataclass(frozen=True, eq=False)
class PackEvidence:
    """Information on every cell's differences: ``A x = b`` with ``A`` the inverse of a covariance.

    ``matrix`` (cells, SIZE, SIZE), ``vector`` (cells, SIZE), ``rows`` (cells,) rows that count,
    ``rmse_V`` (cells,) of what the differences leave, ``noise_V``, ``change_share`` and ``block_V``
    the noise found: of a quiet row, of the voltage's change, of a block of ten minutes;
    ``balancing_soc`` by how much cells' SOC moves against the mean from log to log, ``days`` from
    the first to the last.
    """

    matrix: FloatArray
    vector: FloatArray
    rows: IndexArray
    rmse_V: FloatArray
    noise_V: float
    change_share: float
    block_V: float
    balancing_soc: float
    days: float = 0.0


def period_evidence(model: CellModel, days: Sequence[PackDay]) -> PackEvidence:
    """What the logs of one period say of the cells; of many rows every so many are enough."""
    middle = 0.5 * (days[0].ordinal + days[-1].ordinal)
    some = slice(None, None, max(-(-sum(len(d.log) for d in days) // MOST_ROWS), 1))
    parts = []
    count = 0
    for number, day in enumerate(days):
        log, part = day.log, day.mean.part
        found = regressors(day.mean, OcvSlope(model, log.mean), day.ordinal - middle)
        ok = np.isfinite(log.cell_V)
        if log.balancing is not None:
            ok &= ~log.balancing  # the bypass current loads the sense wires
        clock = (log.mean.time_s // BLOCK_S).astype(np.int64)
        moved = np.diff(clock, prepend=clock[0]) + np.abs(np.diff(part, prepend=part[0]))
        block = count + np.cumsum(moved != 0)
        count = int(block[-1]) + 1
        of_log = np.full(len(log), number)
        columns = (*found, log.difference_V, ok, block, of_log)
        parts.append([column[some] for column in columns])
    rows, change, used, *others = (np.concatenate(c) for c in zip(*parts, strict=True))
    found_of_all = pack_evidence(Regressors(rows, change, used), *others)
    return replace(found_of_all, days=days[-1].ordinal - days[0].ordinal)


def pack_evidence(
    found: Regressors,
    difference_V: FloatArray,
    known: BoolArray,
    block: IndexArray,
    log: IndexArray,
) -> PackEvidence:
    """What the logs of one period say of the cells.

    Parameters
    ----------
    found : Regressors
    difference_V : (n, cells) float      cell minus mean; NaN where unknown
    known : (n, cells) bool              readings to use
    block, log : (n,) int                numbers of the stretches whose errors stay alike, and of
                                         the logs; both ascending

    Returns
    -------
    PackEvidence      a cell without a reading has no information
    """
    used = np.flatnonzero(found.used)
    cells = difference_V.shape[1]
    if used.size == 0:
        nothing = np.zeros((cells, SIZE, SIZE)), np.zeros((cells, SIZE))
        return PackEvidence(
            *nothing, np.zeros(cells, np.int64), np.full(cells, np.nan),
            ROW_V, CHANGE_SHARE, BLOCK_V, 0.0,
        )  # fmt: skip
    rows, change = found.rows[used], found.change_V[used]
    d, ok = difference_V[used], known[used]
    ok &= np.isfinite(d)
    d[~ok] = 0.0
    prior = np.diag(by.CELLS**-2.0)
    weight = 1.0 / (ROW_V**2 + (CHANGE_SHARE * change) ** 2)
    x = _ridge(rows, weight, d, ok, prior)
    noise, share = _row_noise(d - rows @ x.T, ok, change)
    variance = noise**2 + (share * change) ** 2
    weight = 1.0 / variance
    for _ in range(2):  # readings far off are drawn to the fit
        fit = rows @ x.T
        limit = ROBUST * np.sqrt(variance)[:, None]
        drawn = np.minimum(np.maximum(d, fit - limit), fit + limit)
        drawn[~ok] = 0.0
        x = _ridge(rows, weight, drawn, ok, prior)
    starts = _starts(block[used])
    matrix, vector = _block_sums(rows, weight, drawn, ok, starts)
    block_V = _block_noise(matrix, vector, x)
    own = np.zeros(SIZE)
    own[by.OFFSET] = block_V**2  # each block has an offset of its own
    matrix, vector = _integrated(matrix, vector, own)
    starts = _starts(log[used][starts])
    balance = 0.0
    if starts.size > 1:
        matrix = np.add.reduceat(matrix, starts, axis=0)
        vector = np.add.reduceat(vector, starts, axis=0)
        matrix, vector, balance = _without_balancing(matrix, vector, prior)
    matrix, vector = _clustered(matrix, vector, prior)
    left = d - rows @ x.T
    left[~ok] = 0.0
    count = ok.sum(axis=0)
    rmse = np.sqrt(np.einsum("ij,ij->j", left, left) / np.maximum(count, 1))
    return PackEvidence(
        matrix, vector, count, np.where(count > 0, rmse, np.nan), noise, share, block_V, balance
    )


def _ridge(
    rows: FloatArray, weight: FloatArray, d: FloatArray, ok: BoolArray, prior: FloatArray
) -> FloatArray:
    """Weighted fit of every cell, held by its usual size, shape (cells, SIZE)."""
    weighted = weight[:, None] * rows
    full = ok.all(axis=0)
    common = rows.T @ weighted
    right = weighted.T @ d
    x = np.linalg.solve(common + prior, right).T
    for k in np.flatnonzero(~full):
        own = rows.T @ (weighted * ok[:, k : k + 1])
        x[k] = np.linalg.solve(own + prior, right[:, k])
    return np.ascontiguousarray(x)


def _row_noise(left: FloatArray, ok: BoolArray, change: FloatArray) -> tuple[float, float]:
    """Noise of a quiet row [V], and the share of the voltage's change that is noise."""
    order = np.argsort(change)
    third = max(order.size // 3, 1)

    def scale(part: IndexArray) -> float:
        values = left[part][ok[part]]
        return float(robust_std(values)) if values.size else ROW_V

    quiet, busy = order[:third], order[-third:]
    noise = max(scale(quiet), LEAST_V)
    moved = float(np.sqrt(np.mean(change[busy] ** 2)))
    excess = max(scale(busy) ** 2 - noise**2, 0.0)
    return noise, float(np.sqrt(excess)) / max(moved, LEAST_V)


def _starts(number: IndexArray) -> IndexArray:
    """Rows at which a new number begins."""
    return np.flatnonzero(np.diff(number, prepend=number[0] - 1) != 0)


def _block_sums(
    rows: FloatArray, weight: FloatArray, d: FloatArray, ok: BoolArray, starts: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of each block: (blocks, cells or 1, SIZE, SIZE) and (blocks, cells, SIZE).

    Cells have one matrix unless readings of some are missing.
    """
    weighted = weight[:, None] * rows
    spans = list(pairwise([*starts.tolist(), rows.shape[0]]))
    matrix = np.stack([rows[i:j].T @ weighted[i:j] for i, j in spans])[:, None]
    vector = np.stack([d[i:j].T @ weighted[i:j] for i, j in spans])
    missing = np.flatnonzero(~ok.all(axis=0))
    if missing.size:
        matrix = np.repeat(matrix, d.shape[1], axis=1)
    for k in missing.tolist():
        masked = weighted * ok[:, k : k + 1]
        matrix[:, k] = np.stack([rows[i:j].T @ masked[i:j] for i, j in spans])
    return matrix, vector


def _block_noise(matrix: FloatArray, vector: FloatArray, x: FloatArray) -> float:
    """Standard deviation of what stays for a block [V], of all cells and blocks."""
    total = matrix[:, :, by.OFFSET, by.OFFSET]
    left = vector[:, :, by.OFFSET] - np.einsum(
        "bci,ci->bc", _of_cells(matrix[:, :, by.OFFSET], x), x
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(total > 0.0, left / total, np.nan)
    mean = mean[np.isfinite(mean)]
    if mean.size == 0:
        return BLOCK_V
    of_rows = float(np.median(1.0 / total[total > 0.0]))
    found = max(float(robust_std(mean)) ** 2 - of_rows, 0.0)
    return _with_usual(found, float(mean.size), BLOCK_V)


def _of_cells(of_one: FloatArray, x: FloatArray) -> FloatArray:
    """What all cells have in common (n, 1, SIZE), for each of them."""
    return np.broadcast_to(of_one, (of_one.shape[0], *x.shape))


def _with_usual(found: float, many: float, usual: float) -> float:
    """Deviation of a variance that so many have shown, and of a usual one [unit of ``usual``]."""
    return float(np.sqrt((many * found + WEIGHT * usual**2) / (many + WEIGHT)))


def _without_balancing(
    matrix: FloatArray, vector: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Information of each log with its own SOC difference integrated out, and how large it is.

    Between logs a pack is charged and balanced: what a cell's SOC is against the mean's is new each
    time, by a size that the logs themselves show; and what that does to the voltage is known as
    well as the OCV's slope is. Shapes as
    :func:`_block_sums` has them.
    """
    size = BALANCING_SOC
    for _ in range(PASSES):
        a, b = _integrated(matrix, vector, _balanced(size))
        x = np.linalg.solve(a.sum(axis=0) + prior, b.sum(axis=0)[..., None])[..., 0]
        pull = vector[:, :, by.SOC] - np.einsum("lci,ci->lc", _of_cells(matrix[:, :, by.SOC], x), x)
        variance = 1.0 / (matrix[:, :, by.SOC, by.SOC] + size**-2.0)
        moved = variance * pull
        seen = float(np.median(np.broadcast_to(variance, moved.shape)))
        found = float(robust_std(moved.ravel())) ** 2 + min(seen, size**2)
        size = _with_usual(found, float(moved.size), BALANCING_SOC)
    return *_integrated(matrix, vector, _balanced(size)), size


def _balanced(size: float) -> FloatArray:
    """Variances of what balancing by a size moves, (SIZE,)."""
    own = np.zeros(SIZE)
    own[by.SOC] = size**2
    own[by.NAMED :] = (SLOPE_V * size) ** 2
    return own


def _integrated(
    matrix: FloatArray, vector: FloatArray, own: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Information of parts (a block, a log) once each has differences of its own, by variances."""
    eye = np.eye(SIZE)
    a = np.linalg.solve(eye + matrix * own, matrix)
    b = np.linalg.solve(eye + matrix * own, vector[..., None])[..., 0]
    return np.asarray(0.5 * (a + np.swapaxes(a, 2, 3))), np.asarray(b)


def _clustered(a: FloatArray, b: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information whose covariance is what clusters scatter by, pooled over the cells.

    The covariance of a fit under errors that are alike within clusters (Liang and Zeger,
    Biometrika 73 (1986) 13), never smaller than that of independent rows.
    """
    clusters, cells = b.shape[:2]
    bread, right = a.sum(axis=0), b.sum(axis=0)  # (1 or cells, SIZE, SIZE), (cells, SIZE)
    x = np.linalg.solve(bread + prior, right[..., None])[..., 0]
    score = b - np.einsum(
        "gcij,cj->gci", np.broadcast_to(a, (*a.shape[:1], cells, *a.shape[2:])), x
    )
    common = bread[0] if bread.shape[0] == 1 else np.median(bread, axis=0)
    root = np.linalg.cholesky(common + 1e-3 * prior)
    white = np.linalg.solve(root, score.reshape(-1, SIZE).T).reshape(SIZE, clusters, cells)
    per_cell = np.einsum("igc,jgc->cij", white, white)
    size = np.trace(per_cell, axis1=1, axis2=2)
    usual = per_cell[size <= np.quantile(size, 0.8)] if cells > 4 else per_cell
    meat = usual.mean(axis=0) * clusters / max(clusters - 1.0, 1.0)
    values, vectors = np.linalg.eigh(meat)
    # x' = A J^-1 A x: the same estimate with the covariance A^-1 J A^-1.
    inner = (vectors / np.maximum(values, 1.0)) @ vectors.T
    back = np.linalg.solve(root.T, inner)
    j_inverse = np.linalg.solve(root.T, back.T).T
    lifted = bread @ j_inverse
    whole = lifted @ bread
    return (
        np.array(np.broadcast_to(0.5 * (whole + np.swapaxes(whole, 1, 2)), (cells, SIZE, SIZE))),
        np.einsum("cij,cj->ci", np.broadcast_to(lifted, (cells, SIZE, SIZE)), right),
    )

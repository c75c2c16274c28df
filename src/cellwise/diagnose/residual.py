"""Analysis of a residual: where it sits, how fast it moves, what of it is noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class Groups(NamedTuple):
    """How a residual is divided.

    ``rates_C``: sizes of the current in units of 1C, between the rates that laboratories use; below
    the first it is a rest. ``edge_C``: a larger step of the current starts a new edge, whose rows
    are parted after ``since_s``. Means over ``means_s`` part the residual by period: a mean over w
    keeps periods longer than about 2 w. ``parts`` of SOC, time and charge; temperatures in steps of
    ``step_K``, at most so many of them.
    """

    rates_C: tuple[float, ...] = (0.02, 0.15, 0.4, 0.75, 1.25, 2.25)
    edge_C: float = 0.1
    since_s: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    means_s: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    parts: int = 10
    step_K: float = 5.0
    most_temperatures: int = 12


GROUPS = Groups()


def residual_analysis(
    model: CellModel, log: CellLog, soc0: float, h0: float | None = None
) -> dict[str, Any]:
    """Where measured minus simulated voltage sits.

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : float          SOC at the first row, 0..1
    h0 : float or None    hysteresis state there, see :func:`cellwise.cell.simulate.simulate`

    Returns
    -------
    dict of JSON values: ``rows``, ``rmse_V``, ``mean_V`` and

        ``by_soc``, ``by_current_C`` (negative: charge), ``by_edge_s`` (time since the current last
        stepped), ``by_temperature_C``, ``by_time_s``, ``by_charge_Ah`` (charge moved either way):
        lists of groups, each with ``from``, ``to`` (null: open), ``rows``, ``rmse_V``, ``mean_V``
        and ``share`` of the squared error;

        ``by_period_s``: ``from``, ``to``, ``rms_V`` and ``share``; with ``constant`` (the mean)
        they make up the whole squared error, because means over 1, 10, 100, 1000 s are nested;

        ``noise``: what jumps from row to row, ``floor_V``, and its ``share``.

    Raises
    ------
    InputError        soc0 outside 0..1
    """
    run = simulate(model, log, soc0, h0)
    error = run.error_V
    known = np.isfinite(error)
    current = log.interval_current_A
    flow = np.nan_to_num(log.known_current_A()) * log.interval_s / 3600.0
    moved = np.cumsum(np.abs(flow))
    elapsed = log.time_s - log.time_s[0]
    one_C = model.capacity_Ah
    e, seconds = error[known], elapsed[known]
    return {
        "rows": int(known.sum()),
        "rmse_V": _root(float(np.mean(e * e))) if e.size else None,
        "mean_V": float(np.mean(e)) if e.size else None,
        "by_soc": groups(error, run.soc, [*np.arange(1, GROUPS.parts) / GROUPS.parts], 0.0, 1.0),
        "by_current_C": _by_current(error, current / one_C),
        "by_edge_s": groups(error, since_edge_s(log, GROUPS.edge_C * one_C), GROUPS.since_s, 0.0),
        "by_temperature_C": _by_temperature(error, log.temperature_C),
        "by_time_s": groups(error, elapsed, *_parts(elapsed)),
        "by_charge_Ah": groups(error, moved, *_parts(moved)),
        **periods(e, seconds),
        "noise": noise_floor(error),
    }


def groups(
    error_V: FloatArray,
    by: FloatArray,
    edges: tuple[float, ...] | list[float],
    first: float | None = None,
    last: float | None = None,
) -> list[dict[str, Any]]:
    """The error by what lies between edges: rows, RMSE, mean, share of the squared error.

    A value at an edge belongs to the group above it. Groups without a row are left out; ``first``
    and ``last`` are only stated, not enforced: what lies beyond belongs to the outer groups.
    """
    use = np.isfinite(error_V) & np.isfinite(by)
    e = error_V[use]
    place = np.searchsorted(np.asarray(edges, dtype=np.float64), by[use], side="right")
    count = np.bincount(place, minlength=len(edges) + 1)
    total = np.bincount(place, e, len(edges) + 1)
    square = np.bincount(place, e * e, len(edges) + 1)
    whole = float(square.sum())
    bounds = [first, *(float(x) for x in edges), last]
    return [
        {
            "from": bounds[k],
            "to": bounds[k + 1],
            "rows": int(count[k]),
            "rmse_V": _root(square[k] / count[k]),
            "mean_V": float(total[k] / count[k]),
            "share": float(square[k]) / whole if whole > 0.0 else 0.0,
        }
        for k in range(len(edges) + 1)
        if count[k]
    ]


def since_edge_s(log: CellLog, step_A: float) -> FloatArray:
    """Time since the current last stepped by more than ``step_A`` [s], shape (n,).

    A row's current flowed in the interval that ends there, so a step shows in the row whose
    interval begins at the step. The log's start counts as one.
    """
    current = np.nan_to_num(log.interval_current_A)
    stepped = np.abs(np.diff(current, prepend=current[:1])) > step_A
    start = log.time_s - log.interval_s
    start[0] = log.time_s[0]
    at = np.maximum.accumulate(np.where(stepped, np.arange(len(log)), 0))
    return np.asarray(log.time_s - start[at])


def periods(error_V: FloatArray, seconds: FloatArray) -> dict[str, Any]:
    """Mean square by how fast the error moves: variance between means over nested blocks of time.

    The law of total variance, block within block: the parts and the squared mean add up to the
    mean square, whatever the rows' spacing.
    """
    if not error_V.size:
        return {"constant": None, "by_period_s": []}
    whole = float(np.mean(error_V * error_V))
    scale = whole if whole > 0.0 else 1.0
    inner = error_V
    result = []
    edges = (None, *(2.0 * w for w in GROUPS.means_s), None)
    for k, width in enumerate((*GROUPS.means_s, np.inf)):
        outer = _block_means(error_V, seconds, width)
        square = float(np.mean((inner - outer) ** 2))
        result.append(
            {"from": edges[k], "to": edges[k + 1], "rms_V": _root(square), "share": square / scale}
        )
        inner = outer
    mean = float(np.mean(error_V))
    return {"constant": {"mean_V": mean, "share": mean * mean / scale}, "by_period_s": result}


def noise_floor(error_V: FloatArray) -> dict[str, float | None]:
    """Standard deviation of what is new in every row, from successive differences [V]."""
    jump = np.abs(np.diff(error_V))
    jump = jump[np.isfinite(jump)]
    e = error_V[np.isfinite(error_V)]
    if not jump.size:
        return {"floor_V": None, "share": None}
    for share in (0.5, 0.9):  # where most rows repeat the last (a coarse digit) by the others
        white = math.sqrt(2.0) * float(ndtri(0.5 + 0.5 * share))
        floor = float(np.quantile(jump, share)) / white
        if floor > 0.0:
            break
    whole = float(np.mean(e * e))
    return {"floor_V": floor, "share": min(floor * floor / whole, 1.0) if whole > 0.0 else 1.0}


def _block_means(error_V: FloatArray, seconds: FloatArray, width_s: float) -> FloatArray:
    """Of every row the mean over its block of time, shape as the error's."""
    if np.isinf(width_s):
        return np.full_like(error_V, np.mean(error_V))
    # Tiny: a stamp of 0.1 x 10 must not fall below the block that it begins.
    block = np.floor(seconds / width_s + 1e-9).astype(np.int64)
    new = np.diff(block, prepend=block[0]) != 0
    place = np.cumsum(new)
    means = np.bincount(place, error_V) / np.bincount(place)
    return np.asarray(means[place])


def _by_current(error_V: FloatArray, rate_C: FloatArray) -> list[dict[str, Any]]:
    return groups(error_V, rate_C, [*(-x for x in reversed(GROUPS.rates_C)), *GROUPS.rates_C])


def _by_temperature(error_V: FloatArray, temperature_C: FloatArray | None) -> list[dict[str, Any]]:
    if temperature_C is None or not np.isfinite(temperature_C).any():
        return []
    low, high = float(np.nanmin(temperature_C)), float(np.nanmax(temperature_C))
    step = GROUPS.step_K * max(
        1.0, np.ceil((high - low) / GROUPS.step_K / GROUPS.most_temperatures)
    )
    edges = np.arange(np.floor(low / step) + 1, np.ceil(high / step)) * step
    first = float(np.floor(low / step) * step)
    last = float(max(np.ceil(high / step), np.floor(low / step) + 1) * step)
    return groups(error_V, temperature_C, [float(x) for x in edges], first, last)


def _parts(x: FloatArray) -> tuple[list[float], float, float]:
    """Edges of ten even parts, and the ends."""
    low, high = float(x[0]), float(x[-1])
    if high <= low:
        return [], low, high
    return [float(v) for v in np.linspace(low, high, GROUPS.parts + 1)[1:-1]], low, high


def _root(square: float) -> float:
    return float(np.sqrt(square))

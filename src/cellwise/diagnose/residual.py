"""Analysis of a residual: where it sits, how fast it moves, what of it is noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

# How a residual is divided.
# Between the rates that laboratories use; below the first it is a rest.
RATES_C = (0.02, 0.15, 0.4, 0.75, 1.25, 2.25)
EDGE_C = 0.1  # a larger step of the current, in units of 1C, starts a new edge
SINCE_S = (1.0, 10.0, 100.0, 1000.0)  # after an edge
# Over which means part it by period: one over w keeps periods longer than about 2 w.
MEANS_S = (1.0, 10.0, 100.0, 1000.0)
PARTS = 10  # of SOC, time and charge
STEP_K = 5.0  # of temperature
MOST_TEMPERATURES = 12


def residual_analysis(model: CellModel, log: CellLog, soc0: float) -> dict[str, Any]:
    """Where measured minus simulated voltage sits.

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : float          SOC at the first row, 0..1

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
    run = simulate(model, log, soc0)
    error_V, elapsed_s = run.residual_V, log.time_s - log.time_s[0]
    known = np.isfinite(error_V)
    e = error_V[known]
    one_C = model.capacity_Ah
    moved_Ah = np.cumsum(np.abs(np.nan_to_num(log.known_current_A()) * log.interval_s)) / 3600.0
    temperature_C = np.full(len(log), np.nan) if log.temperature_C is None else log.temperature_C
    rates = (*(-x for x in reversed(RATES_C)), *RATES_C)
    divided: dict[str, tuple[FloatArray, Sequence[float | None]]] = {
        "by_soc": (run.soc, [k / PARTS for k in range(PARTS + 1)]),
        "by_current_C": (log.interval_current_A / one_C, (None, *rates, None)),
        "by_edge_s": (_since_edge_s(log, EDGE_C * one_C), (0.0, *SINCE_S, None)),
        "by_temperature_C": (temperature_C, _steps(temperature_C)),
        "by_time_s": (elapsed_s, _parts(elapsed_s)),
        "by_charge_Ah": (moved_Ah, _parts(moved_Ah)),
    }
    return {
        "rows": int(known.sum()),
        "rmse_V": _root(float(np.mean(e * e))) if e.size else None,
        "mean_V": float(np.mean(e)) if e.size else None,
        **{name: _groups(error_V, *by) for name, by in divided.items()},
        **_periods(e, elapsed_s[known]),
        "noise": _noise_floor(error_V),
    }


def _groups(
    error_V: FloatArray, by: FloatArray, ends: Sequence[float | None]
) -> list[dict[str, Any]]:
    """The error by what lies between ends: rows, RMSE, mean, share of the squared error.

    A value at an end belongs to the group above it. Groups without a row are left out; what lies
    beyond the outer ends belongs to the outer groups.
    """
    use = np.isfinite(error_V) & np.isfinite(by)
    e, inner = error_V[use], np.asarray(ends[1:-1], dtype=np.float64)
    place = np.searchsorted(inner, by[use], side="right")
    count, total, square = (
        np.bincount(place, w, len(ends) - 1) for w in (np.ones(e.size), e, e * e)
    )
    whole = max(float(square.sum()), 1e-300)
    bounds = [None if x is None else float(x) for x in ends]
    return [
        {
            "from": bounds[k],
            "to": bounds[k + 1],
            "rows": int(count[k]),
            "rmse_V": _root(square[k] / count[k]),
            "mean_V": float(total[k] / count[k]),
            "share": float(square[k]) / whole,
        }
        for k in np.flatnonzero(count)
    ]


def _since_edge_s(log: CellLog, step_A: float) -> FloatArray:
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


def _steps(temperature_C: FloatArray) -> Sequence[float | None]:
    """Even steps over all temperatures."""
    if not np.isfinite(temperature_C).any():
        return None, None
    low, high = float(np.nanmin(temperature_C)), float(np.nanmax(temperature_C))
    wide = math.ceil((high - low) / STEP_K / MOST_TEMPERATURES)
    step = STEP_K * max(1, wide)
    first = math.floor(low / step)
    last = max(math.ceil(high / step), first + 1)
    return [step * k for k in range(first, last + 1)]


def _parts(x: FloatArray) -> list[float | None]:
    """Ends of ten even parts of what rises; of one where it stays."""
    return [float(v) for v in np.linspace(x[0], x[-1], PARTS + 1 if x[-1] > x[0] else 2)]


def _periods(error_V: FloatArray, seconds: FloatArray) -> dict[str, Any]:
    """Mean square by how fast the error moves: variance between means over nested blocks of time.

    The law of total variance, block within block: the parts and the squared mean add up to the
    mean square, whatever the rows' spacing.
    """
    if not error_V.size:
        return {"constant": None, "by_period_s": []}
    whole = max(float(np.mean(error_V * error_V)), 1e-300)
    mean = float(np.mean(error_V))
    inner, parts = error_V, []
    ends = (None, *(2.0 * w for w in MEANS_S), None)
    for k, width_s in enumerate((*MEANS_S, math.inf)):
        outer = np.full_like(error_V, mean)
        if width_s < math.inf:
            # Tiny: a stamp of 0.1 x 10 must not fall below the block that it begins.
            block = np.unique(np.floor(seconds / width_s + 1e-9), return_inverse=True)[1]
            outer = (np.bincount(block, error_V) / np.bincount(block))[block]
        square = float(np.mean((inner - outer) ** 2))
        parts.append(
            {"from": ends[k], "to": ends[k + 1], "rms_V": _root(square), "share": square / whole}
        )
        inner = outer
    return {"constant": {"mean_V": mean, "share": mean * mean / whole}, "by_period_s": parts}


def _noise_floor(error_V: FloatArray) -> dict[str, float | None]:
    """Standard deviation of what is new in every row, from successive differences [V]."""
    jump = np.abs(np.diff(error_V))
    jump = jump[np.isfinite(jump)]
    if not jump.size:
        return {"floor_V": None, "share": None}
    for share in (0.5, 0.9):  # where most rows repeat the last (a coarse digit) by the others
        floor = float(np.quantile(jump, share)) / (math.sqrt(2.0) * float(ndtri(0.5 + 0.5 * share)))
        if floor > 0.0:
            break
    whole = float(np.nanmean(error_V**2))
    return {"floor_V": floor, "share": min(floor * floor / whole, 1.0) if whole > 0.0 else 1.0}


def _root(square: float) -> float:
    return float(np.sqrt(square))

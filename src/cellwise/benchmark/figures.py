"""The figures of one run, as one flat row."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwise.cell.metrics import NEAR_EMPTY
from cellwise.estimate.adaptive import AdaptiveTrace
from cellwise.estimate.replay import Replay, soc_errors
from cellwise.typing import FloatArray

MISSING = float("nan")
OUTSIDE = 0.05  # share of the rows that a band of two deviations may leave outside

# Name and kind of every column of the results, in order.
COLUMNS: dict[str, type] = {
    "suite": str, "cell": str, "log": str, "temperature_C": float, "estimator": str,
    "fault": str, "start_error": float, "soc0": float, "soc0_true": float,
    "samples": int, "dt_s": float, "reference_Ah": float, "model_Ah": float, "noise": str,
    "soc_rmse": float, "soc_mae": float, "soc_max_error": float, "convergence_s": float,
    "settled_rmse": float, "settled_mae": float, "settled_max": float, "low_soc_rmse": float,
    "soc_final_error": float, "voltage_rmse_V": float, "nis_mean": float,
    "coverage_2sigma": float, "interval_score": float, "band_width": float,
    "ns_per_step": float, "state_bytes": int, "process_MB": float, "easy": bool, "quick": bool,
    "offset_A": float, "capacity_Ah": float, "resistance_scale": float, "problem": str,
}  # fmt: skip


def figures_of(found: Replay, truth: FloatArray) -> dict[str, Any]:
    """What is judged of one replay; NaN where there is no such figure."""
    error = found.trace.soc - truth
    every = soc_errors(error)
    settled = found.settled or soc_errors(error)
    low = error[truth <= NEAR_EMPTY]
    known = np.flatnonzero(np.isfinite(error))
    row: dict[str, Any] = {
        "soc_rmse": every.rmse,
        "soc_mae": every.mae,
        "soc_max_error": every.max,
        "convergence_s": _number(found.convergence_s),
        "settled_rmse": settled.rmse,
        "settled_mae": settled.mae,
        "settled_max": settled.max,
        "low_soc_rmse": soc_errors(low).rmse,
        "soc_final_error": float(error[known[-1]]) if known.size else MISSING,
        "voltage_rmse_V": found.voltage_rmse_V,
        "nis_mean": _number(found.nis_mean),
        "coverage_2sigma": _coverage(error, found.trace.soc_std),
        **_band(error, found.trace.soc_std),
        "ns_per_step": found.ns_per_step,
    }
    if isinstance(found.trace, AdaptiveTrace):
        estimated = found.trace.parameters()
        row["offset_A"] = estimated.offset_A.value
        row["capacity_Ah"] = estimated.capacity_Ah.value
        row["resistance_scale"] = estimated.resistance_scale.value
    return row


def whole_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row with every column."""
    empty = {str: "", float: MISSING, int: 0, bool: False}
    return {name: row.get(name, empty[kind]) for name, kind in COLUMNS.items()}


def state_bytes(estimator: object) -> int:
    """Bytes of what an estimator carries from sample to sample: its numbers as float64.

    0 where its state cannot be looked into.
    """
    if hasattr(estimator, "state_bytes"):  # the process of a row says it
        return int(estimator.state_bytes)
    inner = getattr(estimator, "filter", None)
    if inner is not None:  # an adapter may say it itself
        return int(getattr(inner, "state_bytes", 0))
    begin = getattr(estimator, "init", None)
    return _bytes(begin(0.5)) if begin is not None else 0


def _bytes(value: Any) -> int:
    if hasattr(value, "nbytes"):
        return int(value.nbytes)
    if isinstance(value, bool | int | float):
        return 8
    if isinstance(value, tuple | list):
        return sum(_bytes(v) for v in value)
    if hasattr(value, "x") and hasattr(value, "P"):  # filterpy: mean and covariance
        return _bytes(np.asarray(value.x)) + _bytes(np.asarray(value.P))
    return 0


def _coverage(error: FloatArray, std: FloatArray) -> float:
    """Share of rows within two standard deviations; NaN where the filter gives none."""
    known = np.isfinite(error) & np.isfinite(std)
    return float(np.mean(np.abs(error[known]) <= 2.0 * std[known])) if known.any() else MISSING


def _band(error: FloatArray, std: FloatArray) -> dict[str, float]:
    """Sharpness and interval score of the band of two deviations, taken as one of 95 %.

    The width, plus what lies outside over half the share that may: the smaller the better, and
    least for the band that is as wide as it has to be (Gneiting and Raftery 2007, eq. 43,
    doi:10.1198/016214506000001437).
    """
    known = np.isfinite(error) & np.isfinite(std)
    if not known.any():
        return {"band_width": MISSING, "interval_score": MISSING}
    half = 2.0 * std[known]
    outside = np.maximum(np.abs(error[known]) - half, 0.0)
    score = 2.0 * half + 2.0 / OUTSIDE * outside
    return {"band_width": float(np.mean(2.0 * half)), "interval_score": float(np.mean(score))}


def _number(value: float | None) -> float:
    return MISSING if value is None else value

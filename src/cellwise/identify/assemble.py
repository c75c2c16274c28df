"""From a refinement to a CellModel: tables on the grid, effects, standard errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwise.cell.effects import (
    Effect,
    Hysteresis,
    SlowDiffusion,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.model import CellModel, ModelTables
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.refinement.refine import RefineResult, StartTables
from cellwise.identify.refinement.splines import spline_rows, spline_values
from cellwise.identify.tables import NAMES, PulseTables
from cellwise.typing import FloatArray

GRID_POINTS = 201
LEAST_RISE_V = 1e-6  # per grid step, so that the OCV can be inverted everywhere
LEAST_M_V = 1e-4
LEAST_SKEW_S = 0.005


def refined_tables(result: RefineResult, start: StartTables) -> ModelTables:
    """The fitted tables on the grid."""
    grid = np.linspace(0.0, 1.0, GRID_POINTS)
    lay, theta = result.layout, result.theta
    rows = spline_rows(grid, result.knots)
    correction = spline_values(spline_rows(grid, result.ocv_knots), theta[: lay.knots_ocv])

    def table(at: int) -> FloatArray:
        return np.asarray(np.exp(spline_values(rows, theta[at : at + lay.knots])))

    return ModelTables(
        ocv_V=monotone(start.ocv(grid) + correction),
        r0_ohm=table(lay.r0),
        r1_ohm=table(lay.r(0)),
        tau1_s=table(lay.tau(0)),
        r2_ohm=table(lay.r(1)),
        tau2_s=table(lay.tau(1)),
    )


def refined_effects(result: RefineResult, skewed: bool, hot: bool) -> tuple[Effect, ...]:
    """Effects that the refinement fitted.

    ``skewed``: a log with a skew was among the data; ``hot``: a temperature was measured.
    """
    grid = np.linspace(0.0, 1.0, GRID_POINTS)
    lay, theta = result.layout, result.theta
    rows = spline_rows(grid, result.knots)
    found: list[Effect] = []
    if lay.branches == 3:
        r3, tau3 = lay.r(2), lay.tau(2)
        found.append(
            SlowDiffusion(
                np.exp(spline_values(rows, theta[r3 : r3 + lay.knots]))[None, :],
                np.exp(spline_values(rows, theta[tau3 : tau3 + lay.knots]))[None, :],
            )
        )
    if lay.hysteresis:
        m = np.maximum(spline_values(rows, theta[lay.m : lay.m + lay.knots]), 0.0)
        if float(np.max(m)) > LEAST_M_V:
            found.append(Hysteresis(m[None, :], float(np.exp(theta[lay.gamma]))))
    if hot:
        found.append(TemperatureDependence(result.activation_K, result.reference_C))
    if skewed and result.skew_s > LEAST_SKEW_S:
        found.append(TimeSkew(result.skew_s))
    return tuple(found)


def plain_model(
    tables: PulseTables, ocv: OcvCurve, capacity: float, temperature: float
) -> CellModel:
    """A model of the pulses' tables as they are, without refinement."""
    return CellModel(
        capacity,
        *ModelTables(
            monotone(ocv.function.evaluate(tables.soc)),
            *(tables.values[name] for name in NAMES),
        ),
        temperature_C=np.array([temperature]),
    )


def relative_errors(result: RefineResult) -> dict[str, float]:
    """Median standard error of each table over its knots: a share, for the OCV volts."""
    lay, std = result.layout, result.theta_std

    def median(at: int, size: int) -> float:
        return float(np.median(std[at : at + size]))

    found = {"ocv_V": median(0, lay.knots_ocv), "r0_ohm": median(lay.r0, lay.knots)}
    for j in range(lay.branches):
        found[f"r{j + 1}_ohm"] = median(lay.r(j), lay.knots)
        found[f"tau{j + 1}_s"] = median(lay.tau(j), lay.knots)
    if lay.hysteresis:
        found["m_V"] = median(lay.m, lay.knots)
        found["gamma"] = float(std[lay.gamma])
    return found


def monotone(voltage_V: FloatArray) -> FloatArray:
    """Nearest OCV that never falls with SOC (isotonic regression), with a least rise per step."""
    from scipy.optimize import isotonic_regression

    level = np.asarray(isotonic_regression(voltage_V).x)
    steps = np.maximum(np.diff(level), LEAST_RISE_V)
    return np.concatenate(([level[0]], level[0] + np.cumsum(steps)))


def table_summary(result: RefineResult) -> dict[str, Any]:
    """What the provenance says of a refinement."""
    return {
        "method": "whole-log least squares, cubic B-splines over SOC",
        "logs": [p.name for p in result.logs],
        "rmse_V": list(result.rmse_V),
        "standard_error": relative_errors(result),
        "knots_soc": result.knots.tolist(),
        "iterations": result.iterations,
        "residual_sigma_V": result.sigma_V,
    }

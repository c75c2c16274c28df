"""From a fit to a CellModel: tables on the grid, effects, standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from cellwise.cell.effects import (
    ChargeTransfer,
    Effect,
    Hysteresis,
    SlowDiffusion,
    TimeSkew,
)
from cellwise.cell.model import CellModel, ModelTables
from cellwise.fit.population import NUGGET_LN, TABLES, CellPrior
from cellwise.fit.rows import BEYOND
from cellwise.fit.solve import FitResult
from cellwise.fit.splines import (
    OCV_KNOTS,
    SOC_GRID,
    TABLE_KNOTS,
    greville,
    spline_rows,
    spline_values,
)
from cellwise.fit.unknowns import LEAST_RATIO, bounds_of
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.tables import NAMES, PulseTables
from cellwise.typing import FloatArray


class _Kept(NamedTuple):
    """What of a fit becomes part of a model."""

    rise_V: float = 1e-6  # per grid step, so that the OCV can be inverted everywhere
    m_V: float = 1e-4  # less is no hysteresis
    skew_s: float = 0.005  # less is no delay
    step_K: float = 5.0  # at 5,000 K and -20 degC a line is within 1 % of the exponential
    beyond_K: tuple[float, ...] = (10.0, 20.0)  # rows that no log has shown


KEPT = _Kept()


def fitted_model(result: FitResult, cells: CellPrior, skewed: bool, hot: bool) -> CellModel:
    """The fitted tables and effects as a model.

    With several temperatures it has a row of tables at least every five kelvin, because a model is
    straight over temperature between its rows and a resistance is not. Beyond the last of them it
    goes on as the prior over cells says: held there, it would be off by the whole activation.

    Parameters
    ----------
    cells : CellPrior  the prior of the fit
    skewed : bool      a log with a sampling delay was among the data
    hot : bool         a temperature was measured
    """
    rows = [result.at(t) for t in temperatures_of(result)]
    if len(rows) > 1:
        ends = ((rows[0], -1.0), (rows[-1], 1.0))
        cold, warm = (
            [_beyond(result, cells, end, sign * away) for away in KEPT.beyond_K]
            for end, sign in ends
        )
        rows = [*reversed(cold), *rows, *warm]
    tables = [fitted_tables(row) for row in rows]
    stacked = ModelTables(*(np.array(t) for t in zip(*tables, strict=True)))
    return CellModel(
        result.fitted_Ah,
        **stacked._asdict(),
        temperature_C=np.array([row.grid_C[0] for row in rows]),
        effects=fitted_effects(result, rows, skewed, hot),
    )


def own_model(model: CellModel, capacity_scale: float) -> CellModel:
    """The model as of a cell that holds another charge."""
    if capacity_scale == 1.0:
        return model
    return replace(model, capacity_Ah=capacity_scale * model.capacity_Ah)


def temperatures_of(result: FitResult) -> FloatArray:
    """Temperatures at which the model has rows: the grid's, steps between, and what was seen.

    Beyond the grid a row is added where logs were warmer or colder by more than a kelvin.
    """
    grid = result.grid_C
    if grid.size == 1:
        return grid
    seen = np.concatenate([log.temperature_C(result.reference_C) for log in result.logs])
    cold, warm = np.percentile(seen, [1.0, 99.0])
    first = max(cold, grid[0] - BEYOND * (grid[1] - grid[0]))
    last = min(warm, grid[-1] + BEYOND * (grid[-1] - grid[-2]))
    ends = [*([first] if first < grid[0] - 1.0 else []), *grid]
    ends += [last] if last > grid[-1] + 1.0 else []
    rows = [np.array(ends[:1])]
    for a, b in pairwise(ends):
        rows.append(np.linspace(a, b, int(np.ceil((b - a) / KEPT.step_K)) + 1)[1:])
    return np.concatenate(rows)


def _beyond(result: FitResult, cells: CellPrior, end: FitResult, away_K: float) -> FitResult:
    """The tables so far from those of one end, as the prior has them given those of the grid."""
    layout, known = result.layout, result.layout.block
    at_C = float(end.grid_C[0]) + away_K
    every_C = np.array([*result.grid_C, *end.grid_C, at_C])
    theta = end.theta.copy()
    for name, at, there in zip(TABLES, layout.tables(), end.layout.tables(), strict=False):
        mean, covariance = cells.table(name, greville(TABLE_KNOTS), every_C)
        if name.startswith("r"):
            mean = mean - np.log(result.capacity_Ah)
        seen = covariance[:known, :known] + NUGGET_LN**2 * np.eye(known)
        away = np.linalg.solve(seen, result.theta[at : at + known] - mean[:known])
        near, far = (mean[known:] + covariance[known:, :known] @ away).reshape(2, layout.knots)
        theta[there : there + layout.knots] += far - near
    possible = bounds_of(end.layout, 3600.0 * result.fitted_Ah)
    theta = np.clip(theta, *possible)
    return replace(end, theta=theta, reference_C=at_C, grid_C=np.array([at_C]))


def fitted_tables(result: FitResult) -> ModelTables:
    """The fitted tables of one temperature on the grid."""
    layout, theta = result.layout, result.theta
    correction = spline_values(spline_rows(SOC_GRID, OCV_KNOTS), theta[: layout.knots_ocv])
    tau2 = _table(result, layout.tau(1))
    # In order at the temperatures of the grid; carried on beyond them they might cross.
    tau1 = np.minimum(_table(result, layout.tau(0)), tau2 / LEAST_RATIO)
    return ModelTables(
        ocv_V=monotone(result.base.at_soc(SOC_GRID)[0] + correction),
        r0_ohm=_table(result, layout.r0),
        r1_ohm=_table(result, layout.r(0)),
        tau1_s=tau1,
        r2_ohm=_table(result, layout.r(1)),
        tau2_s=tau2,
    )


def _table(result: FitResult, at: int) -> FloatArray:
    """A table of logarithms on the grid."""
    rows = spline_rows(SOC_GRID, TABLE_KNOTS)
    return np.asarray(np.exp(spline_values(rows, result.theta[at : at + result.layout.knots])))


def fitted_effects(
    result: FitResult, rows: Sequence[FitResult], skewed: bool, hot: bool
) -> tuple[Effect, ...]:
    """Effects that were fitted; see :func:`fitted_model`."""
    layout = rows[0].layout
    found: list[Effect] = []
    if layout.branches == 3:
        found.append(
            SlowDiffusion(
                np.array([_table(row, layout.r(2)) for row in rows]),
                np.array([_table(row, layout.tau(2)) for row in rows]),
            )
        )
    if layout.hysteresis:
        knots = spline_rows(SOC_GRID, TABLE_KNOTS)
        m = [spline_values(knots, row.theta[layout.m : layout.m + layout.knots]) for row in rows]
        if float(np.max(m)) > KEPT.m_V:
            found.append(Hysteresis(np.maximum(m, 0.0), float(np.exp(rows[0].theta[layout.gamma]))))
    if hot and result.layout.temperatures == 1:
        found.append(result.temperature_dependence())
    if result.asinh_per_V > 0.0:
        found.append(ChargeTransfer(result.asinh_per_V))
    if skewed and result.skew_s > KEPT.skew_s:
        found.append(TimeSkew(result.skew_s))
    return tuple(found)


def plain_model(
    tables: Sequence[PulseTables],
    ocv: OcvCurve,
    capacity_Ah: float,
    temperature_C: Sequence[float],
) -> CellModel:
    """A model of the pulses' tables as they are, one row for each temperature, ascending."""
    level = monotone(ocv.function.evaluate(tables[0].soc))
    rows = {name: np.array([t.values[name] for t in tables]) for name in NAMES}
    stacked = ModelTables(np.tile(level, (len(tables), 1)), *(rows[name] for name in NAMES))
    return CellModel(capacity_Ah, *stacked, temperature_C=np.array(temperature_C))


def monotone(voltage_V: FloatArray) -> FloatArray:
    """Nearest OCV that never falls with SOC (isotonic regression), with a least rise per step."""
    level = np.asarray(isotonic_regression(voltage_V).x)
    steps = np.maximum(np.diff(level), KEPT.rise_V)
    return np.concatenate(([level[0]], level[0] + np.cumsum(steps)))


def table_summary(result: FitResult) -> dict[str, Any]:
    """What the provenance says of a fit; ``standard_error``: the median over the knots of a table.

    Those of resistances, time constants and gamma are shares, of OCV and hysteresis volts.
    ``standard_errors`` has them at every knot.
    """
    layout, std = result.layout, result.theta_std
    at = {True: greville(OCV_KNOTS), False: greville(TABLE_KNOTS)}
    where = {"ocv_V": (0, layout.knots_ocv), "r0_ohm": (layout.r0, layout.knots)}
    for j in range(layout.branches):
        where |= {
            f"r{j + 1}_ohm": (layout.r(j), layout.knots),
            f"tau{j + 1}_s": (layout.tau(j), layout.knots),
        }
    if layout.hysteresis:
        where |= {"m_V": (layout.m, layout.knots), "gamma": (layout.gamma, 1)}
    return {
        "method": "whole-log least squares, cubic B-splines over SOC",
        "logs": [p.item.log.name for p in result.logs],
        "rmse_V": list(result.rmse_V),
        "standard_error": {
            n: float(np.median(std[a : a + size])) for n, (a, size) in where.items()
        },
        "standard_errors": {
            n: {"soc": at[n == "ocv_V"].round(6).tolist(),
                "std": [float(f"{v:.4g}") for v in std[a : a + size]]}
            for n, (a, size) in where.items()
            if size > 1
        },
        "knots_soc": TABLE_KNOTS.tolist(),
        "iterations": result.iterations,
        "residual_level_V": result.level_V,
    }  # fmt: skip

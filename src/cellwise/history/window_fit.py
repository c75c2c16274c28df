"""Capacity and resistance that one log shows: a fit of the model to whatever part it covers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwise.cell.effects import SlowDiffusion, TemperatureDependence
from cellwise.cell.initial_soc.best_start import best_start_soc
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import known_temperature_C, simulate
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IndexArray

POINTS = 240  # rows that are compared, even in charge and time
PASSES = 40
FEWEST_ROWS = 20
CONVERGED = 1e-5
STEP = np.array([1e-4, 1e-3, 1e-2])
# Before the log: initial SOC by its voltages, the logarithms of capacity and resistance of a life.
LN_CAPACITY_STD = 0.3
LN_RESISTANCE_STD = 0.5
LARGEST_MOVE = np.array([0.1, 0.1, 0.3])
LEAST_SHAPE_V = 0.003
WHITE_V = 0.001
# Errors of a model's OCV are alike over this much of SOC (three measured cells and a physics model:
# the corrections of the priors fall to 0.7 at 0.4).
SHAPE_SOC = 0.3
SHAPE_S = 3600.0
# Of a model that knows one temperature: relative change of resistance and capacity per kelvin.
RESISTANCE_PER_K = 0.02
CAPACITY_PER_K = 0.003


@dataclass(frozen=True, eq=False)
class WindowFit:
    """What one log says of the cell.

    ``capacity_Ah``, ``resistance_scale`` (on the model's) with standard deviations; SOC at the
    first and last row; ``covered`` the share of the SOC range that was seen, ``rate`` the mean
    current under load over the capacity [1/h], ``temperature_C`` (None: nobody measured).
    """

    capacity_Ah: float
    capacity_std_Ah: float
    resistance_scale: float
    resistance_std: float
    soc_start: float
    soc_end: float
    covered: float
    rate: float
    temperature_C: float | None
    rmse_V: float


def fit_window(model: CellModel, log: CellLog) -> WindowFit | None:
    """Fit initial SOC, capacity and resistance of one log; None: too few voltages.

    Notes
    -----
    Generalised least squares. The model's error is taken to stay alike over 0.3 of SOC and an hour
    (an exponential correlation); its size is what the fit leaves (restricted likelihood), 3 mV at
    least: what the log cannot separate from such an error widens the deviation. So does the range
    that it does not cover, which may have aged by itself.
    """
    rows = _compared(log)
    if rows.size < FEWEST_ROWS:
        return None
    centre, stds = _start(model, log)
    prior = np.diag(stds**-2.0)
    x = centre.copy()
    soc, residual, jacobian = _linear(model, log, x, rows)
    shape, damping = 2.0 * LEAST_SHAPE_V, 1e-3
    inverse = _inverse(soc, log.time_s[rows], shape)
    for _ in range(PASSES):
        normal = jacobian.T @ inverse @ jacobian / shape**2 + prior
        right = jacobian.T @ inverse @ residual / shape**2 - prior @ (x - centre)
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)
        tried = x + np.clip(move, -LARGEST_MOVE, LARGEST_MOVE)
        tried[0] = np.clip(tried[0], 0.0, 1.0)
        new = _linear(model, log, tried, rows)
        if _cost(new[1], inverse, shape, tried - centre, prior) > _cost(
            residual, inverse, shape, x - centre, prior
        ):
            damping *= 10.0
            continue
        damping = max(0.1 * damping, 1e-6)
        done = np.max(np.abs(tried - x)) < CONVERGED
        x, (soc, residual, jacobian) = tried, new
        size = float(residual @ inverse @ residual) / max(rows.size - 3.0, 1.0)
        shape = max(float(np.sqrt(size)), LEAST_SHAPE_V)
        inverse = _inverse(soc, log.time_s[rows], shape)
        if done:
            break
    normal = jacobian.T @ inverse @ jacobian / shape**2 + prior
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return _result(model, log, x, covariance, rows, residual)


def changed_model(model: CellModel, ln_capacity: float, ln_resistance: float) -> CellModel:
    """The model of the cell as it has aged: another capacity, resistances by one factor."""
    factor = float(np.exp(ln_resistance))
    effects = tuple(
        replace(e, r3_ohm=factor * np.asarray(e.r3_ohm)) if isinstance(e, SlowDiffusion) else e
        for e in model.effects
    )
    return replace(
        model,
        capacity_Ah=model.capacity_Ah * float(np.exp(ln_capacity)),
        r0_ohm=factor * model.r0_ohm,
        r1_ohm=factor * model.r1_ohm,
        r2_ohm=factor * model.r2_ohm,
        effects=effects,
    )


def _compared(log: CellLog) -> IndexArray:
    """Rows with a voltage, even in charge moved and in time."""
    known = np.flatnonzero(np.isfinite(log.voltage_V))
    if known.size <= POINTS:
        return known
    moved = np.cumsum(np.abs(log.known_current_A()) * log.interval_s)[known]
    time = (log.time_s - log.time_s[0])[known]
    way = moved / max(moved[-1], 1e-9) + time / max(time[-1], 1e-9)
    at = np.searchsorted(way, np.linspace(way[0], way[-1], POINTS))
    return np.asarray(known[np.unique(np.minimum(at, known.size - 1))])


def _start(model: CellModel, log: CellLog) -> tuple[FloatArray, FloatArray]:
    """First guess and standard deviations of initial SOC, ln capacity, ln resistance."""
    stds = np.array([0.3, LN_CAPACITY_STD, LN_RESISTANCE_STD])
    if log.soc0 is not None:
        return np.array([log.soc0, 0.0, 0.0]), np.array([0.005, *stds[1:]])
    found = initial_soc(model, log)
    whole, _ = best_start_soc(model, log, np.linspace(0.0, 1.0, 41))
    rested = found.how.startswith("rest")
    guess = found.soc if rested else whole
    stds[0] = max(found.std, 0.02) if rested else 0.3
    return np.array([np.clip(guess, 0.0, 1.0), 0.0, 0.0]), stds


def _linear(
    model: CellModel, log: CellLog, x: FloatArray, rows: IndexArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """SOC, measured minus model, and the model's derivatives at the compared rows."""

    def run(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = simulate(changed_model(model, at[1], at[2]), log, float(np.clip(at[0], 0.0, 1.0)))
        return found.soc[rows], found.voltage_V[rows]

    soc, voltage = run(x)
    jacobian = np.empty((rows.size, 3))
    for k in range(3):
        step = STEP[k] if k or x[0] < 0.5 else -STEP[k]
        moved = x.copy()
        moved[k] += step
        jacobian[:, k] = (run(moved)[1] - voltage) / step
    return soc, log.voltage_V[rows] - voltage, jacobian


def _correlation(soc: FloatArray, time_s: FloatArray) -> FloatArray:
    apart = np.abs(soc[:, None] - soc[None, :]) / SHAPE_SOC
    apart += np.abs(time_s[:, None] - time_s[None, :]) / SHAPE_S
    return np.asarray(np.exp(-apart))


def _inverse(soc: FloatArray, time_s: FloatArray, shape: float) -> FloatArray:
    return np.asarray(np.linalg.inv(_correlation(soc, time_s) + _white(soc.size, shape)))


def _cost(
    residual: FloatArray, inverse: FloatArray, shape: float, off: FloatArray, prior: FloatArray
) -> float:
    return float(residual @ inverse @ residual) / shape**2 + float(off @ prior @ off)


def _white(size: int, shape: float) -> FloatArray:
    return np.asarray((WHITE_V / shape) ** 2 * np.eye(size))


def _result(
    model: CellModel,
    log: CellLog,
    x: FloatArray,
    covariance: FloatArray,
    rows: IndexArray,
    residual: FloatArray,
) -> WindowFit:
    seen = simulate(changed_model(model, x[1], x[2]), log, float(np.clip(x[0], 0.0, 1.0))).soc
    covered = float(np.ptp(np.clip(seen[rows], 0.0, 1.0)))
    capacity = model.capacity_Ah * float(np.exp(x[1]))
    scale = float(np.exp(x[2]))
    ln_capacity_std, ln_scale_std = (float(np.sqrt(covariance[k, k])) for k in (1, 2))
    warm, apart = _temperature(model, log)
    unseen = (1.0 - covered) * LN_CAPACITY_STD
    ln_capacity_std = float(np.hypot(np.hypot(ln_capacity_std, CAPACITY_PER_K * apart), unseen))
    ln_scale_std = float(np.hypot(ln_scale_std, RESISTANCE_PER_K * apart))
    current = np.abs(log.known_current_A())
    loaded = current > 0.02 * capacity
    weight = log.interval_s * loaded
    rate = float((current * weight).sum() / weight.sum()) / capacity if weight.sum() > 0 else 0.0
    return WindowFit(
        capacity_Ah=capacity,
        capacity_std_Ah=capacity * ln_capacity_std,
        resistance_scale=scale,
        resistance_std=scale * ln_scale_std,
        soc_start=float(x[0]),
        soc_end=float(np.clip(seen[-1], 0.0, 1.0)),
        covered=covered,
        rate=rate,
        temperature_C=warm,
        rmse_V=float(np.sqrt(np.mean(residual**2))),
    )


def _temperature(model: CellModel, log: CellLog) -> tuple[float | None, float]:
    """Mean temperature of the log, and how far it is from a model that knows one alone [K]."""
    if log.temperature_C is None or not np.any(np.isfinite(log.temperature_C)):
        return None, 0.0
    warm = float(np.mean(known_temperature_C(model, log)))
    several = model.temperature_C.size > 1
    several |= any(isinstance(e, TemperatureDependence) for e in model.effects)
    return warm, 0.0 if several else abs(warm - float(model.temperature_C[0]))

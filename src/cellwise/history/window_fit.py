"""Capacity and resistance that one log shows: a fit of the model to whatever part it covers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import FAR_OFF
from cellwise.cell.simulate import Simulation, known_temperature_C, simulate
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray, IndexArray


class Fitting(NamedTuple):
    """How a log is fitted.

    ``points``: rows that are compared, even in charge and time, at least ``fewest_rows``;
    ``passes`` until the size of the model's error stays; ``step`` of the derivatives by SOC, ln
    capacity and ln resistance.
    """

    points: int = 240
    fewest_rows: int = 20
    passes: int = 8
    step: tuple[float, float, float] = (1e-4, 1e-3, 1e-2)


class Aged(NamedTuple):
    """What may have become of a cell before its log: standard deviations."""

    ln_capacity: float = 0.3
    ln_resistance: float = 0.5


class ModelShape(NamedTuple):
    """How a model's voltage is wrong: alike over so much of SOC and so long, and white beside it.

    The white part, at least ``least_white_V``, is what neighbouring rows differ by beyond that: a
    sensor that lags, branches that are off. Taken for less, it is explained by any resistance.

    Three measured cells and a physics model: the corrections of the priors fall to 0.7 at 0.4.
    """

    soc: float = 0.3
    time_s: float = 3600.0
    least_V: float = 0.003
    least_white_V: float = 0.001


class PerKelvin(NamedTuple):
    """Relative changes away from the one temperature that a model knows [1/K]."""

    resistance: float = 0.02
    capacity: float = 0.003


FITTING, AGED, SHAPE, PER_KELVIN = Fitting(), Aged(), ModelShape(), PerKelvin()


@dataclass(frozen=True, eq=False)
class WindowFit:
    """What one log says of the cell.

    ``capacity_Ah``, ``resistance_scale`` (on the model's) with standard deviations; SOC at the
    first and last row; ``covered`` the share of the SOC range that was seen; ``far_off`` says that
    the log is many times as far off the fitted model as that states of itself.
    """

    capacity_Ah: float
    capacity_std_Ah: float
    resistance_scale: float
    resistance_std: float
    soc_start: float
    soc_end: float
    covered: float
    far_off: str | None


def fit_window(model: CellModel, log: CellLog) -> WindowFit | None:
    """Fit initial SOC, capacity and resistance of one log; None: too few voltages.

    Notes
    -----
    Generalised least squares. The model's error is taken to stay alike over 0.3 of SOC and an hour
    (an exponential correlation), beside a white one; its size is what the fit leaves (restricted
    likelihood), 3 mV at least: what the log cannot separate from such an error widens the
    deviation. So does the range that it does not cover, which may have aged by itself.
    """
    rows = _compared(log)
    if rows.size < FITTING.fewest_rows:
        return None
    centre, stds = _start(model, log)
    x, measured = centre, log.voltage_V[rows]

    def run(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = simulate(changed_model(model, at[1], at[2]), log, float(np.clip(at[0], 0.0, 1.0)))
        return found.soc, found.voltage_V[rows]

    def slopes(at: FloatArray) -> FloatArray:
        size = np.array(FITTING.step)
        steps = np.diag(np.where([at[0] < 0.5, True, True], size, -size))
        voltage = run(at)[1]
        return np.column_stack([(run(at + s)[1] - voltage) / s.sum() for s in steps])

    shape, before = 2.0 * SHAPE.least_V, 0.0
    for _ in range(FITTING.passes):
        soc, voltage = run(x)
        white = _whitening(soc[rows], log.time_s[rows], shape, voltage - measured)

        def off(at: FloatArray, white: FloatArray = white, shape: float = shape) -> FloatArray:
            left = white @ (run(at)[1] - measured) / shape
            return np.concatenate((left, (at - centre) / stds))

        def jacobian(at: FloatArray, white: FloatArray = white, shape: float = shape) -> FloatArray:
            return np.vstack((white @ slopes(at) / shape, np.diag(1.0 / stds)))

        bounds = ([0.0, -np.inf, -np.inf], [1.0, np.inf, np.inf])
        found = least_squares(off, x, jacobian, bounds, x_scale=stds, xtol=1e-5, ftol=1e-6)
        x, before = found.x, shape
        left = found.fun[: rows.size] * shape
        shape = max(float(np.sqrt(left @ left / max(rows.size - 3.0, 1.0))), SHAPE.least_V)
        if abs(shape - before) < 0.01 * shape:
            break
    covariance = np.asarray(np.linalg.inv(found.jac.T @ found.jac), dtype=np.float64)
    aged = simulate(changed_model(model, x[1], x[2]), log, float(np.clip(x[0], 0.0, 1.0)))
    # An error that is alike everywhere costs this fit little: far off is what the model itself is.
    # So it is where no ageing would make the cell follow the log.
    impossible = bool(np.any(np.abs(x[1:]) > FAR_OFF.deviations * np.array(AGED)))
    far_off = None
    if impossible or aged.far_off is not None:
        far_off = simulate(model, log, float(centre[0])).far_off
    return _result(model, aged, x, covariance, rows, far_off)


def changed_model(model: CellModel, ln_capacity: float, ln_resistance: float) -> CellModel:
    """The model of the cell as it has aged: another capacity, resistances by one factor."""
    aged = model.with_resistances(float(np.exp(ln_resistance)))
    return replace(aged, capacity_Ah=model.capacity_Ah * float(np.exp(ln_capacity)))


def _compared(log: CellLog) -> IndexArray:
    """Rows with a voltage, even in charge moved and in time."""
    known = np.flatnonzero(np.isfinite(log.voltage_V))
    if known.size <= FITTING.points:
        return known
    moved = np.cumsum(np.abs(log.known_current_A()) * log.interval_s)[known]
    time = (log.time_s - log.time_s[0])[known]
    way = moved / max(moved[-1], 1e-9) + time / max(time[-1], 1e-9)
    at = np.searchsorted(way, np.linspace(way[0], way[-1], FITTING.points))
    return np.asarray(known[np.unique(np.minimum(at, known.size - 1))])


def _start(model: CellModel, log: CellLog) -> tuple[FloatArray, FloatArray]:
    """First guess and standard deviations of initial SOC, ln capacity, ln resistance."""
    stds = np.array([0.3, *AGED])
    if log.soc0 is not None:
        return np.array([log.soc0, 0.0, 0.0]), np.array([0.005, *stds[1:]])
    found = initial_soc(model, log, whole_log=True)
    # Free beyond that, an error that is alike everywhere would be explained by any start at all.
    stds[0] = max(found.std, 0.02)
    return np.array([found.soc, 0.0, 0.0]), stds


def _whitening(
    soc: FloatArray, time_s: FloatArray, shape: float, error_V: FloatArray
) -> FloatArray:
    """What makes an error of the model white, in units of ``shape`` [V]; (n, n)."""
    distance = np.abs(soc[:, None] - soc[None, :]) / SHAPE.soc
    distance += np.abs(time_s[:, None] - time_s[None, :]) / SHAPE.time_s
    alike = np.exp(-distance)
    by_shape = 1.0 - float(np.mean(np.diag(alike, 1)))
    white = 0.5 * float(np.mean(np.diff(error_V) ** 2)) / shape**2 - by_shape
    white = max(white, (SHAPE.least_white_V / shape) ** 2)
    covariance = alike + white * np.eye(soc.size)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _result(
    model: CellModel,
    aged: Simulation,
    x: FloatArray,
    covariance: FloatArray,
    rows: IndexArray,
    far_off: str | None,
) -> WindowFit:
    seen = aged.soc
    covered = float(np.ptp(np.clip(seen[rows], 0.0, 1.0)))
    capacity, scale = model.capacity_Ah * float(np.exp(x[1])), float(np.exp(x[2]))
    away_K = _away_K(model, aged.log)
    unseen = (1.0 - covered) * AGED.ln_capacity
    ln_capacity = np.sqrt(covariance[1, 1] + (PER_KELVIN.capacity * away_K) ** 2 + unseen**2)
    ln_scale = np.hypot(np.sqrt(covariance[2, 2]), PER_KELVIN.resistance * away_K)
    return WindowFit(
        capacity_Ah=capacity,
        capacity_std_Ah=capacity * float(ln_capacity),
        resistance_scale=scale,
        resistance_std=scale * float(ln_scale),
        soc_start=float(x[0]),
        soc_end=float(np.clip(seen[-1], 0.0, 1.0)),
        covered=covered,
        far_off=far_off,
    )


def _away_K(model: CellModel, log: CellLog) -> float:
    """How far the log's mean temperature is from a model that knows one alone [K]."""
    if log.temperature_C is None or not np.any(np.isfinite(log.temperature_C)):
        return 0.0
    several = any(isinstance(e, TemperatureDependence) for e in model.effects)
    if several or model.temperature_C.size > 1:
        return 0.0
    warm = float(np.mean(known_temperature_C(model, log)))
    return abs(warm - float(model.temperature_C[0]))

"""What one log shows of capacity and resistance: the one fit, a new cell's model as the prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import Hysteresis, SurfaceSoc, TemperatureDependence
from cellwise.cell.initial_soc.initial_soc import LOOKED, STATED_STD, initial_soc
from cellwise.cell.initial_soc.rest import REST_RATE
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import FAR_DEVIATIONS
from cellwise.cell.simulate import known_temperature_C, simulate, start_hysteresis
from cellwise.fit.capacity import TRIED, Tried, at_open_capacity
from cellwise.fit.log_starts import thinned
from cellwise.fit.model_error import LEAST_LOG
from cellwise.fit.population import ModelPrior, prior_of
from cellwise.fit.posterior import whole_resistance
from cellwise.fit.problem import Problem
from cellwise.fit.rows import PAST_V, FitLog
from cellwise.fit.solve import FitResult, fit_logs
from cellwise.fit.solver import Prior
from cellwise.fit.unknowns import FitSettings, layout_of
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Notice
from cellwise.typing import FloatArray


class Aged(NamedTuple):
    """What may have become of a cell before its log: standard deviations.

    ``error_scales``: how many times the new model's error the aged cell may be off that model, all
    as probable before the log: a stock model states how far cells of its kind differ, and may be of
    this very cell.
    """

    ln_capacity: float = 0.3
    ln_resistance: float = 0.5
    error_scales: tuple[float, ...] = (1.0, 0.3, 0.1)


class FittedLog(NamedTuple):
    """How a log is fitted.

    Parameters
    ----------
    rows, iterations : int    compared rows at most, steps at most
    grid_K, narrow_K : float  tables of several temperatures are taken at most as far apart; within
                              so little one is enough
    """

    rows: int = 400
    iterations: int = 20
    grid_K: float = 10.0
    narrow_K: float = 1.0


class PerKelvin(NamedTuple):
    """Relative changes away from the one temperature that a model knows [1/K]."""

    resistance: float = 0.02
    capacity: float = 0.003


AGED, FITTED, PER_KELVIN = Aged(), FittedLog(), PerKelvin()


@dataclass(frozen=True, eq=False)
class LogHealth:
    """What one log says of the cell.

    ``capacity_Ah``, ``resistance_scale`` (on the model's) with standard deviations; SOC at the
    first and last row; ``covered`` the share of the SOC range that was seen; ``model_mismatch``
    says that the log is many times as far off the fitted model as that states of itself.
    """

    capacity_Ah: float
    capacity_std_Ah: float
    resistance_scale: float
    resistance_std: float
    soc_start: float
    soc_end: float
    covered: float
    model_mismatch: Notice | None


class _Fitted(NamedTuple):
    """Means and deviations of ln capacity and ln resistance, start, covered share."""

    mean: FloatArray
    std: FloatArray
    start: float
    covered: float


def log_health(model: CellModel, log: CellLog) -> LogHealth | None:
    """Fit start, capacity and resistance of one log; None: too few voltages.

    Notes
    -----
    The model is the prior: its OCV and tables are unknowns that may be off by what it states of
    itself, or by a part of that, whichever the marginal likelihood prefers; a common factor of all
    resistances and the capacity may have aged. The capacity is the mean of the profile of its
    likelihood, as where a cell is identified (:mod:`cellwise.fit.capacity`). What the log cannot
    separate from the model's error widens the deviation. So does the range that it does not cover,
    which may have aged by itself.
    """
    if int(np.count_nonzero(np.isfinite(log.voltage_V))) < LEAST_LOG:
        return None
    item = _fit_log(model, log)
    fitted = _fit(model, item)
    ln_capacity, ln_scale = map(float, fitted.mean)
    start = float(np.clip(fitted.start, 0.0, 1.0))
    aged = simulate(changed_model(model, ln_capacity, ln_scale), log, start)
    # An error that is alike everywhere costs this fit little: far off is what the model itself is.
    # So it is where no ageing would make the cell follow the log.
    most = FAR_DEVIATIONS * np.array([AGED.ln_capacity, AGED.ln_resistance])
    impossible = bool(np.any(np.abs(fitted.mean) > most))
    mismatch = None
    if impossible or aged.model_mismatch is not None:
        mismatch = simulate(model, log, float(np.clip(item.soc0, 0.0, 1.0))).model_mismatch
    away_K = _away_K(model, log)
    unseen = (1.0 - fitted.covered) * AGED.ln_capacity
    capacity, scale = model.capacity_Ah * math.exp(ln_capacity), math.exp(ln_scale)
    return LogHealth(
        capacity_Ah=capacity,
        capacity_std_Ah=capacity * math.hypot(fitted.std[0], PER_KELVIN.capacity * away_K, unseen),
        resistance_scale=scale,
        resistance_std=scale * math.hypot(fitted.std[1], PER_KELVIN.resistance * away_K),
        soc_start=start,
        soc_end=float(np.clip(aged.soc[-1], 0.0, 1.0)),
        covered=fitted.covered,
        model_mismatch=mismatch,
    )


def changed_model(model: CellModel, ln_capacity: float, ln_resistance: float) -> CellModel:
    """The model of the cell as it has aged: another capacity, resistances by one factor."""
    aged = model.with_resistances(math.exp(ln_resistance))
    return replace(aged, capacity_Ah=model.capacity_Ah * math.exp(ln_capacity))


def _fit_log(model: CellModel, log: CellLog) -> FitLog:
    """The log, thinned, and what is known of its start."""
    soc0, std = log.soc0, STATED_STD
    if soc0 is None:
        found = initial_soc(model, log, whole_log=True)
        # An error of the model that is alike everywhere moves a start, too.
        soc0, std = found.soc, max(found.std, LOOKED.sure)
    rests = abs(float(log.known_current_A()[0])) < REST_RATE * model.capacity_Ah
    return FitLog(
        thinned(log),
        soc0,
        std,
        h0=start_hysteresis(soc0),
        temperature_C=float(known_temperature_C(model, log)[0]),
        surface=model.effect(SurfaceSoc),
        past_V=0.0 if rests else PAST_V,
    )


def _fit(model: CellModel, item: FitLog) -> _Fitted:
    """The most probable of the fits of each size of the model's error, with its capacity open."""
    grid = _temperatures(model, item)
    hysteresis = any(isinstance(e, Hysteresis) for e in model.effects)
    layout = layout_of(3, hysteresis, int(grid.size), 1)
    settings = FitSettings(
        hysteresis=hysteresis,
        ln_capacity_std=AGED.ln_capacity,
        ln_resistance_std=AGED.ln_resistance,
    )
    base = ModelPrior(model).base()

    def fit(prior: Prior, theta: FloatArray | None) -> FitResult:
        return fit_logs(
            (item,), base, prior, layout, capacity_Ah=model.capacity_Ah, reference_C=float(grid[0]),
            grid_C=grid, theta=theta, most_rows=FITTED.rows, iterations=FITTED.iterations,
        )  # fmt: skip

    fits: list[tuple[Prior, FitResult]] = []
    for error_scale in AGED.error_scales:
        cells = ModelPrior(model, error_scale)
        prior = prior_of(cells, layout, (item,), model.capacity_Ah, grid, float(grid[0]), settings)
        fits.append((prior, fit(prior, fits[-1][1].theta if fits else None)))
    prior, found = max(fits, key=lambda one: one[1].log_evidence)
    problem = Problem(
        (item,), base, prior, layout, model.capacity_Ah, grid, float(grid[0]), FITTED.rows
    )
    return _aged(at_open_capacity(problem, found, fit, _tried(found)), prior.mean)


def _tried(found: FitResult) -> Tried:
    """A profile in steps of the deviation of the quadratic: one log leaves more open than a kit."""
    return TRIED._replace(step=max(TRIED.step, float(found.theta_std[found.layout.capacity])))


def _aged(result: FitResult, new: FloatArray) -> _Fitted:
    """What became of the capacity, and of the whole resistance over the SOC that was seen."""
    layout, soc = result.layout, np.clip(result.soc(0), 0.0, 1.0)
    whole, slopes = whole_resistance(layout, result.theta, soc)
    slope = slopes.mean(axis=0)
    ln_scale = float(np.mean(whole - whole_resistance(layout, new, soc)[0]))
    std = math.sqrt(float(slope @ result.covariance @ slope))
    return _Fitted(
        np.array([result.theta[layout.capacity], ln_scale]),
        np.array([result.theta_std[layout.capacity], std]),
        result.start(0)[0],
        float(np.ptp(soc)),
    )


def _temperatures(model: CellModel, item: FitLog) -> FloatArray:
    """At which the tables are unknowns [degC]: the model's one, or those of the log."""
    if model.temperature_C.size == 1:
        known = any(isinstance(e, TemperatureDependence) for e in model.effects)
        here = model.effect(TemperatureDependence).reference_C if known else model.temperature_C[0]
        return np.array([float(here)])
    low, high = np.quantile(known_temperature_C(model, item.log), (0.02, 0.98))
    if high - low < FITTED.narrow_K:
        return np.array([0.5 * float(low + high)])
    return np.linspace(low, high, 2 + int((high - low) / FITTED.grid_K))


def _away_K(model: CellModel, log: CellLog) -> float:
    """How far the log's mean temperature is from a model that knows one alone [K]."""
    if log.temperature_C is None or not np.any(np.isfinite(log.temperature_C)):
        return 0.0
    several = any(isinstance(e, TemperatureDependence) for e in model.effects)
    if several or model.temperature_C.size > 1:
        return 0.0
    warm = float(np.mean(known_temperature_C(model, log)))
    return abs(warm - float(model.temperature_C[0]))

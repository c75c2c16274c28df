"""Refinement: least squares of the simulated voltage over whole logs, with smooth tables.

Pulses of ten seconds cannot see slow dynamics, and a table read off single pulses need not add up
over a drive. So all tables are fitted at once to the voltage of whole logs (HPPC with its rests,
low-rate and capacity tests, drives) at all temperatures, as splines over SOC: ln R and ln tau
(positive by construction) at each temperature, straight over 1/T in between and held straight
beyond what the data show; a correction of the OCV; and scalars. Levenberg-Marquardt with analytic
sensitivities.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwise.cell.effects import BRANCH_ACTIVATIONS, TemperatureDependence
from cellwise.identify.refinement.layout import (
    ACTIVATION_UNIT_K,
    ASINH_UNIT_PER_V,
    SKEW_UNIT_S,
    Layout,
    RefineSettings,
    StartTables,
)
from cellwise.identify.refinement.problem import Problem
from cellwise.identify.refinement.refine_data import BEYOND, ROWS, PreparedLog, RefineLog, inverse_K
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray

ALL_ROWS = 40_000


@dataclass(frozen=True, eq=False)
class RefineResult:
    """The fitted parameter vector and what it left.

    ``theta`` and ``theta_std`` follow ``layout``; ``rmse_V`` has one entry per log over its
    compared rows; ``residual_V`` holds those rows; ``grid_C`` are the temperatures with tables of
    their own, ascending.
    """

    layout: Layout
    theta: FloatArray
    theta_std: FloatArray
    rmse_V: tuple[float, ...]
    residual_V: tuple[FloatArray, ...]
    logs: tuple[PreparedLog, ...]
    reference_C: float
    sigma_V: float
    iterations: int
    seconds: float
    grid_C: FloatArray

    @property
    def activation_K(self) -> float:
        """Fitted Arrhenius activation [K]."""
        return float(self.theta[self.layout.activation] * ACTIVATION_UNIT_K)

    def temperature_dependence(self) -> TemperatureDependence:
        """Fitted activations, the common one and what each table has beside it."""
        lay = self.layout
        own = self.theta[lay.own : lay.sample] * ACTIVATION_UNIT_K
        beside = {f"{name}_K": float(e) for name, e in zip(BRANCH_ACTIVATIONS, own, strict=False)}
        return TemperatureDependence(self.activation_K, self.reference_C, **beside)

    @property
    def skew_s(self) -> float:
        """Fitted sampling delay between current and voltage [s]."""
        return float(self.theta[self.layout.skew] * SKEW_UNIT_S)

    def capacity_scale(self, sample: int | None) -> float:
        """What the cell of a log holds over the model's capacity; 1 where it has no own."""
        return 1.0 if sample is None else float(np.exp(self.theta[self.layout.sample + sample]))

    @property
    def moved_starts(self) -> tuple[FloatArray, FloatArray]:
        """By how much SOC the logs whose start was fitted begin elsewhere, and standard errors."""
        at = slice(self.layout.start, self.layout.past)
        return self.theta[at], self.theta_std[at]

    @property
    def asinh_per_V(self) -> float:
        """Fitted sharpness of the charge transfer [1/V]; 0 where it was not fitted."""
        return float(self.theta[self.layout.asinh] * ASINH_UNIT_PER_V)

    def at(self, temperature_C: float) -> RefineResult:
        """The tables of one temperature, straight over 1/T between those of the grid.

        Beyond its ends they go on straight for half a step. With the logs in which it was seen.
        """
        lay = self.layout
        if lay.temperatures == 1:
            return self
        x = inverse_K(self.grid_C, self.reference_C)
        low = int(np.clip(np.searchsorted(self.grid_C, temperature_C) - 1, 0, x.size - 2))
        here = float(inverse_K(temperature_C, self.reference_C))
        way = float(np.clip((here - x[low]) / (x[low + 1] - x[low]), -BEYOND, 1.0 + BEYOND))

        places = [lay.part(low + k, 1) for k in (0, 1)]
        cold, warm = (self.theta[part] for part in places)
        nearest = low + round(min(max(way, 0.0), 1.0))
        seen = [
            k
            for k, log in enumerate(self.logs)
            if log.first_temperature <= nearest < log.first_temperature + log.temperatures
        ]
        return replace(
            self,
            layout=lay.of_temperatures(1),
            theta=cold + way * (warm - cold),
            theta_std=np.maximum(*(self.theta_std[part] for part in places)),
            rmse_V=tuple(self.rmse_V[k] for k in seen),
            residual_V=tuple(self.residual_V[k] for k in seen),
            logs=tuple(self.logs[k] for k in seen),
            reference_C=temperature_C,
            grid_C=np.array([temperature_C]),
        )


@one_blas_thread
def refine(
    logs: Sequence[RefineLog],
    start: StartTables,
    *,
    settings: RefineSettings | None = None,
    capacity_Ah: float,
    reference_C: float = 25.0,
    grid_C: FloatArray | None = None,
    theta: FloatArray | None = None,
    most_rows: int | None = None,
    with_errors: bool = True,
) -> RefineResult:
    """Fit the tables to the voltage of whole logs.

    Parameters
    ----------
    logs : sequence of RefineLog      every log has the weight of its mean squared error
    start : StartTables
    capacity_Ah : float               for the hysteresis' rate
    grid_C : (temperatures,) float or None      ascending; None: one temperature, the reference
    theta : (parameters,) float or None         where to begin, if not at ``start``
    most_rows : int or None           compared rows of one log at most; None: all logs together
                                      share ALL_ROWS, none has fewer than ROWS.most
    with_errors : bool                estimate standard errors, too; else they are NaN

    Returns
    -------
    RefineResult
    """
    began = time.perf_counter()
    settings = RefineSettings() if settings is None else settings
    grid = np.array([reference_C]) if grid_C is None else np.asarray(grid_C, dtype=np.float64)
    most = max(ROWS.most, ALL_ROWS // len(logs)) if most_rows is None else most_rows
    problem = Problem(logs, start, settings, capacity_Ah, grid, reference_C, most)
    theta = problem.anchor if theta is None else problem.inside(theta)
    steps = 0
    residuals: tuple[FloatArray, ...] = ()
    # The first passes find the size of each log's residual (smoothing, robustness, balance) and
    # which logs are of another cell.
    for share in (0.3, 0.4, 1.0):
        count = max(3, int(share * settings.iterations))
        theta, done, residuals = problem.minimise(theta, count)
        steps += done
        problem.judge(theta, residuals)
    return RefineResult(
        layout=problem.layout,
        theta=theta,
        theta_std=problem.standard_errors(theta) if with_errors else np.full(theta.size, np.nan),
        rmse_V=tuple(float(np.sqrt(np.mean(r * r))) for r in residuals),
        residual_V=residuals,
        logs=problem.logs,
        reference_C=reference_C,
        sigma_V=problem.sigma,
        iterations=steps,
        seconds=time.perf_counter() - began,
        grid_C=grid,
    )

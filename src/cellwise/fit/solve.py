"""The fit: the most probable unknowns of some logs, and what they left.

Pulses of ten seconds cannot see slow dynamics, and a table read off single pulses need not add up
over a drive. So all tables are fitted at once to the voltage of whole logs at all temperatures, as
splines over SOC: ln R and ln tau (positive by construction) at each temperature, straight over 1/T
in between and held straight beyond what the data show; a correction of the OCV; capacity, starts
and scalars. Analytic sensitivities; held by a prior over cells.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwise.cell.effects import BRANCH_ACTIVATIONS, TemperatureDependence
from cellwise.fit.problem import Problem
from cellwise.fit.rows import BEYOND, ROWS, BaseOcv, FitLog, PreparedLog, inverse_K
from cellwise.fit.solver import Prior
from cellwise.fit.unknowns import ACTIVATION_UNIT_K, ASINH_UNIT_PER_V, SKEW_UNIT_S, Layout
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray

ALL_ROWS = 40_000
PASSES = 3  # that share the iterations; after each the size of every log's residual is taken


@dataclass(frozen=True, eq=False)
class FitResult:
    """The fitted unknowns and what they left.

    ``theta`` and ``covariance`` follow ``layout``; ``base`` is the OCV that they correct;
    ``rmse_V`` has one entry per log over its compared rows; ``residual_V`` holds those rows;
    ``grid_C`` are the temperatures with tables of their own, ascending; ``log_evidence`` the log
    of the marginal likelihood.
    """

    layout: Layout
    theta: FloatArray
    covariance: FloatArray
    base: BaseOcv
    capacity_Ah: float
    rmse_V: tuple[float, ...]
    residual_V: tuple[FloatArray, ...]
    logs: tuple[PreparedLog, ...]
    reference_C: float
    level_V: float
    share: float
    numbers: FloatArray
    log_evidence: float
    iterations: int
    seconds: float
    grid_C: FloatArray

    @property
    def activation_K(self) -> float:
        """Fitted Arrhenius activation [K]."""
        return float(self.theta[self.layout.activation] * ACTIVATION_UNIT_K)

    def temperature_dependence(self) -> TemperatureDependence:
        """Fitted activations, the common one and what each table has beside it."""
        layout = self.layout
        own_K = self.theta[layout.own_activation : layout.capacity] * ACTIVATION_UNIT_K
        beside = {f"{name}_K": float(e) for name, e in zip(BRANCH_ACTIVATIONS, own_K, strict=False)}
        return TemperatureDependence(self.activation_K, self.reference_C, **beside)

    @property
    def skew_s(self) -> float:
        """Fitted sampling delay between current and voltage [s]."""
        return float(self.theta[self.layout.skew] * SKEW_UNIT_S)

    @property
    def theta_std(self) -> FloatArray:
        """Standard error of every unknown; 0 of those that were known."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def fitted_Ah(self) -> float:
        """The capacity."""
        return self.capacity_Ah * float(np.exp(self.theta[self.layout.capacity]))

    def capacity_scale(self, log: int) -> float:
        """What the cell of a log holds over the model's capacity."""
        return float(np.exp(self.theta[self.layout.sample + log]))

    def start(self, log: int) -> tuple[float, float]:
        """SOC at a log's first row, and its standard error."""
        at = self.layout.start + log
        return self.logs[log].item.soc0 + float(self.theta[at]), float(self.theta_std[at])

    def soc(self, log: int) -> FloatArray:
        """SOC of the compared rows of a log."""
        layout = self.layout
        ln_capacity = float(self.theta[layout.capacity] + self.theta[layout.sample + log])
        known = self.logs[log]
        used = (known.soc[0] - known.compared_soc) * np.exp(-ln_capacity)
        return np.asarray(self.start(log)[0] - used)

    @property
    def asinh_per_V(self) -> float:
        """Fitted sharpness of the charge transfer [1/V]; 0 where it was not fitted."""
        return float(self.theta[self.layout.asinh] * ASINH_UNIT_PER_V)

    def at(self, temperature_C: float) -> FitResult:
        """The tables of one temperature, straight over 1/T between those of the grid.

        Beyond its ends they go on straight for half a step. With the logs in which it was seen.
        """
        layout = self.layout
        if layout.temperatures == 1:
            return self
        x = inverse_K(self.grid_C, self.reference_C)
        low = int(np.clip(np.searchsorted(self.grid_C, temperature_C) - 1, 0, x.size - 2))
        here = float(inverse_K(temperature_C, self.reference_C))
        way = float(np.clip((here - x[low]) / (x[low + 1] - x[low]), -BEYOND, 1.0 + BEYOND))

        places = [layout.part(low + k, 1) for k in (0, 1)]
        cold, warm = (self.theta[part] for part in places)
        nearer = places[round(min(max(way, 0.0), 1.0))]
        nearest = low + round(min(max(way, 0.0), 1.0))
        seen = [
            k
            for k, log in enumerate(self.logs)
            if log.first_temperature <= nearest < log.first_temperature + log.temperatures
        ]
        return replace(
            self,
            layout=layout.of_temperatures(1, layout.logs),
            theta=cold + way * (warm - cold),
            covariance=self.covariance[np.ix_(nearer, nearer)],
            rmse_V=tuple(self.rmse_V[k] for k in seen),
            residual_V=tuple(self.residual_V[k] for k in seen),
            logs=tuple(self.logs[k] for k in seen),
            reference_C=temperature_C,
            grid_C=np.array([temperature_C]),
        )


@one_blas_thread
def fit_logs(
    logs: Sequence[FitLog],
    base: BaseOcv,
    prior: Prior,
    layout: Layout,
    *,
    capacity_Ah: float,
    reference_C: float = 25.0,
    grid_C: FloatArray | None = None,
    theta: FloatArray | None = None,
    most_rows: int | None = None,
    iterations: int = 40,
) -> FitResult:
    """Fit the unknowns to the voltage of whole logs.

    Parameters
    ----------
    logs : sequence of FitLog
    base : BaseOcv                    the OCV that is corrected
    prior : Prior                     of the unknowns of ``layout``
    capacity_Ah : float               that the SOC of the logs is counted over
    grid_C : (temperatures,) float or None      ascending; None: one temperature, the reference
    theta : (size,) float or None     where to begin, if not at the prior's mean
    most_rows : int or None           compared rows of one log at most; None: all logs together
                                      share ALL_ROWS, none has fewer than ROWS.most

    Returns
    -------
    FitResult
    """
    began = time.perf_counter()
    grid = np.array([reference_C]) if grid_C is None else np.asarray(grid_C, dtype=np.float64)
    most = max(ROWS.most, ALL_ROWS // len(logs)) if most_rows is None else most_rows
    problem = Problem(logs, base, prior, layout, capacity_Ah, grid, reference_C, most)
    theta = problem.inside(prior.mean if theta is None else theta)
    steps = 0
    for _ in range(PASSES):
        theta, done, _, residuals = problem.minimise(theta, iterations // PASSES)
        steps += done
        problem.update_error_sizes(theta, residuals)
    of_logs, residuals = problem.normal_of_logs(theta)
    normal = problem.prior.with_data(theta, *of_logs)
    return FitResult(
        layout=layout,
        theta=theta,
        covariance=problem.prior.covariance(normal.matrix),
        base=base,
        capacity_Ah=capacity_Ah,
        rmse_V=tuple(float(np.sqrt(np.mean(r * r))) for r in residuals),
        residual_V=residuals,
        logs=problem.logs,
        reference_C=reference_C,
        level_V=problem.level_V,
        share=problem.share,
        numbers=problem.numbers,
        log_evidence=problem.log_evidence(normal),
        iterations=steps,
        seconds=time.perf_counter() - began,
        grid_C=grid,
    )

"""What a pulse fit knows: size and memory of its residual, and standard errors from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from cellwise.identify.pulse_fit.pulse_data import PulseData
from cellwise.identify.pulse_fit.pulse_parameters import PulseFit, PulseParameters
from cellwise.identify.pulse_fit.pulse_problem import (
    UNKNOWNS,
    Problem,
    Solution,
    columns,
    residual_V,
    tau_slopes,
)
from cellwise.typing import FloatArray

LONGEST_MEMORY = 1000  # rows
AT_BOUND = 1e-6  # in log tau


class ResidualStatistics(NamedTuple):
    """What the residual says: its size and how many rows share one independent value."""

    rmse_V: float
    noise_V: float
    rows_per_residual: float


def residual_statistics(problem: Problem, solution: Solution) -> ResidualStatistics:
    """Size and memory of the residual over the rows that count."""
    residual = residual_V(problem, solution.log_tau, solution.coefficients)
    used = problem.weight > 0.0
    residual, weight = residual[used], problem.weight[used]
    freedom = max(residual.size - int(np.count_nonzero(solution.include)) - 2, 1)
    return ResidualStatistics(
        float(np.sqrt(np.sum(weight * residual**2) / np.sum(weight))),
        float(np.sqrt(np.sum(residual**2) / freedom)),
        autocorrelation_time(np.sqrt(weight) * residual),
    )


def autocorrelation_time(residual: FloatArray) -> float:
    """How many rows share one independent residual: 1 + 2 sum of autocorrelations, at least 1.

    Summed over pairs of lags until a pair is not positive (initial positive sequence of Geyer,
    doi:10.1214/ss/1177011137), at most `LONGEST_MEMORY` lags; a longer memory counts as that long.
    """
    longest = min(LONGEST_MEMORY, residual.size // 4) // 2 * 2
    size = next_fast_len(residual.size + longest)
    spectrum = rfft(residual - np.mean(residual), size)
    products = irfft(np.abs(spectrum) ** 2, size)[: longest + 1]
    if longest == 0 or products[0] <= 0.0:
        return 1.0
    pairs = (products[1::2] + products[2::2]) / products[0]
    end = int(np.argmax(pairs <= 0.0)) if np.any(pairs <= 0.0) else pairs.size
    return max(1.0 + 2.0 * float(np.sum(pairs[:end])), 1.0)


def describe(
    data: PulseData, problem: Problem, solution: Solution, limits: FloatArray, method: str
) -> PulseFit:
    """A solution as a `PulseFit`: values, standard errors, bounds reached, notes."""
    statistics = residual_statistics(problem, solution)
    error, condition = _standard_errors(problem, solution, statistics)
    ocv, slope, r0, r1, r2, v1, v2, *bends = (float(c) for c in solution.coefficients)
    tau1, tau2 = np.exp(solution.log_tau)
    ocv += problem.reference_V
    if data.ocv_change_V is not None:
        before, last = max(data.start - 1, 0), data.stop - 1
        change = data.ocv_change_V
        order = np.argsort(problem.dq, kind="stable")
        ocv += float(np.interp(problem.centre, problem.dq[order], change[order]))
        moved = problem.dq[last] - problem.dq[before]
        slope = float((change[before] - change[last]) / moved) if moved != 0.0 else 0.0
    return PulseFit(
        method=method,
        soc=data.soc,
        current_A=data.pulse_current_A,
        duration_s=data.pulse_duration_s,
        window_s=float(data.time_s[-1] - data.time_s[0]),
        value=PulseParameters(r0, r1, float(tau1), r2, float(tau2), ocv, slope),
        error=error,
        rmse_V=statistics.rmse_V,
        noise_V=statistics.noise_V,
        rows=len(data),
        left_out=int(np.count_nonzero(problem.weight == 0.0)),
        rows_per_residual=statistics.rows_per_residual,
        condition=condition,
        at_bound=_at_bound(solution, limits),
        ocv_bends_V=(bends[0], bends[1], bends[2]),
        v1_start_V=v1,
        v2_start_V=v2,
        passes=solution.passes,
        converged=solution.converged,
    )


def _standard_errors(
    problem: Problem, solution: Solution, statistics: ResidualStatistics
) -> tuple[PulseParameters, float]:
    """Standard error of every parameter, and the condition number of the scaled problem.

    With A = J'WJ and the noise equal in all rows, cov = s^2 m A^-1 (J'W^2 J) A^-1; s^2 is the
    residual variance and m the rows that share one independent residual. A time constant whose
    branch has no resistance is not seen: inf. An unknown that the model does not have: 0.
    """
    linear, of_tau = columns(problem, solution.log_tau, solution.include)
    slopes = tau_slopes(of_tau, solution.coefficients)
    seen = np.any(slopes != 0.0, axis=1)
    jacobian = np.concatenate((linear[solution.include], slopes[seen]))
    names = [n for n, used in zip(UNKNOWNS, solution.include, strict=True) if used]
    names += [n for n, used in zip(("log_tau1", "log_tau2"), seen, strict=True) if used]
    weighted = jacobian * problem.weight
    normal, spread = weighted @ jacobian.T, weighted @ weighted.T
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    values = np.maximum(values, 1e-15 * values[-1])
    inverse = (vectors / values) @ vectors.T / np.outer(scale, scale)
    variance = statistics.noise_V**2 * statistics.rows_per_residual
    covariance = variance * np.diag(inverse @ spread @ inverse)
    error = dict(zip(names, np.sqrt(np.maximum(covariance, 0.0)).tolist(), strict=True))
    tau1, tau2 = np.exp(solution.log_tau).tolist()
    return (
        PulseParameters(
            r0_ohm=error.get("r0", np.inf),
            r1_ohm=error.get("r1", np.inf),
            tau1_s=tau1 * error.get("log_tau1", np.inf),
            r2_ohm=error.get("r2", np.inf),
            tau2_s=tau2 * error.get("log_tau2", np.inf),
            ocv_V=error.get("ocv", 0.0),
            ocv_slope_V=error.get("slope", 0.0),
        ),
        float(np.sqrt(values[-1] / values[0])),
    )


def _at_bound(solution: Solution, limits: FloatArray) -> tuple[str, ...]:
    """Names of the parameters that a bound holds."""
    slope, r0, r1, r2 = solution.coefficients[1:5]
    fast, slow = solution.log_tau
    held = {
        "r0_ohm": r0 <= 0.0,
        "r1_ohm": r1 <= 0.0,
        "tau1_s": fast <= limits[0] + AT_BOUND or fast >= limits[1] - AT_BOUND,
        "r2_ohm": r2 <= 0.0,
        "tau2_s": slow <= limits[2] + AT_BOUND or slow >= limits[3] - AT_BOUND,
        "ocv_slope_V": solution.include[1] and slope <= 0.0,
    }
    if slow - fast <= limits[4] + AT_BOUND:
        held["tau1_s"] = held["tau2_s"] = True
    return tuple(name for name, at in held.items() if at)

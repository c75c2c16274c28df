"""Variable projection: a pulse fitted in its two time constants, everything else solved for.

.. math::

    v = OCV + s x + b_2 x^2 + b_3 x^3 + b_4 x^4
        - R_0 I - R_1 u_1 - R_2 u_2 - V_{10} e_1 - V_{20} e_2

with x the SOC minus the pulse's mean SOC, u_j the response of a branch of one ohm (exact for
current that is constant over an interval) and e_j the decay of what the branch held at the start.
Only tau1 and tau2 enter nonlinearly; at given time constants the rest is a small linear problem
with R >= 0 (Golub and Pereyra, doi:10.1137/0710036). The slope s is what keeps a pulse at the ends
of the SOC range from bending tau2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.pulse_fit.fit_errors import (
    profile_errors,
    residual_statistics,
    standard_errors,
)
from cellwise.identify.pulse_fit.pulse_data import PulseData, Weighting
from cellwise.identify.pulse_fit.pulse_parameters import (
    PulseFit,
    PulseParameters,
    PulseTrend,
    TauBounds,
)
from cellwise.identify.pulse_fit.pulse_problem import (
    Problem,
    Solution,
    build_problem,
    log_limits,
    window_tau_bounds,
)
from cellwise.identify.pulse_fit.varpro_kernels import BENDS, LINEAR
from cellwise.identify.pulse_fit.varpro_search import (
    TIGHT,
    descend,
    search,
    thinned,
)
from cellwise.typing import FloatArray

# A further unknown stays when it lowers the sum of squares by this many residual variances per
# independent residual: 3.5 standard errors.
CLEAR_GAIN = 12.0
# Over less SOC than this an OCV does not bend; what looks like it is some other nonlinearity.
BEND_SWING = 0.006
# After five time constants a branch holds less than a hundredth of what it held. Rests shorter
# than the second figure are looked at in any case.
RESTED_TAUS = 5.0
SHORT_REST_S = (20.0, 300.0)
AT_BOUND = 1e-6  # in log tau

_SLOPE, _R0, _R1, _R2, _V1, _V2 = 1, 2, 3, 4, 8, 9


@dataclass(frozen=True)
class VarproOptions:
    """Choices of the fit; the defaults suit any pulse.

    Parameters
    ----------
    weighting : str           see `row_weights`
    tau : TauBounds or None   by default from the window, see `window_tau_bounds`
    bends : "auto", 0 to 3    powers of the OCV inside the pulse beyond its slope; ``auto`` keeps
                              those that the residual calls for
    initial : "auto" or bool  fit what the branches held at the window's start; ``auto`` does after
                              a short rest, if the residual calls for it
    """

    weighting: Weighting = "balanced"
    tau: TauBounds | None = None
    bends: Literal["auto", 0, 1, 2, 3] = "auto"
    initial: Literal["auto"] | bool = "auto"

    def __post_init__(self) -> None:
        if self.bends not in ("auto", 0, 1, 2, 3) or self.initial not in ("auto", True, False):
            raise InputError(
                f"bends = {self.bends!r}, initial = {self.initial!r}",
                "bends 'auto' or 0 to 3; initial 'auto', True or False",
                "Choose one of these.",
            )


def fit_varpro(
    data: PulseData,
    options: VarproOptions | None = None,
    trend: PulseTrend | None = None,
    start_tau_s: tuple[float, float] | None = None,
) -> PulseFit:
    """Fit one pulse and its relaxation by variable projection.

    Parameters
    ----------
    data : PulseData
    options : VarproOptions
    trend : PulseTrend        change of the parameters with SOC, from neighbouring pulses
    start_tau_s : (2,) float  time constants to start from [s]; by default a grid is searched

    Returns
    -------
    PulseFit

    Raises
    ------
    InputError        bounds that leave no room, too few settled rows
    """
    options = options or VarproOptions()
    trend = trend or PulseTrend()
    problem = build_problem(data, options.weighting, trend)
    limits = log_limits(options.tau or window_tau_bounds(data))
    include = np.zeros(LINEAR, dtype=np.bool_)
    include[[0, _R0, _R1, _R2]] = True
    include[_SLOPE] = data.ocv_change_V is None
    start = None if start_tau_s is None else np.log(np.array(start_tau_s, dtype=np.float64))
    few = thinned(problem)
    found = search(few, include, limits, start)
    found = _with_initial(few, limits, found, options, data.rest_before_window_s)
    found = _with_bends(few, limits, found, options)
    solution = descend(problem, found.include, limits, found.log_tau, TIGHT)
    fit = describe(data, problem, solution, limits, trend, "varpro")
    return replace(fit, error=profile_errors(few, found, limits, fit.value, fit.error))


def _with_initial(
    problem: Problem, limits: FloatArray, plain: Solution, options: VarproOptions, rest_s: float
) -> Solution:
    """Add what the branches held at the start where the rest before was too short to forget it."""
    if options.initial is False:
        return plain
    tau = np.exp(plain.log_tau)
    remembered = rest_s < np.maximum(RESTED_TAUS * tau, SHORT_REST_S)
    include = plain.include.copy()
    include[[_V1, _V2]] = True if options.initial is True else remembered
    if not include[_V2]:
        return plain
    richer = search(problem, include, limits, None)
    return _choose(problem, plain, richer, options.initial is True)


def _with_bends(
    problem: Problem, limits: FloatArray, plain: Solution, options: VarproOptions
) -> Solution:
    """Add powers of the OCV inside the pulse, one after the other, while they are worth it."""
    wanted = BENDS if options.bends == "auto" else options.bends
    if options.bends == "auto" and np.ptp(problem.dq) < BEND_SWING:
        return plain
    for power in range(wanted):
        include = plain.include.copy()
        include[5 + power] = True
        richer = search(problem, include, limits, plain.log_tau)
        chosen = _choose(problem, plain, richer, options.bends != "auto")
        if not chosen.include[5 + power]:
            return chosen
        plain = chosen
    return plain


def _choose(problem: Problem, plain: Solution, richer: Solution, forced: bool) -> Solution:
    """The richer model where it is asked for or where the residual calls for it."""
    memory = residual_statistics(problem, richer).rows_per_residual
    independent = np.count_nonzero(problem.weight) / memory
    unknowns = np.count_nonzero(richer.include) - np.count_nonzero(plain.include)
    gain = (plain.cost - richer.cost) * independent
    return richer if forced or gain > CLEAR_GAIN * unknowns * richer.cost else plain


def describe(
    data: PulseData,
    problem: Problem,
    solution: Solution,
    limits: FloatArray,
    trend: PulseTrend,
    method: str,
) -> PulseFit:
    """A solution as a `PulseFit`: values, standard errors, bounds reached, notes."""
    statistics = residual_statistics(problem, solution)
    error, condition = standard_errors(problem, solution, statistics)
    c = solution.coefficients
    tau1, tau2 = np.exp(solution.log_tau)
    ocv, slope = c[0] + problem.reference_V, c[_SLOPE]
    if data.ocv_change_V is not None:
        before, last = max(data.start - 1, 0), data.stop - 1
        change = data.ocv_change_V
        order = np.argsort(problem.dq, kind="stable")
        ocv += float(np.interp(problem.centre, problem.dq[order], change[order]))
        moved = problem.dq[last] - problem.dq[before]
        slope = (change[before] - change[last]) / moved if moved != 0.0 else 0.0
    value = PulseParameters(c[_R0], c[_R1], tau1, c[_R2], tau2, ocv, slope)
    return PulseFit(
        method=method,
        soc=data.soc,
        current_A=data.pulse_current_A,
        duration_s=data.pulse_duration_s,
        window_s=float(data.time_s[-1] - data.time_s[0]),
        value=PulseParameters(*(float(v) for v in value)),
        error=PulseParameters(*(float(e) for e in error)),
        rmse_V=statistics.rmse_V,
        noise_V=statistics.noise_V,
        rows=len(data),
        left_out=int(np.count_nonzero(problem.weight == 0.0)),
        rows_per_residual=statistics.rows_per_residual,
        condition=condition,
        at_bound=_at_bound(solution, limits),
        ocv_bends_V=(float(c[5]), float(c[6]), float(c[7])),
        v1_start_V=float(c[_V1]),
        v2_start_V=float(c[_V2]),
        trend=trend,
        passes=solution.passes,
        converged=solution.converged,
    )


def _at_bound(solution: Solution, limits: FloatArray) -> tuple[str, ...]:
    """Names of the parameters that a bound holds."""
    c, (fast, slow) = solution.coefficients, solution.log_tau
    held = {
        "r0_ohm": c[_R0] <= 0.0,
        "r1_ohm": c[_R1] <= 0.0,
        "tau1_s": fast <= limits[0] + AT_BOUND or fast >= limits[1] - AT_BOUND,
        "r2_ohm": c[_R2] <= 0.0,
        "tau2_s": slow <= limits[2] + AT_BOUND or slow >= limits[3] - AT_BOUND,
        "ocv_slope_V": solution.include[_SLOPE] and c[_SLOPE] <= 0.0,
    }
    if slow - fast <= limits[4] + AT_BOUND:
        held["tau1_s"] = held["tau2_s"] = True
    return tuple(name for name, at in held.items() if at)

"""SOC at a log's first row when nobody says it: a rest's OCV, else the one fit, asked from starts.

The model is the prior of that fit: its OCV and tables may be off by what it states of itself, and
the branches hold what a past like the log's own load leaves. From each start of a grid these are
fitted to the rows; a start is as probable as the marginal likelihood that the fit reaches there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.cell.description import BRANCHES
from cellwise.cell.effects import Hysteresis, SurfaceSoc
from cellwise.cell.model import CellModel, branch_table
from cellwise.cell.plausibility.notice import stated_error_V
from cellwise.cell.simulate import check_soc0, known_temperature_C, simulate
from cellwise.fit.beginnings import TRIALS, thinned
from cellwise.fit.population import ModelPrior, prior_of, temperatures_of
from cellwise.fit.problem import Problem
from cellwise.fit.rest import EVERY_SOC, REST_RATE, SHORT_REST_V, rest_ocv, soc_of_ocv
from cellwise.fit.rows import FitLog
from cellwise.fit.solver import Prior
from cellwise.fit.unknowns import FitSettings, layout_of
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import uncounted_pauses
from cellwise.threads import one_blas_thread
from cellwise.typing import FloatArray

LEAST_PAST_V = 0.002  # and what no branch of a model knows
STATED_STD = 0.005  # a start that is known: full and empty of two tests differ by about this


class Asked(NamedTuple):
    """How a log is asked where it begins.

    Parameters
    ----------
    step, finest : float    of SOC between two starts; about the likeliest down to this
    rows, steps : int       compared rows at most, steps of Gauss and Newton from a neighbour's
    weight : float          of the log's evidence: a model is wrong in more than its tables
    first_s, starts : float, int      of a load, for what works online; so many starts over 0..1
    other_resistance : float      share of a used cell's resistances, which so little does not show
    past_s : float          an unknown past is taken to be like so much of the load [s]
    least_rate : float      and like so much of the capacity at least [1/h]: a day's use
    slack : float           how far a counter and a capacity may run beyond full or empty [SOC]
    sure, deviations : float      a rest is enough if it says as much, and so many from full, empty
    """

    step: float = 0.05
    finest: float = 0.004
    rows: int = 400
    steps: int = 2
    weight: float = 0.25
    first_s: float = 60.0
    starts: int = 51
    other_resistance: float = 0.3
    past_s: float = 600.0
    least_rate: float = 0.1
    slack: float = 0.03
    sure: float = 0.02
    deviations: float = 3.0


ASKED = Asked()


@dataclass(frozen=True)
class InitialSoc:
    """SOC at the first row, its standard deviation, and how it was found.

    ``beginning`` is what the first rows alone say, where all of the log was asked; else None. A fit
    of the whole log takes the model for right, the beginning's rest or minute hardly does.
    """

    soc: float
    std: float
    how: str
    beginning: InitialSoc | None = None

    def to_dict(self) -> dict[str, float | str]:
        """As JSON values."""
        return {"value": self.soc, "std": self.std, "how": self.how}


def initial_soc(
    model: CellModel,
    log: CellLog,
    given: float | None = None,
    given_std: float = 0.15,
    *,
    whole_log: bool = False,
) -> InitialSoc:
    """SOC at the first row of a log.

    Taken as given, else as the log states it (`CellLog.soc0`); else from the voltage of a rest at
    the log's start through the OCV; else from the log's first minute. Where that leaves more than
    two points open, ``whole_log`` asks all of the log.

    Parameters
    ----------
    given : float or None     SOC that the user states, 0..1
    given_std : float         how sure that is
    whole_log : bool          use the whole log where its beginning leaves it open (a plateau, a
                              load): not for what claims to work online

    Returns
    -------
    InitialSoc        the standard deviation includes the model's own voltage error, an unfinished
                      relaxation and a flat OCV: on a plateau it is large
    """
    if given is not None:
        return InitialSoc(check_soc0(given), given_std, "given")
    if log.soc0 is not None:
        return InitialSoc(log.soc0, STATED_STD, "stated")
    rested = _rested(model, log)
    beginning = rested or _first_minute(model, log)
    if not whole_log or (rested is not None and _is_enough(rested)):
        return beginning
    # After a pause that nobody counted another start may hold.
    rows = min((len(log), *uncounted_pauses(log)))
    if np.count_nonzero(np.isfinite(log.voltage_V[:rows])) < 2:
        return beginning
    log = log.part(0, rows)
    soc, std = likeliest(*weighed_starts(model, log, also=(beginning.soc,)))
    how = f"fit of the whole log, {log.duration_s / 3600.0:.2f} h"
    return InitialSoc(soc, max(std, STATED_STD), how, beginning)


def _is_enough(rested: InitialSoc) -> bool:
    """Whether a rest is sure of a SOC that is neither full nor empty."""
    inside = min(rested.soc, 1.0 - rested.soc)
    return rested.std <= min(ASKED.sure, inside / ASKED.deviations)


def _rested(model: CellModel, log: CellLog) -> InitialSoc | None:
    """By a rest at the log's start; None where there is none."""
    current = log.known_current_A()
    resting = np.abs(current) < REST_RATE * model.capacity_Ah
    resting[: int(np.argmax(np.isfinite(log.interval_current_A)))] = False  # nobody knows
    rest_end = len(log) if resting.all() else int(np.argmin(resting))
    measured = np.flatnonzero(np.isfinite(log.voltage_V[:rest_end]))
    # One row without current is no rest: a car at a light has come from a load. A rest lasts.
    if not measured.size or (log.time_s[measured[-1]] == log.time_s[0] and rest_end < len(log)):
        return None
    warm = float(known_temperature_C(model, log)[measured[-1]])
    seen_V = log.voltage_V[measured]
    use = slice(rest_end, _load_end(log, rest_end))
    load = log.interval_s[use], current[use]
    found = rest_ocv(model, log.time_s[measured], seen_V, warm, load)
    soc, std = soc_of_ocv(model, found.ocv_V, found.std_V, warm)
    rest_s = log.time_s[measured[-1]] - log.time_s[0]
    return InitialSoc(
        soc, max(std, STATED_STD), f"rest of {rest_s:.0f} s at the start, {seen_V[-1]:.4f} V"
    )


def _load_end(log: CellLog, first: int) -> int:
    """The row that ends the first minutes of load, which an unknown past is taken to be like."""
    if first >= len(log):
        return first
    return int(np.searchsorted(log.time_s, log.time_s[first] + ASKED.past_s, side="right"))


def _first_minute(model: CellModel, log: CellLog) -> InitialSoc:
    """By the first minute under load, from its first voltage on: its mean error says one thing.

    The error is known beforehand as what the model states of itself there, what so little does not
    show of a used cell's resistances, and what an unknown past has left.
    """
    first = int(np.argmax(np.isfinite(log.voltage_V)))
    end = int(np.searchsorted(log.time_s, log.time_s[first] + ASKED.first_s, side="right"))
    head = log.part(0, min(max(first + 2, end), len(log)))
    tried = np.linspace(0.0, 1.0, ASKED.starts)
    runs = [simulate(model, head, float(s)) for s in tried]
    away_V = np.interp(EVERY_SOC, tried, [float(np.nanmean(run.residual_V)) for run in runs])
    held_V, _ = _past_V(model, head)
    away_V += held_V[-1]
    near = runs[round(float(EVERY_SOC[np.argmin(np.abs(away_V))]) * (ASKED.starts - 1))]
    stated_V = stated_error_V(
        model, head, near.soc, near.voltage_V, other_resistance=ASKED.other_resistance
    )
    tau_s = [float(np.median(branch_table(model, "tau", s))) for s in BRANCHES]
    left_V = held_V * np.exp(-head.duration_s / np.array(tau_s))
    known_V2 = float(np.mean(stated_V**2)) + near.rmse_V**2
    variance = known_V2 + SHORT_REST_V**2 + float(left_V @ left_V)
    soc, std = likeliest(EVERY_SOC, -0.5 * away_V**2 / variance)
    how = f"fit of the first {head.duration_s:.0f} s under load"
    return InitialSoc(soc, max(std, 2.0 * STATED_STD), how)


def likeliest(soc: FloatArray, ln: FloatArray) -> tuple[float, float]:
    """The likeliest of some starts, ascending, and the standard deviation about it."""
    weight = np.exp(ln - ln.max()) * np.gradient(soc)
    best = float(soc[np.argmax(ln)])
    return best, math.sqrt(float(np.average((soc - best) ** 2, weights=weight)))


@one_blas_thread
def weighed_starts(
    model: CellModel, log: CellLog, also: tuple[float, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Starts that were tried, ascending, and ln of their marginal likelihood, trusted.

    Parameters
    ----------
    also : floats       tried besides, where the log's charge leaves them possible
    """
    thin = thinned(log)
    problem, prior = _problem(model, thin)
    # The means begin where the first of them ends.
    used = log.counted_charge_Ah() / model.capacity_Ah
    before = float(np.interp(thin.time_s[0], log.time_s, used))
    low, high = _possible(used)
    place, fitted, likely = problem.layout.start, dict[float, FloatArray](), dict[float, float]()

    def ask(soc: float) -> None:
        """The fit from one start, beginning where that of its neighbour ended."""
        near = min(fitted, key=lambda s: abs(s - soc), default=None)
        theta = (prior.mean if near is None else fitted[near]).copy()
        theta[place] = soc - before - problem.logs[0].item.soc0
        problem.prior = prior.held(place, float(theta[place]))
        theta = problem.inside(theta)
        problem.judge_sizes(theta)
        fitted[soc], *_ = problem.minimise(theta, ASKED.steps)
        evidence = problem.log_evidence(problem.normal_equations(fitted[soc]))
        likely[soc] = TRIALS.trust * evidence

    tried = np.linspace(low, high, 2 + int((high - low) / ASKED.step))
    tried = np.union1d(tried, [s for s in also if low <= s <= high])
    for _ in range(2):  # by what rows may be off at first, then as the likeliest start leaves them
        if likely:
            theta = fitted[max(likely, key=lambda s: likely[s])]
            problem.judge(theta, problem.residuals(theta))
        for soc in tried:
            ask(float(soc))
    step = float(np.max(np.diff(tried)))
    while step > ASKED.finest:
        best, step = max(likely, key=lambda s: likely[s]), 0.5 * step
        for soc in (best - step, best + step):
            if low <= soc <= high and soc not in likely:
                ask(soc)
    order = sorted(likely)
    return np.array(order), np.array([likely[s] for s in order])


def _possible(used: FloatArray) -> tuple[float, float]:
    """Between which starts the log stays within empty and full, as far as a counter knows."""
    low = min(max(0.0, float(used.max()) - ASKED.slack), 1.0 - ASKED.slack)
    return low, max(min(1.0, 1.0 + float(used.min()) + ASKED.slack), low + ASKED.slack)


def _problem(model: CellModel, log: CellLog) -> tuple[Problem, Prior]:
    """The fit of the log, and its prior, in which the start may be anywhere."""
    warm = known_temperature_C(model, log)
    item = FitLog(
        log, 0.5, 1.0, weight=ASKED.weight, temperature_C=float(warm[0]),
        surface=model.effect(SurfaceSoc),
    )  # fmt: skip
    grid = temperatures_of(model, warm)
    hysteresis = any(isinstance(e, Hysteresis) for e in model.effects)
    lay = layout_of(len(BRANCHES), hysteresis, int(grid.size))
    cells, settings = ModelPrior(model), FitSettings(hysteresis=hysteresis)
    prior = prior_of(cells, lay, (item,), model.capacity_Ah, grid, float(grid[0]), settings)
    mean, std = _past_V(model, log)
    held = slice(lay.past, lay.past + lay.branches)
    prior.mean[held], prior.free[held] = mean, True
    prior.precision[held, held] = np.diag(std**-2.0)
    problem = Problem(
        (item,), cells.base(), prior, lay, model.capacity_Ah, grid, float(grid[0]), ASKED.rows
    )
    low, high = (np.array(end) for end in (problem.prior.low, problem.prior.high))
    low[lay.start], high[lay.start] = -1.0, 1.0
    return problem, replace(prior, low=low, high=high)


def _past_V(model: CellModel, log: CellLog) -> tuple[FloatArray, FloatArray]:
    """What the branches hold at first: around half of the load's own, and all of that [V]."""
    cell = model.at_temperature(float(known_temperature_C(model, log)[0]))
    ohm = np.array([float(np.median(branch_table(cell, "r", s))) for s in BRANCHES])
    current = log.known_current_A()
    first = int(np.argmax(np.abs(current) > REST_RATE * model.capacity_Ah))
    mean_A = float(np.mean(current[first : max(_load_end(log, first), first + 1)]))
    size_A = max(abs(mean_A), ASKED.least_rate * model.capacity_Ah)
    return 0.5 * mean_A * ohm, size_A * ohm + LEAST_PAST_V

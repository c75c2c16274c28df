"""The likeliest SOC at the first row: the rows simulated from every start, and weighed together."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import announce, for_kernel, inline, rows
from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    at_rest,
    seen_current,
    voltage_of,
)
from cellwise.cell.initial_soc.rest import RELAXED_S, REST_RATE, SHORT_REST_V
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import stated_error_V
from cellwise.cell.simulate import known_temperature_C, simulate, start_hysteresis
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray


class Starts(NamedTuple):
    """SOC and hysteresis state of rested starts, shape (m,) each."""

    soc: FloatArray
    h: FloatArray


class WeighedRows(NamedTuple):
    """Rows of a log, (n,) each, as `simulate_rows` takes them; a voltage may be NaN.

    The weights sum to one over the voltages; ``past`` is what share of an unknown past remains.
    """

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    voltage_V: FloatArray
    weight: FloatArray
    past: FloatArray


class StartSums(NamedTuple):
    """Of every start, (m,): means over the rows, and how far SOC left 0..1, in deviations.

    Means of the squared error, and of the error times what remains of the past.
    """

    squares_V2: FloatArray
    products_V: FloatArray
    beyond: FloatArray


class Past(NamedTuple):
    """What the slow states may hold at the first row: mean and standard deviation [V]."""

    mean_V: float
    std_V: float


PAST_S = 600.0  # load that an unknown past is taken to be like [s]
# How far a counter may run beyond full or empty: at once, and of all that it has moved. Testers'
# counters are up to a hundredth of what they moved off after a discharge and a charge.
BEYOND, DRIFT = 0.01, 0.01
COARSE, FINE = 51, 41  # starts tried over 0..1, then around the likeliest
NORMAL = np.linspace(-3.0, 3.0, 25)  # of an unknown past, in deviations


@inline
def rested(starts: Starts, k: int) -> CellState:
    """One of the starts as a state."""
    return at_rest(starts.soc[k], starts.h[k])


@rows
def sum_errors(tables: CellTables, starts: Starts, log: WeighedRows, sums: StartSums) -> None:
    """Weighed sums of the voltage error from every rested start, added to ``sums``."""
    for k in range(starts.soc.size):
        state = rested(starts, k)
        previous = log.current_A[0]
        moved = 0.0
        for i in range(log.interval_s.size):
            soc = state.soc
            seen = seen_current(tables.cell, log.current_A[i], previous, log.interval_s[i])
            previous = log.current_A[i]
            state, point = advance(tables, state, seen, log.interval_s[i], log.temperature_C[i])
            moved += abs(state.soc - soc)
            outside = max(state.soc - 1.0, -state.soc) / (BEYOND + DRIFT * moved)
            sums.beyond[k] = max(sums.beyond[k], outside)
            error = log.voltage_V[i] - voltage_of(point, state, seen)
            if error == error:  # not NaN
                sums.squares_V2[k] += log.weight[i] * error * error
                sums.products_V[k] += log.weight[i] * error * log.past[i]


def likeliest_soc(
    model: CellModel,
    log: CellLog,
    past: Past,
    before: Callable[[FloatArray], FloatArray] | None = None,
    *,
    other_resistance: float = 0.0,
    candidates: tuple[float, ...] = (),
) -> tuple[float, float]:
    """The likeliest initial SOC of a log with at least two voltages, and its standard deviation.

    Parameters as of `ln_likelihood_of_starts`; ``candidates`` are tried besides full, empty and the
    grid: what is found is at least as likely as each of them.
    """
    step = 1.0 / (COARSE - 1)
    tried = np.union1d(np.linspace(0.0, 1.0, COARSE), candidates)
    of_starts = partial(
        ln_likelihood_of_starts, model, log, past, before, other_resistance=other_resistance
    )
    best = float(tried[np.argmax(of_starts(tried))])
    soc = np.union1d(tried, np.linspace(max(0.0, best - step), min(1.0, best + step), FINE))
    likely = of_starts(soc)
    weight = np.exp(likely - likely.max()) * np.gradient(soc)
    likeliest = float(soc[np.argmax(likely)])
    return likeliest, math.sqrt(float(np.average((soc - likeliest) ** 2, weights=weight)))


def ln_likelihood_of_starts(
    model: CellModel,
    log: CellLog,
    past: Past,
    before: Callable[[FloatArray], FloatArray] | None,
    soc0: FloatArray,
    *,
    other_resistance: float = 0.0,
) -> FloatArray:
    """Ln likelihood of a log's voltages from every start, (m,); a constant is left out.

    A minute is one independent error, a log over the whole SOC range two, since one OCV and one
    resistance are wrong everywhere. Its size is what the model states of itself along the log, and
    what the best fit leaves. A row counts by the charge that it moves, an hour of rest as one at
    C/100. What an unknown past left in the slow states is a voltage that fades, integrated over its
    normal distribution.

    Parameters
    ----------
    before : callable or None       ln likelihood of starts by what is known besides: a rest's OCV
    soc0 : (m,) float               one of them is taken to be near the truth
    other_resistance : float        share by which the cell's resistance may differ, where the log
                                    is too short to show it
    """
    rows_ = _weighed(model, log)
    squares, products, beyond = (np.zeros(soc0.size) for _ in range(3))
    announce(sum_errors, "the initial SOC")
    starts = Starts(soc0, np.array([start_hysteresis(s) for s in soc0]))
    sum_errors(model.parameters(), starts, rows_, StartSums(squares, products, beyond))
    gap_V = float(np.max(np.abs(np.asarray(model.effect(Hysteresis).m_V))))
    shift = past.mean_V + NORMAL[:, None] * math.hypot(past.std_V, gap_V)
    left = float(np.sum(rows_.weight * rows_.past**2))
    size_V2 = np.maximum(squares - 2.0 * shift * products + shift**2 * left, 0.0)
    unlikely = NORMAL[:, None] ** 2 + beyond**2
    least = np.unravel_index(np.argmin(size_V2 + size_V2.min() * unlikely), size_V2.shape)
    nearest = simulate(model, log, float(soc0[least[1]]))
    stated_V = stated_error_V(
        model, log, nearest.soc, nearest.voltage_V, other_resistance=other_resistance
    )
    variance = float(size_V2[least]) + float(np.sum(rows_.weight * stated_V**2))
    errors = (1.0 + min(float(np.ptp(nearest.soc)), 1.0)) * size_V2 / variance
    own = np.asarray(np.logaddexp.reduce(-0.5 * (errors + unlikely), axis=0))
    return own if before is None else own + before(soc0)


def _weighed(model: CellModel, log: CellLog) -> WeighedRows:
    current = log.known_current_A()
    voltage = for_kernel(log.voltage_V)
    weight = (np.abs(current) / model.capacity_Ah + REST_RATE) * log.interval_s
    # The first row has no interval, and is all that a log of one moment has.
    weight = np.where(np.isfinite(voltage), weight + REST_RATE, 0.0)
    past = np.exp(-(log.time_s - log.time_s[0]) / RELAXED_S)
    warm = known_temperature_C(model, log)
    return WeighedRows(log.interval_s, current, warm, voltage, weight / weight.sum(), past)


def past_voltage(model: CellModel, log: CellLog) -> Past:
    """What the slow states may hold of a past that was like the first minutes of the log.

    Between nothing (the load has just begun) and all of it: the middle, and half of the range. In
    a log of moments the fast branches, too, are not known.
    """
    cell = model.at_temperature(float(known_temperature_C(model, log)[0]))
    slow_ohm = float(np.median(np.asarray(cell.effect(SlowDiffusion).r3_ohm)))
    fast_ohm = sum(
        float(np.median(ohm)) * math.exp(-log.duration_s / float(np.median(tau_s)))
        for ohm, tau_s in ((cell.r1_ohm, cell.tau1_s), (cell.r2_ohm, cell.tau2_s))
    )
    early = log.time_s <= log.time_s[0] + PAST_S
    mean_A = float(np.mean(log.known_current_A()[early]))
    full_V = -slow_ohm * mean_A
    return Past(0.5 * full_V, math.hypot(SHORT_REST_V, 0.5 * full_V, 0.5 * fast_ohm * mean_A))

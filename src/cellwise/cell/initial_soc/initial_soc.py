"""SOC at a log's first row when nobody says it: a rest, a short fit, or the whole log.

The likeliest start: the rows simulated from every start, and weighed together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import announce, for_kernel, rows
from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.equations import (
    CellTables,
    advance,
    at_rest,
    delayed_current,
    voltage_of,
)
from cellwise.cell.initial_soc.padding import padded_rows
from cellwise.cell.initial_soc.rest import (
    RELAXED_S,
    REST_RATE,
    SHORT_REST_V,
    ln_likelihood_of_ocv,
    rest_ocv,
    soc_of_ocv,
)
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import stated_error_V
from cellwise.cell.simulate import (
    check_soc0,
    known_temperature_C,
    simulate,
    start_hysteresis,
)
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import uncounted_pauses
from cellwise.typing import FloatArray

STATED_STD = 0.005  # a start that is known: full and empty of two tests differ by about this


class Looked(NamedTuple):
    """How much of a log is asked where it begins.

    Under load the first ``fit_s``, which cannot show by how much a used cell's ``resistance``
    differs from its model's; of a very long log ``rows``. A rest that is surer than ``sure``, and
    likelier than full and empty, is enough.
    """

    fit_s: float = 60.0
    resistance: float = 0.3
    sure: float = 0.02
    rows: int = 400_000


LOOKED = Looked()


@dataclass(frozen=True)
class InitialSoc:
    """SOC at the first row, its standard deviation, and how it was found.

    ``soc`` is a fraction, ``std`` the deviation of it. ``beginning`` is what the first rows alone
    say, where all of the log was asked; else None. A fit of the whole log takes the model for
    right, the beginning's rest or minute hardly does.
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
    the log's start through the OCV; else from the SOC at which the simulation fits the log's first
    minute best. Where that leaves more than two points open, ``whole_log`` asks all of the log.

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
    if skipped := padded_rows(model, log):
        behind = initial_soc(model, log.part(skipped, len(log)), whole_log=whole_log)
        return _before(model, log, skipped, behind)
    current = log.known_current_A()
    resting = np.abs(current) < REST_RATE * model.capacity_Ah
    resting[: int(np.argmax(np.isfinite(log.interval_current_A)))] = False  # nobody knows
    rest_end = len(log) if resting.all() else int(np.argmin(resting))
    measured = np.flatnonzero(np.isfinite(log.voltage_V[:rest_end]))
    last = int(measured[-1]) if measured.size else 0
    rest_s = float(log.time_s[last] - log.time_s[0])
    # One row without current is no rest: a car at a light has come from a load. A rest lasts.
    if measured.size and (rest_s > 0.0 or rest_end == len(log)):
        temperature_C = float(known_temperature_C(model, log)[last])
        seen_V = log.voltage_V[measured]
        use = slice(rest_end, _load_end(log, rest_end))
        load = log.interval_s[use], current[use]
        rested_V, unfinished, moves = rest_ocv(
            model, log.time_s[measured], seen_V, temperature_C, load
        )
        soc, std = soc_of_ocv(model, rested_V, unfinished, temperature_C)
        how = f"rest of {rest_s:.0f} s at the start, {seen_V[-1]:.4f} V"
        found = InitialSoc(soc, max(std, 0.005), how)
        if not whole_log:
            return found

        def by_rest(soc0: FloatArray) -> FloatArray:
            return ln_likelihood_of_ocv(model, soc0, rested_V, unfinished, temperature_C)

        return _from_whole_log(model, log, found, UnknownPast(-moves, unfinished), by_rest)
    # The first minute, from its first voltage on.
    first = int(np.argmax(np.isfinite(log.voltage_V)))
    end = int(np.searchsorted(log.time_s, log.time_s[first] + LOOKED.fit_s, side="right"))
    head = log.part(0, min(max(first + 2, end), len(log)))
    past = past_voltage(model, head)
    soc, std = likeliest_soc(model, head, past, other_resistance=LOOKED.resistance)
    how = f"fit of the first {head.duration_s:.0f} s under load"
    found = InitialSoc(soc, max(std, 0.01), how)
    return _from_whole_log(model, log, found, past_voltage(model, log)) if whole_log else found


def _before(model: CellModel, log: CellLog, rows: int, behind: InitialSoc) -> InitialSoc:
    """The SOC at the first row from which counting comes to a start behind some rows."""
    moved = log.known_current_A()[1 : rows + 1] @ log.interval_s[1 : rows + 1]
    soc = min(max(behind.soc + float(moved) / (3600.0 * model.capacity_Ah), 0.0), 1.0)
    how = f"{behind.how}, behind {rows} rows that are no measurement"
    return InitialSoc(soc, behind.std, how, behind.beginning)


def _load_end(log: CellLog, first: int) -> int:
    """The row that ends the first minutes of load, which an unknown past is taken to be like."""
    if first >= len(log):
        return first
    return int(np.searchsorted(log.time_s, log.time_s[first] + PAST_S, side="right"))


def _from_whole_log(
    model: CellModel,
    log: CellLog,
    beginning: InitialSoc,
    past: UnknownPast,
    by_rest: Callable[[FloatArray], FloatArray] | None = None,
) -> InitialSoc:
    # After a pause that nobody counted another start may hold.
    rows = min((len(log), LOOKED.rows, *uncounted_pauses(log)))
    if np.count_nonzero(np.isfinite(log.voltage_V[:rows])) < 2:
        return beginning
    log = log.part(0, rows)
    if by_rest is not None and beginning.std <= LOOKED.sure:
        ends = np.array([beginning.soc, 0.0, 1.0])
        if np.argmax(ln_likelihood_of_starts(model, log, past, by_rest, ends)) == 0:
            return beginning
    soc, std = likeliest_soc(model, log, past, by_rest, candidates=(beginning.soc,))
    how = f"fit of the whole log, {log.duration_s / 3600.0:.2f} h"
    return InitialSoc(soc, max(std, STATED_STD), how, beginning)


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


class UnknownPast(NamedTuple):
    """What the slow states may hold at the first row: mean and standard deviation [V]."""

    mean_V: float
    std_V: float


PAST_S = 600.0  # load that an unknown past is taken to be like [s]
# How far a counter may run beyond full or empty: at once, and of all that it has moved. Testers'
# counters are up to a hundredth of what they moved off after a discharge and a charge.
BEYOND, DRIFT = 0.01, 0.01
COARSE, FINE = 51, 41  # starts tried over 0..1, then around the likeliest
NORMAL = np.linspace(-3.0, 3.0, 25)  # of an unknown past, in deviations


@rows
def sum_errors(
    tables: CellTables, soc0: FloatArray, h0: FloatArray, log: WeighedRows, sums: FloatArray
) -> None:
    """Of every rested start, (m,): what its voltage error adds to ``sums``, (3, m).

    Means over the rows of the squared error and of the error times what remains of the past; how
    far SOC left 0..1, in deviations.
    """
    for k in range(soc0.size):
        state = at_rest(soc0[k], h0[k])
        previous = log.current_A[0]
        moved = 0.0
        for i in range(log.interval_s.size):
            soc = state.soc
            delayed_A = delayed_current(tables.cell, log.current_A[i], previous, log.interval_s[i])
            previous = log.current_A[i]
            state, point = advance(
                tables, state, delayed_A, log.interval_s[i], log.temperature_C[i]
            )
            moved += abs(state.soc - soc)
            outside = max(state.soc - 1.0, -state.soc) / (BEYOND + DRIFT * moved)
            sums[2, k] = max(sums[2, k], outside)
            error = log.voltage_V[i] - voltage_of(point, state, delayed_A)
            if error == error:  # not NaN
                sums[0, k] += log.weight[i] * error * error
                sums[1, k] += log.weight[i] * error * log.past[i]


def likeliest_soc(
    model: CellModel,
    log: CellLog,
    past: UnknownPast,
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
    of_starts = partial(_ln_likelihood, model, log, past, before, other_resistance)
    tried = np.union1d(np.linspace(0.0, 1.0, COARSE), candidates)
    sums = _sums_of_errors(model, log, tried)
    best = float(tried[np.argmax(of_starts(tried, sums))])
    near = np.linspace(max(0.0, best - step), min(1.0, best + step), FINE)
    near = np.setdiff1d(near, tried)
    soc = np.concatenate((tried, near))
    order = np.argsort(soc)
    soc, sums = soc[order], np.hstack((sums, _sums_of_errors(model, log, near)))[:, order]
    likely = of_starts(soc, sums)
    weight = np.exp(likely - likely.max()) * np.gradient(soc)
    likeliest = float(soc[np.argmax(likely)])
    return likeliest, math.sqrt(float(np.average((soc - likeliest) ** 2, weights=weight)))


def ln_likelihood_of_starts(
    model: CellModel,
    log: CellLog,
    past: UnknownPast,
    before: Callable[[FloatArray], FloatArray] | None,
    soc0: FloatArray,
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
    """
    sums = _sums_of_errors(model, log, soc0)
    return _ln_likelihood(model, log, past, before, 0.0, soc0, sums)


def _sums_of_errors(model: CellModel, log: CellLog, soc0: FloatArray) -> FloatArray:
    """What `sum_errors` finds of every start, (3, m)."""
    h0 = np.array([start_hysteresis(s) for s in soc0])
    sums = np.zeros((3, soc0.size))
    announce(sum_errors, "the initial SOC")
    sum_errors(model.parameters(), soc0, h0, _weighed(model, log), sums)
    return sums


def _ln_likelihood(
    model: CellModel,
    log: CellLog,
    past: UnknownPast,
    before: Callable[[FloatArray], FloatArray] | None,
    other_resistance: float,
    soc0: FloatArray,
    sums: FloatArray,
) -> FloatArray:
    """See `ln_likelihood_of_starts`."""
    rows_ = _weighed(model, log)
    squares, products, beyond = sums
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
    temperature_C = known_temperature_C(model, log)
    return WeighedRows(log.interval_s, current, temperature_C, voltage, weight / weight.sum(), past)


def past_voltage(model: CellModel, log: CellLog) -> UnknownPast:
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
    return UnknownPast(
        0.5 * full_V, math.hypot(SHORT_REST_V, 0.5 * full_V, 0.5 * fast_ohm * mean_A)
    )

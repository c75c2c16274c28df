"""SOC at a log's first row when nobody says it: a rest, a short fit, or the whole log."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import announce
from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.initial_soc.best_start import (
    Pieces,
    PieceSums,
    Starts,
    best_start_of,
    rows_to_fit,
    start_errors,
)
from cellwise.cell.initial_soc.rest import RELAXED_S, REST_RATE, SHORT_REST_V, soc_of_ocv
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.plausibility.cells_in_series import check_cells_in_series
from cellwise.cell.simulate import (
    Simulation,
    check_soc0,
    known_temperature_C,
    model_temperature_C,
    start_hysteresis,
)
from cellwise.cell.simulate import simulate as simulate_from
from cellwise.logs.cell_log import CellLog, check_is_log
from cellwise.typing import FloatArray

FIT_S = 60.0
BEGINNING = 2048  # rows that are looked at before all of a log is
STATED_STD = 0.005  # a start that is known: full and empty of two tests differ by about this
# By how much a used cell's resistance differs from its model's; aged or cold ones by more.
UNKNOWN_RESISTANCE = 0.3
HALF_NORMAL = 0.8  # mean of a half normal distribution, in its deviations: sqrt(2 / pi)
SURE_STD = 0.02  # a start known better than this needs no more than the beginning
MOST_ROWS = 400_000  # of a longer log the beginning is enough


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
    likeliest: bool = False,
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
    likeliest : bool          under load, the SOC that fits best instead of the mean of all that
                              are possible: for a simulation, which has to be one of them
    whole_log : bool          use the whole log where its beginning leaves it open (a plateau, a
                              load): not for what claims to work online

    Returns
    -------
    InitialSoc        the standard deviation includes the model's own voltage error, an unfinished
                      relaxation and a flat OCV: on a plateau it is large
    """
    if given is not None:
        check_soc0(given)
        return InitialSoc(float(given), given_std, "given")
    if log.soc0 is not None:
        return InitialSoc(log.soc0, STATED_STD, "stated")
    current, rest_end = _current_and_rest(model, log)
    voltages = log.voltage_V[:rest_end]
    if np.any(np.isfinite(voltages)):
        last = int(np.flatnonzero(np.isfinite(voltages))[-1])
        rest_s = float(log.time_s[last] - log.time_s[0])
        unfinished = SHORT_REST_V * np.exp(-rest_s / RELAXED_S)
        found = _from_rest(model, log, last, rest_s, unfinished)
        flat = whole_log and found.std > SURE_STD
        return _from_whole_log(model, log, found, (0.0, unfinished)) if flat else found
    found = _from_first_minute(model, log, current, likeliest)
    return _from_whole_log(model, log, found, past_voltage(model, log)) if whole_log else found


def _current_and_rest(model: CellModel, log: CellLog) -> tuple[FloatArray, int]:
    """Currents of the beginning at least, and the row of the first load.

    Most logs need no more than their beginning: a fleet's logs are long, and read once.
    """
    minute = int(np.searchsorted(log.time_s, log.time_s[0] + FIT_S, side="right"))
    rows = max(minute + 2, BEGINNING)
    if rows < len(log) and np.isfinite(log.voltage_V[0]) and not log.gap_rows[:rows].any():
        current = log.interval_current_A[:rows]
        loaded = np.abs(current) >= REST_RATE * model.capacity_Ah
        if loaded.any() and np.isfinite(current).all():
            return current, int(np.argmax(loaded))
    current = log.known_current_A()
    resting = np.abs(current) < REST_RATE * model.capacity_Ah
    resting[: int(np.argmax(np.isfinite(log.interval_current_A)))] = False  # nobody knows
    return current, len(log) if resting.all() else int(np.argmin(resting))


def _from_rest(model: CellModel, log: CellLog, row: int, rest_s: float, std_V: float) -> InitialSoc:
    temperature = known_temperature_C(model, log)[row]
    soc, std = soc_of_ocv(model, float(log.voltage_V[row]), std_V, float(temperature))
    how = f"rest of {rest_s:.0f} s at the start, {log.voltage_V[row]:.4f} V"
    return InitialSoc(soc, max(std, 0.005), how)


def _from_first_minute(
    model: CellModel, log: CellLog, current: FloatArray, likeliest: bool
) -> InitialSoc:
    known = np.isfinite(log.voltage_V[:1]).all()
    first = 0 if known else int(np.argmax(np.isfinite(log.voltage_V)))
    rows = max(first + 2, int(np.searchsorted(log.time_s, log.time_s[first] + FIT_S, side="right")))
    rows = min(rows, len(log))
    head = CellLog(
        log.time_s[:rows],
        current[:rows],
        log.voltage_V[:rows],
        np.full(rows, model_temperature_C(model))
        if log.temperature_C is None
        else log.temperature_C[:rows],
        None if log.charge_Ah is None else log.charge_Ah[:rows],
    )
    rows_of_head = rows_to_fit(model, head)
    best, _ = best_start_of(model, rows_of_head, np.linspace(0.0, 1.0, 101))
    near = np.linspace(max(0.0, best - 0.01), min(1.0, best + 0.01), 41)
    best, rms = best_start_of(model, rows_of_head, near)
    # The cell did not begin at rest here, so its past is in the voltage; and what the fit takes
    # for a low SOC may be a high resistance: say so in the spread.
    temperature = float(rows_of_head.temperature_C[0])
    ocv = float(np.interp(best, model.soc, model.ocv_at(temperature)))
    dropped = ocv - float(np.nanmean(head.voltage_V))
    std_V = float(np.sqrt(SHORT_REST_V**2 + rms**2 + (UNKNOWN_RESISTANCE * dropped) ** 2))
    _, std = soc_of_ocv(model, ocv, std_V, temperature)
    # Beyond full and empty there is nothing: at an end, the mean of the remaining part lies inside.
    inside = 0.0 if likeliest else min(HALF_NORMAL * std, 0.5)
    best = min(max(best, inside), 1.0 - inside)
    return InitialSoc(best, max(std, 0.01), f"fit of the first {head.duration_s:.0f} s under load")


def _from_whole_log(
    model: CellModel, log: CellLog, beginning: InitialSoc, past_V: tuple[float, float]
) -> InitialSoc:
    log = log.part(0, min(len(log), MOST_ROWS))
    if np.count_nonzero(np.isfinite(log.voltage_V)) < 2:
        return beginning
    soc, std = likeliest_soc(model, log, past_V)
    how = f"fit of the whole log, {log.duration_s / 3600.0:.2f} h"
    return InitialSoc(soc, max(std, STATED_STD), how, beginning)


class WholeLogFit(NamedTuple):
    """How the start of a whole log is weighed."""

    piece: float = 0.02  # throughput over which the error hardly changes [capacities]
    independent: float = 2.0  # of a log: one OCV and one capacity are wrong everywhere
    outlying: float = 25.0  # no piece counts more than at five deviations, squared
    beyond: float = 0.01  # how far a counter may run beyond full or empty
    past_s: float = 600.0  # load that an unknown past is taken to be like [s]


WHOLE_LOG = WholeLogFit()

COARSE, FINE = 51, 41  # starts tried over 0..1, then around the likeliest


def likeliest_soc(
    model: CellModel, log: CellLog, past_V: tuple[float, float]
) -> tuple[float, float]:
    """The likeliest initial SOC of a log with at least two voltages, and its standard deviation.

    The squared error of a piece of 2 % throughput counts once, against the model's own claim and
    the best fit; what an unknown past left in the slow states is a voltage that fades, integrated
    over its normal distribution (``past_V``: mean and standard deviation).
    """
    grid = np.linspace(0.0, 1.0, COARSE)
    best = float(grid[np.argmin(_start_cost(model, log, grid, past_V))])
    step = 1.0 / (COARSE - 1)
    near = np.linspace(max(0.0, best - step), min(1.0, best + step), FINE)
    soc = np.union1d(grid, near)
    cost = _start_cost(model, log, soc, past_V)
    weight = np.exp(-0.5 * (cost - cost.min())) * np.gradient(soc)
    mean = float(np.average(soc, weights=weight))
    variance = float(np.average((soc - mean) ** 2, weights=weight))
    likeliest = float(soc[np.argmin(cost)])
    return likeliest, math.hypot(math.sqrt(variance), likeliest - mean)


def _start_cost(
    model: CellModel, log: CellLog, soc0: FloatArray, past_V: tuple[float, float]
) -> FloatArray:
    """Minus twice the log likelihood of every start, shape (m,)."""
    charge = log.counted_charge_Ah() / model.capacity_Ah
    moved = np.cumsum(np.abs(np.diff(charge, prepend=charge[0])))
    piece = (moved / WHOLE_LOG.piece).astype(np.int64)
    past = np.exp(-(log.time_s - log.time_s[0]) / RELAXED_S)
    finite = np.isfinite(log.voltage_V)
    pieces = int(piece[-1]) + 1
    rows = np.bincount(piece[finite], minlength=pieces)
    squares, products, known = (np.zeros((soc0.size, pieces)) for _ in range(3))
    beyond = np.zeros(soc0.size)
    announce(start_errors, "the initial SOC")
    start_errors(
        model.parameters(),
        Starts(soc0, np.array([start_hysteresis(s) for s in soc0])),
        rows_to_fit(model, log),
        Pieces(piece, past),
        np.array(model.slow_error_V(np.linspace(0.0, 1.0, 101))),
        PieceSums(squares, products, known, beyond),
    )
    seen = rows > 0
    count = rows[seen]
    left = np.bincount(piece[finite], past[finite] ** 2, minlength=pieces)[seen] / count
    mean2, mixed = squares[:, seen] / count, products[:, seen] / count
    best_V2 = float(np.min(np.sum(squares, axis=1))) / float(np.sum(rows))
    variance = known[:, seen] / count + best_V2
    share = min(1.0, WHOLE_LOG.independent / count.size)
    normal = np.linspace(-3.0, 3.0, 25)
    costs = np.empty((normal.size, soc0.size))
    gap_V = float(np.max(np.abs(np.asarray(model.effect(Hysteresis).m_V))))
    for place, shift in enumerate(past_V[0] + normal * math.hypot(past_V[1], gap_V)):
        error2 = mean2 - 2.0 * shift * mixed + shift**2 * left
        costs[place] = share * np.sum(np.minimum(error2 / variance, WHOLE_LOG.outlying), axis=1)
    least = costs.min(axis=0)
    prior = np.exp(-0.5 * normal**2)
    likelihood = np.average(np.exp(-0.5 * (costs - least)), axis=0, weights=prior)
    return np.asarray(least - 2.0 * np.log(likelihood) + (beyond / WHOLE_LOG.beyond) ** 2)


def past_voltage(model: CellModel, log: CellLog) -> tuple[float, float]:
    """What the slow states may hold of a past that was like the first minutes of the log [V].

    Between nothing (the load has just begun) and all of it: the middle, and half of the range.
    """
    cell = model.at_temperature(float(known_temperature_C(model, log)[0]))
    slow_ohm = float(np.median(np.asarray(cell.effect(SlowDiffusion).r3_ohm)))
    early = log.time_s <= log.time_s[0] + WHOLE_LOG.past_s
    full_V = -slow_ohm * float(np.mean(log.known_current_A()[early]))
    return 0.5 * full_V, math.hypot(SHORT_REST_V, full_V)


def simulate(
    model: CellModel, log: CellLog, soc0: float | None = None, h0: float | None = None
) -> Simulation:
    """Simulate the terminal voltage of a log from a cell at rest at ``soc0``.

    Exact for constant current within each interval, at any time step. Over gaps the current is
    what :meth:`CellLog.known_current_A` says (the counter's charge, else a rest).

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : float or None  SOC at the first row, 0..1; None: as ``cellwise simulate`` finds it (the
                          log's stated start, a rest at its beginning, or a fit of the log)
    h0 : float or None    hysteresis state at the first row, -1 (after a discharge) to 1 (after a
                          charge); None: +1 from the upper half of SOC, -1 from the lower

    Returns
    -------
    Simulation            its ``soc0`` is the start taken

    Raises
    ------
    InputError            soc0 outside 0..1; without a start, a pack read as one cell
    """
    check_is_model(model)
    check_is_log(log)
    if soc0 is None:
        check_cells_in_series(model, log)
        soc0 = initial_soc(model, log, likeliest=True, whole_log=True).soc
    return simulate_from(model, log, soc0, h0)

"""From a state of a cell to empty if the present load goes on, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    seen_current,
    voltage_of,
    with_soc,
)
from cellwise.estimate.validity_kernels import ValidityScalars, soc_extrapolation_V
from cellwise.typing import BoolArray, FloatArray

# Of a model that does not say how far along the SOC its error stays: those of measured cells that
# do say 0.07 to 0.37.
USUAL_MEMORY_SOC = 0.2
# Why a forecast ended.
BY_CHARGE, BY_VOLTAGE, NEVER = 0, 1, 2
STEPS = 400  # from full to empty
MOST_STEPS = 4 * STEPS


class Remaining(NamedTuple):
    """Time, energy out, voltage and SOC at the end of a forecast, and why it ended."""

    time_s: float
    energy_J: float
    voltage_V: float
    soc: float
    reason: int


class Uncertain(NamedTuple):
    """How far a model's voltage may come to lie off what it is off by now.

    ``share`` of the polarisation and the point's own slow error, both another one once the SOC has
    moved on by ``memory_soc``; outside ``valid`` an OCV that nobody measured. The cell's capacity
    is the model's to ``capacity_std``, as a share.
    """

    share: float
    memory_soc: float
    valid: ValidityScalars
    capacity_std: float


class Outcome(NamedTuple):
    """A forecast, and its ends at two deviations: of time, energy and end voltage."""

    usual: Remaining
    time_s: tuple[float, float]
    energy_J: tuple[float, float]
    voltage_V: tuple[float, float]


class FilteredRows(NamedTuple):
    """A log and what a filter said of it, shape (n,) each; a measured voltage may be NaN."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    voltage_V: FloatArray
    soc: FloatArray
    soc_std: FloatArray


class Load(NamedTuple):
    """What goes on: the present load of every row, whether its power is held, and until when.

    ``wanted`` are the rows to forecast at, ``window_s`` over what time the model's error is
    averaged, ``cutoff_V`` the voltage at which the load gives up.
    """

    current_A: FloatArray
    wanted: BoolArray
    hold_power: bool
    window_s: float
    cutoff_V: float


@rows
def to_empty(
    tables: CellTables,
    start: CellState,
    load_A: float,
    hold_power: bool,
    start_V: float,
    bias_V: float,
    cutoff_V: float,
    temperature_C: float,
    uncertain: Uncertain,
    deviations: float,
) -> Remaining:
    """Go on with a load until the voltage reaches its cutoff or the charge its end.

    Parameters
    ----------
    load_A : float        current now, above zero
    hold_power : bool     keep load times voltage, not the current (a rotor, a drive)
    start_V : float       terminal voltage now
    bias_V : float        measured minus modelled voltage, taken to stay as it is
    cutoff_V : float      terminal voltage at which the load gives up
    deviations : float    by how many of them the voltage goes away from ``bias_V``

    Notes
    -----
    Temperature and load stay, so ``bias_V`` has what they do outside the model's validity; what
    nobody has seen yet is the OCV at a SOC further outside than the present one, and what the
    model's error will be at another SOC: two errors of one deviation sigma whose correlation is
    rho differ by sigma sqrt(2 (1 - rho)).

    Steps of 1/400 of the capacity at the present current; the last one is cut where the voltage,
    taken as linear within it, crosses the cutoff, or where the charge ends.
    """
    dt_s = tables.cell.charge_As / (STEPS * load_A)
    power_W = load_A * start_V
    state = start
    time_s = 0.0
    energy_J = 0.0
    before_V = start_V
    known_V = soc_extrapolation_V(uncertain.valid, start.soc)
    for _ in range(MOST_STEPS):
        current = power_W / before_V if hold_power else load_A
        state_next, point = advance(tables, state, current, dt_s, temperature_C)
        voltage = voltage_of(point, state_next, current) + bias_V
        if deviations != 0.0:
            wrong = uncertain.share * (point.ocv_V - (voltage - bias_V))
            moved = abs(start.soc - state_next.soc) / uncertain.memory_soc
            apart = 2.0 * (1.0 - math.exp(-moved))
            off_V = math.sqrt((point.error_V * point.error_V + wrong * wrong) * apart)
            if state_next.soc < uncertain.valid.soc_low:
                off_V += max(soc_extrapolation_V(uncertain.valid, state_next.soc) - known_V, 0.0)
            voltage += deviations * off_V
        share = 1.0
        reason = NEVER
        if state_next.soc <= 0.0:
            share = max(state.soc, 0.0) / max(state.soc - state_next.soc, 1e-12)
            reason = BY_CHARGE
        if voltage <= cutoff_V:
            crossing = (before_V - cutoff_V) / max(before_V - voltage, 1e-12)
            if reason == NEVER or crossing < share:
                share = max(crossing, 0.0)
                reason = BY_VOLTAGE
        end_V = before_V + share * (voltage - before_V)
        time_s += share * dt_s
        energy_J += share * dt_s * current * 0.5 * (before_V + end_V)
        if reason != NEVER:
            soc = state.soc + share * (state_next.soc - state.soc)
            return Remaining(time_s, energy_J, end_V, soc, reason)
        state = state_next
        before_V = voltage
    return Remaining(time_s, energy_J, before_V, state.soc, NEVER)


@inline
def ends(
    usual: float, low: float, high: float, lower: float, higher: float, share: float
) -> tuple[float, float]:
    """Two deviations either way by three causes that know nothing of each other.

    The last is a ``share`` of what remains, one deviation.
    """
    all_of_it = 2.0 * share * usual
    below = math.hypot(max(usual - low, 0.0), max(usual - lower, 0.0))
    above = math.hypot(max(high - usual, 0.0), max(higher - usual, 0.0))
    return max(usual - math.hypot(below, all_of_it), 0.0), usual + math.hypot(above, all_of_it)


class Going(NamedTuple):
    """What goes on, from one moment; see `to_empty`.

    ``start_V``, the voltage now, is a measured one where it is finite; NaN: the model's at each
    SOC, plus ``bias_V``.
    """

    load_A: float
    hold_power: bool
    start_V: float
    bias_V: float
    cutoff_V: float
    temperature_C: float


@rows
def from_soc(
    tables: CellTables,
    state: CellState,
    away_soc: float,
    go: Going,
    uncertain: Uncertain,
    deviations: float,
) -> Remaining:
    """A forecast from ``away_soc`` beside the state."""
    at = with_soc(state, min(max(state.soc + away_soc, 0.0), 1.0))
    now_V = go.start_V
    if now_V != now_V:
        _, there = advance(tables, at, go.load_A, 0.0, go.temperature_C)
        now_V = voltage_of(there, at, go.load_A) + go.bias_V
    return to_empty(
        tables, at, go.load_A, go.hold_power, now_V, go.bias_V, go.cutoff_V, go.temperature_C,
        uncertain, deviations,
    )  # fmt: skip


@rows
def with_ends(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    go: Going,
    uncertain: Uncertain,
) -> Outcome:
    """A forecast from a state, and its ends: by what is not known of SOC, voltage and capacity."""
    usual = from_soc(tables, state, 0.0, go, uncertain, 0.0)
    low = from_soc(tables, state, -2.0 * soc_std, go, uncertain, 0.0)
    high = from_soc(tables, state, 2.0 * soc_std, go, uncertain, 0.0)
    lower = from_soc(tables, state, 0.0, go, uncertain, -2.0)
    higher = from_soc(tables, state, 0.0, go, uncertain, 2.0)
    share = uncertain.capacity_std
    time_s = ends(usual.time_s, low.time_s, high.time_s, lower.time_s, higher.time_s, share)
    energy = ends(
        usual.energy_J, low.energy_J, high.energy_J, lower.energy_J, higher.energy_J, share
    )
    if usual.reason != NEVER and (high.reason == NEVER or higher.reason == NEVER):
        time_s, energy = (time_s[0], math.inf), (energy[0], math.inf)
    at_end = (min(low.voltage_V, high.voltage_V), max(low.voltage_V, high.voltage_V))
    return Outcome(
        usual, (max(time_s[0], 0.0), time_s[1]), (max(energy[0], 0.0), energy[1]), at_end
    )


@rows
def forecast_rows(
    tables: CellTables,
    start: CellState,
    log: FilteredRows,
    load: Load,
    uncertain: Uncertain,
    out: FloatArray,
) -> None:
    """Carry the cell through a log with the filter's SOC; forecast at the wanted rows.

    ``out`` has shape (wanted rows, 11): the fields of `Remaining`, then both ends of time, energy
    and end voltage. The bias is the mean of measured minus
    modelled voltage over about ``window_s``.
    """
    dt_s, current_A, temperature_C, measured_V, soc, soc_std = log
    load_A, wanted, hold_power, window_s, cutoff_V = load
    state = start
    previous = current_A[0]
    bias = 0.0
    begun = False
    place = 0
    for k in range(dt_s.size):
        seen = seen_current(tables.cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, point = advance(tables, state, seen, dt_s[k], temperature_C[k])
        state = with_soc(state, soc[k])
        voltage = voltage_of(point, state, seen)
        if measured_V[k] == measured_V[k]:  # not NaN
            error = measured_V[k] - voltage
            if not begun:
                bias = error
                begun = True
            bias += (error - bias) * min(dt_s[k] / window_s, 1.0)
        if not wanted[k]:
            continue
        go = Going(load_A[k], hold_power, math.nan, bias, cutoff_V, temperature_C[k])
        found = with_ends(tables, state, soc_std[k], go, uncertain)
        left = found.usual
        out[place, 0] = left.time_s
        out[place, 1] = left.energy_J
        out[place, 2] = left.voltage_V
        out[place, 3] = left.soc
        out[place, 4] = left.reason
        for j in range(2):
            out[place, 5 + j] = found.time_s[j]
            out[place, 7 + j] = found.energy_J[j]
            out[place, 9 + j] = found.voltage_V[j]
        place += 1

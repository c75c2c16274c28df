"""From a state of a cell to empty if the present load goes on, compiled."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import rows
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
    valid: ValidityScalars,
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
    deviations : float    by how many of them the OCV lies off where the model's data end

    Notes
    -----
    Temperature and load stay, so ``bias_V`` has what they do outside ``valid``; what nobody has
    seen yet is the OCV at a SOC further outside than the present one.

    Steps of 1/400 of the capacity at the present current; the last one is cut where the voltage,
    taken as linear within it, crosses the cutoff, or where the charge ends.
    """
    dt_s = tables.cell.charge_As / (STEPS * load_A)
    power_W = load_A * start_V
    state = start
    time_s = 0.0
    energy_J = 0.0
    before_V = start_V
    known_V = soc_extrapolation_V(valid, start.soc)
    for _ in range(MOST_STEPS):
        current = power_W / before_V if hold_power else load_A
        state_next, point = advance(tables, state, current, dt_s, temperature_C)
        voltage = voltage_of(point, state_next, current) + bias_V
        if state_next.soc < valid.soc_low:
            unseen_V = max(soc_extrapolation_V(valid, state_next.soc) - known_V, 0.0)
            voltage += deviations * unseen_V
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


@rows
def forecast_rows(
    tables: CellTables,
    start: CellState,
    log: FilteredRows,
    load: Load,
    valid: ValidityScalars,
    out: FloatArray,
) -> None:
    """Carry the cell through a log with the filter's SOC; forecast at the wanted rows.

    ``out`` has shape (wanted rows, 3, 5): a forecast from the SOC less two deviations, the SOC, and
    the SOC plus two, each with the fields of `Remaining`. The bias is the mean of measured minus
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
        for j in range(3):
            s = min(max(soc[k] + (j - 1) * 2.0 * soc_std[k], 0.0), 1.0)
            at = with_soc(state, s)
            _, there = advance(tables, at, load_A[k], 0.0, temperature_C[k])
            now_V = voltage_of(there, at, load_A[k]) + bias
            left = to_empty(
                tables, at, load_A[k], hold_power, now_V, bias, cutoff_V,
                temperature_C[k], valid, (j - 1) * 2.0,
            )  # fmt: skip
            out[place, j, 0] = left.time_s
            out[place, j, 1] = left.energy_J
            out[place, j, 2] = left.voltage_V
            out[place, j, 3] = left.soc
            out[place, j, 4] = left.reason
        place += 1

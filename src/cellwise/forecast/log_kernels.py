"""A cell followed along a filtered log, and what goes on from its rows, compiled."""

from __future__ import annotations

from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    delayed_current,
    look_up,
    needs_temperature,
    voltage_of,
    with_soc,
)
from cellwise.cell.packed import put_record
from cellwise.forecast.forecast_kernels import LoadScenario, Uncertain, with_ends
from cellwise.forecast.warming_kernels import NOTHING_SEEN, Warming, observed, thermal_of
from cellwise.typing import BoolArray, FloatArray

WINDOW_S = 60.0  # what counts as now: of the load, and of what the model is off by


class FilteredRows(NamedTuple):
    """A log and what a filter said of it, shape (n,) each; a measured voltage may be NaN."""

    interval_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    measured_C: FloatArray
    voltage_V: FloatArray
    soc: FloatArray
    soc_std: FloatArray


class LoadAhead(NamedTuple):
    """What goes on: the load of every row, whether its power is held, and until when.

    ``power_W`` is what is held where that was given, with a current near it; NaN: what the current
    makes of the model's terminal voltage. ``wanted`` are the rows to forecast at, ``cutoff_V`` the
    voltage at which the load gives up or that a charger holds, ``taper_A`` the current at which a
    charger ends. ``warms_unseen``: the losses warm the cell where nobody measures its temperature.
    """

    current_A: FloatArray
    power_W: float
    wanted: BoolArray
    hold_power: bool
    cutoff_V: float
    warms_unseen: bool
    taper_A: float = 0.0


class FollowedCell(NamedTuple):
    """A cell along a log, with the filter's SOC, and what the model is off by of late."""

    state: CellState
    previous_A: float
    bias_V: float
    held_V: float
    begun: bool
    warming: Warming
    error_V: float


@kernel
def asks_temperature(tables: CellTables) -> bool:
    """Whether anything depends on it: a kernel, since what is inlined is compiled for each run."""
    return needs_temperature(tables)


@kernel
def ocv_and_error(tables: CellTables, soc: float, temperature_C: float) -> tuple[float, float]:
    """OCV and the model's own slow error there [V]."""
    point = look_up(tables, soc, temperature_C)
    return point.ocv_V, point.error_V


@kernel
def parts_of(
    uncertain: Uncertain, error_V: float, seen_V: float, polarisation_V: float
) -> tuple[float, float]:
    """What the model is off by, as an offset and as a share of the polarisation.

    Each gets what it is expected to have given their sum, of the deviations that the model
    states of both.
    """
    held = uncertain.share * polarisation_V
    both = held * held + error_V * error_V
    if both <= 0.0:
        return seen_V, 0.0
    share = seen_V * uncertain.share * held / both
    return seen_V - share * polarisation_V, share


@inline
def row_followed(tables: CellTables, was: FollowedCell, log: FilteredRows, k: int) -> FollowedCell:
    """One row on: the model's present error is a mean over about `WINDOW_S`."""
    dt_s, current_A, temperature_C, measured_C, measured_V, soc, _ = log
    delayed_A = delayed_current(tables.cell, current_A[k], was.previous_A, dt_s[k])
    state, point = advance(tables, was.state, delayed_A, dt_s[k], temperature_C[k])
    state = with_soc(state, soc[k])
    voltage = voltage_of(point, state, delayed_A)
    lost_W = delayed_A * (point.ocv_V - voltage)
    bias, held, begun = was.bias_V, was.held_V, was.begun
    if measured_V[k] == measured_V[k]:  # not NaN
        lost_W = delayed_A * (point.ocv_V - measured_V[k])
        share = min(dt_s[k] / WINDOW_S, 1.0) if begun else 1.0
        begun = True
        bias += share * (measured_V[k] - voltage - bias)
        held += share * ((point.ocv_V - voltage) - held)
    warming = observed(was.warming, tables.cell.charge_As, lost_W, measured_C[k], dt_s[k])
    return FollowedCell(state, current_A[k], bias, held, begun, warming, point.error_V)


@inline
def going_of(
    tables: CellTables,
    now: FollowedCell,
    warm_C: float,
    load_A: float,
    load: LoadAhead,
    uncertain: Uncertain,
) -> LoadScenario:
    """What goes on from a row at a load."""
    offset, of_held = parts_of(uncertain, now.error_V, now.bias_V, now.held_V)
    lump = thermal_of(now.warming, tables.cell.charge_As, warm_C, load.warms_unseen)
    return LoadScenario(
        load_A, load.hold_power, load.power_W, offset, of_held, load.cutoff_V, warm_C, lump,
        load.taper_A,
    )  # fmt: skip


@rows
def moment(
    tables: CellTables, start: CellState, log: FilteredRows, load: LoadAhead, uncertain: Uncertain
) -> tuple[CellState, LoadScenario]:
    """The state at the last row of a log, and what goes on from there, with no load yet."""
    now = FollowedCell(start, log.current_A[0], 0.0, 0.0, False, NOTHING_SEEN, 0.0)
    for k in range(log.soc.size):
        now = row_followed(tables, now, log, k)
    warm_C = log.temperature_C[log.soc.size - 1]
    return now.state, going_of(tables, now, warm_C, 0.0, load, uncertain)


@rows
def forecast_rows(
    tables: CellTables,
    start: CellState,
    log: FilteredRows,
    load: LoadAhead,
    uncertain: Uncertain,
    out: FloatArray,
) -> None:
    """Carry the cell through a log with the filter's SOC; forecast at the wanted rows.

    ``out`` has shape (wanted rows, numbers of an `Outcome`). The model's present error is the mean
    of measured minus modelled voltage over about `WINDOW_S`.
    """
    now = FollowedCell(start, log.current_A[0], 0.0, 0.0, False, NOTHING_SEEN, 0.0)
    place = 0
    for k in range(log.soc.size):
        now = row_followed(tables, now, log, k)
        if load.wanted[k]:
            warm_C = log.temperature_C[k]
            go = going_of(tables, now, warm_C, load.current_A[k], load, uncertain)
            found = with_ends(tables, now.state, log.soc_std[k], go, uncertain)
            put_record(out[place], 0, 1, found, True)
            place += 1

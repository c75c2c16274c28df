"""From a state of a cell to empty, or to full, if the present load goes on, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import inline, kernel, part, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    look_up,
    needs_temperature,
    seen_current,
    voltage_of,
    with_soc,
)
from cellwise.cell.packed import changed
from cellwise.cell.plausibility.validity_kernels import extrapolation_V, soc_extrapolation_V
from cellwise.forecast.charging_kernels import new_error_V, to_full
from cellwise.forecast.records import (
    BY_CHARGE,
    BY_VOLTAGE,
    NEVER,
    STEPS,
    TAIL_FACTOR,
    USUAL,
    Away,
    FilteredRows,
    Going,
    Load,
    Outcome,
    Remaining,
    Uncertain,
)
from cellwise.forecast.warming_kernels import (
    NOTHING_SEEN,
    Thermal,
    Warming,
    Warmth,
    observed,
    thermal_of,
    warmed_to,
)
from cellwise.typing import FloatArray

POWER_TURNS = 20


@inline
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


@kernel
def asks_temperature(tables: CellTables) -> bool:
    """Whether anything depends on it: a kernel, since what is inlined is compiled for each run."""
    return needs_temperature(tables)


@rows
def ocv_and_error(tables: CellTables, soc: float, temperature_C: float) -> tuple[float, float]:
    """OCV and the model's own slow error there [V]."""
    point = look_up(tables, soc, temperature_C)
    return point.ocv_V, point.error_V


@rows
def lump_now(seen: Warming, charge_As: float, temperature_C: float, unseen: bool) -> Thermal:
    """`thermal_of`, for callers that are not compiled."""
    return thermal_of(seen, charge_As, temperature_C, unseen)


@rows
def warming_with(
    seen: Warming, charge_As: float, lost_W: float, temperature_C: float, dt_s: float
) -> Warming:
    """`observed`, for callers that are not compiled."""
    return observed(seen, charge_As, lost_W, temperature_C, dt_s)


@part
def to_empty(
    tables: CellTables, start: CellState, go: Going, uncertain: Uncertain, away: Away
) -> Remaining:
    """Go on with a load until the voltage reaches its cutoff or the charge its end.

    Notes
    -----
    The load stays; temperature follows the losses. What the model is off by outside its validity
    is in its present error already; what nobody has seen yet is its error at a SOC or a temperature
    further outside than the present one, and what it will be at another SOC: two errors of one
    deviation sigma whose correlation is rho differ by sigma sqrt(2 (1 - rho)).

    Steps of 1/400 of the capacity at the present current; the last one is cut where the voltage,
    taken as linear within it, crosses the cutoff, or where the charge ends.
    """
    load_A, cutoff_V, lump, valid = go.load_A, go.cutoff_V, go.lump, uncertain.valid
    dt_s = tables.cell.charge_As / (STEPS * load_A)
    state = start
    time_s = 0.0
    energy_J = 0.0
    before_V = go.start_V
    power_W = load_A * before_V
    known_soc_V = soc_extrapolation_V(valid, start.soc)
    known_V = math.nan
    warmth = Warmth(go.temperature_C - lump.origin_C, 0.0, 0.0, 0.0)
    here_C = go.temperature_C
    for _ in range(4 * STEPS):
        current = power_W / before_V if go.hold_power else load_A
        state_next, point = advance(tables, state, current, dt_s, here_C)
        model_V = voltage_of(point, state_next, current)
        held_V = point.ocv_V - model_V
        voltage = model_V + go.offset_V + go.of_polarisation * held_V
        if lump.heats:
            lost_W = current * (point.ocv_V - voltage)
            warmth, here_C = warmed_to(lump, warmth, lost_W, dt_s, away.warmth)
        beyond_V = extrapolation_V(valid, here_C, current, abs(held_V))
        if known_V != known_V:
            known_V = beyond_V
        if away.voltage != 0.0:
            moved, new_V = abs(start.soc - state_next.soc), beyond_V - known_V
            off_V = new_error_V(uncertain, point.error_V, held_V, moved, new_V)
            if state_next.soc < valid.soc_low:
                off_V += max(soc_extrapolation_V(valid, state_next.soc) - known_soc_V, 0.0)
            voltage += away.voltage * off_V
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
            return Remaining(time_s, energy_J, end_V, soc, reason, 0.0)
        state = state_next
        before_V = voltage
    return Remaining(time_s, energy_J, before_V, state.soc, NEVER, 0.0)


@inline
def ends(
    usual: float,
    soc: tuple[float, float],
    voltage: tuple[float, float],
    warmth: tuple[float, float],
    share: float,
) -> tuple[float, float]:
    """Two deviations either way by four causes that know nothing of each other.

    The first three give what remains at both of their ends, the last is a ``share`` of what
    remains, one deviation.
    """
    of_all = 2.0 * share * usual
    below, above = of_all * of_all, of_all * of_all
    for one, other in (soc, voltage, warmth):
        less, more = max(usual - min(one, other), 0.0), max(max(one, other) - usual, 0.0)
        below += less * less
        above += more * more
    return max(usual - math.sqrt(below), 0.0), usual + math.sqrt(above)


@part
def from_soc(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    go: Going,
    uncertain: Uncertain,
    away: Away,
) -> Remaining:
    """A forecast from deviations beside the state."""
    at = with_soc(state, min(max(state.soc + away.soc * soc_std, 0.0), 1.0))
    now_V = go.start_V
    if now_V != now_V:
        _, there = advance(tables, at, go.load_A, 0.0, go.temperature_C)
        now_V = voltage_of(there, at, go.load_A)
        now_V += go.offset_V + go.of_polarisation * (there.ocv_V - now_V)
    begins = changed(go, "start_V", now_V)
    if go.load_A < 0.0:
        return to_full(tables, at, begins, uncertain, away)
    return to_empty(tables, at, begins, uncertain, away)


@part
def at_power(tables: CellTables, state: CellState, go: Going, power_W: float) -> Going:
    """The same with the current and the voltage at which the load has a power now.

    A power beyond what the cell can give has none: the voltage is then below any cutoff.
    """
    current = go.load_A
    voltage = math.nan
    for _ in range(POWER_TURNS):
        _, there = advance(tables, state, current, 0.0, go.temperature_C)
        voltage = voltage_of(there, state, current)
        voltage += go.offset_V + go.of_polarisation * (there.ocv_V - voltage)
        if voltage <= 0.0:
            break
        current = power_W / voltage
    return changed(changed(go, "load_A", current), "start_V", voltage)


@part
def with_ends(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    go: Going,
    uncertain: Uncertain,
) -> Outcome:
    """A forecast from a state, and its ends: by what is not known of SOC, voltage and capacity."""
    usual = from_soc(tables, state, soc_std, go, uncertain, USUAL)
    low = from_soc(tables, state, soc_std, go, uncertain, Away(-2.0, 0.0, 0.0))
    high = from_soc(tables, state, soc_std, go, uncertain, Away(2.0, 0.0, 0.0))
    lower = from_soc(tables, state, soc_std, go, uncertain, Away(0.0, -2.0, 0.0))
    higher = from_soc(tables, state, soc_std, go, uncertain, Away(0.0, 2.0, 0.0))
    cold = warm = usual
    if go.lump.heats:
        cold = from_soc(tables, state, soc_std, go, uncertain, Away(0.0, 0.0, -2.0))
        warm = from_soc(tables, state, soc_std, go, uncertain, Away(0.0, 0.0, 2.0))
    time_s = ends(
        usual.time_s, (low.time_s, high.time_s), (lower.time_s, higher.time_s),
        (cold.time_s, warm.time_s), uncertain.capacity_std,
    )  # fmt: skip
    if go.load_A < 0.0:
        # A voltage that is higher ends the constant current earlier and the constant voltage later:
        # the longest charge lies between the ends.
        for share in (0.5, 1.0, 1.5):
            between = from_soc(tables, state, soc_std, go, uncertain, Away(0.0, share, 0.0))
            time_s = (min(time_s[0], between.time_s), max(time_s[1], between.time_s))
    if usual.tail_s > 0.0:
        less, more = usual.tail_s * (1.0 - 1.0 / TAIL_FACTOR), usual.tail_s * (TAIL_FACTOR - 1.0)
        low_s = usual.time_s - math.sqrt((usual.time_s - time_s[0]) ** 2 + less * less)
        high_s = usual.time_s + math.sqrt((time_s[1] - usual.time_s) ** 2 + more * more)
        time_s = (max(low_s, 0.0), high_s)
    energy = ends(
        usual.energy_J, (low.energy_J, high.energy_J), (lower.energy_J, higher.energy_J),
        (cold.energy_J, warm.energy_J), uncertain.capacity_std,
    )  # fmt: skip
    if usual.reason != NEVER and (high.reason == NEVER or higher.reason == NEVER):
        time_s, energy = (time_s[0], math.inf), (energy[0], math.inf)
    at_end = (min(low.voltage_V, high.voltage_V), max(low.voltage_V, high.voltage_V))
    return Outcome(usual, time_s, energy, at_end)


@rows
def ends_now(
    tables: CellTables, state: CellState, soc_std: float, go: Going, uncertain: Uncertain
) -> Outcome:
    """`with_ends`, for callers that are not compiled."""
    return with_ends(tables, state, soc_std, go, uncertain)


@rows
def power_now(tables: CellTables, state: CellState, go: Going, power_W: float) -> Going:
    """`at_power`, for callers that are not compiled."""
    return at_power(tables, state, go, power_W)


class Followed(NamedTuple):
    """A cell along a log, with the filter's SOC, and what the model is off by of late."""

    state: CellState
    previous_A: float
    bias_V: float
    held_V: float
    begun: bool
    warming: Warming
    error_V: float


@inline
def row_followed(
    tables: CellTables, was: Followed, log: FilteredRows, k: int, window_s: float
) -> Followed:
    """One row on: the model's present error is a mean over about ``window_s``."""
    dt_s, current_A, temperature_C, measured_C, measured_V, soc, _ = log
    seen = seen_current(tables.cell, current_A[k], was.previous_A, dt_s[k])
    state, point = advance(tables, was.state, seen, dt_s[k], temperature_C[k])
    state = with_soc(state, soc[k])
    voltage = voltage_of(point, state, seen)
    lost_W = seen * (point.ocv_V - voltage)
    bias, held, begun = was.bias_V, was.held_V, was.begun
    if measured_V[k] == measured_V[k]:  # not NaN
        error = measured_V[k] - voltage
        lost_W = seen * (point.ocv_V - measured_V[k])
        share = min(dt_s[k] / window_s, 1.0) if begun else 1.0
        begun = True
        bias += share * (error - bias)
        held += share * ((point.ocv_V - voltage) - held)
    warming = observed(was.warming, tables.cell.charge_As, lost_W, measured_C[k], dt_s[k])
    return Followed(state, current_A[k], bias, held, begun, warming, point.error_V)


@rows
def moment(
    tables: CellTables,
    start: CellState,
    log: FilteredRows,
    load: Load,
    uncertain: Uncertain,
) -> tuple[CellState, Going]:
    """The state at the last row of a log, and what goes on from there at its load."""
    now = Followed(start, log.current_A[0], 0.0, 0.0, False, NOTHING_SEEN, 0.0)
    for k in range(log.soc.size):
        now = row_followed(tables, now, log, k, load.window_s)
    offset, of_held = parts_of(uncertain, now.error_V, now.bias_V, now.held_V)
    warm = log.temperature_C[log.soc.size - 1]
    lump = thermal_of(now.warming, tables.cell.charge_As, warm, load.warms_unseen)
    go = Going(
        load.current_A[load.current_A.size - 1], load.hold_power, math.nan, offset, of_held,
        load.cutoff_V, warm, lump, load.taper_A,
    )  # fmt: skip
    return now.state, go


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

    ``out`` has shape (wanted rows, 13): the fields of `Remaining`, both ends of time, energy and
    end voltage, the current that it began with, ``tail_s``. The model's present error is the mean
    of measured minus modelled voltage over about ``window_s``.
    """
    load_A, load_W, wanted, hold_power, window_s, cutoff_V, unseen, taper_A = load
    now = Followed(start, log.current_A[0], 0.0, 0.0, False, NOTHING_SEEN, 0.0)
    charge_As = tables.cell.charge_As
    place = 0
    for k in range(log.soc.size):
        now = row_followed(tables, now, log, k, window_s)
        if not wanted[k]:
            continue
        offset, of_held = parts_of(uncertain, now.error_V, now.bias_V, now.held_V)
        warm = log.temperature_C[k]
        lump = thermal_of(now.warming, charge_As, warm, unseen)
        go = Going(load_A[k], hold_power, math.nan, offset, of_held, cutoff_V, warm, lump, taper_A)
        if load_W[k] == load_W[k]:
            go = at_power(tables, now.state, go, load_W[k])
        found = with_ends(tables, now.state, log.soc_std[k], go, uncertain)
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
        out[place, 11] = go.load_A
        out[place, 12] = left.tail_s
        place += 1

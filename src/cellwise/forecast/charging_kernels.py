"""From a state of a cell to full on a charger of constant current, then constant voltage."""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline, part
from cellwise.cell.equations import BEYOND, CellState, CellTables, advance, voltage_of
from cellwise.cell.plausibility.validity_kernels import extrapolation_V
from cellwise.forecast.records import (
    BY_CHARGE,
    BY_CURRENT,
    NEVER,
    STEPS,
    Away,
    Going,
    Remaining,
    Uncertain,
)
from cellwise.forecast.warming_kernels import Warmth, warmed_to

LONGEST = 8  # times the charge time at the present current
TRIED = 0.9  # of the current, to see what the voltage makes of it


@inline
def new_error_V(
    uncertain: Uncertain, error_V: float, held_V: float, moved_soc: float, beyond_V: float
) -> float:
    """What a model may come to be off by beside its present error, one deviation [V].

    Two errors of one deviation sigma whose correlation is rho differ by sigma sqrt(2 (1 - rho));
    ``beyond_V`` is what being further outside its data adds.
    """
    wrong = uncertain.share * held_V
    apart = 2.0 * (1.0 - math.exp(-moved_soc / uncertain.memory_soc))
    new_V = max(beyond_V, 0.0)
    square = (error_V * error_V + wrong * wrong) * apart
    return math.sqrt(square + new_V * new_V)


@part
def to_full(
    tables: CellTables, start: CellState, go: Going, uncertain: Uncertain, away: Away
) -> Remaining:
    """Go on with a charger until its current has fallen to where it ends.

    Notes
    -----
    The current is held until the terminal voltage is the charger's; from there the current is the
    one that keeps it, by a secant: the voltage is nearly linear in the current. What the model is
    off by stays, and may become another error ahead, as for a load
    (`cellwise.forecast.remaining_kernels.to_empty`). Where the OCV of a model ends below the
    charger's voltage the charge ends 5 % above its full one.

    Steps of 1/400 of the capacity at the present current; the last one is cut where the current,
    taken as linear within it, crosses its end. The energy is what the charger gives.
    """
    limit_V, lump, valid = go.cutoff_V, go.lump, uncertain.valid
    dt_s = tables.cell.charge_As / (STEPS * -go.load_A)
    state = start
    time_s = energy_J = shift_V = tail_s = 0.0
    current = go.load_A
    before_V = go.start_V
    known_V = math.nan
    warmth = Warmth(go.temperature_C - lump.origin_C, 0.0, 0.0, 0.0)
    here_C = go.temperature_C
    for _ in range(LONGEST * STEPS):
        before_A = current
        state_next, point = advance(tables, state, current, dt_s, here_C)
        model_V = voltage_of(point, state_next, current)
        held_V = point.ocv_V - model_V
        voltage = model_V + go.offset_V + go.of_polarisation * held_V + shift_V
        if voltage > limit_V:
            less = TRIED * current
            tried, there = advance(tables, state, less, dt_s, here_C)
            less_V = voltage_of(there, tried, less)
            less_V += go.offset_V + go.of_polarisation * (there.ocv_V - less_V) + shift_V
            slope = (voltage - less_V) / (less - current)
            current = min(current + (voltage - limit_V) / max(slope, 1e-12), 0.0)
            state_next, point = advance(tables, state, current, dt_s, here_C)
            held_V = point.ocv_V - voltage_of(point, state_next, current)
            voltage = limit_V
            held_s = dt_s
        else:
            held_s = 0.0
        if lump.heats:
            lost_W = current * (point.ocv_V - voltage)
            warmth, here_C = warmed_to(lump, warmth, lost_W, dt_s, away.warmth)
        beyond_V = extrapolation_V(valid, here_C, current, abs(held_V))
        if known_V != known_V:
            known_V = beyond_V
        if away.voltage != 0.0:
            moved, new_V = abs(start.soc - state_next.soc), beyond_V - known_V
            shift_V = away.voltage * new_error_V(uncertain, point.error_V, held_V, moved, new_V)
        share = 1.0
        reason = NEVER
        if -current <= go.taper_A:
            share = (before_A + go.taper_A) / min(before_A - current, -1e-12)
            share = min(max(share, 0.0), 1.0)
            reason = BY_CURRENT
        elif state_next.soc >= 1.0 + BEYOND:
            reason = BY_CHARGE
        time_s += share * dt_s
        tail_s += share * held_s
        energy_J -= share * dt_s * 0.5 * (before_A + current) * 0.5 * (before_V + voltage)
        if reason != NEVER:
            soc = state.soc + share * (state_next.soc - state.soc)
            return Remaining(time_s, energy_J, voltage, soc, reason, tail_s)
        state = state_next
        before_V = voltage
    return Remaining(time_s, energy_J, before_V, state.soc, NEVER, tail_s)

"""From a state of a cell through a plan of loads, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import rows
from cellwise.cell.equations import CellState, CellTables, advance, voltage_of, with_soc
from cellwise.cell.plausibility.validity_kernels import extrapolation_V, soc_extrapolation_V
from cellwise.forecast.charging_kernels import new_error_V
from cellwise.forecast.records import Away, Going, Uncertain
from cellwise.forecast.warming_kernels import Warmth, warmed_to
from cellwise.typing import FloatArray

TURNS = 3  # of a power to its current: an error of a per cent of the voltage is below 1e-6 then


class Landing(NamedTuple):
    """Where a plan ends: SOC, lowest voltage, energy given, and when the cutoff was reached.

    ``failed_s`` is infinite where it was not, and ``soc`` is then that of the plan's end.
    """

    soc: float
    least_V: float
    energy_J: float
    failed_s: float


@rows
def through(
    tables: CellTables,
    state: CellState,
    soc_std: float,
    plan: tuple[FloatArray, FloatArray],
    go: Going,
    uncertain: Uncertain,
    away: Away,
) -> Landing:
    """Carry a cell through a plan; deviations away from the usual as in a forecast at one load.

    Below the cutoff a power is limited to its current at the cutoff.

    Parameters
    ----------
    plan : (n,), (n,)     length of each step [s], its power [W], or its current [A] where ``go``
                          holds no power; positive on discharge
    """
    dt_s, load = plan
    lump, valid = go.lump, uncertain.valid
    begun_soc = min(max(state.soc + away.soc * soc_std, 0.0), 1.0)
    state = with_soc(state, begun_soc)
    known_soc_V = soc_extrapolation_V(valid, begun_soc)
    known_V = math.nan
    warmth = Warmth(go.temperature_C - lump.origin_C, 0.0, 0.0, 0.0)
    here_C = go.temperature_C
    _, point = advance(tables, state, 0.0, 0.0, here_C)
    voltage = point.ocv_V
    least_V, failed_s, soc = voltage, math.inf, begun_soc
    energy_J = time_s = shift_V = 0.0
    for k in range(dt_s.size):
        state_next = state
        current = load[k]
        for _ in range(TURNS if go.hold_power else 1):
            if go.hold_power:
                current = load[k] / max(voltage, go.cutoff_V)
            state_next, point = advance(tables, state, current, dt_s[k], here_C)
            model_V = voltage_of(point, state_next, current)
            held_V = point.ocv_V - model_V
            voltage = model_V + go.offset_V + go.of_polarisation * held_V + shift_V
        if lump.heats:
            lost_W = current * (point.ocv_V - voltage)
            warmth, here_C = warmed_to(lump, warmth, lost_W, dt_s[k], away.warmth)
        beyond_V = extrapolation_V(valid, here_C, current, abs(held_V))
        if known_V != known_V:
            known_V = beyond_V
        if away.voltage != 0.0:
            moved, new_V = abs(begun_soc - state_next.soc), beyond_V - known_V
            off_V = new_error_V(uncertain, point.error_V, held_V, moved, new_V)
            if state_next.soc < valid.soc_low:
                off_V += max(soc_extrapolation_V(valid, state_next.soc) - known_soc_V, 0.0)
            shift_V = away.voltage * off_V
        time_s += dt_s[k]
        energy_J += dt_s[k] * current * voltage
        state = state_next
        least_V = min(least_V, voltage)
        soc = state.soc
        if (voltage <= go.cutoff_V or soc <= 0.0) and failed_s == math.inf:
            failed_s = time_s
    return Landing(soc, least_V, energy_J, failed_s)

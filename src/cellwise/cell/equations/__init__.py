"""The cell's equations, once: simulation, every filter and the protocol runner are made of these.

A model without an effect is a model with that effect's neutral value, so there is one set of
equations. The order of operations is part of them: the same bits come out wherever they are used.
"""

from cellwise.cell.equations.interval import advance, loaded, look_up
from cellwise.cell.equations.load import charge_transfer, transfer_resistance, under_load
from cellwise.cell.equations.lookup import BEYOND, moved, place_of, tables_at
from cellwise.cell.equations.records import (
    CellState,
    CellTables,
    Place,
    Transition,
    at_rest,
    empty_state,
    with_heat,
    with_soc,
)
from cellwise.cell.equations.states import (
    branch_gain,
    charge_used,
    decay,
    hysteresis_decay,
    hysteresis_step,
    rc_step,
    relaxed,
    soc_step,
    states_step,
    transition,
)
from cellwise.cell.equations.surface import followed, slow_step, surface_soc, surfaced
from cellwise.cell.equations.temperature import (
    ZERO_CELSIUS_K,
    arrhenius,
    at_temperature,
    heat_step,
    inverse_kelvin,
    needs_temperature,
    thermal_factor,
)
from cellwise.cell.equations.voltage import (
    drop_of,
    held_in_branches,
    loaded_voltage,
    polarisation,
    seen_current,
    terminal_voltage,
    voltage_of,
)

__all__ = [
    "BEYOND",
    "ZERO_CELSIUS_K",
    "CellState",
    "CellTables",
    "Place",
    "Transition",
    "advance",
    "arrhenius",
    "at_rest",
    "at_temperature",
    "branch_gain",
    "charge_transfer",
    "charge_used",
    "decay",
    "drop_of",
    "empty_state",
    "followed",
    "heat_step",
    "held_in_branches",
    "hysteresis_decay",
    "hysteresis_step",
    "inverse_kelvin",
    "loaded",
    "loaded_voltage",
    "look_up",
    "moved",
    "needs_temperature",
    "place_of",
    "polarisation",
    "rc_step",
    "relaxed",
    "seen_current",
    "slow_step",
    "soc_step",
    "states_step",
    "surface_soc",
    "surfaced",
    "tables_at",
    "terminal_voltage",
    "thermal_factor",
    "transfer_resistance",
    "transition",
    "under_load",
    "voltage_of",
    "with_heat",
    "with_soc",
]

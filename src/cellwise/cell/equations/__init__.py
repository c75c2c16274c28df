"""The cell's equations, once: simulation, every filter and the protocol runner are made of these.

A model without an effect is a model with that effect's neutral value, so there is one set of
equations. The order of operations is part of them: the same bits come out wherever they are used.
"""

from cellwise.cell.equations.interval import advance as advance
from cellwise.cell.equations.interval import loaded as loaded
from cellwise.cell.equations.interval import look_up as look_up
from cellwise.cell.equations.load import transfer_resistance as transfer_resistance
from cellwise.cell.equations.load import under_load as under_load
from cellwise.cell.equations.lookup import BEYOND as BEYOND
from cellwise.cell.equations.records import CellState as CellState
from cellwise.cell.equations.records import CellTables as CellTables
from cellwise.cell.equations.records import Transition as Transition
from cellwise.cell.equations.records import at_rest as at_rest
from cellwise.cell.equations.records import empty_state as empty_state
from cellwise.cell.equations.records import with_heat as with_heat
from cellwise.cell.equations.records import with_soc as with_soc
from cellwise.cell.equations.scalar import charge_transfer as charge_transfer
from cellwise.cell.equations.states import branch_gain as branch_gain
from cellwise.cell.equations.states import charge_used as charge_used
from cellwise.cell.equations.states import decay as decay
from cellwise.cell.equations.states import hysteresis_decay as hysteresis_decay
from cellwise.cell.equations.states import hysteresis_step as hysteresis_step
from cellwise.cell.equations.states import rc_step as rc_step
from cellwise.cell.equations.states import relaxed as relaxed
from cellwise.cell.equations.states import soc_step as soc_step
from cellwise.cell.equations.states import states_step as states_step
from cellwise.cell.equations.states import transition as transition
from cellwise.cell.equations.surface import lagged_current as lagged_current
from cellwise.cell.equations.surface import slow_step as slow_step
from cellwise.cell.equations.surface import surface_soc as surface_soc
from cellwise.cell.equations.temperature import ZERO_CELSIUS_K as ZERO_CELSIUS_K
from cellwise.cell.equations.temperature import at_temperature as at_temperature
from cellwise.cell.equations.temperature import heat_step as heat_step
from cellwise.cell.equations.temperature import inverse_kelvin as inverse_kelvin
from cellwise.cell.equations.temperature import needs_temperature as needs_temperature
from cellwise.cell.equations.temperature import thermal_factor as thermal_factor
from cellwise.cell.equations.voltage import delayed_current as delayed_current
from cellwise.cell.equations.voltage import held_in_branches as held_in_branches
from cellwise.cell.equations.voltage import loaded_voltage as loaded_voltage
from cellwise.cell.equations.voltage import polarisation as polarisation
from cellwise.cell.equations.voltage import polarisation_of as polarisation_of
from cellwise.cell.equations.voltage import terminal_voltage as terminal_voltage
from cellwise.cell.equations.voltage import voltage_of as voltage_of

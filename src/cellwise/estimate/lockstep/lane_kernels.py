"""A filter's state in its lane: number by number, LANES cells side by side."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.packed import lane_record, place_of, put_lane_record, size_of
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.typing import FloatArray

LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler
# Numbers of a block, LANES of each: the state, the Arrhenius factor and the temperature it is of.
FACTOR = size_of(EkfState)
FACTOR_C = FACTOR + 1
FIELDS = FACTOR + 2
SOC, SS = place_of(EkfState, "cell.soc"), place_of(EkfState, "p.ss")
LAST_A, LAST_C = place_of(EkfState, "watch.current_A"), place_of(EkfState, "watch.temperature_C")
EVIDENCE = place_of(EkfState, "watch.evidence_s")
NO_CURRENT = place_of(EkfState, "watch.no_current_s")
NO_VOLTAGE = place_of(EkfState, "watch.no_voltage_s")
FIRST_VARIANCE = place_of(EkfState, "past.first_variance")


@inline
def get_state(block: FloatArray, lane: int) -> EkfState:
    """A cell's state out of its lane."""
    state: EkfState = lane_record(EkfState, block, lane, LANES)
    return state


@inline
def put_state(block: FloatArray, lane: int, state: EkfState, puts: bool) -> None:
    """A cell's state into its lane, or none: without a branch."""
    put_lane_record(block, lane, LANES, state, puts)

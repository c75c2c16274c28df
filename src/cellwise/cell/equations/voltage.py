"""The output: what the terminal shows, and which current it has seen."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations.records import CellState
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled


@inline
def polarisation(r0_ohm: float, current_A: float, fast_V: float, slower_V: float) -> float:
    """What the current takes off the OCV: R0 I + V1, and the slower branches V2 + V3 [V]."""
    return (r0_ohm * current_A + fast_V) + slower_V


@inline
@unrolled
def polarisation_of(point: CellPoint, state: ByState, current_A: float) -> float:
    """The same of a state at one point of the tables [V]."""
    slower_V = sum(state.state[i] for i in BRANCHES[1:])
    return polarisation(point.r0_ohm, current_A, state.v1_V, slower_V)


@inline
@unrolled
def held_in_branches(state: ByState) -> float:
    """What the branches hold in absolute value [V]."""
    held_V: float = abs(state.v1_V) + sum(abs(state.state[i]) for i in BRANCHES[1:])
    return held_V


@inline
def loaded_voltage(ocv_V: float, m_V: float, h: float, polarisation_V: float) -> float:
    """V = OCV + M h - (R0 I + V1 + V2 + V3)."""
    return (ocv_V + m_V * h) - polarisation_V


@inline
def terminal_voltage(point: CellPoint, h: float, polarisation_V: float) -> float:
    """Terminal voltage at one point of the tables [V]."""
    return loaded_voltage(point.ocv_V, point.m_V, h, polarisation_V)


@inline
def delayed_current(cell: CellScalars, current_A: float, previous_A: float, dt_s: float) -> float:
    """Current that the logged voltage has seen: delayed by the instrument's sampling delay.

    Linear between the two last samples; a delay longer than one interval counts as one interval.
    """
    if cell.skew_s <= 0.0 or dt_s <= 0.0:
        return current_A
    w = min(cell.skew_s / dt_s, 1.0)
    return current_A + w * (previous_A - current_A)


@inline
def voltage_of(point: CellPoint, state: CellState, current_A: float) -> float:
    """Terminal voltage of a state under a current [V]."""
    return terminal_voltage(point, state.h, polarisation_of(point, state, current_A))

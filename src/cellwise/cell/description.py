r"""The states of a cell and its filters: what each does over an interval, what voltage it gives.

Over an interval of constant current I every state but the SOC is linear,

.. math:: x_i^{+} = a_i x_i + g_i I, \qquad v = v_0 + \sum_i H_i x_i

so transition, covariance and row of derivatives follow from three names a state: its decay a, its
drive g and its output H. The equations themselves, SOC's among them, stand in
:mod:`cellwise.cell.equations`; what is printed from this table says so in its head.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """One state of a filter.

    Parameters
    ----------
    name : str      field of a state record, with its unit
    letter : str    how its entries of P are called: ``s1``, ``p12``; the SOC's come first
    symbol : str    in formulas
    decay : str     factor over an interval; empty: it stays as it is
    drive : str     what one ampere adds over an interval; empty: nothing
    output : str    derivative of the terminal voltage: ``slope``, ``-1``, ``m``
    option : str    option of the fixed step that compiles it in; empty: always there
    meaning : str   for people
    """

    name: str
    letter: str
    symbol: str
    decay: str
    drive: str
    output: str
    option: str
    meaning: str


SOC = State("soc", "s", "z", "", "gs", "slope", "", "state of charge")
V1 = State("v1_V", "1", "v_1", "a1", "g1", "-1", "", "voltage of the fast branch")
V2 = State("v2_V", "2", "v_2", "a2", "g2", "-1", "", "voltage of the second branch")
V3 = State("v3_V", "3", "v_3", "a3", "g3", "-1", "slow", "voltage of the slow branch")
H = State("h", "h", "h", "ah", "", "m", "hysteresis", "hysteresis, -1 to 1")

CELL = (SOC, V1, V2, V3, H)  # what each filter carries
BRANCHES = (V1, V2, V3)
CARRIED = (SOC, V3)  # so slow that float32 keeps beside them what rounding has left out


def entry(a: State, b: State) -> str:
    """Name of the entry of P of two states, whichever comes first: ``ss``, ``s1``, ``p12``."""
    a, b = sorted((a, b), key=CELL.index)
    return f"s{b.letter}" if a is SOC else f"p{a.letter}{b.letter}"


def carry(state: State) -> str:
    """Name of what rounding has kept from a state: ``soc_carry``, ``v3_carry_V``."""
    name, _, unit = state.name.partition("_")
    return f"{name}_carry_{unit}" if unit else f"{name}_carry"


def triangle(states: tuple[State, ...]) -> tuple[tuple[State, State], ...]:
    """The pairs of the upper triangle, row by row."""
    return tuple((a, b) for i, a in enumerate(states) for b in states[i:])

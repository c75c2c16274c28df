"""What the equations take and give, beside the tables' own row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.packed import changed
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.unrolled import unrolled
from cellwise.typing import FloatArray


class CellTables(NamedTuple):
    """A `CellModel` as the equations see it.

    ``table`` has shape (temperatures, soc points, COLUMNS) over a uniform SOC grid 0..1,
    ``grid_C`` (temperatures,) are its temperatures [degC], ``cell`` the numbers beside it.
    """

    table: FloatArray
    grid_C: FloatArray
    cell: CellScalars


class CellState(NamedTuple):
    """What a cell carries from one interval to the next."""

    soc: float
    v1_V: float
    v2_V: float
    v3_V: float
    h: float
    heat_K: float = 0.0
    slow_A: float = 0.0


class Transition(NamedTuple):
    """An interval of constant current: factors a on the states, what one ampere adds g."""

    a1: float
    a2: float
    a3: float
    ah: float
    gs: float
    g1: float
    g2: float
    g3: float


class Place(NamedTuple):
    """Where in the packed table one SOC and temperature lie.

    Between SOC points k and k + 1, temperatures lo and lo + 1: f of the way for columns that go on
    beyond 0..1, g for the others, w of the way in temperature.
    """

    lo: np.uint64
    k: np.uint64
    f: float
    g: float
    w: float


@inline
def with_soc(x: CellState, soc: float) -> CellState:
    """The same state at another SOC."""
    return changed(x, "soc", soc)


@inline
def with_heat(x: CellState, heat_K: float) -> CellState:
    """The same state, warmer or colder."""
    return changed(x, "heat_K", heat_K)


@inline
@unrolled
def at_rest(soc: float, h: float) -> CellState:
    """A cell whose load was off for long."""
    return CellState(soc, *(0.0 for i in BRANCHES), h, 0.0, 0.0)  # type: ignore[call-arg]


def empty_state(soc: float, h: float = 0.0) -> CellState:
    """A cell at rest at the given SOC."""
    return CellState(float(soc), *(0.0 for _ in BRANCHES), float(h))  # type: ignore[call-arg]

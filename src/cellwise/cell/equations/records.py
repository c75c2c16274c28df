"""What the equations take and give, beside the tables' own row."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeAlias

import numpy as np

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, CELL
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


if TYPE_CHECKING:
    Transition: TypeAlias = Any

    class CellState(tuple[float, ...]):
        """What a cell carries from one interval to the next: every state by its name, then these.

        ``heat_K`` is its own warmth, ``slow_A`` the current behind the surface's lag.
        """

        soc: float
        v1_V: float
        v2_V: float
        v3_V: float
        h: float
        heat_K: float
        slow_A: float
        _fields: ClassVar[tuple[str, ...]]

        def __new__(cls, *numbers: float) -> Self:
            """The states in the order of the table; the others 0 unless given."""

        @classmethod
        def _make(cls, numbers: Iterable[float]) -> Self: ...

        def _replace(self, **numbers: float) -> Self: ...

else:
    CellState = NamedTuple(
        "CellState", [*((s.name, float) for s in CELL), ("heat_K", float), ("slow_A", float)]
    )
    CellState.__new__.__defaults__ = (0.0, 0.0)
    # An interval of constant current: factors a on the states, what one ampere adds g.
    Transition = NamedTuple(
        "Transition",
        [(s.decay, float) for s in CELL if s.decay] + [(s.drive, float) for s in CELL if s.drive],
    )


class TablePlace(NamedTuple):
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
    return CellState(soc, *(0.0 for i in BRANCHES), h, 0.0, 0.0)


def empty_state(soc: float, h: float = 0.0) -> CellState:
    """A cell at rest at the given SOC."""
    return CellState(float(soc), *(0.0 for _ in BRANCHES), float(h))

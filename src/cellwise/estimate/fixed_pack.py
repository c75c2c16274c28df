"""A pack in the fixed step: the mean cell's filter and the difference of every cell, as in C."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellwise.arguments import shown
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.filters.kalman import one_reading
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import CAPABILITY, CELL, CELL_OUTPUT, INPUT
from cellwise.estimate.fixed.options import MOST_CELLS
from cellwise.estimate.fixed.stepper import (
    Stepper,
    check_record,
    info_of,
    sequence_number,
    start_state,
)


class FixedPackState(NamedTuple):
    """One record of the mean cell, and one for each cell: what a target keeps."""

    mean: NDArray[Any]
    cells: NDArray[Any]


class FixedPack:
    """The fixed step over a pack of cells in series.

    Parameters
    ----------
    filter_ : FixedStep      made with ``cells=CellSettings(...)``; `Firmware` for the C
    cells : int              in series, 2 to 1000

    Raises
    ------
    InputError        a filter without cells, a number of cells that no pack has
    """

    def __init__(self, filter_: FixedStep, cells: int) -> None:
        if not isinstance(filter_, FixedStep) or filter_.cell_settings is None:
            raise InputError(
                f"{shown(filter_)} for a pack",
                "a FixedStep or Firmware that follows cells",
                "Make it with FixedStep(model, dt_s=1.0, cells=CellSettings()).",
            )
        if isinstance(cells, bool) or not isinstance(cells, int) or not 2 <= cells <= MOST_CELLS:
            raise InputError(
                f"{shown(cells)} cells in a pack",
                f"a whole number from 2 to {MOST_CELLS}",
                "Give how many are in series.",
            )
        self.filter = filter_
        self.count = cells

    def init(self, soc0: float, soc0_std: float = 0.15) -> FixedPackState:
        """A pack at rest: its mean cell at ``soc0``, known to ``soc0_std``."""
        stepper = self._stepper()
        cells = np.zeros(self.count, dtype=CELL)
        stepper.call("start_cells", cells, self.count)
        return FixedPackState(start_state(stepper, soc0, soc0_std), cells)

    def step(
        self,
        state: FixedPackState,
        current_A: float,
        cell_V: ArrayLike,
        temperature_C: float | None = None,
        *,
        sequence: int,
    ) -> EkfInfo:
        """Take the sample of one time step; both parts of the state are stepped in place.

        Parameters
        ----------
        cell_V : (cells,) float      NaN for a cell without a reading, or while it is balanced

        Raises
        ------
        InputError        another number of voltages, a state of another type
        """
        stepper = self._stepper()
        self._check(state, stepper)
        try:
            voltages = np.asarray(cell_V, dtype=np.float32)
        except (TypeError, ValueError):
            voltages = np.empty(0, dtype=np.float32)
        if voltages.shape != (self.count,):
            raise InputError(
                f"cell_V = {shown(cell_V)}",
                f"numbers of shape ({self.count},): one for each cell",
                "Give NaN for a cell without a reading.",
            )
        warm = self.filter.temperature_or_usual_C(temperature_C)
        sample = np.zeros(1, dtype=INPUT)
        sample["current_A"] = one_reading("current_A", current_A, "ampere")
        sample["temperature_C"] = one_reading("temperature_C", warm, "degC")
        sample["sequence"] = sequence_number(sequence)
        out = stepper.pack_rows(state.mean, state.cells, sample, voltages[None, :])[0]
        return info_of(out, self.filter.noise)

    def cells(self, state: FixedPackState) -> NDArray[Any]:
        """What is known of every cell: records of ``layout.CELL_OUTPUT``, shape (cells,)."""
        stepper = self._stepper()
        self._check(state, stepper)
        handed = state.mean, state.cells, self.count
        return stepper.answer("cells_of", CELL_OUTPUT, *handed, count=self.count)

    def power(self, state: FixedPackState) -> NDArray[Any]:
        """State of power of the pack as its weakest cell allows: one record of CAPABILITY [W].

        Raises
        ------
        InputError        the filter was made without ``power``
        """
        stepper = self._stepper()
        self._check(state, stepper)
        handed = state.mean, state.cells, self.count
        return stepper.need("power").answer("pack_power", CAPABILITY, *handed)

    def _stepper(self) -> Stepper:
        return self.filter.stepper(self.filter.known_dt_s)

    def _check(self, state: FixedPackState, stepper: Stepper) -> None:
        """Refuse what is no state of this pack: the kernel would read past it."""
        if not isinstance(state, FixedPackState):
            raise InputError(
                f"state = {shown(state)}",
                "a PackState, as init(soc0) gives it",
                "Begin with init(soc0), and pass on its own.",
            )
        mean, cells = state
        check_record(mean, stepper.tables, self.filter.name)
        if not (isinstance(cells, np.ndarray) and cells.dtype == CELL) or cells.size != self.count:
            raise InputError(
                f"cells = {shown(cells)}",
                f"{self.count} records of {CELL.itemsize} bytes, as init(soc0) gives them",
                "Begin with init(soc0), and pass on its own.",
            )

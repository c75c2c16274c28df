"""Many cells of one kind in lockstep: one EKF each, one call per sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cellwise.arguments import number, numbers
from cellwise.cell.compiled import announce, for_kernel
from cellwise.cell.model import CellModel, check_is_model
from cellwise.errors import InputError
from cellwise.estimate import lockstep_kernels as layout
from cellwise.estimate.filters.filter_state import OUTPUTS, EkfState, ekf_start
from cellwise.estimate.filters.kalman import Ekf, check_state
from cellwise.estimate.lockstep_kernels import LockstepRules, lockstep
from cellwise.estimate.noise import Noise
from cellwise.typing import BoolArray, FloatArray, IntArray


class LockstepState(NamedTuple):
    """What must be carried of ``cells`` cells; ``blocks`` holds them side by side."""

    blocks: FloatArray
    cells: int


class LockstepInfo(NamedTuple):
    """What may be looked at after a step, shape (cells,) each, as in ``EkfInfo``.

    ``short`` counts the cells whose step was plain: SOC well known, nothing missing, nothing
    rejected. The arrays are the filter's own and are overwritten by its next step.
    """

    soc: FloatArray
    soc_std: FloatArray
    voltage_V: FloatArray
    innovation_V: FloatArray
    innovation_variance_V2: FloatArray
    test_ratio: FloatArray
    status: IntArray
    short: int


class LockstepEkf:
    """The EKF for many cells of one model at one time step.

    Parameters
    ----------
    model : CellModel
    cells : int               how many
    dt_s : float              time between samples [s]
    noise : Noise or None     None: from the model's own validation error

    Notes
    -----
    Each cell's estimate is that of :class:`~cellwise.estimate.filters.kalman.Ekf`, to rounding.

    Examples
    --------
    >>> fleet = LockstepEkf(model, cells=10_000, dt_s=1.0)              # doctest: +SKIP
    >>> state = fleet.init(soc0=0.8, soc0_std=0.1)                      # doctest: +SKIP
    >>> state, info = fleet.step(state, current_A, voltage_V, 25.0)     # doctest: +SKIP
    """

    name = "lockstep-ekf"

    def __init__(
        self, model: CellModel, cells: int, dt_s: float, noise: Noise | None = None
    ) -> None:
        check_is_model(model)
        if number("cells", cells, "how many", "Give their number.") < 1:
            raise InputError(f"{cells} cells", "at least one", "Give their number.")
        expected, way_out = "seconds above zero", "Pass the time step."
        if not 0.0 < number("dt_s", dt_s, expected, way_out) < np.inf:
            raise InputError(f"dt_s = {dt_s}", expected, way_out)
        self.model, self.cells, self.dt_s = model, int(cells), float(dt_s)
        self._ekf = Ekf(model, noise)
        self.noise = self._ekf.noise
        self._tables = model.parameters()
        self._noise = self.noise.scalars(model)
        self._rules = LockstepRules(*self._ekf.start(0.5, 0.3), self.cells, self.dt_s)
        self._blocks = -(-self.cells // layout.LANES)
        self._scratch = np.zeros(layout.SCRATCH_ROWS * layout.LANES)
        self._out = np.zeros((OUTPUTS, self.cells))
        self._status = np.zeros(self.cells, dtype=np.int32)
        self._no_gap = np.zeros(self.cells, dtype=np.bool_)

    def init(self, soc0: ArrayLike, soc0_std: ArrayLike = 0.15) -> LockstepState:
        """Cells at ``soc0``, known to ``soc0_std``; one number for all, or one each.

        Raises
        ------
        InputError        soc0 outside 0..1, soc0_std not above zero, another number of cells
        """
        starts = np.stack([self._each(soc0, "soc0"), self._each(soc0_std, "soc0_std")], axis=1)
        fields = np.zeros((self._blocks, layout.FIELDS, layout.LANES))
        different, which = np.unique(starts, axis=0, return_inverse=True)
        for k, one in enumerate(different.tolist()):
            cells = np.flatnonzero(which.ravel() == k)
            row = ekf_start(self._ekf.start(*one), 0.0).row()
            fields[cells // layout.LANES, :, cells % layout.LANES] = row
        return LockstepState(fields.ravel(), self.cells)

    def step(
        self,
        state: LockstepState,
        current_A: ArrayLike,
        voltage_V: ArrayLike,
        temperature_C: ArrayLike | None = None,
        *,
        gap: BoolArray | None = None,
    ) -> tuple[LockstepState, LockstepInfo]:
        """Take the sample of every cell that ends an interval of ``dt_s``; steps in place.

        Parameters
        ----------
        current_A, voltage_V : (cells,) float     positive current is discharge; NaN: missing
        temperature_C : (cells,) float, float or None
        gap : (cells,) bool or None               nobody knows what flowed in this interval

        Raises
        ------
        InputError        arrays of another length or type, a state of another number of cells
        """
        check_state(state, LockstepState, self.name)
        if state.cells != self.cells:
            raise InputError(f"a state of {state.cells} cells", f"{self.cells}", "Pass its own.")
        warm = np.nan if temperature_C is None else temperature_C
        samples = (
            self._each(current_A, "current_A"),
            self._each(voltage_V, "voltage_V"),
            self._each(warm, "temperature_C"),
        )
        gaps = self._no_gap
        if gap is not None:
            gaps = np.array(np.broadcast_to(gap, self.cells), dtype=np.bool_)
        announce(lockstep, "the lockstep filter")
        short = lockstep(
            self._tables,
            self._noise,
            self._rules,
            state.blocks,
            self._scratch,
            *samples,
            gaps,
            self._out,
            self._status,
        )
        return state, LockstepInfo._make((*self._out, self._status, int(short)))

    def cell_state(self, state: LockstepState, cell: int) -> EkfState:
        """One cell's state as the EKF carries it."""
        block, lane = divmod(range(self.cells)[cell], layout.LANES)
        fields = state.blocks.reshape(-1, layout.FIELDS, layout.LANES)
        return EkfState.of_row(fields[block, :, lane])

    def _each(self, values: ArrayLike, name: str) -> FloatArray:
        array = numbers(name, values)
        if array.ndim == 0:
            return np.full(self.cells, float(array))
        if array.shape != (self.cells,):
            raise InputError(
                f"{name} of shape {array.shape}", f"({self.cells},), one value per cell", "Correct."
            )
        return for_kernel(array)

"""Many cells of one kind in lockstep: one EKF each, one call per sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cellwise.arguments import number, numbers
from cellwise.cell.compiled import announce
from cellwise.cell.effects import (
    ChargeAsymmetry,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SlowDiffusion,
    TimeSkew,
    beside_common_activation,
)
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.point_kernels import ERROR, OCV, R0, R1, R2, R3, TAU1, TAU2, TAU3, M
from cellwise.errors import InputError
from cellwise.estimate.filters.filter_state import OUTPUTS, EkfState, ekf_start
from cellwise.estimate.filters.kalman import Ekf, check_state
from cellwise.estimate.lockstep import block_kernels as layout
from cellwise.estimate.lockstep.block_kernels import begin_lane, state_of
from cellwise.estimate.lockstep.plain_kernels import LockstepRules, lockstep
from cellwise.estimate.noise import Noise
from cellwise.typing import BoolArray, FloatArray, IntArray

FINER = 4  # points of the table of one time step per point of the model's
LEAST_POINTS = 401
# What the short way holds beside the factor that all resistances have in common.
SHORT_WAY = (
    SlowDiffusion,
    Hysteresis,
    TimeSkew,
    RateDependence,
    ChargeAsymmetry,
    SelfDischarge,
)


class LockstepState(NamedTuple):
    """What must be carried of ``cells`` cells; ``blocks`` holds them side by side."""

    blocks: FloatArray
    cells: int


class LockstepInfo(NamedTuple):
    """What may be looked at after a step, shape (cells,) each, as in ``EkfInfo``.

    ``short`` counts the cells whose step was plain. The arrays are the filter's own and are
    overwritten by its next step.
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
    Each cell's estimate is that of :class:`~cellwise.estimate.filters.kalman.Ekf` but for the
    look-up of what depends on the time step, tabulated on a finer grid over SOC.

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
        self._fast = step_table(self._tables.table, self.dt_s)
        unknown = self._ekf.start(0.5, 0.3)
        self._noise = self.noise.scalars(model)
        self._rules = LockstepRules(*unknown, self.cells, self.dt_s, _is_beyond(model))
        padded = -(-self.cells // layout.LANES) * layout.LANES
        self._scratch = np.zeros(layout.SCRATCH_ROWS * layout.LANES)
        self._scratch.reshape(-1, layout.LANES)[layout.T_A3] = 1.0  # a third branch that is none
        # Lanes that no cell fills rest at half charge.
        self._samples = np.zeros((3, padded))
        self._samples[1] = float(np.interp(0.5, model.soc, model.ocv_V[0]))
        self._out = np.zeros((OUTPUTS, padded))
        self._status = np.zeros(padded, dtype=np.int32)
        self._gap = np.zeros(padded, dtype=np.bool_)

    def init(self, soc0: ArrayLike, soc0_std: ArrayLike = 0.15) -> LockstepState:
        """Cells at ``soc0``, known to ``soc0_std``; one number for all, or one each.

        Raises
        ------
        InputError        soc0 outside 0..1, soc0_std not above zero, another number of cells
        """
        starts = self._each(soc0, "soc0"), self._each(soc0_std, "soc0_std")
        blocks = self._status.size // layout.LANES
        state = np.zeros(blocks * layout.FIELDS * layout.LANES)
        fields = state.reshape(blocks, layout.FIELDS, layout.LANES)
        known: dict[tuple[float, float], FloatArray] = {}
        every = [*zip(*(a.tolist() for a in starts), strict=True)]
        for k, one in enumerate(every + [(0.5, 0.15)] * (self._status.size - self.cells)):
            if one not in known:
                room = np.zeros(layout.FIELDS * layout.LANES)
                begin_lane(room, 0, ekf_start(self._ekf.start(*one), 0.0))
                known[one] = room.reshape(layout.FIELDS, layout.LANES)[:, 0]
                known[one][layout.FACTOR :] = 1.0, np.nan
            block, lane = divmod(k, layout.LANES)
            fields[block, :, lane] = known[one]
        return LockstepState(state, self.cells)

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
            self._channel(0, current_A, "current_A"),
            self._channel(1, voltage_V, "voltage_V"),
            self._channel(2, warm, "temperature_C"),
        )
        self._gap[: self.cells] = False if gap is None else gap
        announce(lockstep, "the lockstep filter")
        short = lockstep(
            self._tables,
            self._fast,
            self._noise,
            self._rules,
            state.blocks,
            self._scratch,
            *samples,
            self._gap,
            self._out.ravel(),
            self._status,
        )
        shown_now = self._out[:, : self.cells]
        info = LockstepInfo._make((*shown_now, self._status[: self.cells], int(short)))
        return state, info

    def cell_state(self, state: LockstepState, cell: int) -> EkfState:
        """One cell's state as the EKF carries it."""
        block, lane = divmod(range(self.cells)[cell], layout.LANES)
        size = layout.FIELDS * layout.LANES
        return state_of(state.blocks[block * size : (block + 1) * size], lane)

    def _each(self, values: ArrayLike, name: str) -> FloatArray:
        array = numbers(name, values)
        if array.ndim == 0:
            return np.full(self.cells, float(array))
        if array.shape != (self.cells,):
            raise InputError(
                f"{name} of shape {array.shape}", f"({self.cells},), one value per cell", "Correct."
            )
        return array

    def _channel(self, row: int, values: ArrayLike, name: str) -> FloatArray:
        """One value per lane; the caller's own array where it fills every lane."""
        array = numbers(name, values)
        if array.ndim == 0:
            self._samples[row, : self.cells] = array
            return np.asarray(self._samples[row])
        array = self._each(array, name)
        if self._status.size == self.cells:
            return np.ascontiguousarray(array)
        self._samples[row, : self.cells] = array
        return np.asarray(self._samples[row])


def _is_beyond(model: CellModel) -> bool:
    """Whether an effect has no place in the short way."""
    return any(not isinstance(e, SHORT_WAY) for e in beside_common_activation(model.effects))


def step_table(table: FloatArray, dt_s: float) -> FloatArray:
    """What one time step needs over SOC, on a finer grid.

    Shape (temperatures x points x columns,).

    OCV, R0, M and error are linear between the model's points, so a finer grid does not change
    them; the decays are exact at every point of it.
    """
    n = table.shape[1]
    finer = max(FINER, -(-LEAST_POINTS // max(n - 1, 1)))
    grid, fine = np.arange(float(n)), np.linspace(0.0, n - 1.0, finer * (n - 1) + 1)
    columns = []
    for rows in table:
        at = {c: np.interp(fine, grid, rows[:, c]) for c in range(table.shape[2])}
        parts = [at[OCV], at[R0]]
        for r, tau in ((R1, TAU1), (R2, TAU2), (R3, TAU3)):
            a = np.exp(-dt_s / at[tau]) if np.any(at[r]) else np.ones_like(fine)
            if r == R3:
                parts.append(at[ERROR])
            parts += [a, at[r] * (1.0 - a), at[r] ** 2 * (1.0 - a * a)]
        parts.append(at[M])
        parts += [np.zeros_like(fine)] * (layout.TABLE_COLUMNS - len(parts))
        columns.append(np.stack(parts, axis=-1))
    return np.stack(columns).ravel()

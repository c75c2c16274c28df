"""Many cells of one kind in lockstep: one EKF each, side by side in vector registers.

State lies in blocks of LANES cells, number by number. Each lane reads its sample and looks up its
tables by itself; what follows, the filter's own prediction, innovation, gate and update, is one
loop over the lanes without a branch, which compiles to vector instructions. A cell whose step is
not plain (SOC badly known, a reading that is missing, a voltage beyond the gate) takes the EKF's
step after that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cellwise.arguments import number, numbers
from cellwise.cell.compiled import announce, for_kernel, inline, kernel, rows
from cellwise.cell.equations import (
    CellTables,
    heat_step,
    loaded,
    polarisation_of,
    slow_step,
    soc_step,
    states_step,
    transition,
    with_heat,
)
from cellwise.cell.model import CellModel
from cellwise.cell.packed import put_record, record_at, size_of
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.cell.plausibility.validity_kernels import is_outside
from cellwise.cell.point_kernels import CellPoint
from cellwise.errors import InputError
from cellwise.estimate.equations.constants import WIDE_VARIANCE
from cellwise.estimate.evidence_kernels import gate, step_constants
from cellwise.estimate.filters.bank_kernels import empty_bank, is_spread
from cellwise.estimate.filters.covariance_kernels import decayed, no_branches
from cellwise.estimate.filters.filter_state import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
    OUTPUTS,
    EkfInfo,
    EkfStart,
    EkfState,
    ekf_start,
)
from cellwise.estimate.filters.kalman import BankState, Ekf, check_state
from cellwise.estimate.filters.kalman_kernels import bank_or_alone
from cellwise.estimate.filters.offset_kernels import counted_on
from cellwise.estimate.filters.predict_kernels import PredictedInterval, with_noise
from cellwise.estimate.filters.step_kernels import innovate, report
from cellwise.estimate.filters.update_kernels import Predicted, update
from cellwise.estimate.noise import Noise, NoiseScalars
from cellwise.estimate.sensing_kernels import CheckedReading, MeasuredSample, read_sample
from cellwise.estimate.slopes_kernels import tangent
from cellwise.typing import BoolArray, FloatArray, IntArray

LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler


class Lane(NamedTuple):
    """What one cell has read, and the tables at its SOC after the interval."""

    current_A: float
    delayed_current_A: float
    voltage_V: float
    temperature_C: float
    no_warm_s: float
    soc: float
    slow_A: float
    point: CellPoint


# Rows of the scratch of a block, LANES of each: what was read, whether the step is plain, what is
# reported, the status. All in one array: LLVM gives up checking more of them for overlaps ("too
# many memory checks needed"), and then vectorises nothing.
FIELDS = size_of(EkfState)
PLAIN = size_of(Lane)
OUT = PLAIN + 1
STATUS = OUT + OUTPUTS
SCRATCH_ROWS = STATUS + 1


@inline
def get_state(block: FloatArray, lane: int) -> EkfState:
    """A cell's state out of its lane."""
    state: EkfState = record_at(EkfState, block, lane, LANES)
    return state


@inline
def put_info(work: FloatArray, lane: int, info: EkfInfo) -> None:
    """What there is to report of one lane."""
    work[(OUT + OUT_SOC) * LANES + lane] = info.soc
    work[(OUT + OUT_STD) * LANES + lane] = info.soc_std
    work[(OUT + OUT_VOLTAGE) * LANES + lane] = info.voltage_V
    work[(OUT + OUT_INNOVATION) * LANES + lane] = info.innovation_V
    work[(OUT + OUT_VARIANCE) * LANES + lane] = info.innovation_variance_V2
    work[(OUT + OUT_RATIO) * LANES + lane] = info.test_ratio
    work[STATUS * LANES + lane] = info.status


@inline
def read_lane(
    tables: CellTables,
    noise: NoiseScalars,
    start: EkfStart,
    old: EkfState,
    sample: MeasuredSample,
    work: FloatArray,
    lane: int,
) -> None:
    """A cell's sample and its tables; whether its step is plain so far."""
    cell, w = tables.cell, old.watch
    reading = read_sample(tables, noise, w, start.temperature_C, sample)
    soc = soc_step(cell, old.cell.soc, reading.counted_current_A, reading.dt_s)
    plain = reading.status == 0 and math.isfinite(reading.voltage_V) and math.isfinite(soc)
    plain &= (w.evidence_s >= 0.0) & (w.no_voltage_s == 0.0) & (w.no_current_s == 0.0)
    plain &= (old.p.ss <= WIDE_VARIANCE) & (reading.no_warm_s <= 0.0)
    plain = plain and not is_outside(
        noise.valid, soc, reading.temperature_C, reading.delayed_current_A
    )
    work[PLAIN * LANES + lane] = 1.0 if plain else 0.0
    if plain:
        slow = slow_step(cell, old.cell.slow_A, reading.counted_current_A, reading.dt_s)
        point = loaded(
            tables, soc, reading.temperature_C + old.cell.heat_K, reading.delayed_current_A, slow
        )
        read = Lane(
            reading.current_A,
            reading.delayed_current_A,
            reading.voltage_V,
            reading.temperature_C,
            reading.no_warm_s,
            soc,
            slow,
            point,
        )
        put_record(work, lane, LANES, read, True)


@inline
def plain_step(
    tables: CellTables, noise: NoiseScalars, old: EkfState, lane: Lane, dt_s: float
) -> tuple[EkfState, EkfInfo, bool]:
    """The EKF's step where SOC is well known; whether gate and sensors allow it."""
    cell, point, current_A = tables.cell, lane.point, lane.delayed_current_A
    # fmt: off
    reading = CheckedReading(
        lane.current_A, current_A, current_A, 0.0, 0.0, lane.voltage_V, lane.temperature_C, 0.0,
        lane.no_warm_s, dt_s, False, 0,
    )
    t = transition(cell, point, current_A, dt_s)
    end = states_step(old.cell, t, current_A, lane.soc, lane.slow_A)
    interval = PredictedInterval(old.cell, point, t, end, lane.temperature_C, no_branches(), 0)
    c = step_constants(cell, noise, dt_s)
    p = with_noise(decayed(old.p, t), c, noise, reading, interval, 0.0, tables.cell.charge_As)
    polarisation_V = polarisation_of(point, end, current_A)
    x = with_heat(end, heat_step(cell, end.heat_K, current_A, polarisation_V, dt_s))
    bias_soc = old.drift.believed * old.drift.reach
    drift = counted_on(noise, old.drift, t, cell.charge_As, dt_s, reading.current_A)
    predicted = Predicted(
        old, x, p, point, tangent(point.ocv_slope_V, 0.0), lane.temperature_C,
        old.watch.evidence_s, drift, None, bias_soc, 0,
    )
    # fmt: on
    innovation = innovate(c, tables, noise, None, reading, predicted)
    gate_result = gate(c, noise, old, reading, predicted.evidence_s, point.r0_ohm, innovation)
    after, info = report(
        innovation,
        gate_result,
        update(c, noise, None, reading, predicted, innovation, gate_result),
        gate_result.status,
    )
    return after, info, gate_result.accepted


@inline
def plain_block(
    tables: CellTables, noise: NoiseScalars, block: FloatArray, work: FloatArray, dt_s: float
) -> None:
    """The plain lanes of a block; the others keep their state."""
    for k in range(LANES):
        read: Lane = record_at(Lane, work, k, LANES)
        new, info, fits = plain_step(tables, noise, get_state(block, k), read, dt_s)
        plain = (work[PLAIN * LANES + k] > 0.0) & fits
        work[PLAIN * LANES + k] = 1.0 if plain else 0.0
        put_record(block, k, LANES, new, plain)
        put_info(work, k, info)


class Banks(NamedTuple):
    """Memory for the components of every cell (cells, ...), used where ``spread`` (cells,) is."""

    states: FloatArray
    spread: BoolArray


@kernel
def full_lane(
    tables: CellTables,
    noise: NoiseScalars,
    start: EkfStart,
    block: FloatArray,
    lane: int,
    sample: MeasuredSample,
    work: FloatArray,
    bank: FloatArray,
) -> None:
    """The EKF's own step for one lane; ``bank`` is its memory while its components are stepped."""
    if not is_spread(bank):
        put_record(bank[0], 0, 1, get_state(block, lane), True)
    state, _, info = bank_or_alone(tables, noise, None, None, start, bank, None, sample)
    put_record(block, lane, LANES, state, True)
    put_info(work, lane, info)


class LockstepRules(NamedTuple):
    """What stays from step to step: where a state begins, how many cells are real, the time.

    Flat, since Python hands it over with every step, and takes longer over records within records.
    """

    soc: float
    variance: float
    hysteresis_variance: float
    temperature_C: float
    cells: int
    dt_s: float


@rows
def lockstep(
    tables: CellTables,
    noise: NoiseScalars,
    rules: LockstepRules,
    state: FloatArray,
    work: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    gap: BoolArray,
    banks: Banks,
    out: FloatArray,
    status: IntArray,
) -> int:
    """One sample of every cell; how many had a plain step.

    ``state`` is in blocks of LANES cells with FIELDS rows each; the samples have one value for
    each of the ``rules.cells``, ``out`` (OUTPUTS, cells) and ``status`` likewise. ``work`` is
    scratch for one block; ``banks`` the components of cells whose SOC is not known.
    """
    soc0, variance, hysteresis_variance, unknown_C, cells, dt_s = rules
    start = EkfStart(soc0, variance, hysteresis_variance, unknown_C)
    short = 0
    for first in range(0, cells, LANES):
        # Slices: offsets into them are known to be positive, without which nothing is vectorised.
        block = state[first * FIELDS : (first + LANES) * FIELDS]
        lanes = min(LANES, cells - first)
        for k in range(lanes):
            at = first + k
            sample = MeasuredSample(current_A[at], voltage_V[at], temperature_C[at], dt_s, gap[at])
            read_lane(tables, noise, start, get_state(block, k), sample, work, k)
            if banks.spread[at]:
                work[PLAIN * LANES + k] = 0.0
        plain_block(tables, noise, block, work, dt_s)
        for k in range(lanes):
            at = first + k
            if work[PLAIN * LANES + k] > 0.0:
                short += 1
            else:
                sample = MeasuredSample(
                    current_A[at], voltage_V[at], temperature_C[at], dt_s, gap[at]
                )
                full_lane(tables, noise, start, block, k, sample, work, banks.states[at])
                banks.spread[at] = is_spread(banks.states[at])
            for row in range(OUTPUTS):
                out[row, at] = work[(OUT + row) * LANES + k]
            status[at] = int(work[STATUS * LANES + k])
    return short


class LockstepState(NamedTuple):
    """What must be carried of ``cells`` cells; ``blocks`` holds them side by side.

    ``banks`` is memory for the components of each cell.
    """

    blocks: FloatArray
    cells: int
    banks: Banks


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
        self._blocks = -(-self.cells // LANES)
        self._scratch = np.zeros(SCRATCH_ROWS * LANES)
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
        fields = np.zeros((self._blocks, FIELDS, LANES))
        different, which = np.unique(starts, axis=0, return_inverse=True)
        for k, one in enumerate(different.tolist()):
            cells = np.flatnonzero(which.ravel() == k)
            row = ekf_start(self._ekf.start(*one), 0.0).row()
            fields[cells // LANES, :, cells % LANES] = row
        banks = np.zeros((self.cells, *empty_bank().shape))
        spread = np.zeros(self.cells, dtype=np.bool_)
        return LockstepState(fields.ravel(), self.cells, Banks(banks, spread))

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
            state.banks,
            self._out,
            self._status,
        )
        return state, LockstepInfo._make((*self._out, self._status, int(short)))

    def cell_state(self, state: LockstepState, cell: int) -> EkfState:
        """One cell's state as the EKF carries it."""
        block, lane = divmod(range(self.cells)[cell], LANES)
        if state.banks.spread[cell]:
            return BankState.of_bank(state.banks.states[cell].copy())
        fields = state.blocks.reshape(-1, FIELDS, LANES)
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

"""One cell of a fleet through the EKF's own step."""

from __future__ import annotations

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import CellTables
from cellwise.estimate.filters.filter_state import (
    OUT_INNOVATION,
    OUT_RATIO,
    OUT_SOC,
    OUT_STD,
    OUT_VARIANCE,
    OUT_VOLTAGE,
    EkfInfo,
    EkfStart,
    EkfState,
)
from cellwise.estimate.filters.kalman_kernels import kalman_step
from cellwise.estimate.lockstep.lane_kernels import LANES, get_state, put_state
from cellwise.estimate.lockstep.layout import W_OUT
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Reading
from cellwise.typing import FloatArray


@inline
def put_info(work: FloatArray, lane: int, info: EkfInfo) -> None:
    """What there is to report of one lane."""
    work[(W_OUT + OUT_SOC) * LANES + lane] = info.soc
    work[(W_OUT + OUT_STD) * LANES + lane] = info.soc_std
    work[(W_OUT + OUT_VOLTAGE) * LANES + lane] = info.voltage_V
    work[(W_OUT + OUT_INNOVATION) * LANES + lane] = info.innovation_V
    work[(W_OUT + OUT_VARIANCE) * LANES + lane] = info.innovation_variance_V2
    work[(W_OUT + OUT_RATIO) * LANES + lane] = info.test_ratio


@kernel
def full_lane(
    tables: CellTables,
    noise: NoiseScalars,
    start: EkfStart,
    block: FloatArray,
    lane: int,
    reading: Reading,
    work: FloatArray,
) -> int:
    """The EKF's own step for one lane; its status."""
    state, info = kalman_step(tables, noise, None, start, get_state(block, lane), reading)
    put_state(block, lane, state, True)
    put_info(work, lane, info)
    return int(info.status)


@kernel
def begin_lane(block: FloatArray, lane: int, state: EkfState) -> None:
    """A state into its lane."""
    put_state(block, lane, state, True)


@kernel
def state_of(block: FloatArray, lane: int) -> EkfState:
    """A state out of its lane."""
    return get_state(block, lane)

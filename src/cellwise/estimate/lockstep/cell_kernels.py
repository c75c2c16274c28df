"""One cell of a fleet through the EKF's own step."""

from __future__ import annotations

from numba import njit

from cellwise.cell.kernels import CellScalars
from cellwise.estimate.filters.ekf_kernels import ekf_step
from cellwise.estimate.filters.filter_state import EkfStart, EkfState
from cellwise.estimate.lockstep.layout import (
    CURRENT,
    EVIDENCE,
    FACTOR,
    FROZEN_A,
    HEAT,
    LANES,
    LASTING,
    MISMATCH,
    NO_CURRENT,
    NO_VOLTAGE,
    O_INNOVATION,
    O_RATIO,
    O_SOC,
    O_STD,
    O_VARIANCE,
    O_VOLTAGE,
    P1H,
    P2H,
    P3H,
    P11,
    P12,
    P13,
    P22,
    P23,
    P33,
    PHH,
    REJECTIONS,
    REPEATS,
    S1,
    S2,
    S3,
    SH,
    SOC,
    SS,
    V1,
    V2,
    V3,
    VOLTAGE,
    WARM,
    H,
)
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import Watch
from cellwise.typing import FloatArray


@njit(cache=True, error_model="numpy")
def full_lane(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    noise: NoiseScalars,
    anew: EkfStart,
    block: FloatArray,
    lane: int,
    current_A: float,
    voltage_V: float,
    temperature_C: float,
    dt_s: float,
    gap: bool,
    out: FloatArray,
) -> int:
    """The EKF's own step for one lane; its status."""
    at = lane
    # fmt: off
    watch = Watch(
        block[at + CURRENT * LANES], block[at + WARM * LANES], block[at + EVIDENCE * LANES],
        block[at + NO_CURRENT * LANES], block[at + NO_VOLTAGE * LANES],
        block[at + VOLTAGE * LANES], block[at + FROZEN_A * LANES], block[at + REPEATS * LANES],
    )
    x = EkfState(
        block[at + SOC * LANES], block[at + V1 * LANES], block[at + V2 * LANES],
        block[at + V3 * LANES], block[at + H * LANES],
        block[at + SS * LANES], block[at + S1 * LANES], block[at + S2 * LANES],
        block[at + S3 * LANES], block[at + SH * LANES],
        block[at + P11 * LANES], block[at + P12 * LANES], block[at + P13 * LANES],
        block[at + P1H * LANES], block[at + P22 * LANES], block[at + P23 * LANES],
        block[at + P2H * LANES], block[at + P33 * LANES], block[at + P3H * LANES],
        block[at + PHH * LANES],
        block[at + HEAT * LANES], block[at + REJECTIONS * LANES], block[at + MISMATCH * LANES],
        block[at + LASTING * LANES], watch,
    )
    x, info = ekf_step(
        table, grid, cell, noise, anew, x, current_A, voltage_V, temperature_C, dt_s, gap
    )
    # fmt: on
    put_state(block, lane, x)
    out[O_SOC * LANES + lane] = info.soc
    out[O_STD * LANES + lane] = info.soc_std
    out[O_VOLTAGE * LANES + lane] = info.voltage_V
    out[O_INNOVATION * LANES + lane] = info.innovation_V
    out[O_VARIANCE * LANES + lane] = info.innovation_variance_V2
    out[O_RATIO * LANES + lane] = info.test_ratio
    return int(info.status)


@njit(cache=True, error_model="numpy")
def put_state(block: FloatArray, lane: int, x: EkfState) -> None:
    """A cell's state into its lane."""
    at = lane
    w = x.watch
    # fmt: off
    values = (
        x.soc, x.v1_V, x.v2_V, x.v3_V, x.h, x.ss, x.s1, x.s2, x.s3, x.sh,
        x.p11, x.p12, x.p13, x.p1h, x.p22, x.p23, x.p2h, x.p33, x.p3h, x.phh,
        x.heat_K, x.rejections, x.mismatch, x.lasting,
        w.current_A, w.temperature_C, w.evidence_s, w.no_current_s, w.no_voltage_s,
        w.voltage_V, w.frozen_A, w.repeats,
    )
    # fmt: on
    for field in range(FACTOR):
        block[at + field * LANES] = values[field]

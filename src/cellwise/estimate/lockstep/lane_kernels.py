"""A filter's state in its lane: field by field, LANES cells side by side.

Printed from :mod:`cellwise.cell.description` by `python -m cellwise.printing`; do not edit.
"""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.equations import CellState
from cellwise.estimate.filters.covariance_kernels import Covariance
from cellwise.estimate.filters.drift_kernels import Drift
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.past_kernels import Past
from cellwise.estimate.sensing_kernels import Watch
from cellwise.typing import FloatArray

LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler
# Fields of a block, LANES numbers each.
(
    SOC,
    V1,
    V2,
    V3,
    H,
    HEAT,
    SLOW,
    SS,
    S1,
    S2,
    S3,
    SH,
    P11,
    P12,
    P13,
    P1H,
    P22,
    P23,
    P2H,
    P33,
    P3H,
    PHH,
    REJECTIONS,
    MISMATCH,
    PERSISTENT,
    CONTRADICTED,
    REACH,
    OFFSET,
    INFORMATION,
    BELIEVED,
    UNSURE,
    D1,
    D2,
    D3,
    REST_S,
    REST_A,
    LAST_A,
    LAST_C,
    EVIDENCE,
    NO_CURRENT,
    NO_VOLTAGE,
    LAST_V,
    FROZEN,
    REPEATS,
    NO_WARM,
    MEAN,
    LOOKED,
    MISS,
    FIRST_SOC,
    FIRST_VARIANCE,
    FACTOR,
    FACTOR_C,
) = range(52)
FIELDS = 52


@inline
def get_state(block: FloatArray, lane: int) -> EkfState:
    """A cell's state out of its lane."""
    return EkfState(
        CellState(
            block[SOC * LANES + lane],
            block[V1 * LANES + lane],
            block[V2 * LANES + lane],
            block[V3 * LANES + lane],
            block[H * LANES + lane],
            block[HEAT * LANES + lane],
            block[SLOW * LANES + lane],
        ),
        Covariance(
            block[SS * LANES + lane],
            block[S1 * LANES + lane],
            block[S2 * LANES + lane],
            block[S3 * LANES + lane],
            block[SH * LANES + lane],
            block[P11 * LANES + lane],
            block[P12 * LANES + lane],
            block[P13 * LANES + lane],
            block[P1H * LANES + lane],
            block[P22 * LANES + lane],
            block[P23 * LANES + lane],
            block[P2H * LANES + lane],
            block[P33 * LANES + lane],
            block[P3H * LANES + lane],
            block[PHH * LANES + lane],
        ),
        block[REJECTIONS * LANES + lane],
        block[MISMATCH * LANES + lane],
        block[PERSISTENT * LANES + lane],
        block[CONTRADICTED * LANES + lane],
        Drift(
            block[REACH * LANES + lane],
            block[OFFSET * LANES + lane],
            block[INFORMATION * LANES + lane],
            block[BELIEVED * LANES + lane],
            block[UNSURE * LANES + lane],
            block[D1 * LANES + lane],
            block[D2 * LANES + lane],
            block[D3 * LANES + lane],
            block[REST_S * LANES + lane],
            block[REST_A * LANES + lane],
        ),
        Watch(
            block[LAST_A * LANES + lane],
            block[LAST_C * LANES + lane],
            block[EVIDENCE * LANES + lane],
            block[NO_CURRENT * LANES + lane],
            block[NO_VOLTAGE * LANES + lane],
            block[LAST_V * LANES + lane],
            block[FROZEN * LANES + lane],
            block[REPEATS * LANES + lane],
            block[NO_WARM * LANES + lane],
        ),
        Past(
            block[MEAN * LANES + lane],
            block[LOOKED * LANES + lane],
            block[MISS * LANES + lane],
            block[FIRST_SOC * LANES + lane],
            block[FIRST_VARIANCE * LANES + lane],
        ),
    )


@inline
def put_state(block: FloatArray, lane: int, state: EkfState, puts: bool) -> None:
    """A cell's state into its lane, or none: without a branch."""
    block[SOC * LANES + lane] = state.cell.soc if puts else block[SOC * LANES + lane]
    block[V1 * LANES + lane] = state.cell.v1_V if puts else block[V1 * LANES + lane]
    block[V2 * LANES + lane] = state.cell.v2_V if puts else block[V2 * LANES + lane]
    block[V3 * LANES + lane] = state.cell.v3_V if puts else block[V3 * LANES + lane]
    block[H * LANES + lane] = state.cell.h if puts else block[H * LANES + lane]
    block[HEAT * LANES + lane] = state.cell.heat_K if puts else block[HEAT * LANES + lane]
    block[SLOW * LANES + lane] = state.cell.slow_A if puts else block[SLOW * LANES + lane]
    block[SS * LANES + lane] = state.p.ss if puts else block[SS * LANES + lane]
    block[S1 * LANES + lane] = state.p.s1 if puts else block[S1 * LANES + lane]
    block[S2 * LANES + lane] = state.p.s2 if puts else block[S2 * LANES + lane]
    block[S3 * LANES + lane] = state.p.s3 if puts else block[S3 * LANES + lane]
    block[SH * LANES + lane] = state.p.sh if puts else block[SH * LANES + lane]
    block[P11 * LANES + lane] = state.p.p11 if puts else block[P11 * LANES + lane]
    block[P12 * LANES + lane] = state.p.p12 if puts else block[P12 * LANES + lane]
    block[P13 * LANES + lane] = state.p.p13 if puts else block[P13 * LANES + lane]
    block[P1H * LANES + lane] = state.p.p1h if puts else block[P1H * LANES + lane]
    block[P22 * LANES + lane] = state.p.p22 if puts else block[P22 * LANES + lane]
    block[P23 * LANES + lane] = state.p.p23 if puts else block[P23 * LANES + lane]
    block[P2H * LANES + lane] = state.p.p2h if puts else block[P2H * LANES + lane]
    block[P33 * LANES + lane] = state.p.p33 if puts else block[P33 * LANES + lane]
    block[P3H * LANES + lane] = state.p.p3h if puts else block[P3H * LANES + lane]
    block[PHH * LANES + lane] = state.p.phh if puts else block[PHH * LANES + lane]
    block[REJECTIONS * LANES + lane] = (
        state.rejections if puts else block[REJECTIONS * LANES + lane]
    )
    block[MISMATCH * LANES + lane] = state.mismatch if puts else block[MISMATCH * LANES + lane]
    block[PERSISTENT * LANES + lane] = (
        state.persistent if puts else block[PERSISTENT * LANES + lane]
    )
    block[CONTRADICTED * LANES + lane] = (
        state.contradicted if puts else block[CONTRADICTED * LANES + lane]
    )
    block[REACH * LANES + lane] = state.drift.reach if puts else block[REACH * LANES + lane]
    block[OFFSET * LANES + lane] = state.drift.offset if puts else block[OFFSET * LANES + lane]
    block[INFORMATION * LANES + lane] = (
        state.drift.information if puts else block[INFORMATION * LANES + lane]
    )
    block[BELIEVED * LANES + lane] = (
        state.drift.believed if puts else block[BELIEVED * LANES + lane]
    )
    block[UNSURE * LANES + lane] = state.drift.unsure if puts else block[UNSURE * LANES + lane]
    block[D1 * LANES + lane] = state.drift.d1_V if puts else block[D1 * LANES + lane]
    block[D2 * LANES + lane] = state.drift.d2_V if puts else block[D2 * LANES + lane]
    block[D3 * LANES + lane] = state.drift.d3_V if puts else block[D3 * LANES + lane]
    block[REST_S * LANES + lane] = state.drift.rest_s if puts else block[REST_S * LANES + lane]
    block[REST_A * LANES + lane] = state.drift.rest_A if puts else block[REST_A * LANES + lane]
    block[LAST_A * LANES + lane] = state.watch.current_A if puts else block[LAST_A * LANES + lane]
    block[LAST_C * LANES + lane] = (
        state.watch.temperature_C if puts else block[LAST_C * LANES + lane]
    )
    block[EVIDENCE * LANES + lane] = (
        state.watch.evidence_s if puts else block[EVIDENCE * LANES + lane]
    )
    block[NO_CURRENT * LANES + lane] = (
        state.watch.no_current_s if puts else block[NO_CURRENT * LANES + lane]
    )
    block[NO_VOLTAGE * LANES + lane] = (
        state.watch.no_voltage_s if puts else block[NO_VOLTAGE * LANES + lane]
    )
    block[LAST_V * LANES + lane] = state.watch.voltage_V if puts else block[LAST_V * LANES + lane]
    block[FROZEN * LANES + lane] = state.watch.frozen_A if puts else block[FROZEN * LANES + lane]
    block[REPEATS * LANES + lane] = state.watch.repeats if puts else block[REPEATS * LANES + lane]
    block[NO_WARM * LANES + lane] = state.watch.no_warm_s if puts else block[NO_WARM * LANES + lane]
    block[MEAN * LANES + lane] = state.past.mean_A if puts else block[MEAN * LANES + lane]
    block[LOOKED * LANES + lane] = state.past.looked_A if puts else block[LOOKED * LANES + lane]
    block[MISS * LANES + lane] = state.past.miss_V if puts else block[MISS * LANES + lane]
    block[FIRST_SOC * LANES + lane] = (
        state.past.first_soc if puts else block[FIRST_SOC * LANES + lane]
    )
    block[FIRST_VARIANCE * LANES + lane] = (
        state.past.first_variance if puts else block[FIRST_VARIANCE * LANES + lane]
    )

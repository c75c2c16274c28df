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
def put_state(block: FloatArray, lane: int, state: EkfState) -> None:
    """A cell's state into its lane."""
    block[SOC * LANES + lane] = state.cell.soc
    block[V1 * LANES + lane] = state.cell.v1_V
    block[V2 * LANES + lane] = state.cell.v2_V
    block[V3 * LANES + lane] = state.cell.v3_V
    block[H * LANES + lane] = state.cell.h
    block[HEAT * LANES + lane] = state.cell.heat_K
    block[SLOW * LANES + lane] = state.cell.slow_A
    block[SS * LANES + lane] = state.p.ss
    block[S1 * LANES + lane] = state.p.s1
    block[S2 * LANES + lane] = state.p.s2
    block[S3 * LANES + lane] = state.p.s3
    block[SH * LANES + lane] = state.p.sh
    block[P11 * LANES + lane] = state.p.p11
    block[P12 * LANES + lane] = state.p.p12
    block[P13 * LANES + lane] = state.p.p13
    block[P1H * LANES + lane] = state.p.p1h
    block[P22 * LANES + lane] = state.p.p22
    block[P23 * LANES + lane] = state.p.p23
    block[P2H * LANES + lane] = state.p.p2h
    block[P33 * LANES + lane] = state.p.p33
    block[P3H * LANES + lane] = state.p.p3h
    block[PHH * LANES + lane] = state.p.phh
    block[REJECTIONS * LANES + lane] = state.rejections
    block[MISMATCH * LANES + lane] = state.mismatch
    block[PERSISTENT * LANES + lane] = state.persistent
    block[CONTRADICTED * LANES + lane] = state.contradicted
    block[REACH * LANES + lane] = state.drift.reach
    block[OFFSET * LANES + lane] = state.drift.offset
    block[INFORMATION * LANES + lane] = state.drift.information
    block[BELIEVED * LANES + lane] = state.drift.believed
    block[UNSURE * LANES + lane] = state.drift.unsure
    block[D1 * LANES + lane] = state.drift.d1_V
    block[D2 * LANES + lane] = state.drift.d2_V
    block[D3 * LANES + lane] = state.drift.d3_V
    block[REST_S * LANES + lane] = state.drift.rest_s
    block[REST_A * LANES + lane] = state.drift.rest_A
    block[LAST_A * LANES + lane] = state.watch.current_A
    block[LAST_C * LANES + lane] = state.watch.temperature_C
    block[EVIDENCE * LANES + lane] = state.watch.evidence_s
    block[NO_CURRENT * LANES + lane] = state.watch.no_current_s
    block[NO_VOLTAGE * LANES + lane] = state.watch.no_voltage_s
    block[LAST_V * LANES + lane] = state.watch.voltage_V
    block[FROZEN * LANES + lane] = state.watch.frozen_A
    block[REPEATS * LANES + lane] = state.watch.repeats
    block[NO_WARM * LANES + lane] = state.watch.no_warm_s
    block[MEAN * LANES + lane] = state.past.mean_A
    block[LOOKED * LANES + lane] = state.past.looked_A
    block[MISS * LANES + lane] = state.past.miss_V
    block[FIRST_SOC * LANES + lane] = state.past.first_soc
    block[FIRST_VARIANCE * LANES + lane] = state.past.first_variance


@inline
def choose(which: bool, yes: EkfState, no: EkfState) -> EkfState:
    """One of two states, number by number: without a branch."""
    return EkfState(
        CellState(
            yes.cell.soc if which else no.cell.soc,
            yes.cell.v1_V if which else no.cell.v1_V,
            yes.cell.v2_V if which else no.cell.v2_V,
            yes.cell.v3_V if which else no.cell.v3_V,
            yes.cell.h if which else no.cell.h,
            yes.cell.heat_K if which else no.cell.heat_K,
            yes.cell.slow_A if which else no.cell.slow_A,
        ),
        Covariance(
            yes.p.ss if which else no.p.ss,
            yes.p.s1 if which else no.p.s1,
            yes.p.s2 if which else no.p.s2,
            yes.p.s3 if which else no.p.s3,
            yes.p.sh if which else no.p.sh,
            yes.p.p11 if which else no.p.p11,
            yes.p.p12 if which else no.p.p12,
            yes.p.p13 if which else no.p.p13,
            yes.p.p1h if which else no.p.p1h,
            yes.p.p22 if which else no.p.p22,
            yes.p.p23 if which else no.p.p23,
            yes.p.p2h if which else no.p.p2h,
            yes.p.p33 if which else no.p.p33,
            yes.p.p3h if which else no.p.p3h,
            yes.p.phh if which else no.p.phh,
        ),
        yes.rejections if which else no.rejections,
        yes.mismatch if which else no.mismatch,
        yes.persistent if which else no.persistent,
        yes.contradicted if which else no.contradicted,
        Drift(
            yes.drift.reach if which else no.drift.reach,
            yes.drift.offset if which else no.drift.offset,
            yes.drift.information if which else no.drift.information,
            yes.drift.believed if which else no.drift.believed,
            yes.drift.unsure if which else no.drift.unsure,
            yes.drift.d1_V if which else no.drift.d1_V,
            yes.drift.d2_V if which else no.drift.d2_V,
            yes.drift.d3_V if which else no.drift.d3_V,
            yes.drift.rest_s if which else no.drift.rest_s,
            yes.drift.rest_A if which else no.drift.rest_A,
        ),
        Watch(
            yes.watch.current_A if which else no.watch.current_A,
            yes.watch.temperature_C if which else no.watch.temperature_C,
            yes.watch.evidence_s if which else no.watch.evidence_s,
            yes.watch.no_current_s if which else no.watch.no_current_s,
            yes.watch.no_voltage_s if which else no.watch.no_voltage_s,
            yes.watch.voltage_V if which else no.watch.voltage_V,
            yes.watch.frozen_A if which else no.watch.frozen_A,
            yes.watch.repeats if which else no.watch.repeats,
            yes.watch.no_warm_s if which else no.watch.no_warm_s,
        ),
        Past(
            yes.past.mean_A if which else no.past.mean_A,
            yes.past.looked_A if which else no.past.looked_A,
            yes.past.miss_V if which else no.past.miss_V,
            yes.past.first_soc if which else no.past.first_soc,
            yes.past.first_variance if which else no.past.first_variance,
        ),
    )

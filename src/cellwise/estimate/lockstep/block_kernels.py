"""A block of cells: what they have read, the table at their SOC, one cell's own step.

Beside the cells' states lie the tables of one step, and scratch.
"""

from __future__ import annotations

import math

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.equations import BEYOND, CellTables, arrhenius
from cellwise.cell.packed import lane_record, place_of, put_lane_record, size_of
from cellwise.cell.plausibility.validity_kernels import ValidityScalars, is_outside
from cellwise.cell.point_kernels import CellScalars
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
)
from cellwise.estimate.filters.kalman_kernels import kalman_step
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.sensing_kernels import COLDEST_C, HOTTEST_C, Reading
from cellwise.estimate.slopes_kernels import WIDE_VARIANCE
from cellwise.typing import FloatArray

LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler
# Numbers of a block, LANES of each: the state, the Arrhenius factor and the temperature it is of.
FACTOR = size_of(EkfState)
FACTOR_C = FACTOR + 1
FIELDS = FACTOR + 2
SOC, SS = place_of(EkfState, "cell.soc"), place_of(EkfState, "p.ss")
LAST_A, LAST_C = place_of(EkfState, "watch.current_A"), place_of(EkfState, "watch.temperature_C")
EVIDENCE = place_of(EkfState, "watch.evidence_s")
NO_CURRENT = place_of(EkfState, "watch.no_current_s")
NO_VOLTAGE = place_of(EkfState, "watch.no_voltage_s")
FIRST_VARIANCE = place_of(EkfState, "past.first_variance")
# Columns of the table of one time step: decays a, what one ampere adds g, R^2 (1 - a^2) as b.
T_OCV, T_R0, T_A1, T_G1, T_B1, T_A2, T_G2, T_B2, T_ERROR, T_A3, T_G3, T_B3, T_M = range(13)
PLAIN_COLUMNS = 9  # what a model without third branch and hysteresis needs
TABLE_COLUMNS = 16  # whole vectors
# Rows of the scratch of a block: the table at every lane's SOC, what the lanes have read, what is
# reported. All in one array: LLVM gives up checking more of them for overlaps ("too many memory
# checks needed"), and then vectorises nothing.
W_SLOPE = 16
W_SOC, W_FLOW, W_PLAIN, W_DECAY, W_AT, W_BEYOND, W_INSIDE = range(17, 24)
W_CURRENT, W_VOLTAGE, W_WARM = range(24, 27)
W_OUT = 27
SCRATCH_ROWS = W_OUT + OUTPUTS
LONG_FROZEN = 1e300
SERIES_LIMIT = 0.25  # beyond it the series of the decay is left to the exponential
THIRD, SIXTH, SEVENTH = 1.0 / 3.0, 1.0 / 6.0, 1.0 / 7.0


@inline
def get_state(block: FloatArray, lane: int) -> EkfState:
    """A cell's state out of its lane."""
    state: EkfState = lane_record(EkfState, block, lane, LANES)
    return state


@inline
def put_state(block: FloatArray, lane: int, state: EkfState, puts: bool) -> None:
    """A cell's state into its lane, or none: without a branch."""
    put_lane_record(block, lane, LANES, state, puts)


@inline
def read_block(
    cell: CellScalars,
    noise: NoiseScalars,
    points: int,
    block: FloatArray,
    work: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    temperature_C: FloatArray,
    dt_s: float,
    needs_temperature: bool,
) -> None:
    """Which lanes are plain so far, their SOC after the interval, and where it is in the table."""
    held_share = min(cell.skew_s / dt_s, 1.0) if cell.skew_s > 0.0 else 0.0
    per_As = dt_s / cell.charge_As
    last = points - 2.0
    reach = BEYOND * (points - 1)
    coldest = COLDEST_C if needs_temperature else -math.inf
    hottest = HOTTEST_C if needs_temperature else math.inf
    for lane in range(LANES):
        current = current_A[lane]
        voltage = voltage_V[lane]
        warm = temperature_C[lane]
        flow = current + held_share * (block[LAST_A * LANES + lane] - current)
        soc = block[SOC * LANES + lane]
        soc -= (flow * (1.0 if flow > 0.0 else cell.charge_efficiency) + cell.leak_A) * per_As
        x = cell.hysteresis_rate * abs(flow) * per_As
        away = block[NO_CURRENT * LANES + lane] + block[NO_VOLTAGE * LANES + lane]
        plain = (
            (abs(current) <= noise.current_limit_A)
            & (voltage >= noise.voltage_low_V)
            & (voltage <= noise.voltage_high_V)
            & ((not needs_temperature) | ((warm >= coldest) & (warm <= hottest)))
            & (block[SS * LANES + lane] <= WIDE_VARIANCE)
            & (block[EVIDENCE * LANES + lane] >= 0.0)
            & (block[FIRST_VARIANCE * LANES + lane] <= 0.0)
            & (abs(soc) < 2.0)
            & (x <= SERIES_LIMIT)
            & (away == 0.0)
        )
        # e^-x to 4e-10 where x <= 1/4; divisions cost more than all the rest.
        series = 1.0 - x * SIXTH * (1.0 - x * SEVENTH)
        series = 1.0 - x * THIRD * (1.0 - x * 0.25 * (1.0 - x * 0.2 * series))
        at = soc * (points - 1)
        at = at if plain else 0.0
        k = at if at > 0.0 else 0.0
        k = math.floor(k if k < last else last)
        f = at - k
        f = f if f > -reach else -reach
        f = f if f < 1.0 + reach else 1.0 + reach
        g = f if f > 0.0 else 0.0
        work[W_INSIDE * LANES + lane] = g if g < 1.0 else 1.0
        work[W_BEYOND * LANES + lane] = f
        work[W_AT * LANES + lane] = k
        work[W_PLAIN * LANES + lane] = 1.0 if plain else 0.0
        work[W_SOC * LANES + lane] = soc
        work[W_FLOW * LANES + lane] = flow
        work[W_CURRENT * LANES + lane] = current
        work[W_VOLTAGE * LANES + lane] = voltage
        work[W_WARM * LANES + lane] = warm
        work[W_DECAY * LANES + lane] = 1.0 - x * (1.0 - x * 0.5 * series)


@inline
def watch_validity(
    valid: ValidityScalars, block: FloatArray, work: FloatArray, temperature_C: FloatArray
) -> None:
    """Lanes beyond the model's data are not plain: they take the EKF's own step.

    A temperature that was never measured is beyond nothing.
    """
    for lane in range(LANES):
        warm = temperature_C[lane]
        sound = (warm >= COLDEST_C) & (warm <= HOTTEST_C)
        warm = warm if sound else block[LAST_C * LANES + lane]
        soc, flow = work[W_SOC * LANES + lane], work[W_FLOW * LANES + lane]
        if (
            (warm < valid.cold_C)
            | (warm > valid.warm_C)
            | is_outside(valid, soc, valid.cold_C, flow)
        ):
            work[W_PLAIN * LANES + lane] = 0.0


@inline
def look_up_lane(
    fast: FloatArray, row: int, slope_scale: float, work: FloatArray, lane: int, whole: bool
) -> None:
    """The table of one temperature at one lane's SOC."""
    start = (row + int(work[W_AT * LANES + lane])) * TABLE_COLUMNS
    pair = fast[start : start + 2 * TABLE_COLUMNS]
    g = work[W_INSIDE * LANES + lane]
    for c in range(T_R0, PLAIN_COLUMNS):
        work[c * LANES + lane] = pair[c] + g * (pair[TABLE_COLUMNS + c] - pair[c])
    if whole:
        for c in range(PLAIN_COLUMNS, TABLE_COLUMNS):
            work[c * LANES + lane] = pair[c] + g * (pair[TABLE_COLUMNS + c] - pair[c])
    rise = pair[TABLE_COLUMNS + T_OCV] - pair[T_OCV]
    work[T_OCV * LANES + lane] = pair[T_OCV] + work[W_BEYOND * LANES + lane] * rise
    work[W_SLOPE * LANES + lane] = rise * slope_scale


@inline
def look_up_warm_lane(
    fast: FloatArray,
    grid: FloatArray,
    points: int,
    work: FloatArray,
    lane: int,
    temperature_C: float,
) -> None:
    """The same between two temperatures, linear."""
    low = 0
    last = grid.size - 2
    while low < last and temperature_C > grid[low + 1]:
        low += 1
    w = (temperature_C - grid[low]) / (grid[low + 1] - grid[low])
    w = min(max(w, 0.0), 1.0)
    look_up_lane(fast, low * points, points - 1.0, work, lane, True)
    start = ((low + 1) * points + int(work[W_AT * LANES + lane])) * TABLE_COLUMNS
    pair = fast[start : start + 2 * TABLE_COLUMNS]
    g = work[W_INSIDE * LANES + lane]
    rise = pair[TABLE_COLUMNS + T_OCV] - pair[T_OCV]
    ocv = work[T_OCV * LANES + lane]
    ocv += w * (pair[T_OCV] + work[W_BEYOND * LANES + lane] * rise - ocv)
    for c in range(TABLE_COLUMNS):
        here = work[c * LANES + lane]
        there = pair[c] + g * (pair[TABLE_COLUMNS + c] - pair[c])
        work[c * LANES + lane] = here + w * (there - here)
    work[T_OCV * LANES + lane] = ocv
    slope = work[W_SLOPE * LANES + lane]
    work[W_SLOPE * LANES + lane] = slope + w * (rise * (points - 1.0) - slope)


@inline
def scale_lane(
    cell: CellScalars, block: FloatArray, work: FloatArray, lane: int, temperature_C: float
) -> None:
    """Resistances at one temperature and current; the Arrhenius factor is kept until it moves."""
    scale = 1.0
    if cell.activation_K != 0.0:
        if temperature_C != block[FACTOR_C * LANES + lane]:
            block[FACTOR_C * LANES + lane] = temperature_C
            block[FACTOR * LANES + lane] = arrhenius(
                temperature_C, cell.activation_K, cell.reference_K
            )
        scale = block[FACTOR * LANES + lane]
    slow = scale  # the third branch knows no rate
    flow = work[W_FLOW * LANES + lane]
    scale /= 1.0 + cell.rate_per_A * abs(flow)
    if flow < 0.0:
        scale *= cell.charge_scale
        slow *= cell.charge_scale
    work[T_R0 * LANES + lane] *= scale
    work[T_G1 * LANES + lane] *= scale
    work[T_B1 * LANES + lane] *= scale * scale
    work[T_G2 * LANES + lane] *= scale
    work[T_B2 * LANES + lane] *= scale * scale
    work[T_G3 * LANES + lane] *= slow
    work[T_B3 * LANES + lane] *= slow * slow


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

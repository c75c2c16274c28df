"""A filter that was locked out looks for its SOC anew: one way for every filter."""

from __future__ import annotations

from numba import njit

from cellwise.cell.kernels import CellScalars, look_up
from cellwise.estimate.measurement_kernels import (
    LOAD_LIMIT_V,
    REST_LIMIT_V,
    START_BRANCH_V,
    START_REST_RATE,
    soc_of_voltage,
)
from cellwise.typing import FloatArray

RECOVERY_VARIANCE = 0.09
RECOVERY_RATE = 0.3


@njit(cache=True, error_model="numpy")
def recovered(
    table: FloatArray,
    grid: FloatArray,
    cell: CellScalars,
    temperature_C: float,
    current_A: float,
    voltage_V: float,
    branches_V: tuple[float, float, float],
    variances: tuple[float, float, float],
    h: float,
    h_variance: float,
    one: float,
    drop_V: float,
    followed: bool,
    soc: float,
    soc_variance: float,
) -> tuple[float, float, float, float, float]:
    """SOC, its variance and those of the three branches after a lock-out.

    ``one`` is the variance of one voltage about a perfect state, ``drop_V`` the size of the whole
    polarisation. Branches that have been ``followed`` may hold anything.
    """
    v1, v2, v3 = branches_V
    p11, p22, p33 = variances
    held_A = START_REST_RATE * cell.charge_As / 3600.0
    limit_V = REST_LIMIT_V
    branch = START_BRANCH_V * START_BRANCH_V
    if followed:
        held_A = RECOVERY_RATE * cell.charge_As / 3600.0
        limit_V = LOAD_LIMIT_V
        # Under load the resistances may be what is wrong, by as much as they are.
        branch = drop_V * drop_V + v1 * v1 + v2 * v2 + v3 * v3 + ((p11 + p22) + p33)
    # fmt: off
    soc, soc_variance = soc_of_voltage(
        table, grid, cell, temperature_C, current_A, voltage_V, (v1 + v2) + v3, h, h_variance,
        one + branch, held_A, limit_V, soc, max(soc_variance, RECOVERY_VARIANCE),
    )
    # fmt: on
    new = look_up(table, grid, cell, soc, temperature_C)
    branch = START_BRANCH_V * START_BRANCH_V
    p11 = branch + min(held_A * new.r1_ohm, limit_V) ** 2
    p22 = branch + min(held_A * new.r2_ohm, limit_V) ** 2
    p33 = branch + min(held_A * new.r3_ohm, limit_V) ** 2
    if followed:
        p11 += v1 * v1
        p22 += v2 * v2
        p33 += v3 * v3
    if new.r3_ohm == 0.0:
        p33 = 0.0
    return soc, soc_variance, p11, p22, p33

"""What the current does to the resistances."""

from __future__ import annotations

from typing import Any

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES, V1, V2
from cellwise.cell.equations.scalar import charge_transfer
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled


@inline
def transfer_resistance(asinh_per_V: float, r_ohm: float, current_A: float) -> float:
    """Resistance of a charge transfer under a current [ohm]."""
    return r_ohm * charge_transfer(asinh_per_V * r_ohm * current_A)


@inline
@unrolled
def under_load(cell: CellScalars, point: ByState, current_A: float) -> CellPoint:
    r"""Resistances at one current: they fall with its size, and differ on charge.

    .. math:: R_{0,1,2}(I) = \frac{R_{0,1,2}}{1 + k |I|}, \qquad R_{0..3}(I < 0) = c R_{0..3},
       \qquad R_1(I) = R_1 f(k_1 R_1 I)

    The first is a fall of first order of all of them, the last the charge transfer of the fast
    branch alone; k = 0, c = 1 and k_1 = 0 leave every resistance as it is.
    """
    r0 = point.r0_ohm
    r: dict[Any, float] = {}
    for i in BRANCHES:
        r[i] = point.r[i]
    if cell.rate_per_A != 0.0:
        growth = 1.0 + cell.rate_per_A * abs(current_A)
        fall = 1.0 / growth
        r0 *= fall
        for i in (V1, V2):
            r[i] *= fall
    if cell.charge_scale != 1.0 and current_A < 0.0:
        r0 *= cell.charge_scale
        for i in BRANCHES:
            r[i] *= cell.charge_scale
    if cell.asinh_per_V != 0.0:
        r[V1] = transfer_resistance(cell.asinh_per_V, r[V1], current_A)
    # fmt: off
    return CellPoint(  # type: ignore[call-arg]
        point.ocv_V, point.ocv_slope_V,
        r0, *(r[i] for i in BRANCHES), *(point.tau[i] for i in BRANCHES),
        point.m_V, point.error_V, point.entropy_V, point.entropy_slope_V,
    )

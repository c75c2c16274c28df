"""The SOC at the surface of the particles: the mean, less what the load has drawn from there."""

from __future__ import annotations

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations.states import decay
from cellwise.cell.equations.temperature import arrhenius
from cellwise.cell.point_kernels import CellPoint, CellScalars
from cellwise.cell.unrolled import ByState, unrolled


@inline
def lagged_current(cell: CellScalars, slow_A: float, current_A: float, dt_s: float) -> float:
    r"""Current behind the lag of the particles' surface, after an interval.

    .. math:: \bar I^{+} = a \bar I + (1 - a) I, \qquad a = e^{-\Delta t / \tau_s}
    """
    a = decay(dt_s, cell.surface_s)
    return a * slow_A + (1.0 - a) * current_A


@inline
def slow_step(cell: CellScalars, slow_A: float, current_A: float, dt_s: float) -> float:
    """The same where the surface's SOC is not the mean's; else it stays as it is."""
    if cell.surface_per_A == 0.0:
        return slow_A
    return lagged_current(cell, slow_A, current_A, dt_s)


@inline
def surface_soc(cell: CellScalars, soc: float, slow_A: float, temperature_C: float) -> float:
    r"""SOC at the surface of the particles: below the mean on discharge, above it on charge.

    .. math:: z_s = z - \frac{d}{Q} e^{E_s (1/T - 1/T_{ref})} \bar I
    """
    scale = arrhenius(temperature_C, cell.surface_activation_K, cell.surface_reference_K)
    depth = cell.surface_per_A * scale
    return soc - depth * slow_A


@inline
@unrolled
def surfaced(point: CellPoint, below: ByState) -> CellPoint:
    """A point with resistances and time constants of another."""
    # fmt: off
    return CellPoint(  # type: ignore[call-arg]
        point.ocv_V, point.ocv_slope_V,
        below.r0_ohm, *(below.r[i] for i in BRANCHES), *(below.tau[i] for i in BRANCHES),
        point.m_V, point.error_V, point.entropy_V, point.entropy_slope_V,
    )

"""The cell's equations, once: simulation, every filter and the protocol runner are made of these.

A model without an effect is a model with that effect's neutral value, so there is one set of
equations. The order of operations is part of them: the same bits come out wherever they are used.
Their derivatives are printed from this file's own text.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import inline, kernel
from cellwise.cell.point_kernels import CellPoint, CellScalars, between, point_of
from cellwise.typing import FloatArray

ZERO_CELSIUS_K = 273.15

# How far beyond 0..1 the OCV goes on along its last segment.
BEYOND = 0.05


class CellTables(NamedTuple):
    """A `CellModel` as the equations see it.

    ``table`` has shape (temperatures, soc points, COLUMNS) over a uniform SOC grid 0..1,
    ``grid_C`` (temperatures,) are its temperatures [degC], ``cell`` the numbers beside it.
    """

    table: FloatArray
    grid_C: FloatArray
    cell: CellScalars


class CellState(NamedTuple):
    """What a cell carries from one interval to the next."""

    soc: float
    v1_V: float
    v2_V: float
    v3_V: float
    h: float
    heat_K: float = 0.0
    slow_A: float = 0.0


class Transition(NamedTuple):
    """An interval of constant current: factors a on the states, what one ampere adds g."""

    a1: float
    a2: float
    a3: float
    ah: float
    gs: float
    g1: float
    g2: float
    g3: float


class Place(NamedTuple):
    """Where in the packed table one SOC and temperature lie.

    Between SOC points k and k + 1, temperatures lo and lo + 1: f of the way for columns that go on
    beyond 0..1, g for the others, w of the way in temperature.
    """

    lo: np.uint64
    k: np.uint64
    f: float
    g: float
    w: float


@inline
def place_of(tables: CellTables, soc: float, temperature_C: float) -> Place:
    """Where one SOC and temperature lie in the tables.

    Outside 0..1 the OCV goes on along its last segment for BEYOND, so that a filter keeps a slope
    to come back on; every other parameter stays at its end value. Temperature is held at the ends.
    """
    table, grid = tables.table, tables.grid_C
    n = table.shape[1]
    x = soc * (n - 1)
    k = np.uint64(min(max(x, 0.0), n - 2.0))  # unsigned: no test for indices from the end
    f = min(max(x - float(k), -BEYOND * (n - 1)), 1.0 + BEYOND * (n - 1))
    g = min(max(f, 0.0), 1.0)
    lo = np.uint64(0)
    w = 0.0
    if table.shape[0] > 1:
        last = np.uint64(grid.size - 2)
        while lo < last and temperature_C > grid[lo + np.uint64(1)]:
            lo += np.uint64(1)
        w = (temperature_C - grid[lo]) / (grid[lo + np.uint64(1)] - grid[lo])
        w = min(max(w, 0.0), 1.0)
    return Place(lo, k, f, g, w)


@inline
def tables_at(table: FloatArray, place: Place) -> CellPoint:
    """Tables at one place, linear between grid points."""
    point = point_of(table, place.lo, place.k, place.f, place.g)
    if place.w > 0.0:
        warm = point_of(table, place.lo + np.uint64(1), place.k, place.f, place.g)
        point = between(point, warm, place.w)
    return point


@inline
def look_up(tables: CellTables, soc: float, temperature_C: float, slow_A: float = 0.0) -> CellPoint:
    """Tables at one SOC and temperature, and what temperature does beside, under no load.

    Resistances and time constants are those of the particles' surface, which follows ``slow_A``.
    """
    cell = tables.cell
    point = tables_at(tables.table, place_of(tables, soc, temperature_C))
    if cell.surface_per_A != 0.0:
        surface = surface_soc(cell, soc, slow_A, temperature_C)
        point = at_surface(tables, point, surface, temperature_C)
    return at_temperature(cell, point, temperature_C)


@inline
def followed(cell: CellScalars, slow_A: float, current_A: float, dt_s: float) -> float:
    r"""Current that the particles' surface has followed, after an interval.

    .. math:: \bar I^{+} = a \bar I + (1 - a) I, \qquad a = e^{-\Delta t / \tau_s}
    """
    a = decay(dt_s, cell.surface_s)
    return a * slow_A + (1.0 - a) * current_A


@inline
def slow_step(cell: CellScalars, slow_A: float, current_A: float, dt_s: float) -> float:
    """The same where the surface's SOC is not the mean's; else it stays as it is."""
    if cell.surface_per_A == 0.0:
        return slow_A
    return followed(cell, slow_A, current_A, dt_s)


@inline
def surface_soc(cell: CellScalars, soc: float, slow_A: float, temperature_C: float) -> float:
    r"""SOC at the surface of the particles: below the mean on discharge, above it on charge.

    .. math:: z_s = z - \frac{d}{Q} e^{E_s (1/T - 1/T_{ref})} \bar I
    """
    scale = arrhenius(temperature_C, cell.surface_activation_K, cell.surface_reference_K)
    depth = cell.surface_per_A * scale
    return soc - depth * slow_A


@kernel
def at_surface(
    tables: CellTables, point: CellPoint, surface: float, temperature_C: float
) -> CellPoint:
    """A point with resistances and time constants of the SOC at the particles' surface."""
    below = tables_at(tables.table, place_of(tables, surface, temperature_C))
    return surfaced(point, below)


@inline
def surfaced(point: CellPoint, below: CellPoint) -> CellPoint:
    """A point with resistances and time constants of another."""
    # fmt: off
    return CellPoint(
        point.ocv_V, point.ocv_slope_V, below.r0_ohm, below.r1_ohm, below.tau1_s, below.r2_ohm,
        below.tau2_s, below.r3_ohm, below.tau3_s, point.m_V, point.error_V, point.entropy_V,
        point.entropy_slope_V,
    )
    # fmt: on


@inline
def inverse_kelvin(temperature_C: float, reference_K: float) -> float:
    """How far a temperature is from the reference, 1/T - 1/T_ref [1/K]."""
    kelvin = temperature_C + ZERO_CELSIUS_K
    return 1.0 / kelvin - 1.0 / reference_K


@inline
def thermal_factor(activation_K: float, inverse_K: float) -> float:
    """Arrhenius factor at ``inverse_K`` = 1/T - 1/T_ref."""
    return math.exp(activation_K * inverse_K)


@inline
def arrhenius(temperature_C: float, activation_K: float, reference_K: float) -> float:
    r"""Arrhenius factor, 1 at the reference.

    .. math:: e^{E (1/T - 1/T_{ref})}
    """
    return thermal_factor(activation_K, inverse_kelvin(temperature_C, reference_K))


@inline
def at_temperature(cell: CellScalars, point: CellPoint, temperature_C: float) -> CellPoint:
    r"""What temperature does to the tables beside their own axis.

    .. math:: OCV(T) = OCV + \frac{dOCV}{dT} (T - T_{ref}), \qquad
       R_j(T) = R_j e^{(E + E_j)(1/T - 1/T_{ref})}, \qquad
       \tau_j(T) = \tau_j e^{E_{\tau j} (1/T - 1/T_{ref})}
    """
    ocv = point.ocv_V
    slope = point.ocv_slope_V
    r0, r1, r2, r3 = point.r0_ohm, point.r1_ohm, point.r2_ohm, point.r3_ohm
    tau1, tau2, tau3 = point.tau1_s, point.tau2_s, point.tau3_s
    if cell.entropy_K != 0.0:
        warmer = (temperature_C + ZERO_CELSIUS_K) - cell.entropy_K
        ocv += point.entropy_V * warmer
        slope += point.entropy_slope_V * warmer
    if cell.activation_K != 0.0:
        scale = arrhenius(temperature_C, cell.activation_K, cell.reference_K)
        r0 *= scale
        r1 *= scale
        r2 *= scale
        r3 *= scale
    if cell.branch_activation != 0.0:
        r0 *= arrhenius(temperature_C, cell.r0_activation_K, cell.reference_K)
        r1 *= arrhenius(temperature_C, cell.r1_activation_K, cell.reference_K)
        tau1 *= arrhenius(temperature_C, cell.tau1_activation_K, cell.reference_K)
        r2 *= arrhenius(temperature_C, cell.r2_activation_K, cell.reference_K)
        tau2 *= arrhenius(temperature_C, cell.tau2_activation_K, cell.reference_K)
        r3 *= arrhenius(temperature_C, cell.r3_activation_K, cell.reference_K)
        tau3 *= arrhenius(temperature_C, cell.tau3_activation_K, cell.reference_K)
    # fmt: off
    return CellPoint(
        ocv, slope, r0, r1, tau1, r2, tau2, r3, tau3,
        point.m_V, point.error_V, point.entropy_V, point.entropy_slope_V,
    )
    # fmt: on


@inline
def charge_transfer(overvoltage: float) -> float:
    r"""Factor on a resistance whose voltage follows asinh, 1 at small currents.

    .. math:: f(y) = \frac{\mathrm{asinh}\, y}{y}, \qquad y = k R I

    As a fraction that is within 0.05 % of it up to \|y\| = 60, because an embedded target has no
    logarithm whose bits are the same everywhere.
    """
    y = abs(overvoltage)
    above = 0.42143288 + y * 0.01126451
    above = 0.66171232 + y * above
    above = 1.0 + y * above
    below = 0.11957555 + y * 0.00170013
    below = 0.59291773 + y * below
    below = 0.66171232 + y * below
    below = 1.0 + y * below
    return above / below


@inline
def transfer_resistance(asinh_per_V: float, r_ohm: float, current_A: float) -> float:
    """Resistance of a charge transfer under a current [ohm]."""
    return r_ohm * charge_transfer(asinh_per_V * r_ohm * current_A)


@inline
def under_load(cell: CellScalars, point: CellPoint, current_A: float) -> CellPoint:
    r"""Resistances at one current: they fall with its size, and differ on charge.

    .. math:: R_{0,1,2}(I) = \frac{R_{0,1,2}}{1 + k |I|}, \qquad R_{0..3}(I < 0) = c R_{0..3},
       \qquad R_1(I) = R_1 f(k_1 R_1 I)

    The first is a fall of first order of all of them, the last the charge transfer of the fast
    branch alone; k = 0, c = 1 and k_1 = 0 leave every resistance as it is.
    """
    r0, r1, r2, r3 = point.r0_ohm, point.r1_ohm, point.r2_ohm, point.r3_ohm
    if cell.rate_per_A != 0.0:
        growth = 1.0 + cell.rate_per_A * abs(current_A)
        fall = 1.0 / growth
        r0 *= fall
        r1 *= fall
        r2 *= fall
    if cell.charge_scale != 1.0 and current_A < 0.0:
        r0 *= cell.charge_scale
        r1 *= cell.charge_scale
        r2 *= cell.charge_scale
        r3 *= cell.charge_scale
    if cell.asinh_per_V != 0.0:
        r1 = transfer_resistance(cell.asinh_per_V, r1, current_A)
    # fmt: off
    return CellPoint(
        point.ocv_V, point.ocv_slope_V, r0, r1, point.tau1_s, r2, point.tau2_s, r3, point.tau3_s,
        point.m_V, point.error_V, point.entropy_V, point.entropy_slope_V,
    )
    # fmt: on


@inline
def loaded(
    tables: CellTables, soc: float, temperature_C: float, current_A: float, slow_A: float
) -> CellPoint:
    """Tables at one SOC, temperature and current, and the one that the surface has followed."""
    return under_load(tables.cell, look_up(tables, soc, temperature_C, slow_A), current_A)


@inline
def needs_temperature(tables: CellTables) -> bool:
    """Whether anything depends on the temperature."""
    cell = tables.cell
    depends = cell.activation_K != 0.0 or cell.branch_activation != 0.0 or cell.entropy_K != 0.0
    depends = depends or (cell.surface_per_A != 0.0 and cell.surface_activation_K != 0.0)
    return tables.table.shape[0] > 1 or depends


@inline
def charge_used(cell: CellScalars, current_A: float) -> float:
    """What leaves the cell [A]: charging counts by its efficiency, self-discharge adds."""
    used = current_A if current_A > 0.0 else current_A * cell.charge_efficiency
    return used + cell.leak_A


@inline
def soc_step(cell: CellScalars, soc: float, current_A: float, dt_s: float) -> float:
    r"""Coulomb counting over one interval.

    .. math:: z^{+} = z - \frac{(\eta I + I_{sd}) \Delta t}{3600\,Q}
    """
    return soc - charge_used(cell, current_A) * (dt_s / cell.charge_As)


@inline
def decay(dt_s: float, tau_s: float) -> float:
    r"""The share of a state that remains after an interval, :math:`e^{-\Delta t / \tau}`."""
    return math.exp(-dt_s / tau_s)


@inline
def relaxed(old: float, a: float, gain: float, drive: float) -> float:
    r"""A state of first order after an interval of constant drive, exactly.

    .. math:: x^{+} = a x + g I
    """
    return a * old + gain * drive


@inline
def branch_gain(r_ohm: float, a: float) -> float:
    """What one ampere adds to a branch over an interval, R (1 - a) [ohm]."""
    return r_ohm * (1.0 - a)


@inline
def rc_step(v_rc: float, current: float, r: float, tau: float, dt: float) -> float:
    r"""Advance one RC branch over an interval of constant current, exactly.

    .. math:: v^{+} = e^{-\Delta t/\tau} v + R (1 - e^{-\Delta t/\tau}) I

    Parameters
    ----------
    v_rc : float      branch voltage at the start [V]
    current : float   cell current, positive on discharge [A]
    r, tau : float    resistance [ohm], time constant [s], tau > 0
    dt : float        length of the interval [s], dt >= 0

    Returns
    -------
    float             branch voltage at the end [V]
    """
    a = decay(dt, tau)
    return relaxed(v_rc, a, branch_gain(r, a), current)


@inline
def hysteresis_decay(cell: CellScalars, current_A: float, dt_s: float) -> float:
    r"""How much of the old hysteresis state is left after an interval.

    .. math:: a_h = e^{-\gamma |I| \Delta t / (3600 Q)}
    """
    per_A = dt_s / cell.charge_As
    folds = -cell.hysteresis_rate * abs(current_A) * per_A
    return math.exp(folds)


@inline
def hysteresis_step(h: float, ah: float, current_A: float) -> float:
    r"""Hysteresis after an interval; -1 discharged into, +1 charged into.

    .. math:: h^{+} = a_h h - (1 - a_h)\,\mathrm{sgn}(I)

    Source: G. Plett, Battery Management Systems vol. 1, section 2.6 (one-state hysteresis),
    with discharge current positive.
    """
    return ah * h - (1.0 - ah) * math.copysign(1.0, current_A)


@inline
def transition(cell: CellScalars, point: CellPoint, current_A: float, dt_s: float) -> Transition:
    """Decay and drive of every state over an interval of constant current."""
    a1 = decay(dt_s, point.tau1_s)
    a2 = decay(dt_s, point.tau2_s)
    a3 = 1.0
    if point.r3_ohm != 0.0:
        a3 = decay(dt_s, point.tau3_s)
    ah = 1.0
    if cell.hysteresis_rate != 0.0:
        ah = hysteresis_decay(cell, current_A, dt_s)
    return Transition(
        a1,
        a2,
        a3,
        ah,
        -(dt_s / cell.charge_As),
        branch_gain(point.r1_ohm, a1),
        branch_gain(point.r2_ohm, a2),
        branch_gain(point.r3_ohm, a3),
    )


@inline
def polarisation(r0_ohm: float, current_A: float, v1_V: float, v2_V: float, v3_V: float) -> float:
    """What the current takes off the OCV: R0 I + V1 + V2 + V3 [V]."""
    return (r0_ohm * current_A + v1_V) + (v2_V + v3_V)


@inline
def loaded_voltage(ocv_V: float, m_V: float, h: float, polarisation_V: float) -> float:
    """V = OCV + M h - (R0 I + V1 + V2 + V3)."""
    return (ocv_V + m_V * h) - polarisation_V


@inline
def terminal_voltage(point: CellPoint, h: float, polarisation_V: float) -> float:
    """Terminal voltage at one point of the tables [V]."""
    return loaded_voltage(point.ocv_V, point.m_V, h, polarisation_V)


@inline
def heat_step(
    cell: CellScalars, heat_K: float, current_A: float, polarisation_V: float, dt_s: float
) -> float:
    r"""Temperature of the cell above what is measured, after an interval.

    .. math:: \vartheta^{+} = b \vartheta + R_{th} P (1 - b), \quad b = e^{-\Delta t/\tau_{th}},
       \quad P = I (R_0 I + V_1 + V_2 + V_3)
    """
    if cell.heating_K_per_W == 0.0:
        return heat_K
    b = decay(dt_s, cell.heating_s)
    return b * heat_K + cell.heating_K_per_W * (1.0 - b) * (current_A * polarisation_V)


@inline
def seen_current(cell: CellScalars, current_A: float, previous_A: float, dt_s: float) -> float:
    """Current that the logged voltage has seen: delayed by the instrument's sampling delay.

    Linear between the two last samples; a delay longer than one interval counts as one interval.
    """
    if cell.skew_s <= 0.0 or dt_s <= 0.0:
        return current_A
    w = min(cell.skew_s / dt_s, 1.0)
    return current_A + w * (previous_A - current_A)


@inline
def voltage_of(point: CellPoint, state: CellState, current_A: float) -> float:
    """Terminal voltage of a state under a current [V]."""
    drop = polarisation(point.r0_ohm, current_A, state.v1_V, state.v2_V, state.v3_V)
    return terminal_voltage(point, state.h, drop)


@inline
def advance(
    tables: CellTables, state: CellState, current_A: float, dt_s: float, temperature_C: float
) -> tuple[CellState, CellPoint]:
    """One interval of constant current: charge first, then the branches at the new SOC."""
    cell = tables.cell
    soc = soc_step(cell, state.soc, current_A, dt_s)
    slow = slow_step(cell, state.slow_A, current_A, dt_s)
    cell_C = temperature_C + state.heat_K
    point = loaded(tables, soc, cell_C, current_A, slow)
    t = transition(cell, point, current_A, dt_s)
    v1 = relaxed(state.v1_V, t.a1, t.g1, current_A)
    v2 = relaxed(state.v2_V, t.a2, t.g2, current_A)
    v3 = relaxed(state.v3_V, t.a3, t.g3, current_A)
    h = hysteresis_step(state.h, t.ah, current_A)
    drop = polarisation(point.r0_ohm, current_A, v1, v2, v3)
    heat = heat_step(cell, state.heat_K, current_A, drop, dt_s)
    return CellState(soc, v1, v2, v3, h, heat, slow), point


def empty_state(soc: float, h: float = 0.0) -> CellState:
    """A cell at rest at the given SOC."""
    return CellState(float(soc), 0.0, 0.0, 0.0, float(h), 0.0, 0.0)

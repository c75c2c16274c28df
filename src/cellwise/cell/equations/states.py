"""How states go on: charge, branches, hysteresis."""

from __future__ import annotations

import math
from typing import Any

from cellwise.cell.compiled import inline
from cellwise.cell.description import BRANCHES
from cellwise.cell.equations.exponential import exponential
from cellwise.cell.equations.records import CellState, Transition
from cellwise.cell.point_kernels import CellScalars
from cellwise.cell.unrolled import ByState, unrolled


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
    return exponential(-dt_s / tau_s)


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
    return exponential(folds)


@inline
def hysteresis_step(h: float, ah: float, current_A: float) -> float:
    r"""Hysteresis after an interval; -1 discharged into, +1 charged into.

    .. math:: h^{+} = a_h h - (1 - a_h)\,\mathrm{sgn}(I)

    Source: G. Plett, Battery Management Systems vol. 1, section 2.6 (one-state hysteresis),
    with discharge current positive.
    """
    return ah * h - (1.0 - ah) * math.copysign(1.0, current_A)


@inline
@unrolled
def transition(cell: CellScalars, point: ByState, current_A: float, dt_s: float) -> Transition:
    """Decay and drive of every state over an interval of constant current."""
    a: dict[Any, float] = {}
    for i in BRANCHES:
        if i.option:
            a[i] = 1.0
            if point.r[i] != 0.0:
                a[i] = decay(dt_s, point.tau[i])
        else:
            a[i] = decay(dt_s, point.tau[i])
    ah = 1.0
    if cell.hysteresis_rate != 0.0:
        ah = hysteresis_decay(cell, current_A, dt_s)
    return Transition(
        *(a[i] for i in BRANCHES),
        ah,
        -(dt_s / cell.charge_As),
        *(branch_gain(point.r[i], a[i]) for i in BRANCHES),
    )


@inline
@unrolled
def states_step(
    state: ByState, t: ByState, current_A: float, soc: float, slow_A: float
) -> CellState:
    """Branches and hysteresis after an interval; SOC and surface as given, heat as it was."""
    h = hysteresis_step(state.h, t.ah, current_A)
    return CellState(
        soc,
        *(relaxed(state.state[i], t.a[i], t.g[i], current_A) for i in BRANCHES),
        h,
        state.heat_K,
        slow_A,
    )

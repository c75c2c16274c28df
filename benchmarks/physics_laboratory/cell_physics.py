"""A published cell in a stated condition under a current: PyBaMM's SPMe, row by row."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pybamm
from numpy.typing import NDArray

from benchmarks.physics_laboratory.changes import Condition
from benchmarks.physics_laboratory.published_cells import PublishedCell

Array = NDArray[np.float64]

KELVIN = 273.15
# A set current is reached after so long; the rows in between see the mean of it.
RAMP_S = 1e-3
RTOL, ATOL = 1e-4, 1e-6  # within 0.1 mV of a hundred times finer
COOLING = 30.0  # a chamber with a fan [W/m2K]
BEYOND_V = 0.3  # a limit ends a run; what is seen beyond it is no voltage of the cell
JUST_ABOVE_V = 1e-3  # full in equilibrium is not yet beyond the window
HYSTERESIS_DECAY = 40.0  # e-folds per full electrode


class Response(NamedTuple):
    """Rows until the end or a limit of the voltage, and why it stopped."""

    voltage_V: Array
    cell_C: Array
    limit: bool


@dataclass(frozen=True)
class Limits:
    """Voltage window of the tester [V]."""

    lower_V: float
    upper_V: float


def limits_of(cell: PublishedCell) -> Limits:
    """The published voltage window."""
    p = _published(cell)
    return Limits(float(p["Lower voltage cut-off [V]"]), float(p["Upper voltage cut-off [V]"]))


@lru_cache
def capacity_Ah(cell: PublishedCell, condition: Condition = Condition()) -> float:  # noqa: B008
    """Charge between the window's open-circuit voltages [Ah]."""
    p = _in_condition(cell, condition)
    low, high, _, _ = pybamm.lithium_ion.get_min_max_stoichiometries(p)
    return float(p.evaluate(pybamm.LithiumIonParameters().n.prim.Q_init) * (high - low))


def respond(
    cell: PublishedCell,
    condition: Condition,
    time_s: Array,
    current_A: Array,
    soc0: float,
    window: Limits | None = None,
) -> Response:
    """Voltage and temperature at every row.

    Parameters
    ----------
    time_s, current_A : (n,) array   true current, positive on discharge; that of row k flows in
                                     the interval that ends there
    soc0 : float                     of the window of the cell in its condition, in equilibrium
    window : Limits or None          ends the rows; default the published one
    """
    p = _in_condition(cell, condition)
    p.set_initial_state(soc0)
    ends = window or limits_of(cell)
    p["Lower voltage cut-off [V]"] = ends.lower_V
    p["Upper voltage cut-off [V]"] = ends.upper_V + JUST_ABOVE_V
    options: dict[str, Any] = {
        "thermal": "lumped" if cell.thermal else "isothermal",
        "contact resistance": "true",
    }
    if condition.hysteresis_V:
        options["open-circuit potential"] = (
            ("single", "one-state hysteresis") if cell.flat else ("one-state hysteresis", "single")
        )
        _with_hysteresis(p, cell, condition, soc0)
    p["Current function [A]"] = _played(time_s, current_A + condition.leak_A)
    simulation = pybamm.Simulation(
        pybamm.lithium_ion.SPMe(options),
        parameter_values=p,
        solver=pybamm.IDAKLUSolver(rtol=RTOL, atol=ATOL),
    )
    edges = np.flatnonzero(np.diff(current_A[1:])) + 1
    stops = np.unique(np.concatenate(([time_s[0]], time_s[edges], [time_s[-1]])))
    solution = simulation.solve(t_eval=stops, t_interp=time_s)
    found = solution.t
    rows = int(np.searchsorted(time_s, found[-1] + 1e-9))
    voltage = np.interp(time_s[:rows], found, solution["Voltage [V]"].entries)
    if np.any((voltage < ends.lower_V - BEYOND_V) | (voltage > ends.upper_V + BEYOND_V)):
        raise ValueError(f"{cell.name} at {np.max(voltage):.2f} V: the solver has failed")
    warm = solution["Volume-averaged cell temperature [K]"].entries
    if np.ndim(warm) == 0 or warm.shape != found.shape:
        warm = np.full(found.size, condition.ambient_C + KELVIN)
    return Response(
        voltage, np.interp(time_s[:rows], found, warm) - KELVIN, rows < time_s.size
    )  # fmt: skip


def _played(time_s: Array, current_A: Array) -> pybamm.Symbol:
    """Every row's current through its interval, with a ramp of RAMP_S at its start."""
    start, end = time_s[:-1] + RAMP_S, time_s[1:]
    knots = np.concatenate(([time_s[0]], np.column_stack([start, end]).ravel()))
    values = np.concatenate(([current_A[1]], np.repeat(current_A[1:], 2)))
    return pybamm.Interpolant(knots, values, pybamm.t, interpolator="linear")


def _published(cell: PublishedCell) -> pybamm.ParameterValues:
    """The published set with its loans."""
    p = pybamm.ParameterValues(cell.name)
    if cell.borrowed is not None:
        lender = pybamm.ParameterValues(cell.borrowed[0])
        p.update({name: lender[name] for name in cell.borrowed[1]})
    p.update(dict(cell.changes))
    if cell.thermal:
        p["Total heat transfer coefficient [W.m-2.K-1]"] = COOLING
    return p


def _in_condition(cell: PublishedCell, c: Condition) -> pybamm.ParameterValues:
    """The set in a condition."""
    p = _published(cell)
    _age(p, c)
    p.update({"Contact resistance [Ohm]": c.contact_ohm}, check_already_exists=False)
    for side, diffusion, exchange in (
        ("Negative", c.diffusion_negative, c.exchange_negative),
        ("Positive", c.diffusion_positive, c.exchange_positive),
    ):
        _scale(p, f"{side} particle diffusivity [m2.s-1]", diffusion)
        _scale(p, f"{side} electrode exchange-current density [A.m-2]", exchange)
    _scale(p, "Electrolyte conductivity [S.m-1]", c.conductivity)
    kelvin = KELVIN + c.ambient_C
    p.update({"Ambient temperature [K]": kelvin, "Initial temperature [K]": kelvin})
    if cell.thermal:
        p["Total heat transfer coefficient [W.m-2.K-1]"] = COOLING * c.cooling
    return p


def _age(p: pybamm.ParameterValues, c: Condition) -> None:
    """Lithium and active material that are left; lost material was empty of lithium."""
    if c.lithium == c.negative == c.positive == 1.0:
        return
    fractions = {s: f"{s} electrode active material volume fraction" for s in _SIDES}
    filled = {s: f"Initial concentration in {s.lower()} electrode [mol.m-3]" for s in _SIDES}
    depth = {s: f"{s} electrode thickness [m]" for s in _SIDES}
    moles = {s: p[fractions[s]] * p[depth[s]] * p[filled[s]] for s in _SIDES}
    for side, left in (("Negative", c.negative), ("Positive", c.positive)):
        p[fractions[side]] *= left
    # Only the sum matters: the window's open-circuit voltages distribute it.
    for side in _SIDES:
        p[filled[side]] = c.lithium * moles[side] / (p[fractions[side]] * p[depth[side]])


_SIDES = ("Negative", "Positive")


def _scale(p: pybamm.ParameterValues, name: str, factor: float) -> None:
    if factor == 1.0:
        return
    own = p[name]
    if callable(own):
        p[name] = lambda *a, **k: factor * own(*a, **k)
    else:
        p[name] = factor * own


def _with_hysteresis(
    p: pybamm.ParameterValues, cell: PublishedCell, c: Condition, soc0: float
) -> None:
    """Two branches around the published potential; the cell was charged into a high SOC."""
    side, sign = ("Positive", -1.0) if cell.flat else ("Negative", 1.0)
    own = p[f"{side} electrode OCP [V]"]
    # Inserting lithium lowers an electrode's potential by half the gap, taking it out raises it.
    p.update(
        {
            f"{side} electrode lithiation OCP [V]": lambda sto: own(sto) - c.hysteresis_V,
            f"{side} electrode delithiation OCP [V]": lambda sto: own(sto) + c.hysteresis_V,
            f"{side} particle lithiation hysteresis decay rate": HYSTERESIS_DECAY,
            f"{side} particle delithiation hysteresis decay rate": HYSTERESIS_DECAY,
            # PyBaMM: h = -1 lithiated into, +1 delithiated into.
            f"Initial hysteresis state in {side.lower()} electrode": -sign if soc0 > 0.5 else sign,
        },
        check_already_exists=False,
    )

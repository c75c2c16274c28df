"""Cells of porous electrodes (PyBaMM's SPMe) with the capacity, OCV and pulses of a model's cell.

What an equivalent circuit cannot do is in them: lithium that is slow within the particles, kinetics
that change with it, an electrolyte that runs short. What a published parameter set would add of its
own is not: each electrode has a part of the stated OCV for its potential, their area gives the
stated capacity, and conductivity, exchange current and diffusion are scaled until the drops after
one second and after ten minutes of a pulse are the stated cell's.

Source: Chen et al., J. Electrochem. Soc. 167 (2020) 080534, doi:10.1149/1945-7111/ab9050, for all
that is not scaled; Marquis et al., J. Electrochem. Soc. 166 (2019) A3693,
doi:10.1149/2.0341915jes, for the SPMe.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.protocol import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    Step,
    run_protocol,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

PUBLISHED = "Chen2020"
KELVIN = 273.15


@dataclass(frozen=True)
class ScalingPulse:
    """What the scaling is done on: a rest, and a load at which two drops are read."""

    soc: float = 0.5
    rate: float = 0.5  # of 1C; ten minutes take a twelfth of the charge
    rest_s: float = 10.0
    fast_s: float = 1.0
    slow_s: float = 600.0
    passes: int = 4
    most_factor: float = 50.0  # that a pass may change a property by


@dataclass(frozen=True)
class Porous:
    """How a cell is made of a stated one, and solved.

    The negative electrode has ``negative_V`` at half charge and its share of the OCV's slope; a
    particle's surface may leave the window by ``beyond_soc``, the voltage the OCV's ends by
    ``beyond_V``; a drive gives nothing back in the first ``full_share`` of the charge, the cell may
    be full; a step that ends at a limit takes at most ``longest_s``. A set current is reached in
    ``ramp_s``. The tolerances are within 0.1 mV of hundred times finer ones.
    """

    negative_V: float = 0.1
    negative_share: float = 0.5
    beyond_soc: float = 0.15
    beyond_V: float = 1.0
    full_share: float = 0.1
    longest_s: float = 8.0 * 3600.0
    ramp_s: float = 1e-3
    rtol: float = 1e-4
    atol: float = 1e-6


PULSE, POROUS = ScalingPulse(), Porous()
_one_at_a_time = threading.Lock()  # PyBaMM's models are built in global state


def has_pybamm() -> bool:
    """PyBaMM is installed; it takes seconds to import."""
    return find_spec("pybamm") is not None


@dataclass(frozen=True)
class Scales:
    """Factors on conductivity and kinetics, on diffusion; a contact's resistance."""

    fast: float = 1.0
    diffusion: float = 1.0
    contact_ohm: float = 0.0


@dataclass(frozen=True, eq=False)
class PhysicsCell:
    """A cell of porous electrodes that stands in for a model's cell at one temperature.

    Parameters
    ----------
    truth : CellModel         whose OCV, capacity and pulses it has
    temperature_C : float
    """

    truth: CellModel
    temperature_C: float
    scales: Scales = Scales()

    def lived(self, steps: Iterable[Step], soc0: float, dt_s: float) -> tuple[CellLog, FloatArray]:
        """What an ideal instrument logs of this cell, and its true SOC, shape (n,).

        A step whose limit is reached before it begins is left out; where the surface of a particle
        runs empty or full the log ends.
        """
        with _one_at_a_time:
            pybamm = import_module("pybamm")
            full_Ah = POROUS.full_share * self.truth.capacity_Ah
            pybamm.set_logging_level("CRITICAL")
            played = tuple(_played(pybamm, step, dt_s, full_Ah) for step in steps)
            simulation = pybamm.Simulation(
                pybamm.lithium_ion.SPMe({"contact resistance": "true"}),
                parameter_values=self._values(pybamm, soc0),
                experiment=pybamm.Experiment([played]),
                solver=pybamm.IDAKLUSolver(rtol=POROUS.rtol, atol=POROUS.atol),
            )
            solution = simulation.solve()
        time_s, first = np.unique(solution.t, return_index=True)
        voltage = solution["Voltage [V]"].entries[first]
        moved_Ah = solution["Discharge capacity [A.h]"].entries[first]
        current = 3600.0 * np.diff(moved_Ah) / np.diff(time_s)
        log = CellLog(
            time_s=time_s,
            current_A=np.concatenate(([0.0], current)),
            voltage_V=voltage,
            temperature_C=np.full(time_s.size, self.temperature_C),
        )
        return log, soc0 - moved_Ah / self.truth.capacity_Ah

    def _values(self, pybamm: Any, soc0: float) -> Any:
        """Parameters of PyBaMM at an SOC in equilibrium."""
        p = pybamm.ParameterValues(PUBLISHED)
        low, high, full, empty = map(float, pybamm.lithium_ion.get_min_max_stoichiometries(p))
        charge = float(p.evaluate(pybamm.LithiumIonParameters().n.prim.Q_init))
        soc = np.linspace(-POROUS.beyond_soc, 1.0 + POROUS.beyond_soc, 601)
        ocv_V = self.ocv_V(soc)
        part_V = POROUS.negative_share * (ocv_V - ocv_V.mean())
        for title, lithium, potential_V in (
            ("Negative", low + soc * (high - low), POROUS.negative_V - part_V),
            (
                "Positive",
                (empty - soc * (empty - full))[::-1],
                (POROUS.negative_V + ocv_V - part_V)[::-1],
            ),
        ):
            p[f"{title} electrode OCP [V]"] = partial(
                pybamm.Interpolant, lithium, potential_V, interpolator="linear"
            )
        p["Electrode width [m]"] *= self.truth.capacity_Ah / (charge * (high - low))
        p["Nominal cell capacity [A.h]"] = self.truth.capacity_Ah
        p["Lower voltage cut-off [V]"] = float(ocv_V[soc >= 0.0][0]) - POROUS.beyond_V
        p["Upper voltage cut-off [V]"] = float(ocv_V[soc <= 1.0][-1]) + POROUS.beyond_V
        kelvin = KELVIN + self.temperature_C
        p.update({"Ambient temperature [K]": kelvin, "Initial temperature [K]": kelvin})
        p.update({"Contact resistance [Ohm]": self.scales.contact_ohm}, check_already_exists=False)
        for side, share in (
            ("negative", low + soc0 * (high - low)),
            ("positive", empty - soc0 * (empty - full)),
        ):
            most = p[f"Maximum concentration in {side} electrode [mol.m-3]"]
            p[f"Initial concentration in {side} electrode [mol.m-3]"] = share * most
            title = side.capitalize()
            _scale(p, f"{title} particle diffusivity [m2.s-1]", self.scales.diffusion)
            _scale(p, f"{title} electrode exchange-current density [A.m-2]", self.scales.fast)
        _scale(p, "Electrolyte conductivity [S.m-1]", self.scales.fast)
        _scale(p, "Electrolyte diffusivity [m2.s-1]", max(self.scales.fast, 1.0))
        return p

    def ocv_V(self, soc: FloatArray) -> FloatArray:
        """OCV at the temperature, on straight lines beyond its ends."""
        model = self.truth
        row = np.maximum.accumulate(model.ocv_at(self.temperature_C))
        first, last = np.diff(row)[[0, -1]] / np.diff(model.soc)[[0, -1]]
        inside = np.interp(soc, model.soc, row)
        return np.asarray(inside + first * np.minimum(soc, 0.0) + last * np.maximum(soc - 1.0, 0.0))


def physics_cell(truth: CellModel, temperature_C: float) -> PhysicsCell:
    """The cell of porous electrodes whose pulse at half charge is that of a model's cell."""
    load_A = PULSE.rate * truth.capacity_Ah
    steps = (Rest(PULSE.rest_s), ConstantCurrent(current_A=load_A, duration_s=PULSE.slow_s))
    cell = PhysicsCell(truth, temperature_C)
    moved = PULSE.slow_s * PULSE.rate / 3600.0
    ocv_V = float(np.subtract(*cell.ocv_V(np.array([PULSE.soc, PULSE.soc - moved]))))
    wanted = _drops(run_protocol(truth, steps, PULSE.soc, PULSE.fast_s, temperature_C), ocv_V)
    for _ in range(PULSE.passes):
        found = _drops(cell.lived(steps, PULSE.soc, PULSE.fast_s)[0], ocv_V)
        cell = replace(cell, scales=_closer(cell.scales, found, wanted, load_A))
    return cell


def _closer(
    old: Scales, found: tuple[float, float], wanted: tuple[float, float], load_A: float
) -> Scales:
    """Scales with which the drops come nearer to the wanted ones."""
    contact = old.contact_ohm + (wanted[0] - found[0]) / load_A
    fast = old.fast
    if contact < 0.0:  # faster, until a contact can make up the rest
        fast, contact = fast * min(1.2 * found[0] / wanted[0], PULSE.most_factor), 0.0
    return Scales(fast, old.diffusion * min(found[1] / wanted[1], PULSE.most_factor), contact)


def _drops(pulse: CellLog, ocv_V: float) -> tuple[float, float]:
    """Voltage lost within the first second of the pulse, and from there to its end [V].

    ``ocv_V`` is what the OCV moves by meanwhile.
    """
    times_s = PULSE.rest_s + np.array([0.0, PULSE.fast_s, PULSE.slow_s])
    rest, fast, slow = np.interp(times_s, pulse.time_s, pulse.voltage_V)
    return max(float(rest - fast), 1e-6), max(float(fast - slow) - ocv_V, 1e-6)


def _played(pybamm: Any, step: Step, dt_s: float, full_Ah: float) -> Any:
    """A step as PyBaMM has it; a drive gives nothing back before ``full_Ah`` are gone."""
    period = f"{dt_s} seconds"
    match step:
        case Rest():
            return pybamm.step.rest(duration=step.duration_s, period=period)
        case DriveProfile():
            start = np.concatenate(([0.0], step.time_s[:-1])) + POROUS.ramp_s
            times = np.concatenate(([0.0], np.column_stack([start, step.time_s]).ravel()))
            loads = np.concatenate((step.current_A[:1], np.repeat(step.current_A, 2)))
            taken_Ah = np.cumsum(np.diff(times, prepend=0.0) * loads) / 3600.0
            loads[(taken_Ah < full_Ah) & (loads < 0.0)] = 0.0
            ends = [] if step.voltage_min_V is None else [f"<{step.voltage_min_V} V"]
            played = np.column_stack([times, loads])
            return pybamm.step.current(played, termination=ends, period=period)
        case ConstantVoltage():
            ends = [f"{step.until_current_A} A"]
            return pybamm.step.voltage(
                step.voltage_V, termination=ends, duration=POROUS.longest_s, period=period
            )
        case ConstantCurrent():
            charges = step.current_A < 0.0
            limit_V = step.voltage_max_V if charges else step.voltage_min_V
            ends = [] if limit_V is None else [f"{'>' if charges else '<'}{limit_V} V"]
            duration = step.duration_s
            if step.charge_Ah is not None:
                duration = 3600.0 * step.charge_Ah / abs(step.current_A)
            return pybamm.step.current(
                step.current_A,
                termination=ends,
                duration=duration or POROUS.longest_s,
                period=period,
            )
    raise TypeError(type(step))


def _scale(p: Any, name: str, factor: float) -> None:
    own = p[name]
    if callable(own):
        p[name] = lambda *a, **k: factor * own(*a, **k)
    else:
        p[name] = factor * own

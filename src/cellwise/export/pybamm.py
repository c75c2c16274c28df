"""Parameters of PyBaMM's Thevenin model: a Python file of tables, or PyBaMM's JSON of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.effects import (
    IN_TABLES,
    ChargeAsymmetry,
    RateDependence,
    SelfHeating,
    SlowDiffusion,
    TemperatureDependence,
    effect_table,
)
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.model import CellModel
from cellwise.cell.resolved import over_temperature
from cellwise.errors import InputError
from cellwise.estimate.fixed.tables import ROWS_C
from cellwise.export.c_tables import comment, filled
from cellwise.export.firmware import need_package
from cellwise.files import write_atomically
from cellwise.typing import FloatArray

KNOWN = (*IN_TABLES, SlowDiffusion, RateDependence, ChargeAsymmetry, SelfHeating)
HELD_J_PER_K = 1e12  # thermal mass of what keeps its temperature

FILE = '''\
"""PyBaMM's Thevenin model of the cell "@NAME@", written by `cellwise export`.

    import pybamm
    model = pybamm.equivalent_circuit.Thevenin(options=OPTIONS)
    simulation = pybamm.Simulation(model, parameter_values=get_parameter_values())

Current is positive on discharge. @NOTICES@
"""

import numpy as np
import pybamm

OPTIONS = {"number of rc elements": @BRANCHES@}
SCALARS = @SCALARS@
RATE_PER_A = @RATE@  # R0, R1 and R2 fall with the current as 1 / (1 + RATE_PER_A |I|)
CHARGE_SCALE = @CHARGE@  # factor on every resistance on charge
SOC = np.linspace(0.0, 1.0, @POINTS@)
# Rows of the tables: temperatures; columns: SOC.
OCV_TEMPERATURE_C = np.array(@OCV_TEMPERATURES@)
OCV_V = np.array([
@OCV@
])
TEMPERATURE_C = np.array(@TEMPERATURES@)
TABLES = {
@TABLES@
}
ACTIVATION_K = @ACTIVATIONS@
REFERENCE_K = @REFERENCE@


def looked_up(name, temperature_C, soc):
    """A table, linear in SOC and temperature, by its Arrhenius factor; held beyond its rows."""
    table = np.array(TABLES[name])
    axes, at = SOC, soc
    if len(TEMPERATURE_C) > 1:
        warm = pybamm.maximum(pybamm.minimum(temperature_C, TEMPERATURE_C[-1]), TEMPERATURE_C[0])
        axes, at = (TEMPERATURE_C, SOC), (warm, soc)
    else:
        table = table[0]
    found = pybamm.Interpolant(axes, table, at, name=name, interpolator="linear")
    if ACTIVATION_K[name]:
        colder = 1.0 / (temperature_C + 273.15) - 1.0 / REFERENCE_K
        found = found * pybamm.exp(ACTIVATION_K[name] * colder)
    return found


def resistance(branch):
    def r_ohm(temperature_C, current_A, soc):
        found = looked_up(f"r{branch}_ohm", temperature_C, soc)
        if RATE_PER_A and branch < 3:
            found = found / (1.0 + RATE_PER_A * abs(current_A))
        if CHARGE_SCALE != 1.0:
            found = found * (1.0 + (CHARGE_SCALE - 1.0) * (current_A < 0))
        return found

    return r_ohm


def capacitance(branch):
    def c_F(temperature_C, current_A, soc):
        r_ohm = resistance(branch)(temperature_C, current_A, soc)
        return looked_up(f"tau{branch}_s", temperature_C, soc) / r_ohm

    return c_F


def get_parameter_values(temperature_C=@USUAL@):
    """Everything that the model asks for; Initial SoC and the current function are to be set.

    PyBaMM's OCV knows no temperature: it is that of ``temperature_C``, where the cell begins.
    """
    ocv_V = [np.interp(temperature_C, OCV_TEMPERATURE_C, at_soc) for at_soc in OCV_V.T]

    def open_circuit_voltage(soc):
        return pybamm.Interpolant(SOC, np.array(ocv_V), soc, name="ocv_V", interpolator="linear")

    values = {**SCALARS, "R0 [Ohm]": resistance(0)}
    values["Open-circuit voltage [V]"] = open_circuit_voltage
    for name in ("Initial temperature [K]", "Ambient temperature [K]"):
        values[name] = temperature_C + 273.15
    for branch in range(1, @BRANCHES@ + 1):
        values[f"R{branch} [Ohm]"] = resistance(branch)
        values[f"C{branch} [F]"] = capacitance(branch)
        values[f"Element-{branch} initial overpotential [V]"] = 0.0
    return pybamm.ParameterValues(values)
'''


def write_pybamm(model: CellModel, path: str | Path) -> tuple[Path, list[str]]:
    """Write the parameters, a ``.json`` by PyBaMM; the place, and what they omit.

    Raises
    ------
    InputError        effects that PyBaMM's model has no place for; no PyBaMM for a ``.json``; a
                      path that cannot be written
    """
    others = [e.name for e in model.effects if not isinstance(e, KNOWN)]
    if others:
        raise InputError(
            f"a model with {', '.join(others)}",
            "what PyBaMM's Thevenin model knows: RC branches, temperature, current, own warming",
            "Leave them out: " + " ".join(f"`without={name}`" for name in others) + ".",
        )
    text, notices = parameter_file(model)
    if not str(path).lower().endswith(".json"):
        return write_atomically(path, text), notices
    need_package("pybamm", "generate")
    names: dict[str, Any] = {"__name__": "cellwise_parameters"}
    exec(compile(text, "cellwise_parameters.py", "exec"), names)  # what was written above
    values = names["get_parameter_values"]().to_json()
    return write_atomically(path, json.dumps(values, indent=1) + "\n"), notices


def parameter_file(model: CellModel) -> tuple[str, list[str]]:
    """The Python file, and what of the model it leaves out."""
    usual_C = model.usual_temperature_C
    slow, heating = model.effect(SlowDiffusion), model.effect(SelfHeating)
    warmth, shape = model.effect(TemperatureDependence), model.r0_ohm.shape
    branches = 3 if np.any(slow.r3_ohm) else 2
    tables = {k: getattr(model, k) for k in ("r0_ohm", "r1_ohm", "tau1_s", "r2_ohm", "tau2_s")}
    if branches == 3:
        tables |= {k: effect_table(getattr(slow, k), shape) for k in ("r3_ohm", "tau3_s")}
    activations = {k: getattr(warmth, f"{k.partition('_')[0]}_K") for k in tables}
    activations |= {k: activations[k] + warmth.activation_K for k in tables if k.startswith("r")}
    # Linear in temperature: two rows beside the model's own hold an entropy term exactly.
    rows = np.union1d(model.temperature_C, ROWS_C[[0, -1]])
    ocv_V = over_temperature(model, rows).ocv_V
    notices = [f"OCV as it is at {usual_C:g} degC."] if np.ptp(ocv_V, axis=0).any() else []
    if model.charge_efficiency != 1.0:
        notices.append(f"charge_efficiency {model.charge_efficiency:g} is left out.")
    low, high = float(model.ocv_V.min()), float(model.ocv_V.max())
    per_K = 1.0 / heating.rth_K_per_W if heating.rth_K_per_W > 0.0 else 1.0
    warming_J_per_K = heating.thermal_s * per_K if heating.rth_K_per_W > 0.0 else HELD_J_PER_K
    scalars = {
        "Cell capacity [A.h]": model.capacity_Ah,
        "Nominal cell capacity [A.h]": model.capacity_Ah,
        "Current function [A]": model.capacity_Ah,
        "Initial SoC": 1.0,
        "Upper voltage cut-off [V]": model.voltage_max_V or high + 0.2,
        "Lower voltage cut-off [V]": model.voltage_min_V or 0.5 * low,
        "Cell thermal mass [J/K]": warming_J_per_K,
        "Cell-jig heat transfer coefficient [W/K]": per_K,
        "Jig thermal mass [J/K]": HELD_J_PER_K,
        "Jig-air heat transfer coefficient [W/K]": 1.0,
        "Entropic change [V/K]": 0.0,
    }
    marks = {
        "@NAME@": comment(model.name).replace('"', "'") or "unnamed",
        "@NOTICES@": " ".join(notices),
        "@BRANCHES@": str(branches),
        "@SCALARS@": json.dumps(scalars, indent=4),
        "@RATE@": repr(model.effect(RateDependence).rate_h / model.capacity_Ah),
        "@CHARGE@": repr(model.effect(ChargeAsymmetry).charge_scale),
        "@POINTS@": str(model.points),
        "@OCV_TEMPERATURES@": repr(rows.tolist()),
        "@OCV@": _rows(ocv_V),
        "@TEMPERATURES@": repr(model.temperature_C.tolist()),
        "@TABLES@": "\n".join(f'    "{k}": [\n{_rows(v)}\n    ],' for k, v in tables.items()),
        "@ACTIVATIONS@": json.dumps(activations, indent=4),
        "@REFERENCE@": repr(warmth.reference_C + ZERO_CELSIUS_K),
        "@USUAL@": repr(usual_C),
    }
    return filled(FILE, marks), notices


def _rows(table: FloatArray) -> str:
    return "\n".join("        [" + ", ".join(f"{v:.8g}" for v in row) + "]," for row in table)

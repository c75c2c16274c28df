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
from cellwise.export.c_tables import comment, filled, firmware_folder
from cellwise.export.firmware import need_package
from cellwise.export.package import Export
from cellwise.files import write_atomically
from cellwise.notices import Code, Notice, texts
from cellwise.typing import FloatArray
from cellwise.wording import arg, joined_texts

KNOWN = (*IN_TABLES, SlowDiffusion, RateDependence, ChargeAsymmetry, SelfHeating)
SUFFIXES = (".py", ".json")
HELD_J_PER_K = 1e12  # thermal mass of what keeps its temperature
TEMPLATE = "pybamm/parameters.py.in"


def check(path: str) -> None:
    """Refuse a ``.json`` without PyBaMM, which writes it."""
    if path.lower().endswith(".json"):
        need_package("pybamm")


def write(export: Export, path: str) -> tuple[list[Path], list[Notice]]:
    """Write the parameters, a ``.json`` by PyBaMM; the place, and what they omit.

    Raises
    ------
    InputError        effects that PyBaMM's model has no place for; a path that cannot be written
    """
    model = export.model
    others = [e.name for e in model.effects if not isinstance(e, KNOWN)]
    if others:
        raise InputError(
            f"a model with {', '.join(others)}",
            "what PyBaMM's Thevenin model knows: RC branches, temperature, current, own warming",
            "Leave them out: "
            + joined_texts((arg("without", letter=name) for name in others), " ")
            + ".",
        )
    text, notices = parameter_file(model)
    if not path.lower().endswith(".json"):
        return [write_atomically(path, text)], notices
    names: dict[str, Any] = {"__name__": "cellwise_parameters"}
    exec(compile(text, "cellwise_parameters.py", "exec"), names)  # what was written above
    values = names["get_parameter_values"]().to_json()
    return [write_atomically(path, json.dumps(values, indent=1) + "\n")], notices


def parameter_file(model: CellModel) -> tuple[str, list[Notice]]:
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
    notices = []
    if np.ptp(ocv_V, axis=0).any():
        text = f"OCV as it is at {usual_C:g} degC."
        notices.append(Notice(Code.OCV_OF_ONE_TEMPERATURE, text))
    if model.charge_efficiency != 1.0:
        text = f"charge_efficiency {model.charge_efficiency:g} is left out."
        notices.append(Notice(Code.EFFICIENCY_LEFT_OUT, text))
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
        "@NOTICES@": " ".join(texts(notices)),
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
    template = (firmware_folder() / TEMPLATE).read_text(encoding="utf-8")
    return filled(template, marks), notices


def _rows(table: FloatArray) -> str:
    return "\n".join("        [" + ", ".join(f"{v:.8g}" for v in row) + "]," for row in table)

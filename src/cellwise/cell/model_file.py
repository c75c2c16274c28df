"""A CellModel as JSON: written whole, read with its version checked."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.effects import EFFECTS, Effect
from cellwise.cell.model import TABLES, CellModel, ModelError, ModelTables
from cellwise.errors import InputError
from cellwise.files import write_atomically

SCHEMA_VERSION = 1


def model_to_dict(model: CellModel) -> dict[str, Any]:
    """The model as plain JSON values, every number at full precision."""
    return {
        "schema_version": SCHEMA_VERSION,
        "kind": "cellwise.CellModel",
        "name": model.name,
        "chemistry": model.chemistry,
        "capacity_Ah": float(model.capacity_Ah),
        "charge_efficiency": float(model.charge_efficiency),
        "voltage_min_V": model.voltage_min_V,
        "voltage_max_V": model.voltage_max_V,
        "temperature_C": model.temperature_C.tolist(),
        "soc": model.soc.tolist(),
        **{name: getattr(model, name).tolist() for name in TABLES},
        "effects": [_effect_to_dict(e) for e in model.effects],
        "error": asdict(model.error),
        "provenance": dict(model.provenance),
    }


def model_mark(model: CellModel) -> str:
    """A short mark of everything that changes what a model computes; not its name or its past."""
    kept = {k: v for k, v in model_to_dict(model).items() if k not in ("provenance", "name")}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def model_from_dict(data: Any, where: str = "the model") -> CellModel:
    """The model back from JSON values.

    Raises
    ------
    InputError        not a cellwise model, another schema version, a missing or wrong entry
    """
    if not isinstance(data, dict) or data.get("kind") != "cellwise.CellModel":
        raise InputError(
            f"JSON that is not a cellwise model in {where}",
            'an object with "kind": "cellwise.CellModel"',
            "Write one with `cellwise identify ... -o MODEL`.",
        )
    version = data.get("schema_version")
    if version != SCHEMA_VERSION:
        raise InputError(
            f"schema_version {version!r} in {where}",
            f"schema_version {SCHEMA_VERSION}",
            "Identify the model again with this cellwise, or use the cellwise that wrote it.",
        )
    try:
        soc = np.asarray(data["soc"], dtype=np.float64)
        if not np.allclose(soc, np.linspace(0.0, 1.0, soc.size), atol=1e-9):
            raise InputError(
                f"a SOC grid that is not uniform from 0 to 1 in {where}",
                "uniform steps from 0 to 1",
                "Interpolate the tables onto a uniform grid.",
            )
        if soc.size != np.shape(data["ocv_V"])[-1]:
            raise InputError(
                f"a SOC grid of {soc.size} points and tables of {np.shape(data['ocv_V'])[-1]} "
                f"in {where}",
                "one table column per SOC point",
                "Write the model again.",
            )
        return CellModel(
            float(data["capacity_Ah"]),
            *ModelTables(*(np.asarray(data[name], dtype=np.float64) for name in TABLES)),
            temperature_C=np.asarray(data["temperature_C"], dtype=np.float64),
            effects=tuple(_effect_from_dict(e, where) for e in data["effects"]),
            charge_efficiency=float(data["charge_efficiency"]),
            error=_error_from_dict(data["error"]),
            voltage_min_V=data["voltage_min_V"],
            voltage_max_V=data["voltage_max_V"],
            name=str(data["name"]),
            chemistry=str(data["chemistry"]),
            provenance=dict(data["provenance"]),
        )
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(
            f"{where} with a missing or wrong entry: {error}",
            "every entry that `cellwise identify` writes",
            "Write the model again.",
        ) from error


def write_model(model: CellModel, path: str | Path) -> None:
    """Write the model as JSON; the file appears whole or not at all."""
    text = json.dumps(model_to_dict(model), indent=1, allow_nan=False) + "\n"
    write_atomically(Path(path), text)


def read_model(path: str | Path) -> CellModel:
    """Read a model file; see :func:`model_from_dict` for what is refused."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"no readable model file at {path} ({error.__class__.__name__})",
            "a JSON file written by `cellwise identify`",
            "Check the path.",
        ) from error
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path} that is not JSON (line {error.lineno}: {error.msg})",
            "a JSON file written by `cellwise identify`",
            "Check that the file is complete.",
        ) from error
    return model_from_dict(data, str(path))


def _error_from_dict(data: dict[str, Any]) -> ModelError:
    return ModelError(**{**data, "slow_V": tuple(float(v) for v in data["slow_V"])})


def _effect_to_dict(effect: Effect) -> dict[str, Any]:
    values = {
        f.name: np.asarray(getattr(effect, f.name), dtype=np.float64).tolist()
        for f in fields(effect)
    }
    return {"name": effect.name, **values}


def _effect_from_dict(data: dict[str, Any], where: str) -> Effect:
    kind = EFFECTS.get(str(data.get("name")))
    if kind is None:
        raise InputError(
            f"effect {data.get('name')!r} in {where}",
            f"one of {', '.join(EFFECTS)}",
            "Use the cellwise that wrote the model.",
        )
    values: dict[str, Any] = {
        key: np.asarray(value, dtype=np.float64) if isinstance(value, list) else float(value)
        for key, value in data.items()
        if key != "name"
    }
    return kind(**values)

"""A CellModel as JSON: written whole, read with its version, entries and sizes checked."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from cellwise.arguments import file_path
from cellwise.cell.effects import EFFECTS, Effect
from cellwise.cell.model import TABLES, CellModel, ModelTables
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.sizes import check_is_model, check_physical
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.posterior import Posterior
from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.typing import FloatArray

T = TypeVar("T")
SCHEMA_VERSION = 1
ENTRIES = ("schema_version", "kind", "soc", *(f.name for f in fields(CellModel)))


def model_to_dict(model: CellModel) -> dict[str, Any]:
    """The model as plain JSON values, every number at full precision."""
    posterior = {} if model.posterior is None else {"posterior": model.posterior.to_dict()}
    validity = {"validity": model.validity.to_dict()} if model.validity.known else {}
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
        "error": {k: v for k, v in model.error.to_dict().items() if v is not None and v != ()},
        **posterior,
        **validity,
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
    InputError        not a cellwise model, another schema version, a missing, unknown or wrong
                      entry, a number that no cell can have
    """
    if not isinstance(data, dict) or data.get("kind") != "cellwise.CellModel":
        raise InputError(
            f"JSON that is not a cellwise model in {where}",
            'an object with "kind": "cellwise.CellModel"',
            "Write one with `cellwise identify ... -o MODEL`.",
        )
    version = data.get("schema_version")
    if isinstance(version, bool) or version != SCHEMA_VERSION:
        raise InputError(
            f"schema_version {version!r} in {where}",
            f"schema_version {SCHEMA_VERSION}",
            "Identify the model again with this cellwise, or use the cellwise that wrote it.",
        )
    _check_entries(data, ENTRIES, where)
    try:
        soc = _array(data["soc"])
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
        model = CellModel(
            _number(data["capacity_Ah"]),
            *ModelTables(*(_array(data[name]) for name in TABLES)),
            temperature_C=_array(data["temperature_C"]),
            effects=tuple(_effect_from_dict(e, where) for e in data["effects"]),
            charge_efficiency=_number(data["charge_efficiency"]),
            error=_record(ModelError, data["error"], f"the error of {where}", "soc"),
            posterior=_maybe(Posterior.of_dict, data.get("posterior")),
            validity=_record(Validity, data.get("validity", {}), f"the validity of {where}"),
            voltage_min_V=_maybe(_number, data["voltage_min_V"]),
            voltage_max_V=_maybe(_number, data["voltage_max_V"]),
            name=str(data["name"]),
            chemistry=str(data["chemistry"]),
            provenance=dict(data["provenance"]),
        )
    except InputError as error:
        if where in error.found:
            raise
        raise InputError(error.found + f" in {where}", error.expected, error.action) from None
    except (
        *(KeyError, TypeError, ValueError, AttributeError, IndexError),
        *(OverflowError, RecursionError),
    ) as error:
        raise InputError(
            f"{where} with a missing or wrong entry: {error}",
            "every entry that `cellwise identify` writes",
            "Write the model again.",
        ) from error
    check_physical(model, where)
    return model


def write_model(model: CellModel, path: str | Path) -> None:
    """Write the model as JSON; the file appears whole or not at all.

    Raises
    ------
    InputError        a number that no cell can have: the file could not be read back
    """
    check_is_model(model)
    place = file_path("path", path)
    text = json.dumps(model_to_dict(model), indent=1, allow_nan=False) + "\n"
    write_atomically(place, text)


def read_model(path: str | Path) -> CellModel:
    """Read a model file; see :func:`model_from_dict` for what is refused."""
    path = file_path("path", path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"no readable model file at {path} ({error.__class__.__name__})",
            "a JSON file written by `cellwise identify`",
            "Check the path.",
        ) from error
    try:
        data = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_double)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path} that is not JSON ({error})",
            "a JSON file written by `cellwise identify`",
            "Check that the file is complete.",
        ) from None
    return model_from_dict(data, str(path))


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}, which is no number")


def _no_double(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose every key stands once."""
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"'{next(n for n in names if names.count(n) > 1)}' stands twice in it")
    return found


def _check_entries(data: Mapping[str, Any], known: Collection[str], where: str) -> None:
    """Refuse an entry that nothing would read: mostly a misspelt one."""
    for name in data:
        if name not in known:
            near = difflib.get_close_matches(name, [n for n in known if n not in data], 1, 0.6)
            raise InputError(
                f"an unknown entry '{name}' in {where}",
                f"'{near[0]}'" if near else f"only {', '.join(known)}",
                "Correct its name, or use the cellwise that wrote the model.",
            )


def _array(value: Any) -> FloatArray:
    """Numbers in lists, all rows of one length."""
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{str(value)[:40]} where numbers belong")
    return np.asarray(array, dtype=np.float64)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{str(value)[:40]!r} where a number belongs")
    return float(value)


def _numbers(value: Any) -> Any:
    """A number, or lists of lists of them as tuples."""
    return tuple(map(_numbers, value)) if isinstance(value, list | tuple) else _number(value)


def _table(value: Any) -> FloatArray | float:
    return _array(value) if isinstance(value, list) else _number(value)


def _maybe(read: Callable[[Any], Any], value: Any) -> Any:
    return None if value is None else read(value)


def _record(
    kind: type[T], data: Any, where: str, beside: str = "", read: Callable[[Any], Any] = _numbers
) -> T:
    """A record of numbers; null where its default is, and one entry ``beside`` that is not its."""
    if not isinstance(data, Mapping):
        raise TypeError(f"{str(data)[:40]} where the entries of {kind.__name__} belong")
    known = {f.name: f.default is None for f in fields(kind)}  # type: ignore[arg-type]
    _check_entries(data, (beside, *known), where)
    return kind(
        **{k: _maybe(read, v) if known[k] else read(v) for k, v in data.items() if k != beside}
    )


def _effect_to_dict(effect: Effect) -> dict[str, Any]:
    values = {f.name: np.asarray(getattr(effect, f.name), np.float64) for f in fields(effect)}
    return {"name": effect.name, **{name: value.tolist() for name, value in values.items()}}


def _effect_from_dict(data: dict[str, Any], where: str) -> Effect:
    name = str(data.get("name"))
    if name not in EFFECTS:
        raise InputError(
            f"effect {data.get('name')!r} in {where}",
            f"one of {', '.join(EFFECTS)}",
            "Use the cellwise that wrote the model.",
        )
    return _record(EFFECTS[name], data, f"effect {name} of {where}", "name", _table)

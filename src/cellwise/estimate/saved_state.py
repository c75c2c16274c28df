"""A filter's state as JSON values and back, so that a restart goes on where it stopped."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.packed import fields_of
from cellwise.errors import InputError
from cellwise.estimate.filters.bank_kernels import empty_bank
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.kalman import BankState
from cellwise.files import write_atomically
from cellwise.typing import FloatArray

SCHEMA_VERSION = 6
MAY_BE_MISSING = {"temperature_C", "voltage_V", "current_A"}  # not measured yet


def state_to_dict(state: EkfState, estimator: str = "ekf") -> dict[str, Any]:
    """A state of the EKF or UKF as JSON values, records within records; missing numbers are null.

    After a restart pass ``gap=True`` and the time that has passed as ``dt_s`` with the first
    sample: nobody knows what has flowed meanwhile.
    """
    known = {"schema_version": SCHEMA_VERSION, "estimator": estimator}
    saved = {**known, "state": _to_json(state)}
    if isinstance(state, BankState):
        saved["bank"] = [[_to_json(value) for value in row] for row in state.bank.tolist()]
    return saved


def state_from_dict(saved: Mapping[str, Any], estimator: str = "ekf") -> EkfState:
    """The state that :func:`state_to_dict` wrote, bit for bit.

    Raises
    ------
    InputError        of another version or estimator; a number that is missing or none
    """
    found = saved.get("schema_version"), saved.get("estimator")
    if found != (SCHEMA_VERSION, estimator):
        raise InputError(
            f"a state of version {found[0]} of estimator '{found[1]}'",
            f"version {SCHEMA_VERSION} of '{estimator}'",
            "Start again with init() where there is no such state.",
        )
    state: EkfState = _record("state", EkfState, saved.get("state"))
    return state if "bank" not in saved else BankState.of_bank(_bank(saved["bank"]))


def write_state(state: EkfState, path: Path | str, estimator: str = "ekf") -> None:
    """Save a state as a JSON file; it appears whole or not at all."""
    text = json.dumps(state_to_dict(state, estimator), indent=1, allow_nan=False)
    write_atomically(path, text)


def read_state(path: Path | str, estimator: str = "ekf") -> EkfState:
    """Read a state from a JSON file; raises InputError as :func:`state_from_dict`."""
    return state_from_dict(read_saved(path), estimator)


def read_saved(path: Path | str) -> Mapping[str, Any]:
    """The JSON object in a file of a state.

    Raises
    ------
    InputError        no file, no JSON, no object
    """
    try:
        saved = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"no state in '{path}' ({error})", "a file that cellwise wrote", "Start again."
        ) from None
    if not isinstance(saved, Mapping):
        raise InputError(f"a {type(saved).__name__} in '{path}'", "a JSON object", "Start again.")
    return saved


def _bank(rows: Any) -> FloatArray:
    """The components of a saved state."""
    bank = empty_bank()
    try:
        found = np.array([[np.nan if v is None else float(v) for v in row] for row in rows])
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.ndim != 2 or found.shape[0] < 3 or found.shape[1:] != bank.shape[1:]:
        raise InputError(
            f"components of shape {found.shape} in a saved state",
            f"numbers of shape (components and 2, {bank.shape[1]})",
            "Start again with init().",
        )
    return found


def _to_json(value: Any) -> Any:
    if isinstance(value, tuple):
        record: Any = value
        return {k: _to_json(v) for k, v in record._asdict().items()}
    if math.isnan(value):
        return None
    return float(value) if math.isfinite(value) else str(float(value))


def _record(name: str, kind: Any, values: Any) -> Any:
    if not isinstance(values, Mapping) or set(values) != set(kind._fields):
        raise InputError(
            f"a saved {name} with {sorted(values) if isinstance(values, Mapping) else values}",
            f"the fields {', '.join(kind._fields)}",
            "Start again with init().",
        )
    kinds = zip(kind._fields, fields_of(kind), strict=True)
    return kind(*(_number(n, values[n]) if k is float else _record(n, k, values[n])
                  for n, k in kinds))  # fmt: skip


def _number(name: str, value: Any) -> float:
    if value is None and name in MAY_BE_MISSING:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{name} = {value} in a saved state", "a finite number", "Start again.")
    return float(value)

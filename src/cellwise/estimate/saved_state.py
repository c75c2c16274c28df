"""A filter's state as JSON values and back, so that a restart goes on where it stopped."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellwise.cell.equations import CellState
from cellwise.errors import InputError
from cellwise.estimate.filters.covariance_kernels import Covariance
from cellwise.estimate.filters.drift_kernels import Drift, no_drift
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.past_kernels import Past, no_past
from cellwise.estimate.sensing_kernels import Watch
from cellwise.files import write_atomically

SCHEMA_VERSION = 2
INFINITE = {"inf": math.inf, "-inf": -math.inf}
# What a file of this version calls them.
COUNTS = {
    "rejections": "rejections",
    "mismatch": "mismatch",
    "lasting": "persistent",
    "contradicted": "contradicted",
}
PARTS = {
    "state": (*CellState._fields, *Covariance._fields, *COUNTS),
    "drift": Drift._fields,
    "past": Past._fields,
    "watch": Watch._fields,
}
# Not in files of versions before it was carried,
NEWER: dict[str, dict[str, float]] = {
    "state": {"slow_A": 0.0, "contradicted": 0.0},
    "drift": no_drift()._asdict(),
    "past": no_past()._asdict(),
    "watch": {"no_warm_s": -1.0},
}
# and in files of versions that carried it.
GONE = ("room_up", "room_down", "fresh")
MAY_BE_MISSING = {"temperature_C", "voltage_V", "current_A"}  # not measured yet


def state_to_dict(state: EkfState, estimator: str = "ekf") -> dict[str, Any]:
    """A state of the EKF or UKF as JSON values: a missing number is null.

    After a restart pass ``gap=True`` and the time that has passed as ``dt_s`` with the first
    sample: nobody knows what has flowed meanwhile.
    """
    counts = {name: getattr(state, field) for name, field in COUNTS.items()}
    parts = {
        "state": {**state.cell._asdict(), **state.p._asdict(), **counts},
        "drift": state.drift._asdict(),
        "past": state.past._asdict(),
        "watch": state.watch._asdict(),
    }
    return {
        "schema_version": SCHEMA_VERSION,
        "estimator": estimator,
        **{part: {k: _to_json(float(v)) for k, v in of.items()} for part, of in parts.items()},
    }


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
    values = {part: _numbers(part, saved.get(part, {})) for part in PARTS}
    state = values["state"]
    return EkfState(
        CellState(**{name: state[name] for name in CellState._fields}),
        Covariance(**{name: state[name] for name in Covariance._fields}),
        **{field: state[name] for name, field in COUNTS.items()},
        drift=Drift(**values["drift"]),
        watch=Watch(**values["watch"]),
        past=Past(**values["past"]),
    )


def write_state(state: EkfState, path: Path | str, estimator: str = "ekf") -> None:
    """Save a state as a JSON file; it appears whole or not at all."""
    text = json.dumps(state_to_dict(state, estimator), indent=1, allow_nan=False)
    write_atomically(path, text)


def read_state(path: Path | str, estimator: str = "ekf") -> EkfState:
    """Read a state from a JSON file; raises InputError as :func:`state_from_dict`."""
    try:
        saved = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"no state in '{path}' ({error})", "a JSON file that write_state wrote", "Start again."
        ) from None
    if not isinstance(saved, Mapping):
        raise InputError(f"a {type(saved).__name__} in '{path}'", "a JSON object", "Start again.")
    return state_from_dict(saved, estimator)


def _to_json(value: float) -> float | str | None:
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else str(value)


def _numbers(part: str, values: Any) -> dict[str, float]:
    if isinstance(values, Mapping):
        values = NEWER[part] | {k: v for k, v in values.items() if k not in GONE}
    if not isinstance(values, Mapping) or set(values) != set(PARTS[part]):
        raise InputError(
            f"a saved state with {sorted(values) if isinstance(values, Mapping) else values}",
            f"the fields {', '.join(PARTS[part])}",
            "Start again with init().",
        )
    return {name: _number(name, values[name]) for name in PARTS[part]}


def _number(name: str, value: Any) -> float:
    if value is None and name in MAY_BE_MISSING:
        return math.nan
    if isinstance(value, str) and value in INFINITE and name in ("repeats", "rest_s"):
        return INFINITE[value]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{name} = {value} in a saved state", "a finite number", "Start again.")
    return float(value)

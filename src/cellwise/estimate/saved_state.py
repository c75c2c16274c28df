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
# Not in files of versions before it was carried; a cell at rest has none.
NEWER = {"slow_A": 0.0, "contradicted": 0.0}

NEWER_PAST = {"looked_A": 0.0}
NEWER_DRIFT = {"rest_s": 0.0, "rest_A": 0.0}
NEWER_WATCH = {"no_warm_s": -1.0}
GONE = ("room_up", "room_down", "fresh")  # in files of versions that carried them
MAY_BE_MISSING = {"temperature_C", "voltage_V", "current_A"}  # not measured yet


def state_to_dict(state: EkfState, estimator: str = "ekf") -> dict[str, Any]:
    """A state of the EKF or UKF as JSON values: a missing number is null.

    After a restart pass ``gap=True`` and the time that has passed as ``dt_s`` with the first
    sample: nobody knows what has flowed meanwhile.
    """
    values = {**state.cell._asdict(), **state.p._asdict()}
    values |= {name: getattr(state, field) for name, field in COUNTS.items()}
    return {
        "schema_version": SCHEMA_VERSION,
        "estimator": estimator,
        "state": {name: _to_json(float(value)) for name, value in values.items()},
        "drift": {k: _to_json(float(v)) for k, v in state.drift._asdict().items()},
        "past": {k: float(v) for k, v in state.past._asdict().items()},
        "watch": {k: _to_json(float(v)) for k, v in state.watch._asdict().items()},
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
    seen = saved.get("watch")
    if isinstance(seen, Mapping):
        seen = {**NEWER_WATCH, **{k: v for k, v in seen.items() if k not in GONE}}
    watch = Watch(**_numbers(seen, Watch._fields))
    before = saved.get("past", no_past()._asdict())
    if isinstance(before, Mapping):
        before = {**NEWER_PAST, **before}
    past = Past(**_numbers(before, Past._fields))
    moved = saved.get("drift", no_drift()._asdict())
    if isinstance(moved, Mapping):
        moved = {**NEWER_DRIFT, **moved}
    drift = Drift(**_numbers(moved, Drift._fields))
    names = (*CellState._fields, *Covariance._fields, *COUNTS)
    given = saved.get("state")
    if isinstance(given, Mapping):
        given = {**NEWER, **given}
    values = _numbers(given, names)
    return EkfState(
        CellState(**{name: values[name] for name in CellState._fields}),
        Covariance(**{name: values[name] for name in Covariance._fields}),
        **{field: values[name] for name, field in COUNTS.items()},
        drift=drift,
        watch=watch,
        past=past,
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


def _numbers(values: Any, names: tuple[str, ...]) -> dict[str, float]:
    if not isinstance(values, Mapping) or set(values) != set(names):
        raise InputError(
            f"a saved state with {sorted(values) if isinstance(values, Mapping) else values}",
            f"the fields {', '.join(names)}",
            "Start again with init().",
        )
    return {name: _number(name, values[name]) for name in names}


def _number(name: str, value: Any) -> float:
    if value is None and name in MAY_BE_MISSING:
        return math.nan
    if isinstance(value, str) and value in INFINITE and name in ("repeats", "rest_s"):
        return INFINITE[value]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{name} = {value} in a saved state", "a finite number", "Start again.")
    return float(value)

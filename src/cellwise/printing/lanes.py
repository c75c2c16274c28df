"""Prints `estimate/lockstep/lane_kernels.py`: a filter's state in and out of its lane."""

from __future__ import annotations

from cellwise.cell.description import CELL, entry, triangle
from cellwise.printing.text import head, wrapped_call

WATCH = (
    "current_A",
    "temperature_C",
    "evidence_s",
    "no_current_s",
    "no_voltage_s",
    "voltage_V",
    "frozen_A",
    "repeats",
    "no_warm_s",
)
PAST = ("mean_A", "looked_A", "miss_V", "first_soc", "first_variance")
DRIFT = (
    *("reach", "offset", "information", "believed", "unsure", "d1_V", "d2_V", "d3_V"),
    *("rest_s", "rest_A"),
)
# Groups of a state as the filters nest them: the record, and its fields.
GROUPS = (
    ("cell", "CellState", (*(s.name for s in CELL), "heat_K", "slow_A")),
    ("p", "Covariance", tuple(entry(a, b) for a, b in triangle(CELL))),
    ("", "", ("rejections", "mismatch", "persistent", "contradicted")),
    ("drift", "Drift", DRIFT),
    ("watch", "Watch", WATCH),
    ("past", "Past", PAST),
)
# Readings of the sample before.
LAST = {"voltage_V": "LAST_V", "current_A": "LAST_A", "temperature_C": "LAST_C"}
# What a lane carries beside the state: the Arrhenius factor, and the temperature it is of.
EXTRA = ("factor", "factor_C")


def fields() -> list[tuple[str, str]]:
    """Name of every field and how it is reached from a state."""
    return [
        (f, f"state.{group}.{f}" if group else f"state.{f}") for group, _, g in GROUPS for f in g
    ]


def constant(field: str) -> str:
    """Name of a field's place: ``P11``, ``SOC``, ``REPEATS``."""
    if field in LAST:
        return LAST[field]
    if field in ("rest_s", "rest_A"):
        return field.upper()
    has_unit = field[-2:] in ("_V", "_A", "_K", "_s", "_C")
    return (field[:-2] if has_unit else field).upper()


def lanes_text() -> str:
    """The module's text."""
    names = [constant(f) for f, _ in fields()] + [e.upper() for e in EXTRA]
    lines = [
        *head("A filter's state in its lane: field by field, LANES cells side by side."),
        "from cellwise.cell.compiled import inline",
        "from cellwise.cell.equations import CellState",
        "from cellwise.estimate.filters.covariance_kernels import Covariance",
        "from cellwise.estimate.filters.drift_kernels import Drift",
        "from cellwise.estimate.filters.filter_state import EkfState",
        "from cellwise.estimate.filters.past_kernels import Past",
        "from cellwise.estimate.sensing_kernels import Watch",
        "from cellwise.typing import FloatArray",
        "",
        "LANES = 16  # fewer than sixteen turns are not worth a vector to the compiler",
        "# Fields of a block, LANES numbers each.",
        *wrapped_call("", [*names]),
    ]
    lines[-1] += f" = range({len(names)})"
    lines += [f"FIELDS = {len(names)}", *("", "", "@inline")]
    lines += [
        "def get_state(block: FloatArray, lane: int) -> EkfState:",
        '    """A cell\'s state out of its lane."""',
        "    return EkfState(",
    ]
    for _, record, group in GROUPS:
        places = [f"block[{constant(f)} * LANES + lane]" for f in group]
        if record:
            lines += [f"        {record}(", *(f"            {p}," for p in places), "        ),"]
        else:
            lines += [f"        {p}," for p in places]
    lines += ["    )", *("", "", "@inline")]
    lines += [
        *wrapped_call(
            "def put_state",
            ["block: FloatArray", "lane: int", "state: EkfState", "puts: bool"],
            " -> None:",
        ),
        '    """A cell\'s state into its lane, or none: without a branch."""',
    ]
    for field, path in fields():
        place = f"block[{constant(field)} * LANES + lane]"
        lines.append(f"    {place} = {path} if puts else {place}")
    return "\n".join([*lines, ""])

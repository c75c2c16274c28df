"""Prints `cell/point_kernels.py`: parameters as the kernels see them, and a row of the tables."""

from __future__ import annotations

from cellwise.cell.description import COLUMNS, SCALARS
from cellwise.printing.text import head, wrapped_call

SIGNATURE = "table: FloatArray, at: np.uint64, k: np.uint64, f: float, g: float"


def point_fields() -> tuple[str, ...]:
    """Fields of a `CellPoint`: every column, and the slope of those that have one."""
    return tuple(n for c in COLUMNS for n in ((c.field, c.slope) if c.sloped else (c.field,)))


def scalar_fields() -> tuple[str, ...]:
    """Fields of a `CellScalars`."""
    return tuple(s.name for s in SCALARS)


def points_text() -> str:
    """The module's text."""
    numbers = ", ".join(c.number for c in COLUMNS)
    lines = [
        *head("Parameters of a cell as the kernels see them, and a row of its tables."),
        "from typing import NamedTuple",
        "",
        "import numpy as np",
        "",
        "from cellwise.cell.compiled import inline",
        "from cellwise.typing import FloatArray",
        "",
        "# Columns of the packed table.",
        f"({numbers}) = range({len(COLUMNS)})",
        f"COLUMNS = {len(COLUMNS)}",
        "",
        "",
        "class CellScalars(NamedTuple):",
        '    """What a `CellModel` says beside its tables."""',
        "",
        *(f"    {s.name}: float  # {s.meaning}" for s in SCALARS),
        "",
        "",
        "class CellPoint(NamedTuple):",
        '    """The tables at one SOC and temperature; slopes over SOC."""',
        "",
    ]
    for c in COLUMNS:
        lines.append(f"    {c.field}: float  # {c.meaning}")
        if c.sloped:
            lines.append(f"    {c.slope}: float")
    lines += [
        "",
        "",
        "@inline",
        f"def point_of({SIGNATURE}) -> CellPoint:",
        '    """Tables of one temperature, at share f (sloped columns) or g of interval k."""',
        "    n = table.shape[1]",
        "    k1 = k + np.uint64(1)",
    ]
    for c in COLUMNS:
        name, share = c.field.rsplit("_", 1)[0], "f" if c.sloped else "g"
        low, high = f"table[at, k, {c.number}]", f"table[at, k1, {c.number}]"
        lines.append(f"    {name} = {low} + {share} * ({high} - {low})")
        if c.sloped:
            lines.append(f"    {name}_slope = ({high} - {low}) * (n - 1)")
    names = [n.rsplit("_", 1)[0] for n in point_fields()]
    lines += wrapped_call("    return CellPoint", names)
    lines += [
        "",
        "",
        "@inline",
        "def between(low: CellPoint, high: CellPoint, w: float) -> CellPoint:",
        '    """From one temperature\'s point at w = 0 to the next one\'s at w = 1."""',
    ]
    lines += wrapped_call(
        "    return CellPoint", [f"low.{n} + w * (high.{n} - low.{n})" for n in point_fields()]
    )
    return "\n".join([*lines, ""])

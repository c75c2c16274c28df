"""Prints `identify/refinement/derivative_kernels.py`: derivatives of single equations.

The refinement knows the SOC and has splines for tables, so it goes through the equations one by
one and carries derivatives with respect to its own coefficients.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass

from cellwise.cell.point_kernels import CellScalars
from cellwise.printing.tangents.derivatives import Derivatives
from cellwise.printing.tangents.straight_line import Reader, Value, Wish, record
from cellwise.printing.text import head, wrapped_call

IMPORTS = """
import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.point_kernels import CellScalars
"""


@dataclass(frozen=True)
class Part:
    """Equations whose derivatives are taken together.

    Parameters
    ----------
    name, text : str                 of the printed function
    calls : what is called           function, arguments, and what the result is called
    arguments : tuple of str         of the printed function
    by : tuple of str                with respect to what
    """

    name: str
    text: str
    calls: tuple[tuple[str, tuple[str, ...], str], ...]
    arguments: tuple[str, ...]
    by: tuple[str, ...]


PARTS = (
    Part(
        "seen_partials",
        "Of the current that the voltage has seen.",
        (("seen_current", ("cell", "current_A", "previous_A", "dt_s"), "seen"),),
        ("cell", "current_A", "previous_A", "dt_s"),
        ("cell.skew_s",),
    ),
    Part(
        "thermal_partials",
        "Of an Arrhenius factor.",
        (("thermal_factor", ("activation_K", "inverse_K"), "factor"),),
        ("activation_K", "inverse_K"),
        ("activation_K",),
    ),
    Part(
        "transfer_partials",
        "Of the resistance of a charge transfer.",
        (("transfer_resistance", ("asinh_per_V", "r_ohm", "current_A"), "new"),),
        ("asinh_per_V", "r_ohm", "current_A"),
        ("asinh_per_V", "r_ohm", "current_A"),
    ),
    Part(
        "branch_partials",
        "Of a branch's voltage after an interval.",
        (("rc_step", ("v_V", "current_A", "r_ohm", "tau_s", "dt_s"), "new"),),
        ("v_V", "current_A", "r_ohm", "tau_s", "dt_s"),
        ("v_V", "current_A", "r_ohm", "tau_s"),
    ),
    Part(
        "hysteresis_partials",
        "Of the hysteresis state after an interval.",
        (
            ("hysteresis_decay", ("cell", "current_A", "dt_s"), "ah"),
            ("hysteresis_step", ("h", "ah", "current_A"), "new"),
        ),
        ("cell", "h", "current_A", "dt_s"),
        ("h", "cell.hysteresis_rate", "current_A"),
    ),
    Part(
        "voltage_partials",
        "Of the terminal voltage.",
        (
            ("polarisation", ("r0_ohm", "current_A", "v1_V", "v2_V", "v3_V"), "drop"),
            ("loaded_voltage", ("ocv_V", "m_V", "h", "drop"), "voltage"),
        ),
        ("ocv_V", "m_V", "h", "r0_ohm", "current_A", "v1_V", "v2_V", "v3_V"),
        ("ocv_V", "m_V", "h", "r0_ohm", "current_A", "v1_V", "v2_V", "v3_V"),
    ),
)


def part_text(part: Part) -> list[str]:
    """A record and the function that fills it."""
    reader = Reader()
    known: dict[str, Value] = {n: ast.Name(n) for n in part.arguments}
    known["cell"] = record("cell", CellScalars._fields)
    output = ""
    for function, arguments, output in part.calls:
        known[output] = reader.call(function, [known[n] for n in arguments], Wish(output, function))
    d = Derivatives(reader, [output], part.by, constants=True)
    name = part.name.title().replace("_", "")
    typed = [f"{n}: {'CellScalars' if n == 'cell' else 'float'}" for n in part.arguments]
    return [
        *d.record(name, part.text),
        *("", "", "@inline"),
        *wrapped_call(f"def {part.name}", typed, f" -> {name}:"),
        f'    """{part.text}"""',
        *d.body(),
        *wrapped_call(f"    return {name}", d.values()),
    ]


def part_derivatives_text(parts: Sequence[Part] = PARTS) -> str:
    """The module's text."""
    lines = [
        *head(
            "Derivatives of single equations of a cell.",
            source="cellwise.cell.equations",
        ),
        *IMPORTS.strip().splitlines(),
        *(line for part in parts for line in part_text(part)),
    ]
    return "\n".join([*lines, ""])

"""Prints the derivatives of the cell's equations, from their text.

Every line of the equations has derivatives with respect to the names in it. Lines in between are
then taken out, from the last to the first, by the chain rule: what remains is how the new state
and the voltage follow the old state, the current, the tables and the scalars.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cellwise.cell.equations import CellState
from cellwise.cell.point_kernels import COLUMN_SOURCES, CellPoint, CellScalars
from cellwise.printing.gradients import added, gradient, is_number, product
from cellwise.printing.straight_line import Line, Reader, Value, Wish, record, unused
from cellwise.printing.text import head, wrapped_call

Edges = dict[str, dict[str, ast.expr]]

POINT, SCALARS, STATE = CellPoint._fields, CellScalars._fields, CellState._fields
# What stays a name of its own over an interval, in the order of the equations.
OUTPUTS = ("soc", "slow", "v1", "v2", "v3", "h", "drop", "heat", "voltage")
FIELDS = list(COLUMN_SOURCES)
SURFACE_ONLY = ("slow", "cell.surface_")
SURFACE_ORIGINS = ("followed", "surface_soc")
ACTIVATION = "activation_K"
SURFACE = [n for n in FIELDS if n.endswith(("_ohm", "_s"))]  # at the surface's SOC
CELL_ARGUMENTS = ["cell: CellScalars", "state: CellState"]
NOW = ["current_A: float", "dt_s: float", "temperature_C: float"]
IMPORTS = """
import math
from typing import NamedTuple

from cellwise.cell.compiled import inline
from cellwise.cell.equations import ZERO_CELSIUS_K, CellState
from cellwise.cell.point_kernels import CellPoint, CellScalars
"""


def atomic(node: ast.expr) -> bool:
    """A name, a number, or one of them with a minus."""
    if isinstance(node, ast.UnaryOp):
        return atomic(node.operand)
    return isinstance(node, ast.Name | ast.Constant)


def only_needed(line: Line) -> ast.expr:
    """What a line computes; an exponential of the surface only where the surface counts.

    Another one of an activation that is zero is 1 without being computed.
    """
    value = line.value
    if not isinstance(value, ast.Call):
        return value
    if line.origin in SURFACE_ORIGINS:
        return ast.IfExp(ast.Name("surface_counts"), value, ast.Constant(0.0))
    exponent = value.args[0]
    if isinstance(exponent, ast.BinOp) and ast.unparse(exponent.left).endswith(ACTIVATION):
        active = ast.Compare(exponent.left, [ast.NotEq()], [ast.Constant(0.0)])
        return ast.IfExp(active, value, ast.Constant(1.0))
    return value


def short(name: str) -> str:
    """Name of an input or a line within the name of a derivative: ``old_v1`` for ``state.v1_V``."""
    holder, _, last = name.rpartition(".")
    return f"{'old_' if holder == 'state' else ''}{last}"


class Derivatives:
    """Lines of a calculation and what remains of their derivatives.

    Parameters
    ----------
    reader : Reader       has read the calculation
    outputs : names of lines that stay; everything else is taken out
    inputs : names with respect to which derivatives are taken
    edges : derivatives that are not those of a line, by name and by what they are with respect to
    constants : whether derivatives of 1 and -1 have a field of the record, too
    """

    def __init__(
        self,
        reader: Reader,
        outputs: Sequence[str],
        inputs: Sequence[str],
        edges: Edges | None = None,
        *,
        constants: bool = False,
    ) -> None:
        self.lines, self.outputs, self.constants = reader.lines, outputs, constants
        edges = edges or {}
        self.edges: Edges = dict(edges)
        self.chain: list[Line] = []
        active = {*inputs, *edges}
        for line in self.lines:
            found = gradient(line.value, active, ast.Name(line.name))
            if found:
                self.edges[line.name] = found
                active.add(line.name)
        self._names = {line.name for line in self.lines}
        # From the last to the first; tables after the lines that use them, and after the tables
        # the lines that nothing but a look-up uses.
        late: list[str] = []
        for line in reversed(self.lines):
            users = {u for u, by in self.edges.items() if line.name in by}
            if users and users <= {*edges, *late}:
                late.append(line.name)
        early = [line.name for line in reversed(self.lines) if line.name not in late]
        for name in [*early, *edges, *late]:
            if name not in outputs:
                self._take_out(name)
        for name in outputs:
            self.edges[name] = {n: self._shared(name, n, g) for n, g in self.edges[name].items()}

    def _shared(self, name: str, by: str, value: ast.expr) -> ast.expr:
        """A derivative under its name, where it is more than a name or a number."""
        if atomic(value):
            return value
        called = unused(f"{short(name)}_by_{short(by)}", self._names)
        self._names.add(called)
        self.chain.append(Line(called, value, "chain rule, from the last line to the first"))
        return ast.Name(called)

    def _take_out(self, name: str) -> None:
        """Chain rule: those who follow this line follow what it follows."""
        followed = self.edges.pop(name, {})
        users = [u for u, by in self.edges.items() if name in by]
        if not users:
            return
        if len(users) > 1:
            followed = {n: self._shared(name, n, g) for n, g in followed.items()}
        for user in users:
            outer = self._shared(user, name, self.edges[user].pop(name))
            for by, inner in followed.items():
                self.edges[user][by] = added(self.edges[user].get(by), product(outer, inner))

    def kept(self) -> list[tuple[str, str]]:
        """Outputs and what they follow, where that is not a constant."""
        pairs = [(u, by) for u in self.outputs for by in self.edges[u]]
        return [(u, by) for u, by in pairs if self.constants or not self.constant(u, by)]

    def constant(self, name: str, by: str) -> bool:
        """Whether a derivative is 1 or -1."""
        return any(is_number(self.edges[name][by], x) for x in (1.0, -1.0))

    def body(self) -> list[str]:
        """The lines that the derivatives need, and the chain rule."""
        needed = {n for u, by in self.kept() for n in names_in(self.edges[u][by])}
        shown: list[Line] = []
        for line in reversed([*self.lines, *self.chain]):
            if line.name in needed:
                needed |= names_in(line.value)
                shown.insert(0, line)
        text: list[str] = []
        for k, line in enumerate(shown):
            if k == 0 or line.origin != shown[k - 1].origin:
                text.append(f"    # {line.origin}")
            text.append(f"    {line.name} = {ast.unparse(only_needed(line))}")
        return text

    def record(self, name: str, text: str, more: Sequence[str] = ()) -> list[str]:
        """The record of derivatives."""
        fields = [f"    {short(u)}_by_{short(by)}: float" for u, by in self.kept()]
        return [*("", "", f"class {name}(NamedTuple):"), f'    """{text}"""', "", *more, *fields]

    def values(self) -> list[str]:
        """What goes into the record."""
        return [ast.unparse(self.edges[u][by]) for u, by in self.kept()]

    def follows(self, name: str, directions: Mapping[str, str]) -> str:
        """The direction of an output, given those of what it follows."""
        text = ""
        for by, value in self.edges[name].items():
            if by not in directions:
                continue
            minus = is_number(value, -1.0)
            factor = "" if self.constant(name, by) else f"p.{short(name)}_by_{short(by)} * "
            sign = " - " if minus else " + "
            text += f"{sign if text or minus else ''}{factor}{directions[by]}"
        return text.removeprefix(" ") or "0.0"


def names_in(node: ast.expr) -> set[str]:
    """Names of an expression."""
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def interval() -> Derivatives:
    """An interval of constant current, and the voltage at its end."""
    reader = Reader(given={"tables_at": record("table", POINT), "place_of": {}})
    # Columns that are looked up at the surface's SOC are those that stand there.
    reader.given["at_surface"] = reader.given["tables_at"]
    tables: Value = {"cell": record("cell", SCALARS), "table": {}}
    now: list[Value] = [ast.Name(n.split(":")[0]) for n in NOW]
    old = record("state", STATE)
    match reader.call("advance", [tables, old, *now]):
        case [state, point]:
            reader.call("voltage_of", [point, state, now[0]], Wish("voltage", "voltage_of"))
    looked_up: Edges = {
        f"table.{n}": {
            "surface" if n in SURFACE else "soc": ast.Name(f"by_soc.{n}"),
            "cell_C": ast.Name(f"by_kelvin.{n}"),
            f"column.{n}": ast.Constant(1.0),
        }
        for n in FIELDS
    }
    inputs = [f"state.{n}" for n in STATE] + [f"cell.{n}" for n in SCALARS]
    inputs += ["current_A", *(f"column.{n}" for n in FIELDS)]
    return Derivatives(reader, OUTPUTS, inputs, looked_up)


def tangent(
    d: Derivatives, name: str, text: str, arguments: list[str], given: dict[str, str]
) -> list[str]:
    """A function of directions: the new state's and the voltage's."""
    directions = given | {n: n for n in d.outputs}
    lines = ["", "", "@inline"]
    lines += wrapped_call(
        f"def {name}",
        ["p: Partials", *arguments, "surface_counts: bool"],
        " -> tuple[CellState, float]:",
    )
    lines += [f'    """{text}"""']
    for n in d.outputs:
        # What comes by the surface costs nothing where it is not.
        by_surface = {by: x for by, x in directions.items() if by.startswith(SURFACE_ONLY)}
        others = {by: x for by, x in directions.items() if by not in by_surface}
        if n == "slow":
            others, by_surface = directions, {}
        lines.append(f"    {n} = {d.follows(n, others)}")
        more = d.follows(n, by_surface)
        if more != "0.0":
            lines += ["    if surface_counts:", f"        {n} += {more}"]
    return [*lines, "    return CellState(soc, v1, v2, v3, h, heat, slow), voltage"]


def derivatives_text() -> str:
    """The module's text."""
    d = interval()
    lines = [
        *head(
            "Derivatives of the cell's equations over an interval of constant current.",
            "Line by line, and with respect to an effect that is at its neutral value, too.",
            source="cellwise.cell.equations",
        ),
        *IMPORTS.strip().splitlines(),
        *d.record("Partials", "How states and voltage follow what the interval began with."),
        *("", "", "@inline"),
        *wrapped_call(
            "def partials",
            [
                *CELL_ARGUMENTS,
                *NOW,
                "table: CellPoint",
                "by_soc: CellPoint",
                "by_kelvin: CellPoint",
                "surface_counts: bool",
            ],
            " -> Partials:",
        ),
        '    """Derivatives; ``table`` at the new SOC under no load, and its slopes.',
        "",
        "    Where not ``surface_counts`` nothing of the surface's SOC counts, nor is it right.",
        '    """',
        *d.body(),
        *wrapped_call("    return Partials", d.values()),
        *tangent(
            d,
            "carried",
            "Directions after an interval, of those before it, of the current and the tables.",
            ["d: CellState", "flow_A: float", "at: CellPoint"],
            {f"state.{n}": f"d.{n}" for n in STATE}
            | {"current_A": "flow_A"}
            | {f"column.{n}": f"at.{n}" for n in FIELDS},
        ),
        *tangent(
            d,
            "driven",
            "What the directions of the scalars add to those after the interval.",
            ["d: CellScalars"],
            {f"cell.{n}": f"d.{n}" for n in SCALARS},
        ),
    ]
    return "\n".join([*lines, ""])


class Part(NamedTuple):
    """Equations whose derivatives are taken together, with respect to the names ``by``.

    ``calls`` are statements with functions of the equations, ``arguments`` the printed function's.
    """

    name: str
    text: str
    calls: tuple[str, ...]
    arguments: tuple[str, ...]
    by: tuple[str, ...]


PARTS = (
    Part(
        "seen_partials",
        "Of the current that the voltage has seen.",
        ("seen = seen_current(cell, current_A, previous_A, dt_s)",),
        ("cell", "current_A", "previous_A", "dt_s"),
        ("cell.skew_s",),
    ),
    Part(
        "thermal_partials",
        "Of an Arrhenius factor.",
        ("factor = thermal_factor(activation_K, inverse_K)",),
        ("activation_K", "inverse_K"),
        ("activation_K",),
    ),
    Part(
        "transfer_partials",
        "Of the resistance of a charge transfer.",
        ("new = transfer_resistance(asinh_per_V, r_ohm, current_A)",),
        ("asinh_per_V", "r_ohm", "current_A"),
        ("asinh_per_V", "r_ohm", "current_A"),
    ),
    Part(
        "branch_partials",
        "Of a branch's voltage after an interval.",
        ("new = rc_step(v_V, current_A, r_ohm, tau_s, dt_s)",),
        ("v_V", "current_A", "r_ohm", "tau_s", "dt_s"),
        ("v_V", "current_A", "r_ohm", "tau_s"),
    ),
    Part(
        "hysteresis_partials",
        "Of the hysteresis state after an interval.",
        ("ah = hysteresis_decay(cell, current_A, dt_s)", "new = hysteresis_step(h, ah, current_A)"),
        ("cell", "h", "current_A", "dt_s"),
        ("h", "cell.hysteresis_rate", "current_A"),
    ),
    Part(
        "voltage_partials",
        "Of the terminal voltage.",
        (
            "drop = polarisation(r0_ohm, current_A, v1_V, v2_V, v3_V)",
            "voltage = loaded_voltage(ocv_V, m_V, h, drop)",
        ),
        ("ocv_V", "m_V", "h", "r0_ohm", "current_A", "v1_V", "v2_V", "v3_V"),
        ("ocv_V", "m_V", "h", "r0_ohm", "current_A", "v1_V", "v2_V", "v3_V"),
    ),
)


def part_text(part: Part) -> list[str]:
    """A record and the function that fills it."""
    reader = Reader()
    known: dict[str, Value] = {n: ast.Name(n) for n in part.arguments}
    known["cell"] = record("cell", SCALARS)
    output = ""
    for statement in part.calls:
        match ast.parse(statement).body[0]:
            case ast.Assign([ast.Name(output)], ast.Call(ast.Name(function), arguments)):
                values = [known[ast.unparse(a)] for a in arguments]
                known[output] = reader.call(function, values, Wish(output, function))
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


def part_derivatives_text() -> str:
    """The text of `identify/refinement/derivative_kernels.py`.

    The refinement knows the SOC and has splines for tables, so it goes through the equations one by
    one and carries derivatives with respect to its own coefficients.
    """
    imports = IMPORTS.replace("from cellwise.cell.equations import ZERO_CELSIUS_K, CellState\n", "")
    lines = [
        *head("Derivatives of single equations of a cell.", source="cellwise.cell.equations"),
        *imports.replace("CellPoint, ", "").strip().splitlines(),
        *(line for part in PARTS for line in part_text(part)),
    ]
    return "\n".join([*lines, ""])

"""A Python function of the fixed step as C reads it: names, types, expressions."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import Any

from cellwise.printing.c.chosen import FLOATS

SCALARS = {**dict.fromkeys(FLOATS, "float"), "int": "uint32_t", "bool": "bool"}
RECORDS = {
    "Model": "const cellwise_model", "Constants": "const cellwise_constants",
    "State": "cellwise_state", "Sample": "const cellwise_input", "Output": "cellwise_output",
    "Capability": "cellwise_capability", "Outlook": "cellwise_outlook",
    "Landing": "cellwise_landing", "Phase": "const cellwise_phase",
    "Cell": "cellwise_pack_cell",
    "Cells": "cellwise_pack_cell", "CellOutput": "cellwise_cell_output", "Floats": "const float",
    "Phases": "const cellwise_phase",
}  # fmt: skip
ELEMENTS = {"Cells": "Cell", "Floats": "float", "Phases": "Phase"}  # of what is an array
KEPT = ("State", "Cell")  # from step to step: const where nothing is changed
# Done on bits in cellwise_float.h: macros, and functions.
MACROS = {
    "within", "size_within", "size_below", "not_negative", "positive_within", "positive_above",
    "is_number", "known_fraction",
}  # fmt: skip
BY_HAND = {**dict.fromkeys(MACROS, "bool"), "known_fraction": "float", "magnitude": "float"}
POINTS = "m.row.shape[1]"
OPERATORS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitOr: "|", ast.Lt: "<",
    ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.And: "&&",
    ast.Or: "||",
}  # fmt: skip


@dataclass
class Program:
    """What the functions stand on.

    ``structs`` are the fields of every record and named tuple with their type, ``constants`` the
    type and text of every name that is one, ``columns`` the fields of the table by column.
    """

    structs: dict[str, dict[str, str]]
    constants: dict[str, tuple[str, str]]
    columns: dict[str, str]
    sizes: dict[str, str]
    temperatures: bool = False
    functions: dict[str, Any] = field(default_factory=dict)


class Reading:
    """One function of the step: what it calls, and its text in C; ``behind`` are its comments."""

    def __init__(self, node: ast.FunctionDef, program: Program, behind: dict[int, str]) -> None:
        self.node, self.program, self.behind = node, program, behind
        self.parameters = {a.arg: ast.unparse(a.annotation) for a in node.args.args if a.annotation}
        self.returns = ast.unparse(node.returns) if node.returns else "None"
        self.noinline = any(ast.unparse(d) == "noinline" for d in node.decorator_list)
        self.types = dict(self.parameters)
        self.pointers = {n for n, t in self.parameters.items() if t not in SCALARS}
        self.renamed = self._renamed()
        self.uses = {
            n.id for s in self._body() for n in ast.walk(s)
            if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
        }  # fmt: skip
        self.mutates = self._mutates()

    def _body(self) -> list[ast.stmt]:
        return self.node.body[1:] if ast.get_docstring(self.node) else self.node.body

    @property
    def fills(self) -> bool:
        """Whether it returns a named tuple, in C through a pointer."""
        return self.returns in self.program.structs

    @property
    def filled(self) -> str:
        """Name of that pointer."""
        return self.returns.lower()

    def _renamed(self) -> dict[str, tuple[str, str]]:
        """Locals that are a field of the struct which is filled: text and type."""
        last = self.node.body[-1]
        if not (isinstance(last, ast.Return) and isinstance(last.value, ast.Call)):
            return {}
        if not self.fills or ast.unparse(last.value.func) != self.returns:
            return {}
        fields = self.program.structs[self.returns].items()
        return {
            a.id: (f"{self.filled}->{name}", kind)
            for (name, kind), a in zip(fields, last.value.args, strict=True)
            if isinstance(a, ast.Name) and a.id not in self.parameters
            and a.id not in self.program.constants
        }  # fmt: skip

    def _mutates(self) -> set[str]:
        """Kinds of records that it changes, itself or by what it calls."""
        found: set[str] = set()
        for node in ast.walk(self.node):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                found.add(self.parameters.get(ast.unparse(node.value), ""))
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                called = self.program.functions.get(node.func.id)
                found |= called.mutates if called else set()
        return found

    def _called(self, node: ast.AST) -> Reading | None:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self.program.functions.get(node.func.id)
        return None

    # ---- expressions ----

    def type_of(self, node: ast.expr) -> str:
        """float, int, bool or the name of a record."""
        match node:
            case ast.Name():
                if node.id in self.renamed:
                    return self.renamed[node.id][1]
                known = self.types.get(node.id) or self.program.constants.get(node.id, ("",))[0]
                return known or "int"
            case ast.Attribute():
                fields = self.program.structs.get(self.type_of(node.value), {})
                return fields.get(node.attr, "int")
            case ast.Call():
                name = ast.unparse(node.func)
                made = {"F": "float", "U": "int", "read": "float", "rise": "float", **BY_HAND}
                called = self._called(node)
                return called.returns if called else made[name]
            case ast.BinOp():
                return self.type_of(node.left)
            case ast.IfExp():
                return self.type_of(node.body)
            case ast.Compare() | ast.BoolOp():
                return "bool"
            case ast.UnaryOp():
                return "bool" if isinstance(node.op, ast.Not) else self.type_of(node.operand)
            case ast.Constant():
                return "bool" if isinstance(node.value, bool) else "int"
            case ast.Subscript():
                if ast.unparse(node) == POINTS:
                    return "int"
                return ELEMENTS.get(self.type_of(node.value), "float")
        return "float"

    def expression(self, node: ast.expr) -> str:
        """An expression with the parentheses that it needs inside another."""
        node = self._unwrapped(node)
        text = self.bare(node)
        compound = isinstance(node, ast.BinOp | ast.Compare | ast.BoolOp | ast.IfExp)
        return f"({text})" if compound else text

    def bare(self, node: ast.expr) -> str:
        """An expression as it stands alone."""
        node = self._unwrapped(node)
        of = self.expression
        match node:
            case ast.Name():
                if node.id in self.renamed:
                    return self.renamed[node.id][0]
                return self.program.constants.get(node.id, ("", node.id))[1]
            case ast.Constant():
                return str(node.value).lower() + ("" if isinstance(node.value, bool) else "u")
            case ast.Attribute():
                if node.attr == "size":
                    return self.program.sizes[node.value.attr]  # type: ignore[attr-defined]
                arrow = isinstance(node.value, ast.Name) and node.value.id in self.pointers
                return f"{self.bare(node.value)}{'->' if arrow else '.'}{node.attr}"
            case ast.Subscript():
                if ast.unparse(node) == POINTS:
                    return "CELLWISE_POINTS"
                return f"{of(node.value)}[{self.bare(node.slice)}]"
            case ast.UnaryOp():
                return f"{'!' if isinstance(node.op, ast.Not) else '-'}{of(node.operand)}"
            case ast.BinOp():
                return f"{of(node.left)} {OPERATORS[type(node.op)]} {of(node.right)}"
            case ast.Compare():
                return f"{of(node.left)} {OPERATORS[type(node.ops[0])]} {of(node.comparators[0])}"
            case ast.BoolOp():
                return f" {OPERATORS[type(node.op)]} ".join(map(of, node.values))
            case ast.IfExp():
                return f"{of(node.test)} ? {of(node.body)} : {of(node.orelse)}"
            case ast.Call():
                return self._call(node)
        raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")

    def _unwrapped(self, node: ast.expr) -> ast.expr:
        """Without a conversion that C does not need."""
        while isinstance(node, ast.Call) and ast.unparse(node.func) in ("F", "U"):
            if (ast.unparse(node.func) == "F") != (self.type_of(node.args[0]) in FLOATS):
                break
            node = node.args[0]
        return node

    def _call(self, node: ast.Call) -> str:
        name = ast.unparse(node.func)
        if name in ("F", "U"):
            return f"({'float' if name == 'F' else 'uint32_t'}){self.expression(node.args[0])}"
        if name in ("read", "rise"):
            args = [self.program.columns.get(ast.unparse(a)) or self.bare(a) for a in node.args[2:]]
            return f"{name.upper()}({', '.join(args)})"
        args = [self.argument(a) for a in node.args]
        return f"{name.upper() if name in MACROS else name}({', '.join(args)})"

    def argument(self, node: ast.expr) -> str:
        """An argument: records by their address."""
        by_address = self.type_of(node) in (*self.program.structs, *RECORDS)
        if by_address and not (isinstance(node, ast.Name) and node.id in self.pointers):
            return f"&{self.bare(node)}"
        return self.bare(node)

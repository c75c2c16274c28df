"""Reads functions of `cell/equations/` as straight lines: one assignment after the other.

Calls are put in place, records split into fields. A condition on a parameter (`rate_per_A != 0.0`,
an effect that may be absent) is taken as met, because a derivative AT the neutral value is wanted;
a condition on what the cell is doing (`current_A < 0.0`) becomes part of the line.
"""

from __future__ import annotations

import ast
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import NamedTuple

from cellwise.cell import equations
from cellwise.cell.point_kernels import CellPoint

Value = ast.expr | dict[str, "Value"] | list["Value"]
# Records that the equations build.
RECORDS = {
    "CellPoint": CellPoint._fields,
    "CellState": equations.CellState._fields,
    "Transition": equations.Transition._fields,
}
KEPT_CALLS = ("abs", "min", "max")


@dataclass(frozen=True)
class Line:
    """``name = value``, out of the function ``origin``."""

    name: str
    value: ast.expr
    origin: str


class Wish(NamedTuple):
    """What a value is to be called, and the function that calls it so."""

    name: str
    origin: str

    def part(self, field: str) -> Wish:
        """The same for a field of a record."""
        return Wish(field.rsplit("_", 1)[0], self.origin)


Known = dict[str, Value]


def number(value: Value | None) -> ast.expr:
    """A value that must not be a record."""
    if isinstance(value, ast.expr):
        return value
    raise ValueError(f"a number is needed, not {value}")


def functions_of(text: str) -> dict[str, ast.FunctionDef]:
    """Every function of a module's text."""
    return {n.name: n for n in ast.parse(text).body if isinstance(n, ast.FunctionDef)}


def parsed(text: str | None = None) -> dict[str, ast.FunctionDef]:
    """Every function of the equations, or of another text."""
    if text is not None:
        return functions_of(text)
    found: dict[str, ast.FunctionDef] = {}
    for file in sorted(Path(equations.__file__).parent.glob("*.py")):
        found |= functions_of(file.read_text(encoding="utf-8"))
    return found


def record(holder: str, names: tuple[str, ...]) -> Value:
    """A record whose fields are inputs: ``holder.name``."""
    return {n: ast.Name(f"{holder}.{n}") for n in names}


def unused(name: str, names: Collection[str]) -> str:
    """The name, or the name with the first number that is not taken."""
    numbered = (name if k == 1 else f"{name}_{k}" for k in count(1))
    return next(n for n in numbered if n not in names)


@dataclass
class Reader:
    """Functions put in place, into ``lines``.

    ``given`` are functions that are not read, but whose result is given.
    """

    given: dict[str, Value] = field(default_factory=dict)
    functions: dict[str, ast.FunctionDef] = field(default_factory=parsed)
    lines: list[Line] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    conditional: bool = False

    def call(self, name: str, arguments: list[Value], wish: Wish | None = None) -> Value:
        """Result of a function of the equations, under the name it is wished to have."""
        if name in self.given:
            return self.given[name]
        function = self.functions[name]
        names = [a.arg for a in function.args.args]
        wish = wish or Wish(name, name)
        found = self.block(function.body, dict(zip(names, arguments, strict=True)), name, wish)
        if found is None:
            raise ValueError(f"{name} returns nothing")
        return self.named(found, wish)

    def named(self, value: Value, wish: Wish) -> Value:
        """The value under a name of its own, where it is more than a name or a number."""
        if isinstance(value, dict):
            return {n: self.named(v, wish.part(n)) for n, v in value.items()}
        if isinstance(value, list | ast.Name | ast.Constant) or self.conditional:
            return value
        text = ast.unparse(value)
        if text not in self.names:
            self.names[text] = unused(wish.name, self.names.values())
            self.lines.append(Line(self.names[text], value, wish.origin))
        return ast.Name(self.names[text])

    def block(self, body: list[ast.stmt], known: Known, origin: str, wish: Wish) -> Value | None:
        """Run statements; what they return, if they do."""
        for at, statement in enumerate(body):
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)], value=node):
                    own = Wish(name, origin)
                    known[name] = self.named(self.value(node, known, own), own)
                case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=nodes)):
                    for target, node in zip(names, nodes, strict=True):
                        known[ast.unparse(target)] = self.value(node, known, wish)
                case ast.AugAssign(target=ast.Name(id=name), op=op, value=node):
                    change = self.single(node, known, Wish(f"{name}_factor", origin))
                    whole = ast.BinOp(number(known[name]), op, change)
                    known[name] = self.named(whole, Wish(name, origin))
                case ast.If(test=test, body=inner, orelse=[]):
                    condition = self.condition(test, known, origin)
                    if condition is False:
                        continue
                    if condition is True:
                        returned = self.block(inner, known, origin, wish)
                        if returned is not None:
                            return returned
                        continue
                    within, returned = self.on_condition(inner, known, origin, wish)
                    if returned is not None:
                        rest = self.block(body[at + 1 :], known, origin, wish)
                        return ast.IfExp(condition, number(returned), number(rest))
                    for name, value in within.items():
                        if known.get(name) is not value:
                            either = ast.IfExp(condition, number(value), number(known[name]))
                            known[name] = self.named(either, Wish(name, origin))
                case ast.Return(value=ast.expr() as node):
                    return self.value(node, known, wish)
                case ast.Expr(value=ast.Constant()):
                    continue
                case _:
                    raise ValueError(f"{origin}: cannot read {ast.unparse(statement)}")
        return None

    def on_condition(
        self, body: list[ast.stmt], known: Known, origin: str, wish: Wish
    ) -> tuple[Known, Value | None]:
        """What is known and returned if a condition holds; no lines are written for it."""
        outer, self.conditional = self.conditional, True
        within = dict(known)
        returned = self.block(body, within, origin, wish)
        self.conditional = outer
        return within, returned

    def condition(self, test: ast.expr, known: Known, origin: str) -> ast.expr | bool:
        """Whether a test is met away from every neutral value, or what remains of it."""
        if isinstance(test, ast.BoolOp):
            met = isinstance(test.op, ast.And)
            parts = [self.condition(t, known, origin) for t in test.values]
            if (not met) in parts:
                return not met
            rest = [p for p in parts if not isinstance(p, bool)]
            if not rest:
                return met
            return rest[0] if len(rest) == 1 else ast.BoolOp(test.op, rest)
        match test:
            case ast.Compare(left=ast.Attribute(value=ast.Name(id="cell" | "point")), ops=[op]):
                return isinstance(op, ast.NotEq | ast.Gt)
        return self.single(test, known, Wish("condition", origin))

    def single(self, node: ast.expr, known: Known, wish: Wish) -> ast.expr:
        """An expression that is a number."""
        return number(self.value(node, known, wish))

    def value(self, node: ast.expr, known: Known, wish: Wish) -> Value:
        """An expression in terms of the inputs and the lines before."""

        def of(inner: ast.expr) -> ast.expr:
            return self.single(inner, known, Wish("", wish.origin))

        match node:
            case ast.Name(id=name):
                return known.get(name, ast.Name(name))
            case ast.Constant():
                return node
            case ast.Attribute(value=holder, attr=name):
                whole = self.value(holder, known, wish)
                if isinstance(whole, dict):
                    return whole[name]
            case ast.BinOp(left=left, op=op, right=right):
                return ast.BinOp(of(left), op, of(right))
            case ast.UnaryOp(op=sign, operand=operand):
                return ast.UnaryOp(sign, of(operand))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return ast.Compare(of(left), ops, [of(o) for o in others])
            case ast.IfExp(test=test, body=yes, orelse=no):
                return ast.IfExp(of(test), of(yes), of(no))
            case ast.Tuple(elts=elements):
                return [self.value(e, known, wish) for e in elements]
            case ast.Call(func=ast.Attribute(value=ast.Name(id="math")), args=arguments):
                return ast.Call(node.func, [of(a) for a in arguments], [])
            case ast.Call(func=ast.Name(id=name), args=arguments) if name in RECORDS:
                pairs = zip(RECORDS[name], arguments, strict=True)
                return {n: self.value(a, known, wish.part(n)) for n, a in pairs}
            case ast.Call(func=ast.Name(id=name), args=arguments) if name in KEPT_CALLS:
                return ast.Call(node.func, [of(a) for a in arguments], [])
            case ast.Call(func=ast.Name(id=name), args=arguments):
                own = wish if wish.name else Wish(name, name)
                names = [a.arg for a in self.functions[name].args.args]
                given = zip(names, arguments, strict=True)
                return self.call(name, [self.argument(n, a, known, own) for n, a in given], own)
        raise ValueError(f"{wish.origin}: cannot read {ast.unparse(node)}")

    def argument(self, name: str, node: ast.expr, known: Known, wish: Wish) -> Value:
        """What a function is called with; a calculation there has a line of its own."""
        if isinstance(node, ast.Call):
            return self.value(node, known, Wish("", wish.origin))
        own = Wish(name, wish.origin)
        return self.named(self.value(node, known, own), own)

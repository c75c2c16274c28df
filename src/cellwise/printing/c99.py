"""Python functions of the fixed step as C99, statement by statement, in the same order.

What the sources may say is what C can: floats, counts, flags, records; ``if``, loops, calls. A
function that returns a named tuple fills a struct: what it names in its last statement is that
struct's field from the start.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import Any

from cellwise.estimate.fixed import layout
from cellwise.printing.chosen import FLOATS, joined, note_of
from cellwise.printing.text import WIDTH, broken, comment, float_literal

SCALARS = {**dict.fromkeys(FLOATS, "float"), "int": "uint32_t", "Count": "uint32_t", "bool": "bool"}
WHOLE = ("U", "Count")  # conversions to a whole number
ELEMENTS = {
    "States": "State",
    "Cells": "Cell",
    "Floats": "float",
    "Phases": "Phase",
}  # of what is an array
READ = ("Model", "Constants", "Sample", "Phase", "Phases")  # and never changed
RECORDS = {
    kind: ("const " if kind in READ else "") + layout.c_name(ELEMENTS.get(kind, kind))
    for kind in ("Model", *layout.RECORDS, "States", "Cells", "Phases")
} | {"Floats": "const float"}
KEPT = ("State", "Cell", "Soh", "Sketch")  # from step to step: const where nothing is changed
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
    type and text of every name that is one, ``columns`` the fields of the table by column,
    ``public`` how functions that others call are named there, ``requirements`` the numbers of those
    that a function meets.
    """

    structs: dict[str, dict[str, str]]
    constants: dict[str, tuple[str, str]]
    columns: dict[str, str]
    sizes: dict[str, str]
    temperatures: bool = False
    functions: dict[str, Any] = field(default_factory=dict)
    public: dict[str, str] = field(default_factory=dict)
    requirements: dict[str, str] = field(default_factory=dict)


# What READ and RISE of cellwise_float.h read: rows of the neighbouring temperatures.
LOW = "    const cellwise_row *const low = m->row[place->low];"
HIGH = "    const cellwise_row *const high = m->row[place->low + 1u];"


class Function:
    """One function of the step, printed; ``behind`` are the comments behind its lines."""

    def __init__(self, node: ast.FunctionDef, program: Program, behind: dict[int, str]) -> None:
        self.node, self.program, self.behind = node, program, behind
        dotted = {ast.unparse(n.value) for n in ast.walk(node) if isinstance(n, ast.Attribute)}
        node.body = joined(node.body, behind, dotted)
        self.parameters = {a.arg: ast.unparse(a.annotation) for a in node.args.args if a.annotation}
        self.returns = ast.unparse(node.returns) if node.returns else "None"
        said = {ast.unparse(d) for d in node.decorator_list}
        self.hint = "NOINLINE " if "noinline" in said else "INLINED " if "inlined" in said else ""
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
            if isinstance(node, ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
                of = node.value
                if isinstance(of, ast.Subscript | ast.Attribute):  # of an array: whose it is
                    of = of.value
                kind = self.parameters.get(ast.unparse(of), "")
                found.add(ELEMENTS.get(kind, kind))
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                called = self.program.functions.get(node.func.id)
                found |= called.mutates if called else set()
        return found

    def _called(self, node: ast.AST) -> Function | None:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self.program.functions.get(node.func.id)
        return None

    # ---- statements ----

    def text(self, name: str, static: bool) -> list[str]:
        """The function in C with what it says of itself; a header says it of a public one."""
        self.lines: list[str] = []
        self.declared = set(self.parameters)
        self.lines += [f"    (void){n};" for n in self.parameters if n not in self.uses]
        if "read" in self.uses:
            self.lines += [LOW, HIGH] if self.program.temperatures else [LOW]
        self._block(self._body(), 4)
        met = self.program.requirements.get(self.node.name, "")
        said = comment(met + (ast.get_docstring(self.node) or "")) if static else []
        return [*said, *self.signature(name, static), "{", *self.lines, "}"]

    def signature(self, name: str, static: bool) -> list[str]:
        """Its first line, or lines."""
        kind = "void" if self.fills or self.returns == "None" else SCALARS[self.returns]
        start = f"{'static ' if static else ''}{self.hint}{kind} {name}("
        parts = [
            f"{SCALARS[t]} {n}" if t in SCALARS else f"{self._pointer_to(t)}{n}"
            for n, t in self.parameters.items()
        ]
        if self.fills:
            parts.append(f"cellwise_{self.filled} *{self.filled}")
        return broken(f"{start}{', '.join(parts)})", 0)

    def _pointer_to(self, kind: str) -> str:
        if ELEMENTS.get(kind, kind) in KEPT:
            const = "" if ELEMENTS.get(kind, kind) in self.mutates else "const "
            return f"{const}{RECORDS[kind]} *"
        return f"{RECORDS.get(kind, f'const cellwise_{kind.lower()}')} *"

    def _block(self, body: list[ast.stmt], indent: int) -> None:
        for node in body:
            if note_of(node):
                self.lines += comment(note_of(node), indent)
            self._statement(node, indent)

    def _say(self, text: str, indent: int, line: int = 0) -> None:
        """A line, with what stands behind it in Python."""
        note = f" /* {self.behind[line]} */" if line in self.behind else ""
        if note and indent + len(text + note) > WIDTH:
            self.lines += comment(self.behind[line], indent)
            note = ""
        self.lines += [" " * indent + text + note] if note else broken(text, indent)

    def _statement(self, node: ast.stmt, indent: int) -> None:
        match node:
            case ast.If():
                self._if(node, indent)
            case ast.Assign():
                self._assign(node, indent)
            case ast.For():
                self._for(node, indent)
            case ast.While():
                self._say(f"while ({self.bare(node.test)}) {{", indent)
                self._scope(node.body, indent)
                self._say("}", indent)
            case ast.Return():
                self._return(node, indent)
            case ast.Break():
                self._say("break;", indent)
            case ast.Expr():
                self._say_call(node.value, indent)
            case _:
                raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")

    def _scope(self, body: list[ast.stmt], indent: int) -> None:
        before = set(self.declared)
        self._block(body, indent + 4)
        self.declared = before

    def _if(self, node: ast.If, indent: int) -> None:
        if self._is_guard(node, indent):
            return
        self._say(f"if ({self.bare(node.test)}) {{", indent, node.lineno)
        self._scope(node.body, indent)
        while node.orelse:
            inner = node.orelse[0]
            if not isinstance(inner, ast.If) or len(node.orelse) > 1:
                last = node.body[-1].end_lineno if node.body else node.lineno
                between = range((last or 0) + 1, inner.lineno)
                self._say("} else {", indent, next((k for k in between if k in self.behind), 0))
                self._scope(node.orelse, indent)
                break
            node = inner
            self._say(f"}} else if ({self.bare(node.test)}) {{", indent, node.lineno)
            self._scope(node.body, indent)
            if not node.orelse:
                self._say("} else { /* as before */", indent)
        self._say("}", indent)

    def _is_guard(self, node: ast.If, indent: int) -> bool:
        """Say it on one line where all that follows is a way out."""
        start = len(self.lines)
        if node.orelse or not isinstance(node.body[0], ast.Return | ast.Break):
            return False
        self._block(node.body, 0)
        said = self.lines[start:]
        del self.lines[start:]
        line = f"{' ' * indent}if ({self.bare(node.test)}) {{ {said[0]} }}"
        short = len(said) == 1 and len(line) <= WIDTH and node.lineno not in self.behind
        if short:
            self.lines.append(line)
        return short

    def _for(self, node: ast.For, indent: int) -> None:
        name = ast.unparse(node.target).replace("_", "k")
        self.types[name] = "int"
        (most,) = node.iter.args  # type: ignore[attr-defined]
        self._say(f"for (uint32_t {name} = 0u; {name} < {self.bare(most)}; {name}++) {{", indent)
        self._scope(node.body, indent)
        self._say("}", indent)

    def _return(self, node: ast.Return, indent: int) -> None:
        if node.value is None:
            self._say("return;", indent)
        elif not self.fills:
            self._say(f"return {self.bare(node.value)};", indent, node.lineno)
        elif self._called(node.value):
            self._say_call(node.value, indent, self.filled)
        elif isinstance(node.value, ast.Call):
            fields = self.program.structs[self.returns]
            whole = ast.unparse(node.value.args[0]).rpartition(".")[0]
            if [ast.unparse(a) for a in node.value.args] == [f"{whole}.{f}" for f in fields]:
                star = "*" if whole in self.pointers else ""
                self._say(f"*{self.filled} = {star}{whole};", indent)
                return
            for name, value in zip(fields, node.value.args, strict=True):
                if not (isinstance(value, ast.Name) and value.id in self.renamed):
                    self._say(f"{self.filled}->{name} = {self.bare(value)};", indent)

    def _assign(self, node: ast.Assign, indent: int) -> None:
        target, value = node.targets[0], node.value
        if isinstance(target, ast.Tuple):  # a compensated sum: total and carry in place
            total, carry, more = value.args  # type: ignore[attr-defined]
            self._say(f"add(&{self.bare(total)}, &{self.bare(carry)}, {self.bare(more)});", indent)
            return
        called = self._called(value)
        kind = self.type_of(value)
        name = target.id if isinstance(target, ast.Name) else ""
        new = bool(name) and name not in self.declared and name not in self.renamed
        if new:
            self.declared.add(name)
            self.types[name] = kind
        if called and called.fills:
            if new:
                self._say(f"cellwise_{kind.lower()} {name};", indent)
            self._say_call(value, indent, "&" + self.bare(target))
        elif kind in RECORDS and not name:  # a record copied whole
            self._say(f"{self.bare(target)} = {self.bare(value)};", indent)
        elif kind in RECORDS:
            self.pointers.add(name)
            self._say(f"{RECORDS[kind]} *const {name} = &{self.bare(value)};", indent, node.lineno)
        else:
            start = ""
            if new:
                once = assignments(name, self._body()) == 1
                start = ("const " if once else "") + SCALARS[kind] + " "
            line = node.end_lineno or 0
            self._say(f"{start}{self.bare(target)} = {self.bare(value)};", indent, line)

    def _say_call(self, node: ast.expr, indent: int, *more: str) -> None:
        called = self._called(node)
        if called is None or not isinstance(node, ast.Call):
            raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")
        parts = [*map(self.argument, node.args), *more]
        name = self.program.public.get(called.node.name, called.node.name)
        self._say(f"{name}({', '.join(parts)});", indent)

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
                floats = dict.fromkeys(("F", "read", "rise"), "float")
                made = {**dict.fromkeys(WHOLE, "int"), **floats, **BY_HAND}
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
                return type(node.value).__name__
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
            case ast.Constant(value=float(value)):
                return float_literal(value)
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
        while isinstance(node, ast.Call) and ast.unparse(node.func) in ("F", *WHOLE):
            if (ast.unparse(node.func) == "F") != (self.type_of(node.args[0]) in FLOATS):
                break
            node = node.args[0]
        return node

    def _call(self, node: ast.Call) -> str:
        name = ast.unparse(node.func)
        if name in ("F", *WHOLE):
            return f"({'float' if name == 'F' else 'uint32_t'}){self.expression(node.args[0])}"
        if name in ("read", "rise"):
            args = [self.program.columns.get(ast.unparse(a)) or self.bare(a) for a in node.args[2:]]
            return f"{name.upper()}({', '.join(args)})"
        args = [self.argument(a) for a in node.args]
        name = self.program.public.get(name, name)
        return f"{name.upper() if name in MACROS else name}({', '.join(args)})"

    def argument(self, node: ast.expr) -> str:
        """An argument: records by their address."""
        by_address = self.type_of(node) in (*self.program.structs, *RECORDS)
        if by_address and not (isinstance(node, ast.Name) and node.id in self.pointers):
            return f"&{self.bare(node)}"
        return self.bare(node)


def assignments(name: str, body: list[ast.stmt]) -> int:
    """How often a name is assigned."""
    return sum(
        isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == name
        for s in body for n in ast.walk(s)
    )  # fmt: skip

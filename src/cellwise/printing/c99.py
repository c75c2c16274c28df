"""Python functions of the fixed step as C99, sentence by sentence, in the same order.

What the sources may say is what C can: floats, counts, flags, records; ``if``, loops, calls. An
``if`` about options becomes ``#if``. A function that returns a named tuple fills a struct: what it
names in its last sentence is that struct's field from the start. ``a if OPTION else ZERO`` is there
only where the option is.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field

from cellwise.printing.c_text import (
    ALWAYS,
    Guard,
    broken,
    comment,
    merged,
    opposite,
    preprocessor,
    resolved,
)

FLOATS = {"Float": "", "SlowFloat": "SLOW", "HysteresisFloat": "HYSTERESIS"}
FLOATS |= {"OffsetFloat": "OFFSET", "WarmFloat": "WARM"}  # and the option of each
SCALARS = {**dict.fromkeys(FLOATS, "float"), "Count": "uint32_t", "Flag": "bool"}
RECORDS = {
    "Model": "const cellwise_model", "Constants": "const cellwise_constants",
    "State": "cellwise_state", "Sample": "const cellwise_input", "Output": "cellwise_output",
}  # fmt: skip
# Done on bits in cellwise_float.h: macros, and functions.
MACROS = {
    "within", "size_within", "size_below", "not_negative", "positive_within", "positive_above",
    "is_number", "known_fraction",
}  # fmt: skip
BY_HAND = {"magnitude": "Float", "add": "", **dict.fromkeys(MACROS, "Flag"), "known_fraction": "Float"}
POINTS = "m.row.shape[1]"
# What READ and RISE of cellwise_float.h read: rows of the neighbouring temperatures.
ROWS = [
    "    const cellwise_row *const low = m->row[place->low];",
    "#if CELLWISE_TEMPERATURES > 1",
    "    const cellwise_row *const high = m->row[place->low + 1u];",
    "#endif",
]
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

    options: set[str]
    structs: dict[str, dict[str, str]]
    constants: dict[str, tuple[str, str]]
    columns: dict[str, str]
    sizes: dict[str, str]
    functions: dict[str, Function] = field(default_factory=dict)


class Function:
    """One function of the step: what it calls under which options, and its text in C."""

    def __init__(
        self, node: ast.FunctionDef, program: Program, notes: tuple[dict[int, str], dict[int, str]]
    ) -> None:
        self.node, self.program = node, program
        self.alone, self.behind = notes
        self.parameters = {a.arg: ast.unparse(a.annotation) for a in node.args.args if a.annotation}
        self.returns = ast.unparse(node.returns) if node.returns else "None"
        self.apart = any(ast.unparse(d) == "apart" for d in node.decorator_list)
        self.types = dict(self.parameters)
        self.pointers = {n for n, t in self.parameters.items() if t not in SCALARS}
        self.renamed = self._renamed()
        self.uses = [(name, guard) for s in self._body() for name, guard in self._walk(s, ALWAYS)]
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
        if not self.fills or not isinstance(last, ast.Return) or not isinstance(last.value, ast.Call):
            return {}
        fields = self.program.structs[self.returns].items()
        return {
            a.id: (f"{self.filled}->{name}", kind)
            for (name, kind), a in zip(fields, last.value.args, strict=True)
            if isinstance(a, ast.Name) and a.id not in self.parameters
            and a.id not in self.program.constants
        }  # fmt: skip

    def _mutates(self) -> bool:
        for node in ast.walk(self.node):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                if self.parameters.get(ast.unparse(node.value)) == "State":
                    return True
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                called = self.program.functions.get(node.func.id)
                if called and called.mutates:
                    return True
        return False

    # ---- options ----

    def _options(self, test: ast.expr) -> tuple[Guard, ast.expr | None]:
        """The options that a test asks for first, and what is left of it."""
        parts = test.values if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And) else [test]
        found: list[str] = []
        for part in parts:
            inner = part.operand if isinstance(part, ast.UnaryOp) else part
            if not (isinstance(inner, ast.Name) and inner.id in self.program.options):
                break
            found.append(("not " if inner is not part else "") + inner.id)
        rest = parts[len(found) :]
        if not rest:
            return frozenset(found), None
        left = rest[0] if len(rest) == 1 else ast.BoolOp(ast.And(), rest)
        return frozenset(found), left

    def _guard_of(self, node: ast.stmt) -> Guard:
        """Options without which a sentence has no meaning: that of its target."""
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            kind = self.renamed.get(target.id, ("", ""))[1] if isinstance(target, ast.Name) else ""
            option = FLOATS.get(kind, "")
            if not option and isinstance(node.value, ast.IfExp):
                guard, rest = self._options(node.value.test)
                if guard and rest is None and ast.unparse(node.value.orelse) == "ZERO":
                    return guard
            return frozenset({option}) if option else ALWAYS
        return ALWAYS

    def _walk(self, node: ast.AST, guard: Guard) -> Iterator[tuple[str, Guard]]:
        """Every name that is read, with the options under which it is."""
        if isinstance(node, ast.stmt):
            guard = guard | self._guard_of(node)
        if isinstance(node, ast.If | ast.IfExp):
            asked, rest = self._options(node.test)
            if rest is not None:
                yield from self._walk(rest, guard | asked)
            for part, inner in ((node.body, guard | asked), (node.orelse, guard | _not(asked))):
                for child in part if isinstance(part, list) else [part]:
                    yield from self._walk(child, inner)
            return
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id, guard
        called = self._called(node)
        kinds = list(called.parameters.values()) if called else []
        for k, child in enumerate(ast.iter_child_nodes(node)):
            option = FLOATS.get(kinds[k - 1], "") if kinds and 0 < k <= len(kinds) else ""
            yield from self._walk(child, guard | {option} if option else guard)

    def _called(self, node: ast.AST) -> Function | None:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self.program.functions.get(node.func.id)
        return None

    # ---- expressions ----

    def type_of(self, node: ast.expr) -> str:
        """Float, Count, Flag or the name of a record."""
        match node:
            case ast.Name():
                if node.id in self.renamed:
                    return self.renamed[node.id][1]
                known = self.types.get(node.id) or self.program.constants.get(node.id, ("",))[0]
                return known or "Count"
            case ast.Attribute():
                return self.program.structs.get(self.type_of(node.value), {}).get(node.attr, "Count")
            case ast.Call():
                name = ast.unparse(node.func)
                made = {"F": "Float", "U": "Count", "read": "Float", "rise": "Float", **BY_HAND}
                called = self._called(node)
                return called.returns if called else made[name]
            case ast.BinOp():
                return self.type_of(node.left)
            case ast.IfExp():
                return self.type_of(node.body)
            case ast.Compare() | ast.BoolOp():
                return "Flag"
            case ast.UnaryOp():
                return "Flag" if isinstance(node.op, ast.Not) else self.type_of(node.operand)
            case ast.Constant():
                return "Flag" if isinstance(node.value, bool) else "Count"
            case ast.Subscript():
                return "Count" if ast.unparse(node) == POINTS else "Float"
        return "Float"

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

    # ---- sentences ----

    def text(self, name: str, static: bool) -> list[str]:
        """The function in C with what it says of itself."""
        self.lines: list[str] = []
        self.declared: set[str] = set(self.parameters)
        self.line = self.node.body[0].end_lineno or 0
        self.held: Guard = ALWAYS
        for parameter, kind in self.parameters.items():
            own = frozenset({FLOATS.get(kind, "")} - {""})
            found = {guard - own for n, guard in self.uses if n == parameter}
            if ALWAYS not in resolved(found):
                self._guarded(own, [f"    (void){parameter};"])
        if any(isinstance(n, ast.Call) and ast.unparse(n.func) == "read" for n in ast.walk(self.node)):
            self.lines += ROWS
        self._block(self._body(), 4)
        return [*comment(ast.get_docstring(self.node) or ""), *self.signature(name, static), "{",
                *merged(self.lines), "}"]  # fmt: skip

    def signature(self, name: str, static: bool) -> list[str]:
        """Its first line, or lines where a parameter is there only with an option."""
        kind = "void" if self.fills or self.returns == "None" else SCALARS[self.returns]
        start = f"{'static ' if static else ''}{'APART ' if self.apart else ''}{kind} {name}("
        parts = [
            (f"{self._pointer_to(t)}{n}" if t not in SCALARS else f"{SCALARS[t]} {n}", FLOATS.get(t, ""))
            for n, t in self.parameters.items()
        ]
        if self.fills:
            parts.append((f"cellwise_{self.filled} *{self.filled}", ""))
        return self._listed(start, parts, ")", 0)

    def _pointer_to(self, kind: str) -> str:
        if kind == "State":
            return "cellwise_state *" if self.mutates else "const cellwise_state *"
        return f"{RECORDS.get(kind, f'const cellwise_{kind.lower()}')} *"

    def _listed(self, start: str, parts: list[tuple[str, str]], end: str, indent: int) -> list[str]:
        """What stands between parentheses, the optional ones on lines of their own."""
        if not any(option for _, option in parts):
            return broken(start + ", ".join(text for text, _ in parts) + end, indent)
        lines, said = [], start
        for k, (text, option) in enumerate(parts):
            piece = text + (", " if k < len(parts) - 1 else end)
            if option:
                pad = indent + 4 if lines else indent
                lines += broken(said.rstrip(), pad) if said else []
                lines += [f"#if {preprocessor(frozenset({option}))}", " " * (indent + 4) + piece.rstrip()]
                lines.append("#endif")
                said = ""
            else:
                said += piece
        return merged([*lines, *broken(said, indent + 4)])

    def _block(self, body: list[ast.stmt], indent: int) -> None:
        for node in body:
            note = " ".join(self.alone[k] for k in range(self.line + 1, node.lineno) if k in self.alone)
            guard = self._guard_of(node)
            start = len(self.lines)
            if note:
                self.lines += comment(note, indent)
            self.line = node.lineno
            self._statement(node, indent)
            self.line = max(self.line, node.end_lineno or 0)
            self.lines[start:] = self._inside(guard, self.lines[start:])

    def _inside(self, guard: Guard, lines: list[str]) -> list[str]:
        guard -= self.held
        return [f"#if {preprocessor(guard)}", *lines, "#endif"] if guard else lines

    def _guarded(self, guard: Guard, lines: list[str]) -> None:
        self.lines += self._inside(guard, lines)

    def _say(self, text: str, indent: int, line: int = 0) -> None:
        """A line, with what stands behind it in Python."""
        note = f" /* {self.behind[line]} */" if line in self.behind else ""
        if note and indent + len(text + note) > 100:
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
                self._say_call(node.value, [], indent)
            case _:
                raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")

    def _scope(self, body: list[ast.stmt], indent: int) -> None:
        before = set(self.declared)
        self._block(body, indent + 4)
        self.declared = before

    def _if(self, node: ast.If, indent: int) -> None:
        guard, rest = self._options(node.test)
        if guard and rest is None:
            self.lines.append(f"#if {preprocessor(guard - self.held)}")
            before, held = set(self.declared), self.held
            self.held = held | guard
            self._block(node.body, indent)
            if node.orelse:
                self.lines.append("#else")
                after, self.declared = self.declared, before
                self.held = held | _not(guard)
                self._block(node.orelse, indent)
                self.declared |= after
            self.held = held
            self.lines.append("#endif")
            return
        start, held = len(self.lines), self.held
        self.held = held | guard
        self._plain_if(node, self.bare(rest or node.test), indent)
        self.held = held
        self.lines[start:] = self._inside(guard, self.lines[start:])

    def _plain_if(self, node: ast.If, test: str, indent: int) -> None:
        self._say(f"if ({test}) {{", indent, node.lineno)
        self._scope(node.body, indent)
        while node.orelse:
            inner = node.orelse[0]
            chained = isinstance(inner, ast.If) and len(node.orelse) == 1
            if not isinstance(inner, ast.If) or not chained or self._options(inner.test)[0]:
                between = range((node.body[-1].end_lineno or 0) + 1, inner.lineno)
                self._say("} else {", indent, next((k for k in between if k in self.behind), 0))
                self._scope(node.orelse, indent)
                break
            node = inner
            self._say(f"}} else if ({self.bare(node.test)}) {{", indent, node.lineno)
            self.line = node.lineno
            self._scope(node.body, indent)
            if not node.orelse:
                self._say("} else {", indent)
                self._say("/* as before */", indent + 4)
        self._say("}", indent)

    def _for(self, node: ast.For, indent: int) -> None:
        name = ast.unparse(node.target).replace("_", "k")
        self.types[name] = "Count"
        (most,) = node.iter.args  # type: ignore[attr-defined]
        self._say(f"for (uint32_t {name} = 0u; {name} < {self.bare(most)}; {name}++) {{", indent)
        self._scope(node.body, indent)
        self._say("}", indent)

    def _return(self, node: ast.Return, indent: int) -> None:
        if node.value is None:
            self._say("return;", indent)
        elif not self.fills:
            self._say(f"return {self.bare(node.value)};", indent, node.lineno)
        elif isinstance(node.value, ast.Call):
            fields = self.program.structs[self.returns].items()
            for (name, kind), value in zip(fields, node.value.args, strict=True):
                if not (isinstance(value, ast.Name) and value.id in self.renamed):
                    line = f"{' ' * indent}{self.filled}->{name} = {self.bare(value)};"
                    option = FLOATS.get(kind, "")
                    self._guarded(frozenset({option}) if option else ALWAYS, [line])

    def _assign(self, node: ast.Assign, indent: int) -> None:
        target, value = node.targets[0], node.value
        if isinstance(target, ast.Tuple):  # a compensated sum: total and carry in place
            total, carry, more = value.args  # type: ignore[attr-defined]
            self._say(f"add(&{self.bare(total)}, &{self.bare(carry)}, {self.bare(more)});", indent)
            return
        if isinstance(value, ast.IfExp):
            guard, rest = self._options(value.test)
            if guard and rest is None:
                self._choice(node, value, guard, indent)
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
            self._say_call(value, [("&" + self.bare(target), "")], indent)
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

    def _choice(self, node: ast.Assign, value: ast.IfExp, guard: Guard, indent: int) -> None:
        """One of two values by an option; only the first where the name needs the option."""
        first, second = (
            ast.copy_location(ast.Assign(node.targets, v), node) for v in (value.body, value.orelse)
        )
        if self._guard_of(node):
            self._assign(first, indent)
            return
        self.lines.append(f"#if {preprocessor(guard)}")
        before = set(self.declared)
        self._assign(first, indent)
        self.declared = before
        self.lines.append("#else")
        self._assign(second, indent)
        self.lines.append("#endif")

    def _say_call(self, node: ast.expr, more: list[tuple[str, str]], indent: int) -> None:
        called = self._called(node)
        if called is None or not isinstance(node, ast.Call):
            raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")
        kinds = called.parameters.values()
        parts = [
            (self.argument(a), FLOATS.get(kind, ""))
            for a, kind in zip(node.args, kinds, strict=True)
        ]
        self.lines += self._listed(f"{called.node.name}(", [*parts, *more], ");", indent)


def _not(guard: Guard) -> Guard:
    """What holds in the else of options: exact for one of them."""
    if len(guard) != 1:
        return ALWAYS
    (term,) = guard
    return frozenset({opposite(term)})


def assignments(name: str, body: list[ast.stmt]) -> int:
    """How often a name is assigned at most, whatever is compiled in."""
    count = 0
    for node in body:
        if isinstance(node, ast.If):
            test = ast.unparse(node.test)
            parts = [assignments(name, node.body), assignments(name, node.orelse)]
            count += max(parts) if test.isupper() else sum(parts)
        elif isinstance(node, ast.For | ast.While):
            count += assignments(name, node.body)
        elif isinstance(node, ast.Assign):
            count += ast.unparse(node.targets[0]) == name
    return count

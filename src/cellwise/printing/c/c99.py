"""Python functions of the fixed step as C99, statement by statement, in the same order.

What the sources may say is what C can: floats, counts, flags, records; ``if``, loops, calls. An
``if`` about options becomes ``#if``. A function that returns a named tuple fills a struct: what it
names in its last statement is that struct's field from the start. ``a if OPTION else ZERO`` is
there only where the option is.
"""

from __future__ import annotations

import ast

from cellwise.printing.c.reading import ELEMENTS, FLOATS, KEPT, RECORDS, SCALARS, Reading, refuted
from cellwise.printing.c.text import ALWAYS, Guard, broken, comment, merged, preprocessor, resolved

# What READ and RISE of cellwise_float.h read: rows of the neighbouring temperatures.
ROWS = [
    "    const cellwise_row *const low = m->row[place->low];",
    "#if CELLWISE_TEMPERATURES > 1",
    "    const cellwise_row *const high = m->row[place->low + 1u];",
    "#endif",
]


class Function(Reading):
    """One function of the step, printed."""

    def text(self, name: str, static: bool) -> list[str]:
        """The function in C with what it says of itself."""
        self.lines: list[str] = []
        self.declared: dict[str, Guard] = dict.fromkeys(self.parameters, ALWAYS)
        self.line = self.node.body[0].end_lineno or 0
        self.held: Guard = ALWAYS
        for parameter, kind in self.parameters.items():
            own = frozenset({FLOATS.get(kind, "")} - {""})
            found = {guard - own for n, guard in self.uses if n == parameter}
            if ALWAYS not in resolved(found):
                self._guarded(own, [f"    (void){parameter};"])
        calls = [n for n in ast.walk(self.node) if isinstance(n, ast.Call)]
        self.lines += ROWS if any(ast.unparse(n.func) == "read" for n in calls) else []
        self._block(self._body(), 4)
        return [*comment(ast.get_docstring(self.node) or ""), *self.signature(name, static), "{",
                *merged(self.lines), "}"]  # fmt: skip

    def signature(self, name: str, static: bool) -> list[str]:
        """Its first line, or lines where a parameter is there only with an option."""
        kind = "void" if self.fills or self.returns == "None" else SCALARS[self.returns]
        start = f"{'static ' if static else ''}{'NOINLINE ' if self.noinline else ''}{kind} {name}("
        parts = [
            (
                f"{SCALARS[t]} {n}" if t in SCALARS else f"{self._pointer_to(t)}{n}",
                FLOATS.get(t, ""),
            )
            for n, t in self.parameters.items()
        ]
        if self.fills:
            parts.append((f"cellwise_{self.filled} *{self.filled}", ""))
        return self._listed(start, parts, ")", 0)

    def _pointer_to(self, kind: str) -> str:
        if ELEMENTS.get(kind, kind) in KEPT:
            const = "" if ELEMENTS.get(kind, kind) in self.mutates else "const "
            return f"{const}{RECORDS[kind]} *"
        return f"{RECORDS.get(kind, f'const cellwise_{kind.lower()}')} *"

    def _listed(self, start: str, parts: list[tuple[str, str]], end: str, indent: int) -> list[str]:
        """What stands between parentheses, the optional ones on lines of their own."""
        if not any(option for _, option in parts):
            return broken(start + ", ".join(text for text, _ in parts) + end, indent)
        lines: list[str] = []
        said = start
        for k, (text, option) in enumerate(parts):
            piece = text + (", " if k < len(parts) - 1 else end)
            if option:
                pad = indent + 4 if lines else indent
                lines += broken(said.rstrip(), pad) if said else []
                lines.append(f"#if {preprocessor(frozenset({option}))}")
                lines += [" " * (indent + 4) + piece.rstrip(), "#endif"]
                said = ""
            else:
                said += piece
        return merged([*lines, *broken(said, indent + 4)])

    def _block(self, body: list[ast.stmt], indent: int) -> None:
        for node in body:
            above = range(self.line + 1, node.lineno)
            note = " ".join(self.alone[k] for k in above if k in self.alone)
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
        before = dict(self.declared)
        self._block(body, indent + 4)
        self.declared = before

    def _if(self, node: ast.If, indent: int) -> None:
        guard, rest = self._options(node.test)
        if guard and rest is None:
            self.lines.append(f"#if {preprocessor(guard - self.held)}")
            before, held = dict(self.declared), self.held
            self.held = held | guard
            self._block(node.body, indent)
            if node.orelse:
                self.lines.append("#else")
                after, self.declared = self.declared, before
                self.held = held | refuted(guard)
                self._block(node.orelse, indent)
                both = dict.fromkeys(after.keys() & self.declared.keys(), held)
                self.declared = after | self.declared | both | before
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
            self.declared[name] = self.held
            self.types[name] = kind
        elif not self.declared.get(name, ALWAYS) <= self.held:
            raise ValueError(f"{name} in {self.node.name} is there only with an option")
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
        before = dict(self.declared)
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

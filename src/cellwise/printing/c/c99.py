"""Python functions of the fixed step as C99, statement by statement, in the same order.

What the sources may say is what C can: floats, counts, flags, records; ``if``, loops, calls. A
function that returns a named tuple fills a struct: what it names in its last statement is that
struct's field from the start.
"""

from __future__ import annotations

import ast

from cellwise.printing.c.chosen import note_of
from cellwise.printing.c.reading import ELEMENTS, KEPT, RECORDS, SCALARS, Reading
from cellwise.printing.c.text import broken, comment

# What READ and RISE of cellwise_float.h read: rows of the neighbouring temperatures.
LOW = "    const cellwise_row *const low = m->row[place->low];"
HIGH = "    const cellwise_row *const high = m->row[place->low + 1u];"


class Function(Reading):
    """One function of the step, printed."""

    def text(self, name: str, static: bool) -> list[str]:
        """The function in C with what it says of itself."""
        self.lines: list[str] = []
        self.declared = set(self.parameters)
        self.lines += [f"    (void){n};" for n in self.parameters if n not in self.uses]
        if "read" in self.uses:
            self.lines += [LOW, HIGH] if self.program.temperatures else [LOW]
        self._block(self._body(), 4)
        return [*comment(ast.get_docstring(self.node) or ""), *self.signature(name, static), "{",
                *self.lines, "}"]  # fmt: skip

    def signature(self, name: str, static: bool) -> list[str]:
        """Its first line, or lines."""
        kind = "void" if self.fills or self.returns == "None" else SCALARS[self.returns]
        start = f"{'static ' if static else ''}{'NOINLINE ' if self.noinline else ''}{kind} {name}("
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
                self._say_call(node.value, indent)
            case _:
                raise ValueError(f"no C for '{ast.unparse(node)}' in {self.node.name}")

    def _scope(self, body: list[ast.stmt], indent: int) -> None:
        before = set(self.declared)
        self._block(body, indent + 4)
        self.declared = before

    def _if(self, node: ast.If, indent: int) -> None:
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
                self._say("} else {", indent)
                self._say("/* as before */", indent + 4)
        self._say("}", indent)

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
        self._say(f"{called.node.name}({', '.join(parts)});", indent)


def assignments(name: str, body: list[ast.stmt]) -> int:
    """How often a name is assigned."""
    return sum(
        isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == name
        for s in body for n in ast.walk(s)
    )  # fmt: skip

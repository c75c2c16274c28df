"""Functions of the fixed step as one set of options leaves them, before they are printed.

What an option rules out goes: branches, fields of named tuples, parameters, and what is then only
assigned. Comments stay with the statements that they stand above.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable
from typing import Any

from cellwise.cell.description import CELL

# The option without which a kind of float is not there.
FLOATS = {
    "float": "",
    **{f"{s.option.capitalize()}Float": s.option.upper() for s in CELL if s.option},
    "WarmFloat": "WARM",
    "SurfaceFloat": "SURFACE",
    "OffsetFloat": "OFFSET",
}


def is_there(kind: ast.expr | None, flags: dict[str, int]) -> bool:
    """Whether something of a kind is there with these options."""
    option = FLOATS.get(ast.unparse(kind), "") if kind else ""
    return not option or bool(flags[option])


class _Folded(ast.NodeTransformer):
    """Options as the numbers that they are, and what follows from it."""

    def __init__(self, flags: dict[str, int], kept: dict[str, list[bool]]) -> None:
        self.flags, self.kept = flags, kept

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self.flags:
            return node
        return ast.copy_location(ast.Constant(bool(self.flags[node.id])), node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        self.generic_visit(node)
        known = isinstance(node.op, ast.Not) and isinstance(node.operand, ast.Constant)
        return ast.Constant(not node.operand.value) if known else node  # type: ignore[attr-defined]

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        ends = isinstance(node.op, ast.Or)  # True ends an or, False an and
        if any(isinstance(v, ast.Constant) and v.value is ends for v in node.values):
            return ast.Constant(ends)
        values = [v for v in node.values if not isinstance(v, ast.Constant)]
        if len(values) < 2:
            return values[0] if values else ast.Constant(not ends)
        return ast.BoolOp(node.op, values)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        if not isinstance(node.test, ast.Constant):
            return node if node.body or node.orelse else None
        left = node.body if node.test.value else node.orelse
        if left and note_of(node):
            left[0].note = f"{note_of(node)} {note_of(left[0])}".strip()  # type: ignore[attr-defined]
        return left

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        kept = self.kept.get(ast.unparse(node.func))
        if kept:
            node.args = [a for a, there in zip(node.args, kept, strict=True) if there]
        return node


def note_of(node: ast.stmt) -> str:
    """The comment above a statement."""
    note: str = getattr(node, "note", "")
    return note


def with_notes(body: Iterable[ast.stmt], line: int, alone: dict[int, str]) -> int:
    """Give each statement the comment above it; ``line`` is the last one that was read."""
    for node in body:
        above = range(line + 1, node.lineno)
        node.note = " ".join(alone[k] for k in above if k in alone)  # type: ignore[attr-defined]
        line = node.lineno
        for inner in ("body", "orelse"):
            line = with_notes(getattr(node, inner, []), line, alone)
        line = max(line, node.end_lineno or 0)
    return line


def without_unread(node: ast.FunctionDef) -> None:
    """Leave out what is assigned to a name that nobody reads."""
    while True:
        names = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
        read = {n.id for n in names if isinstance(n.ctx, ast.Load)}
        if not _removed(node, read):
            return


def _removed(node: Any, read: set[str]) -> bool:
    found = False
    for part in ("body", "orelse"):
        body = getattr(node, part, [])
        kept = [s for s in body if not _is_unread(s, read)]
        inner = [_removed(s, read) for s in kept]  # all of them
        found |= len(kept) < len(body) or any(inner)
        if body:
            setattr(node, part, kept)
    return found


def joined(body: list[ast.stmt], behind: Collection[int], records: set[str]) -> list[ast.stmt]:
    """Statements with what is done to one number in turn as one expression, in the same order.

    What an option has left of a choice is assigned and overwritten at once: it goes. Comments keep
    statements apart (``behind`` are the lines with one), and so do calls that get one of
    ``records``: they may read or change what is assigned.
    """
    found: list[ast.stmt] = []
    for node in body:
        for part in ("body", "orelse"):
            if hasattr(node, part):
                setattr(node, part, joined(getattr(node, part), behind, records))
        last = found[-1] if found else None
        if isinstance(last, ast.Assign) and isinstance(node, ast.Assign) and not note_of(node):
            said = last.end_lineno in behind or _gets(last.value, records) or _gets(node, records)
            if not said and _taken_on(last, node):
                node.note = note_of(last)  # type: ignore[attr-defined]
                found.pop()
        found.append(node)
    return found


def _gets(node: ast.AST, records: set[str]) -> bool:
    calls = (n for n in ast.walk(node) if isinstance(n, ast.Call))
    return any(ast.unparse(a) in records for call in calls for a in call.args)


def _taken_on(last: ast.Assign, node: ast.Assign) -> bool:
    """Whether the second says all of the first: it overwrites it, or begins with its value now."""
    name, at = ast.unparse(last.targets[0]), node.value
    times = [ast.unparse(n) for n in ast.walk(node.value)].count(name)
    if ast.unparse(node.targets[0]) != name or times > 1 or isinstance(last.value, ast.IfExp):
        return ast.unparse(node.targets[0]) == name and not times
    while times and isinstance(at, ast.BinOp):
        if ast.unparse(at.left) == name:
            at.left = last.value
            return True
        at = at.left
    return not times


def _is_unread(node: ast.stmt, read: set[str]) -> bool:
    target = node.targets[0] if isinstance(node, ast.Assign) else None
    return isinstance(target, ast.Name) and target.id not in read


def chosen(tree: ast.Module, flags: dict[str, int], kept: dict[str, list[bool]]) -> ast.Module:
    """A module's classes and functions as options leave them.

    ``kept`` are the fields and parameters that are there, by the name of the class or function; it
    holds those of the modules before and gets this one's.
    """
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            fields = [n for n in node.body if isinstance(n, ast.AnnAssign)]
            kept[node.name] = [is_there(f.annotation, flags) for f in fields]
            gone = {f for f in fields if not is_there(f.annotation, flags)}
            node.body = [n for n in node.body if n not in gone]
        elif isinstance(node, ast.FunctionDef):
            arguments = node.args.args
            kept[node.name] = [is_there(a.annotation, flags) for a in arguments]
            node.args.args = [a for a in arguments if is_there(a.annotation, flags)]
            _Folded(flags, kept).visit(node)
            without_unread(node)
    return tree

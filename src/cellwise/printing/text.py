"""What the printers share: a head that says so, and lines of at most 100 characters."""

from __future__ import annotations

import ast
from collections.abc import Sequence

COMMAND = "python -m cellwise.printing"
WIDTH = 100


def head(title: str, *more: str, source: str = "cellwise.cell.description") -> list[str]:
    """First lines of a printed Python module."""
    return [
        f'"""{title}',
        "",
        *more,
        *([""] if more else []),
        f"Printed from :mod:`{source}` by `{COMMAND}`; do not edit.",
        '"""',
        "",
        "from __future__ import annotations",
        "",
    ]


def wrapped_call(start: str, arguments: Sequence[str], end: str = "") -> list[str]:
    """``start(arguments)end`` as the formatter writes it: in one line, in two, or one each."""
    listed = ", ".join(arguments)
    whole = f"{start}({listed}){end}"
    if len(whole) <= WIDTH:
        return [whole]
    indent = " " * (len(start) - len(start.lstrip()))
    return [f"{start}(", *(f"{indent}    {a}," for a in arguments), f"{indent}){end}"]


def broken_sum(start: str, value: ast.expr) -> list[str]:
    """``start`` and an expression as the formatter writes them: a long sum term by term."""
    if len(whole := start + ast.unparse(value)) <= WIDTH:
        return [whole]
    indent = " " * (len(start) - len(start.lstrip()))
    if isinstance(value, ast.UnaryOp):
        return [f"{start}-(", f"{indent}    {ast.unparse(value.operand)}", f"{indent})"]
    if len(inner := f"{indent}    {ast.unparse(value)}") <= WIDTH:
        return [f"{start}(", inner, f"{indent})"]
    if isinstance(value, ast.IfExp):
        parts = (value.body, value.test, value.orelse)
        words = [w + ast.unparse(p) for w, p in zip(("", "if ", "else "), parts, strict=True)]
        return [f"{start}(", *(f"{indent}    {w}" for w in words), f"{indent})"]
    if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult):
        first, last = ast.unparse(value.left), ast.unparse(value.right)
        return [f"{start}{first} * (", f"{indent}    {last}", f"{indent})"]
    terms: list[str] = []
    while isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add | ast.Sub):
        sign = "+" if isinstance(value.op, ast.Add) else "-"
        terms.insert(0, f"{sign} {bracketed(value.right)}")
        value = value.left
    listed = [ast.unparse(value), *terms]
    return [f"{start}(", *(f"{indent}    {t}" for t in listed), f"{indent})"]


def bracketed(node: ast.expr) -> str:
    """A term of a sum; a sum within it keeps its brackets."""
    inner = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)
    return f"({ast.unparse(node)})" if inner else ast.unparse(node)

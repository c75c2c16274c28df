"""The derivative of one expression with respect to the names in it.

Nothing is simplified but factors of one and terms of zero.
"""

from __future__ import annotations

import ast
from collections.abc import Container

ONE, ZERO = ast.Constant(1.0), ast.Constant(0.0)


def is_number(node: ast.expr, number: float) -> bool:
    """Whether an expression is this number."""
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.USub) and is_number(node.operand, -number)
    return isinstance(node, ast.Constant) and node.value == number


def negative(node: ast.expr) -> ast.expr:
    """-x."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return node.operand
    return ast.UnaryOp(ast.USub(), node)


def product(a: ast.expr, b: ast.expr) -> ast.expr:
    """A times b; the signs go to the front."""
    if is_number(a, 1.0) or is_number(b, 0.0):
        return b
    if is_number(b, 1.0) or is_number(a, 0.0):
        return a
    for inner, other in ((a, b), (b, a)):
        if isinstance(inner, ast.UnaryOp):
            return negative(product(inner.operand, other))
    return ast.BinOp(a, ast.Mult(), b)


def added(a: ast.expr | None, b: ast.expr) -> ast.expr:
    """A plus b."""
    if a is None or is_number(a, 0.0):
        return b
    if isinstance(b, ast.UnaryOp):
        return ast.BinOp(a, ast.Sub(), b.operand)
    return ast.BinOp(a, ast.Add(), b)


def gradient(
    node: ast.expr, active: Container[str], itself: ast.expr | None = None
) -> dict[str, ast.expr]:
    """Derivatives with respect to the active names; ``itself`` is what the whole is called."""
    whole = node if itself is None else itself
    match node:
        case ast.Name(id=name):
            return {name: ONE} if name in active else {}
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return {n: negative(g) for n, g in gradient(operand, active).items()}
        case ast.BinOp(left=a, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=b):
            found: dict[str, ast.expr] = {}
            for n, g in gradient(a, active).items():
                match op:
                    case ast.Mult():
                        g = product(g, b)
                    case ast.Div():
                        g = ast.BinOp(g, ast.Div(), b)
                found[n] = g
            for n, g in gradient(b, active).items():
                match op:
                    case ast.Mult():
                        g = product(a, g)
                    case ast.Div():
                        g = negative(product(ast.BinOp(whole, ast.Div(), b), g))
                    case ast.Sub():
                        g = negative(g)
                found[n] = added(found.get(n), g)
            return found
        case ast.IfExp(test=test, body=yes, orelse=no):
            return either(test, gradient(yes, active), gradient(no, active))
        case ast.Call(func=ast.Attribute(attr="exp"), args=[u]):
            return {n: product(whole, g) for n, g in gradient(u, active).items()}
        case ast.Call(func=ast.Name(id="abs"), args=[u]):
            sign = ast.parse(f"math.copysign(1.0, {ast.unparse(u)})", mode="eval").body
            return {n: product(sign, g) for n, g in gradient(u, active).items()}
        case ast.Call(func=ast.Name(id="min" | "max" as which), args=[a, b]):
            first = ast.Lt() if which == "min" else ast.Gt()
            test = ast.Compare(a, [first], [b])
            return either(test, gradient(a, active), gradient(b, active))
        case ast.Call(func=ast.Attribute(attr="copysign")) | ast.Constant():
            return {}
    raise ValueError(f"no derivative of {ast.unparse(node)}")


def either(
    test: ast.expr, yes: dict[str, ast.expr], no: dict[str, ast.expr]
) -> dict[str, ast.expr]:
    """Derivatives of the branch that is taken."""
    found: dict[str, ast.expr] = {}
    for n in (*yes, *(n for n in no if n not in yes)):
        a, b = yes.get(n, ZERO), no.get(n, ZERO)
        found[n] = a if ast.dump(a) == ast.dump(b) else ast.IfExp(test, a, b)
    return found

"""Printed derivatives are those of the text they are printed from, whatever stands in it."""

from __future__ import annotations

import ast
import math

import pytest

from cellwise.printing.derivatives import Derivatives
from cellwise.printing.gradients import gradient
from cellwise.printing.straight_line import Reader, Wish, parsed, record

VALUES = {"x": 0.7, "y": -1.3, "z": 2.1}
EXPRESSIONS = (
    "x * y + z",
    "x * x * x - -y",
    "x / y / z",
    "1.0 / (1.0 + z * abs(y))",
    "math.exp(-x * y / z) * x",
    "abs(x * y) + math.copysign(1.0, y) * x",
    "min(x * z, y) + max(x * z, y)",
    "x * y if x > z else y * z",
    "(x - y) * (x - y * (z - x))",
)


def value(text, values):
    return eval(text, {"math": math}, values)


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_gradient_of_an_expression_is_its_central_difference(text):
    found = gradient(ast.parse(text, mode="eval").body, set(VALUES))
    step = 1e-6
    for name in VALUES:
        above, below = ({**VALUES, name: VALUES[name] + s * step} for s in (1.0, -1.0))
        expected = (value(text, above) - value(text, below)) / (2.0 * step)
        derivative = value(ast.unparse(found[name]), VALUES) if name in found else 0.0
        assert derivative == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_gradient_leaves_out_what_is_not_asked_for():
    assert set(gradient(ast.parse("x * y + z", mode="eval").body, {"x", "z"})) == {"x", "z"}


def test_an_operation_without_a_derivative_is_refused():
    with pytest.raises(ValueError, match="no derivative of x"):
        gradient(ast.parse("x ** y", mode="eval").body, {"x"})


EQUATIONS = '''
def factor(cell, u):
    """An effect that may be absent."""
    scale = 1.0
    if cell.k != 0.0:
        scale = math.exp(cell.k * u)
    return scale

def driven(cell, x, u):
    """With a branch, an early return, and an effect on one side only."""
    if cell.tau == 0.0:
        return x
    gain = cell.r * factor(cell, u)
    if cell.c != 1.0 and u < 0.0:
        gain *= cell.c
    a = math.exp(-1.0 / cell.tau)
    return a * x + gain * (1.0 - a) * u

def output(cell, x, u):
    """What is seen: the state after two intervals."""
    new = driven(cell, x, u)
    return new * new + driven(cell, new, u)
'''
NAMES = ("k", "tau", "r", "c")


class Cell:
    def __init__(self, **values):
        self.__dict__.update(values)


@pytest.mark.parametrize("u", [0.8, -0.6])
@pytest.mark.parametrize("numbers", [(0.3, 2.0, 1.5, 1.2), (0.0, 2.0, 1.5, 1.0)])
def test_chain_rule_through_functions_at_and_off_neutral_values(u, numbers):
    reader = Reader(functions=parsed(EQUATIONS))
    arguments = [record("cell", NAMES), ast.Name("x"), ast.Name("u")]
    reader.call("output", arguments, Wish("seen", "output"))
    inputs = ["x", "u", *(f"cell.{n}" for n in NAMES)]
    d = Derivatives(reader, ["seen"], inputs, constants=True)
    at = {"cell": Cell(**dict(zip(NAMES, numbers, strict=True))), "x": 0.4, "u": u}
    known = {"math": math, **at}
    exec("\n".join(line.strip() for line in d.body()), known)
    derivatives = {
        by: eval(text, known) for (_, by), text in zip(d.kept(), d.values(), strict=True)
    }
    source = {"math": math}
    exec(EQUATIONS, source)
    step = 1e-6
    for name in inputs:
        ends = []
        for sign in (1.0, -1.0):
            cell, x, u_ = Cell(**vars(at["cell"])), at["x"], at["u"]
            if name.startswith("cell."):
                setattr(cell, name[5:], getattr(cell, name[5:]) + sign * step)
            x += sign * step * (name == "x")
            u_ += sign * step * (name == "u")
            ends.append(source["output"](cell, x, u_))
        expected = (ends[0] - ends[1]) / (2.0 * step)
        assert derivatives.get(name, 0.0) == pytest.approx(expected, rel=1e-8, abs=1e-8), name


def test_a_calculation_that_stands_twice_is_done_once():
    reader = Reader(functions=parsed(EQUATIONS))
    reader.call("output", [record("cell", NAMES), ast.Name("x"), ast.Name("u")])
    texts = [ast.unparse(line.value) for line in reader.lines]
    assert len(texts) == len(set(texts))
    assert sum("math.exp" in text for text in texts) == 2


def test_what_cannot_be_read_is_refused():
    reader = Reader(functions=parsed("def f(x):\n    while x > 0.0:\n        x = x - 1.0\n"))
    with pytest.raises(ValueError, match="f: cannot read while"):
        reader.call("f", [ast.Name("x")])

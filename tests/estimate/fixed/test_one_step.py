"""One step: every equation and every constant of the filters stands once, for float64 and for C."""

from __future__ import annotations

import ast
from copy import deepcopy
from pathlib import Path

import pytest
from benchmarks.example_cell import three_branches

from cellwise.cell.effects import Hysteresis
from cellwise.estimate.equations import constants
from cellwise.estimate.evidence_kernels import constants_of
from cellwise.estimate.fixed.stepper import FUNCTIONS, STEP_MODULES
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import Noise
from sources import tree_of

ESTIMATE = Path(constants.__file__).parents[1]
CELL = ESTIMATE.parent / "cell"
ONCE = [*sorted((ESTIMATE / "equations").glob("*.py")), CELL / "equations" / "scalar.py"]
# What each target computes in its own way: functions of these names stand there twice.
OWN_WAY = CELL / "equations" / "double.py"
FIXED = [
    *sorted((ESTIMATE / "fixed").glob("*.py")),
    *sorted((ESTIMATE / "power").glob("fixed_*.py")),
    *sorted((ESTIMATE / "capacity").glob("fixed_*.py")),
]
KERNELS = [p for p in sorted(ESTIMATE.rglob("*.py")) if p not in FIXED and p not in ONCE]
# An expression of so many operations is an equation, and no longer a product here and a sum there.
EQUATION = 4
CALLED = {"max": "at_least", "min": "at_most", "abs": "magnitude", "fabs": "magnitude"}


def numbers_of(path: Path) -> dict[str, float]:
    """Upper-case names that a module gives a number, whatever kind of float it is made."""
    found = {}
    for node in tree_of(path).body:
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            pairs = zip(*(getattr(n, "elts", [n]) for n in (target, value)), strict=False)
            for name, given in pairs:
                number = number_in(given)
                if isinstance(name, ast.Name) and name.id.isupper() and number is not None:
                    found[name.id] = number
    return found


def number_in(node: ast.expr) -> float | None:
    """The number that an expression of literals is."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("F", "U"):
        node = node.args[0]
    try:
        value = eval(ast.unparse(node), {"__builtins__": {}})
    except (NameError, SyntaxError):
        return None
    return value if isinstance(value, float | int) and not isinstance(value, bool) else None


def functions_of(path: Path) -> dict[str, ast.FunctionDef]:
    return {n.name: n for n in tree_of(path).body if isinstance(n, ast.FunctionDef)}


class Shape(ast.NodeTransformer):
    """An expression without the names of what it reads."""

    def visit_Name(self, node):
        return ast.Name("x")

    visit_Attribute = visit_Subscript = visit_Name

    def visit_Call(self, node):
        name = ast.unparse(node.func).rsplit(".", 1)[-1]
        given = [self.visit(a) for a in node.args]
        if name in ("F", "U", "float"):
            return given[0]
        return ast.Call(ast.Name(CALLED.get(name, name)), given, [])


def equations_in(tree: ast.AST, least: int = EQUATION) -> dict[str, str]:
    """Arithmetic of ``least`` operations or more: its shape, and how it is written."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp):
            operations = sum(isinstance(n, ast.BinOp | ast.Call) for n in ast.walk(node))
            if operations >= least:
                found[ast.unparse(Shape().visit(deepcopy(node)))] = ast.unparse(node)
    return found


def imported_by(paths: list[Path]) -> set[str]:
    nodes = (n for p in paths for n in ast.walk(tree_of(p)) if isinstance(n, ast.ImportFrom))
    return {a.name for n in nodes for a in n.names}


def test_no_number_stands_in_both_rooms():
    """Of the same name: neither beside the shared ones, nor once for float64 and once for C."""
    shared = numbers_of(ESTIMATE / "equations" / "constants.py")
    assert len(shared) > 30
    for path in (*FIXED, *KERNELS):
        assert not shared.keys() & numbers_of(path).keys(), path.name
    of_fixed = {name for p in FIXED for name in numbers_of(p)}
    of_kernels = {name for p in KERNELS for name in numbers_of(p)}
    assert not of_fixed & of_kernels


# Numbers of an equation that a room reads as well: what marks a state, where chords begin, what a
# lean step does without the equation, what a sound state holds.
MARKS = {"FOUND_FROZEN", "WIDE_VARIANCE", "VARIANCE_FLOOR"}
READ_IN_C = {
    *("GIVEN_UP", "SQUARE_MOST", "SWINGS_MOST"),
    *("INFORMATION_MOST", "REST_USED", "LARGE", "NEXT_LOOK"),
}


def read_in(paths: list[Path]) -> set[str]:
    """Names that the modules read or give."""
    return {n.id for p in paths for n in ast.walk(tree_of(p)) if isinstance(n, ast.Name)}


def test_what_an_equation_decides_by_a_number_no_room_decides_again():
    """A voltage that is frozen, where a component begins, when it is given up: by their limits."""
    numbers = numbers_of(ESTIMATE / "equations" / "constants.py").keys()
    decide = numbers & read_in([p for p in ONCE if p.stem != "constants"])
    assert {"DITHER_V", "COMPONENT_WIDTH", "COST_MOST", "LEAST_PASSED"} <= decide
    assert decide & read_in(KERNELS) == MARKS
    assert decide & read_in(FIXED) == MARKS | READ_IN_C


def test_no_equation_is_written_a_second_time():
    shared = {shape: text for p in ONCE for shape, text in equations_in(tree_of(p)).items()}
    assert len(shared) > 20
    for path in (*FIXED, *KERNELS):
        again = {s: t for s, t in equations_in(tree_of(path)).items() if s in shared}
        assert not again, (path.name, again)


def test_no_equation_stands_in_both_rooms():
    """Of a step: what stands beside it (power, cells of a pack) has its own."""
    beside = ("power", "cells", "capacity")
    step = [m.__file__ for m in STEP_MODULES if not m.__name__.endswith(beside)]
    longer = EQUATION + 1  # a running mean of squares is none of a filter
    fixed: dict[str, str] = {}
    for path in FIXED:
        if str(path) in step:
            fixed |= equations_in(tree_of(path), longer)
    assert len(fixed) > 10
    for path in KERNELS:
        if path.name.endswith("_kernels.py") and path.parent.name != "power":
            again = {s: t for s, t in equations_in(tree_of(path), longer).items() if s in fixed}
            assert not again, (path.name, again)


@pytest.mark.parametrize("path", [p for p in ONCE if p.stem != "constants"], ids=lambda p: p.stem)
def test_an_equation_has_one_name_and_both_rooms_take_it(path):
    for name in functions_of(path):
        assert not [p for p in (*FIXED, *KERNELS) if name in functions_of(p)], name
        inside = {n.id for p in ONCE for n in ast.walk(tree_of(p)) if isinstance(n, ast.Name)}
        assert name in imported_by(FIXED) | inside, f"{name} is not what the C does"
        others = [p for p in CELL.rglob("*.py") if p not in ONCE]
        assert name in imported_by(KERNELS + others) | inside, f"{name} is not what the filters do"


def test_the_fixed_step_has_its_own_way_of_everything_that_a_target_does_in_its_own():
    """Else a function of float64 would be called within the float32 step."""
    for name in functions_of(OWN_WAY):
        assert FUNCTIONS[name].__module__.endswith("fixed.arithmetic")


def test_the_same_function_is_compiled_in_either_precision():
    for path in ONCE:
        for name in functions_of(path):
            assert FUNCTIONS[name].__code__.co_filename == str(path)


@pytest.mark.parametrize("text", ["DITHER_V = 0.003", "DITHER_V = F(0.0025)", "A, LOOKS = 1, U(3)"])
def test_a_number_that_is_given_again_is_found(text, tmp_path):
    path = tmp_path / "again.py"
    path.write_text(text)
    assert numbers_of(path).keys() & vars(constants).keys()


def test_an_equation_under_other_names_is_found():
    (text,) = [t for t in equations_in(tree_of(ONCE[0].parent / "components.py")).values()
               if t.startswith("size *")]  # fmt: skip
    assert text == "size * (near + (room - near) * (size * size))"
    again = "def f(w: float):\n    return w * (a.b + (c[0] - a.b) * (w * w))"
    assert equations_in(ast.parse(again)).keys() & equations_in(ast.parse(text)).keys()


# What a target holds in whole steps, in its own range, or for intervals longer than the memory.
OF_A_TARGET = {
    *("recovery_after", "look_steps", "voltage_low_V", "voltage_high_V"),
    *("shared_early", "shared_half", "block_steps", "lately"),
}


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 20.0])
def test_what_a_step_of_a_period_reads_is_reckoned_once(dt_s):
    """The filters' constants, time in steps: the fixed step has the same numbers."""
    model = three_branches()
    tables = fixed_step_tables(model, dt_s)
    noise = Noise.of_model(model).scalars()
    once = constants_of(
        3600.0 * model.capacity_Ah, model.effect(Hysteresis).gamma, noise, dt_s, dt_s
    )._asdict()
    held = tables.constants[0]
    there = once.keys() & set(held.dtype.names) - OF_A_TARGET
    assert len(there) > 10
    for name in there:
        assert held[name] == pytest.approx(once[name], rel=1e-6), name
    source = tree_of(ESTIMATE / "fixed" / "constants.py")
    (step,) = [n for n in source.body if getattr(n, "name", "") == "step_constants"]
    given = {n.value for n in ast.walk(step) if isinstance(n, ast.Constant)}
    assert once.keys() & given == OF_A_TARGET

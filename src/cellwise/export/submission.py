"""The fixed step as one file of NumPy, or of MATLAB, for benches that run others' filters.

Printed from what numba compiles and the C is printed from, with what the options leave of it; every
operation is of float32, so it says what the fixed step says. ``firmware_ref/submission`` holds what
calls it: ``Model(X, z) -> (soc, z)``.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from numbers import Number
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.initial_soc import padding
from cellwise.errors import InputError
from cellwise.estimate import status
from cellwise.estimate.filters.bank_kernels import COMPONENTS
from cellwise.estimate.fixed import layout
from cellwise.estimate.fixed.stepper import SINGLE, STEP_MODULES
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export import matlab
from cellwise.export.c_tables import comment, filled, firmware_folder
from cellwise.export.package import Export
from cellwise.files import write_atomically
from cellwise.printing.firmware import sources

SUFFIXES = (".py", ".m")
TEMPLATE, MATLAB_TEMPLATE = "submission/model.py.in", "submission/Model.m.in"
BEGIN, STEP = "start_bank", "step_bank"
STILL = ("explained_V2", "still_rows", "still_rows_step")
BY_HAND = ("magnitude",)  # of the template: of Python's it would be a float64


def check(path: str) -> None:
    """Nothing is needed."""


def write(export: Export, path: str) -> tuple[list[Path], list[str]]:
    """Write the file; its place, and nothing to say.

    Raises
    ------
    InputError        as of the tables; a step without a bank for a start that is not known
    """
    if not export.tables.options.bank:
        raise InputError(
            "a submission of a lean step, which has no bank",
            "the step with its bank: nobody says where such a log begins",
            "Leave `lean` out.",
        )
    text = matlab_text(export) if path.lower().endswith(".m") else submission_text(export)
    return [write_atomically(path, text)], []


def submission_text(export: Export) -> str:
    """The file."""
    tables = export.tables
    marks = {
        "@NAME@": comment(export.model.name).replace('"', "'") or "unnamed",
        "@DT_S@": repr(tables.dt_s),
        "@COMPONENTS@": str(COMPONENTS),
        "@PADDING@": "\n\n\n".join(_padding()),
        "@TABLES@": "\n".join(_tables(tables)),
        "@STEP@": "\n\n".join(_functions(tables)),
    }
    template = (firmware_folder() / TEMPLATE).read_text(encoding="utf-8")
    return filled(template, marks)


def matlab_text(export: Export) -> str:
    """The file in MATLAB's language."""
    tables = export.tables
    numbers, nodes = _chosen(tables)
    still, rule = _rule()
    functions = {
        n: one for n, one in {**nodes, **still}.items() if isinstance(one, ast.FunctionDef)
    }
    tuples = {
        name: _fields(one)
        for name, one in {**nodes, **still}.items()
        if isinstance(one, ast.ClassDef)
    }
    translated = matlab.Translation(functions, tuples, numbers | rule)
    changed = [translated.changed[name] for name in (BEGIN, STEP)]
    if changed != [["b", "of"], ["b", "of", "out"]]:  # as the template has it
        raise ValueError(f"{BEGIN} and {STEP} change {changed}")
    record = tables.constants[0]
    constant = {name: _in_matlab(record[name]) for name in tables.constants.dtype.names or ()}
    rows = np.asfortranarray(tables.table, dtype=np.float32)
    whole = ", ".join(repr(float(v)) for v in rows.ravel(order="F"))
    column = nodes_column(tables)
    marks = {
        "@NAME@": comment(export.model.name) or "unnamed",
        "@DT_S@": repr(tables.dt_s),
        "@COMPONENTS@": str(COMPONENTS),
        "@LEAST_OHM@": repr(float(rows[..., column].min())),
        "@TABLES@": f"m.constant = {matlab.struct(constant)};\n"
        f"m.row = reshape(single([{whole}]), [{', '.join(map(str, rows.shape))}]);",
        "@STEP@": "\n\n".join(translated.texts()),
    }
    for kind, mark in (("State", "@STATE@"), ("Bank", "@BANK@"), ("Output", "@OUTPUT@")):
        fields = layout.fields_of(layout.RECORDS[kind], tables.options)
        empty = {f.name: "single(0)" if f.type == "f4" else "0" for f in fields}
        marks[mark] = matlab.struct(empty)
    template = (firmware_folder() / MATLAB_TEMPLATE).read_text(encoding="utf-8")
    return filled(template, marks)


def nodes_column(tables: FixedStepTables) -> int:
    """The table's column of the ohmic resistance."""
    return layout.row_names(tables.options).index("r0_ohm")


def _in_matlab(value: Any) -> str:
    if np.ndim(value):
        return f"single([{', '.join(repr(float(v)) for v in value)}])"
    return matlab.number(value)


def _fields(node: ast.ClassDef) -> list[str]:
    return [ast.unparse(n.target) for n in node.body if isinstance(n, ast.AnnAssign)]


def _rule() -> tuple[dict[str, ast.stmt], dict[str, Any]]:
    """The rule of rows that were put before a log, as the start of a log has it; its numbers."""
    nodes: dict[str, ast.stmt] = {}
    for node in ast.parse(inspect.getsource(padding)).body:
        if isinstance(node, ast.ClassDef):
            nodes[node.name] = node
        elif isinstance(node, ast.FunctionDef) and node.name in STILL:
            nodes[node.name] = _bare(node)
    return nodes, {n: v for n, v in vars(padding).items() if isinstance(v, float)}


def _tables(tables: FixedStepTables) -> Iterator[str]:
    """Constants, the table, and empty records: every number as NumPy reads its bits again."""
    record = tables.constants[0]
    yield "CONSTANT = Record("
    for name in tables.constants.dtype.names or ():
        yield f"    {name}={_number(record[name])},"
    yield ")"
    rows = np.ascontiguousarray(tables.table, dtype="<f4")
    yield f'ROW = np.frombuffer(bytes.fromhex(\n    "{rows.tobytes().hex()}"\n), "<f4")'
    yield f"ROW = ROW.reshape({rows.shape})"
    for kind, name in (("State", "STATE"), ("Bank", "BANK"), ("Output", "OUTPUT")):
        fields = layout.fields_of(layout.RECORDS[kind], tables.options)
        empty = ", ".join(f"{f.name}={'F' if f.type == 'f4' else 'U'}(0)" for f in fields)
        yield f"{name} = dict({empty})"


def _number(value: Any) -> str:
    if np.ndim(value):
        return f'np.frombuffer(bytes.fromhex("{value.tobytes().hex()}"), "<f4")'
    if np.asarray(value).dtype.kind == "u":
        return f"U({int(value)})"
    return f"F({float(value)!r})"


def _functions(tables: FixedStepTables) -> Iterator[str]:
    """Named tuples, numbers and functions that a step needs, in the order of their calls."""
    numbers, nodes = _chosen(tables)
    yield "\n".join(f"{name} = {_scalar(value)}" for name, value in numbers.items())
    for node in nodes.values():
        yield _printed(node)


def _chosen(tables: FixedStepTables) -> tuple[dict[str, Any], dict[str, ast.stmt]]:
    """Numbers, and named tuples and functions, that a step needs."""
    options = tables.options
    scope: dict[str, Any] = {bit.name: np.uint32(bit) for bit in status.Status if bit.name}
    nodes: dict[str, ast.stmt] = {}
    for read, module in zip(sources(options), STEP_MODULES, strict=True):
        scope |= {k: v for k, v in vars(module).items() if isinstance(v, Number)}
        for node in read.tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name not in BY_HAND:
                nodes[node.name] = node
    scope |= SINGLE
    scope |= {n.upper(): np.uint32(k) for k, n in enumerate(layout.row_names(options))}
    needed = _needed(nodes)
    named = sorted(name for name in needed - nodes.keys() if name in scope)
    numbers = {name: _counted(scope[name]) for name in named}
    return numbers, {name: node for name, node in nodes.items() if name in needed}


def _counted(value: Any) -> np.generic:
    return np.float32(value) if isinstance(value, float | np.float32) else np.uint32(value)


def _padding() -> Iterator[str]:
    """That rule as Python."""
    nodes, numbers = _rule()
    yield "\n".join(f"{name} = {value!r}" for name, value in numbers.items())
    for node in nodes.values():
        yield _printed(node)


def _scalar(value: Any) -> str:
    return f"F({float(value)!r})" if isinstance(value, float | np.float32) else f"U({int(value)})"


def _needed(nodes: dict[str, ast.stmt]) -> set[str]:
    """Every name that a start and a step lead to."""
    found: set[str] = set()
    waiting = [BEGIN, STEP]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            node = nodes.get(name)
            if isinstance(node, ast.FunctionDef):
                inside = ast.walk(_plain(node))
                waiting += [n.id for n in inside if isinstance(n, ast.Name)]
    return found


def _plain(node: ast.stmt) -> ast.stmt:
    """A function without types, marks and its text; its numbers in float32."""
    bare = _bare(node) if isinstance(node, ast.FunctionDef) else node
    return _Single().visit(bare)  # type: ignore[no-any-return]


def _bare(node: ast.FunctionDef) -> ast.FunctionDef:
    node.decorator_list, node.returns = [], None
    for argument in node.args.args:
        argument.annotation = None
    if ast.get_docstring(node):
        node.body = node.body[1:]
    return node


class _Single(ast.NodeTransformer):
    """Numbers with a point as float32."""

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        if not isinstance(node.value, float):
            return node
        return ast.Call(ast.Name("F", ast.Load()), [ast.Name(repr(node.value), ast.Load())], [])

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """What is one already stays."""
        done = isinstance(node.func, ast.Name) and node.func.id == "F" and not node.keywords
        if done and isinstance(node.args[0], ast.Name | ast.Constant):
            return node
        return ast.copy_location(self.generic_visit(node), node)  # type: ignore[return-value]


def _printed(node: ast.stmt) -> str:
    if isinstance(node, ast.ClassDef):
        return f'{node.name} = namedtuple("{node.name}", "{" ".join(_fields(node))}")'
    return ast.unparse(ast.fix_missing_locations(node))

"""The C99 twin of the fixed step, printed from the Python that numba compiles."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.unrolled import unrolled_by_option, write_out
from cellwise.estimate import status
from cellwise.estimate.fixed import arithmetic, layout, options
from cellwise.estimate.fixed.stepper import STEP_MODULES
from cellwise.printing.c.c99 import Function
from cellwise.printing.c.reading import FLOATS, SCALARS, Program
from cellwise.printing.c.text import (
    ALWAYS,
    Guard,
    any_of,
    comment,
    comments_of,
    float_literal,
    merged,
    preprocessor,
)

READS = ("read", "rise")  # macros of cellwise_float.h
PUBLIC = {
    "init": "cellwise_init",
    "step": "cellwise_step",
    "power": "cellwise_power",
    "remaining": "cellwise_remaining",
    "plan": "cellwise_plan",
    "set_health": "cellwise_set_health",
    "start_cells": "cellwise_cells_init",
    "mean_voltage": "cellwise_mean_voltage",
    "step_cells": "cellwise_cells_step",
    "cell_of": "cellwise_cell_of",
    "pack_power": "cellwise_pack_power",
}
# What of these is there only with options.
GUARDS: dict[str, Guard] = {
    "power": frozenset({"POWER"}),
    **dict.fromkeys(("remaining", "plan"), frozenset({"REMAINING"})),
    "set_health": frozenset({"HEALTH"}),
    **dict.fromkeys(("start_cells", "mean_voltage", "step_cells", "cell_of"), frozenset({"CELLS"})),
    "pack_power": frozenset({"CELLS", "POWER"}),
}
NUMERALS = {"ZERO", "QUARTER", "HALF", "ONE", "TWO", "THREE", "FOUR", "SIXTY_FOURTH"}
RECORDS = {
    "Constants": layout.CONSTANTS, "State": layout.STATE, "Sample": layout.INPUT_FIELDS,
    "Output": layout.OUTPUT_FIELDS, "Capability": layout.CAPABILITY_FIELDS,
    "Outlook": layout.OUTLOOK_FIELDS, "Phase": layout.PHASE_FIELDS,
    "Landing": layout.LANDING_FIELDS,
    "Cell": layout.CELL_FIELDS, "CellOutput": layout.CELL_OUTPUT_FIELDS,
}  # fmt: skip


class Source(NamedTuple):
    """A module of the step with its functions; ``first`` is the one from which on C is printed."""

    module: ModuleType
    tree: ast.Module
    notes: tuple[dict[int, str], dict[int, str]]
    first: int


def sources() -> list[Source]:
    """The modules as they are read."""
    found = []
    for module in STEP_MODULES:
        text = inspect.getsource(module)
        line = text.find("# ---- from here on the C is printed ----")
        notes = comments_of(text)
        tree = written_out(ast.parse(text), vars(module))
        found.append(Source(module, tree, notes, text.count("\n", 0, max(line, 0))))
    return found


def written_out(tree: ast.Module, scope: dict[str, Any]) -> ast.Module:
    """A module with the loops over states of its functions written out."""
    for k, node in enumerate(tree.body):
        if isinstance(node, ast.FunctionDef):
            said = [ast.unparse(d) for d in node.decorator_list]
            if unrolled_by_option.__name__ in said:
                tree.body[k] = write_out(node, scope, by_option=True)
    return tree


def constants() -> dict[str, tuple[str, str]]:
    """Type and text of every name that is a constant."""
    found = {"True": ("Flag", "true"), "False": ("Flag", "false")}
    for name, value in vars(arithmetic).items():
        if isinstance(value, np.float32):
            found[name] = ("Float", float_literal(value) if name in NUMERALS else name)
        elif isinstance(value, np.uint32):
            found[name] = ("Count", name)
    for bit in status.Status:
        found[str(bit.name)] = ("Count", f"CELLWISE_{bit.name}")
    return found


def program(read: list[Source]) -> Program:
    """Everything that is printed, functions in the order of their calls."""
    structs: dict[str, dict[str, str]] = {
        name: {f.name: "Float" if f.type == "f4" else "Count" for f in table}
        for name, table in RECORDS.items()
    }
    structs["Model"] = {"constant": "Constants", "row": "Rows"}
    for source in read:
        for node in source.tree.body:
            if isinstance(node, ast.ClassDef):
                fields = [n for n in node.body if isinstance(n, ast.AnnAssign)]
                structs[node.name] = {
                    ast.unparse(f.target): ast.unparse(f.annotation) for f in fields
                }
    made = Program(
        options=set(options.flags_of(options.Options(points=3))),
        structs=structs,
        constants=constants(),
        columns={f.name.upper(): f.name for f in layout.ROW},
        sizes={f.name: size_of(f) for f in layout.CONSTANTS if f.size},
    )
    for source in read:
        for node in source.tree.body:
            if not isinstance(node, ast.FunctionDef) or node.lineno < source.first:
                continue
            if node.name not in READS:
                made.functions[node.name] = Function(node, made, source.notes)
    return made


def conditions(made: Program) -> dict[str, set[Guard]]:
    """Under which options each function is called."""
    found: dict[str, set[Guard]] = {name: set() for name in made.functions}
    for name in reversed(made.functions):
        if name in PUBLIC:
            found[name].add(GUARDS.get(name, ALWAYS))
        for used, guard in made.functions[name].uses:
            if used in found:
                found[used] |= {guard | outer for outer in found[name] if consistent(guard | outer)}
    found["between"].add(ALWAYS)  # in the macros of cellwise_float.h
    return found


def consistent(guard: Guard) -> bool:
    """Whether options can hold together."""
    return not any(f"not {term}" in guard for term in guard)


def size_of(field: layout.Field) -> str:
    """Elements of an array."""
    most = f"CELLWISE_{field.size.upper()}"
    return f"({most} - {field.fewer}u)" if field.fewer else most


def struct(name: str, fields: list[tuple[str, str, str, str]]) -> list[str]:
    """A struct from types, names, conditions and meanings."""
    lines = []
    for kind, text, condition, meaning in fields:
        line = f"    {kind} {text};"
        said = [f"{line} /* {meaning} */"] if meaning else [line]
        if len(said[0]) > 100:
            said = [*comment(meaning, 4), line]
        lines += [f"#if {condition}", *said, "#endif"] if condition else said
    return ["typedef struct {", *merged(lines), f"}} {name};"]


def record(name: str, table: tuple[layout.Field, ...]) -> list[str]:
    """A struct of the layout."""
    fields = []
    for f in table:
        kind = "float" if f.type == "f4" else "uint32_t"
        guard = frozenset(f.option.split(" and ")) if f.option else ALWAYS
        array = f"[{size_of(f).strip('()')}]" if f.size else ""
        fields.append((kind, f.name + array, preprocessor(guard) if guard else "", f.meaning))
    return struct(name, fields)


def named_tuple(node: ast.ClassDef, fields: dict[str, str]) -> list[str]:
    """A named tuple as a struct."""
    found = []
    for name, kind in fields.items():
        option = FLOATS.get(kind, "")
        condition = preprocessor(frozenset({option})) if option else ""
        found.append((SCALARS.get(kind, f"cellwise_{kind.lower()}"), name, condition, ""))
    about = ast.get_docstring(node) or ""
    return [*comment(about), *struct(f"cellwise_{node.name.lower()}", found)]


def defines(read: Source, made: Program) -> Iterator[str]:
    """Constants that the step uses."""
    used = {name for f in made.functions.values() for name, _ in f.uses}
    for node in read.tree.body:
        if not isinstance(node, ast.Assign):
            continue
        targets = node.targets[0]
        names = targets.elts if isinstance(targets, ast.Tuple) else [targets]
        for target in names:
            name = ast.unparse(target)
            if name not in used or name in NUMERALS or name not in made.constants:
                continue
            value = getattr(arithmetic, name)
            if isinstance(value, np.float32):
                text, note = float_literal(value), ""
                if text.startswith("0x1."):
                    note = f"{float(value):.6g}"
                text = f"({text})" if value < 0 else text
            else:
                text, note = f"{int(value)}u" if value < 0x10000 else f"0x{int(value):X}u", ""
                if value >= 0x10000 and int(value) % 10000 == 0:
                    text = f"{int(value)}u"
            note = ": ".join(n for n in (note, read.notes[1].get(node.lineno, "")) if n)
            yield f"#define {name} {text}" + (f" /* {note} */" if note else "")


def print_source() -> str:
    """``cellwise_ekf.c``."""
    read = sources()
    made = program(read)
    found = conditions(made)
    lines = [*comment(HEAD.format(what="src/cellwise/estimate/fixed")), '#include "cellwise_ekf.h"',
             '#include "cellwise_float.h"', "", *comment("Constants of the algorithm."),
             *defines(read[0], made), ""]  # fmt: skip
    for source in read:
        name = source.module.__name__.rsplit(".", 1)[-1]
        about = (ast.get_docstring(source.tree) or "").split("\n")[0]
        lines += [*comment(f"---- {name}.py: {about}"), ""]
        for node in source.tree.body:
            if isinstance(node, ast.ClassDef):
                made_so = named_tuple(node, made.structs[node.name])
                lines += [*inside(made_so, used_under(node.name, made, found)), ""]
            elif isinstance(node, ast.FunctionDef) and node.name in made.functions:
                lines += [*function(made.functions[node.name], found[node.name]), ""]
    return "\n".join(lines)


def function(one: Function, called: set[Guard]) -> list[str]:
    """A function of C, where it is called at all."""
    name = one.node.name
    return inside(one.text(PUBLIC.get(name, name), name not in PUBLIC), called)


def inside(lines: list[str], guards: set[Guard]) -> list[str]:
    """Lines that are there under one of the guards."""
    condition = any_of(guards)
    return [f"#if {condition}", *lines, "#endif"] if condition else lines


def used_under(struct_name: str, made: Program, found: dict[str, set[Guard]]) -> set[Guard]:
    """Under which options a function is there that uses a struct."""
    type_name = f"cellwise_{struct_name.lower()} "
    guards: set[Guard] = set()
    for name, one in made.functions.items():
        if any(type_name in line for line in one.text(name, True)):
            guards |= found[name]
    return guards


def print_header() -> str:
    """``cellwise_ekf.h``."""
    made = program(sources())
    blocks = {
        "head": comment(HEAD.format(what="src/cellwise/estimate/fixed/layout.py")),
        "status": status_bits(),
        "row": record("cellwise_row", layout.ROW),
        "constants": record("cellwise_constants", layout.CONSTANTS),
        "state": record("cellwise_state", layout.STATE),
        "input": record("cellwise_input", layout.INPUT_FIELDS),
        "output": record("cellwise_output", layout.OUTPUT_FIELDS),
        "capability": record("cellwise_capability", layout.CAPABILITY_FIELDS),
        "outlook": record("cellwise_outlook", layout.OUTLOOK_FIELDS),
        "phase": record("cellwise_phase", layout.PHASE_FIELDS),
        "landing": record("cellwise_landing", layout.LANDING_FIELDS),
        "cell": record("cellwise_pack_cell", layout.CELL_FIELDS),
        "cell_output": record("cellwise_cell_output", layout.CELL_OUTPUT_FIELDS),
    }
    for name, public in PUBLIC.items():
        f = made.functions[name]
        said = f.signature(public, False)
        blocks[public] = [*comment(ast.get_docstring(f.node) or ""), *said[:-1], said[-1] + ";"]
        if name in GUARDS:
            condition = preprocessor(GUARDS[name])
            blocks[public] = [f"#if {condition}", *blocks[public], "#endif"]
    text = (Path(__file__).parent / "cellwise_ekf.h.in").read_text(encoding="utf-8")
    for name, lines in blocks.items():
        text = text.replace(f"[{name}]\n", "\n".join(lines) + "\n")
    return text


def status_bits() -> list[str]:
    """Every bit with what it means."""
    source = inspect.getsource(status)
    notes = comments_of(source)[1]
    lines = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            for bit in node.body:
                if isinstance(bit, ast.Assign):
                    name, value = ast.unparse(bit.targets[0]), ast.unparse(bit.value)
                    line = f"#define CELLWISE_{name} {value}u"
                    note = f"{line} /* {notes[bit.lineno]} */"
                    lines += [note] if len(note) <= 100 else [*comment(notes[bit.lineno]), line]
    return lines


HEAD = (
    "State of charge of one battery cell: float32 extended Kalman filter at a fixed time step. "
    "Printed from {what} by `python -m cellwise.printing`; do not edit."
)

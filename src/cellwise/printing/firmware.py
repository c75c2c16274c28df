"""The C99 twin of the fixed step, printed from the Python that numba compiles.

What one set of options rules out is not printed: the C of an export has no branch for effects that
its model does not have. ``firmware_ref`` holds a print with all of them, to be read.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.unrolled import unrolled_by_option, write_out
from cellwise.estimate import status
from cellwise.estimate.fixed import arithmetic, layout
from cellwise.estimate.fixed.options import WHOLE_SKETCH, Options, flags_of
from cellwise.estimate.fixed.stepper import SINGLE, STEP_MODULES
from cellwise.printing.c99 import SCALARS, Function, Program
from cellwise.printing.chosen import chosen, with_notes
from cellwise.printing.text import WIDTH, comment, comments_of, float_literal

READS = ("read", "rise")  # macros of cellwise_float.h
PUBLIC = {
    "init": "cellwise_init",
    "step": "cellwise_step",
    "start_bank": "cellwise_bank_init",
    "step_bank": "cellwise_bank_step",
    "power": "cellwise_power",
    "remaining": "cellwise_remaining",
    "plan": "cellwise_plan",
    "set_health": "cellwise_set_health",
    "start_cells": "cellwise_cells_init",
    "mean_voltage": "cellwise_mean_voltage",
    "step_cells": "cellwise_cells_step",
    "cell_of": "cellwise_cell_of",
    "pack_power": "cellwise_pack_power",
    "start_soh": "cellwise_soh_init",
    "step_soh": "cellwise_soh_step",
    "soh_of": "cellwise_soh_of",
    "clear_sketch": "cellwise_sketch_init",
    "add_to_sketch": "cellwise_sketch_add",
}
# Numbers of the requirements (docs/firmware.md) that a function meets, said where it stands in C.
REQUIREMENTS = {
    "see": "CW-001, CW-004, CW-005. ",
    "correct": "CW-002. ",
    "count_charge": "CW-003. ",
    "is_sound": "CW-006. ",
    "finish": "CW-007. ",
    "judge": "CW-008. ",
    "watch_voltage": "CW-009. ",
    "watch_current": "CW-010. ",
    "outside": "CW-018. ",
    "bank_is_sound": "CW-019. ",
}
# What of these is there only with options.
ASKED = {
    **dict.fromkeys(("start_bank", "step_bank"), ("BANK",)),
    "power": ("POWER",),
    **dict.fromkeys(("remaining", "plan"), ("REMAINING",)),
    "set_health": ("HEALTH",),
    **dict.fromkeys(("start_cells", "mean_voltage", "step_cells", "cell_of"), ("CELLS",)),
    "pack_power": ("CELLS", "POWER"),
    **dict.fromkeys(("start_soh", "step_soh", "soh_of"), ("SOH",)),
    **dict.fromkeys(("clear_sketch", "add_to_sketch"), ("SKETCH",)),
}
ALWAYS = ("between",)  # in the macros of cellwise_float.h
# Tables of two temperatures and over the Arrhenius factor, every effect, every function.
EVERYTHING = Options(**{f.name: 1 for f in fields(Options)} | {
    "points": 101, "temperatures": 3, "arrhenius": 161, "depth": 161, "validity": 2,
    "sketch": WHOLE_SKETCH, "sketch_sums": WHOLE_SKETCH * (WHOLE_SKETCH + 1) // 2,
})  # fmt: skip


# What a part of the C holds, in the order of calls. A part is a module or, by FIRST, what follows
# the beginning of one, or a function in it. In objects of their own a step of three states takes
# 596 instructions on a Cortex-M4F instead of 367, and three times the stack: they are one.
PARTS = {
    "arithmetic": "Constants of the algorithm, small helpers.",
    "scalar": "Equations of single numbers.",
    "evidence": "How much a voltage weighs, and what stays of the model's error.",
    "sensors": "Readings that a sensor cannot have meant, and a charge that nobody counted.",
    "likelihood": "What a voltage and the past say against one of several filters.",
    "offset": "What rests and voltages say of a current that is off all the time.",
    "covariance": "What a step does to P, and to the state through it.",
    "start": "What branches may hold that nobody has seen before.",
    "place": "Where a temperature and a SOC lie between the tables.",
    "lookup": "Tables at one SOC, temperature and current.",
    "weighing": "What becomes of a voltage: gate, recovery, weight, what contradicts the count.",
    "state": "Whether a state is sound, where it starts, what an interval does to it.",
    "sensing": "What a sample means: numbers missing, currents and voltages that are invalid.",
    "innovation": "What a measured voltage is expected to be, and how far it may be off.",
    "correction": "What a measured voltage does: refused, weighed, used.",
    "step": "A start and one step.",
    "components": "A start that is not known: filters side by side, weighed, gathered.",
    "past": "What the branches of a component hold of the load before its start.",
    "block": "What a block of samples does to the estimate, and says to a component.",
    "spread": "One sample of all of them, until they agree.",
    "bank": "A bank's memory, its start, its step.",
    "power": "State of power: what a constant current makes of the cell, and the largest one.",
    "remaining": "A load carried on: time and energy to its cutoff or to empty.",
    "plan": "A plan of loads, and where it ends.",
    "cells": "Cells of a pack on one table: their difference from the mean cell.",
    "pack_power": "What a pack gives and takes as its weakest cell allows.",
    "record": "What is known of capacity and resistance, and whether that is sound.",
    "capacity": "What a pair of rests far apart says of the capacity.",
    "rests": "The charge between rests, how long a cell has rested, the first load after.",
    "accumulate": "What a sketch adds up after a step.",
}
FIRST = {
    "components.py": "likelihood",
    "lookup.py": "place", "resistances_at": "lookup",
    "step.py": "correction", "begin_at": "step",
    "bank.py": "components", "left_by_load": "past", "collect_sample": "block",
    "likeliest_of": "spread", "is_lost": "bank",
    "fixed_power.py": "power", "fixed_remaining.py": "remaining", "is_plan_sound": "plan",
    "fixed_cells.py": "cells", "with_cell": "pack_power", "fixed_capacity.py": "record",
    "soc_of_ocv": "capacity", "fixed_rests.py": "rests",
}  # fmt: skip
HEADERS = {
    "cellwise_model.h": "Tables of one cell, as `cellwise export` writes them.",
    "cellwise_bank_record.h": "What is kept of a start that is not known, beside its states.",
    "cellwise_ekf.h": "State of charge of one battery cell: a Kalman filter at a fixed time step.",
    "cellwise_soh.h": "Capacity that is left, between rests far apart, and resistance, after one.",
    "cellwise_sketch.h": "A sketch of the residual: sums for a diagnosis from nothing else.",
}
WHOLE = (
    "The filter, its parts compiled as one. In objects of their own a step of three states takes "
    "62 % more instructions on a Cortex-M4F, and three times the stack."
)


class StepModule(NamedTuple):
    """A module of the step with its functions; ``first`` is the line from which on C is printed."""

    name: str
    tree: ast.Module
    behind: dict[int, str]
    first: int


def sources(options: Options) -> list[StepModule]:
    """The modules as they are read, with what options leave of them."""
    found = []
    flags, kept = flags_of(options), dict[str, list[bool]]()
    for module in STEP_MODULES:
        text = inspect.getsource(module)
        line = text.find("# ---- from here on the C is printed ----")
        alone, behind = comments_of(text)
        tree = written_out(ast.parse(text), vars(module))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                with_notes(node.body, node.body[0].end_lineno or 0, alone)
        name = f"src/{module.__name__.replace('.', '/')}.py"
        first = text.count("\n", 0, max(line, 0))
        found.append(StepModule(name, chosen(tree, flags, kept), behind, first))
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
    found = {"True": ("bool", "true"), "False": ("bool", "false")}
    for name, value in (vars(arithmetic) | SINGLE).items():
        if isinstance(value, np.float32):
            found[name] = ("float", name)
        elif isinstance(value, np.uint32):
            found[name] = ("int", name)
    for bit in status.Status:
        found[str(bit.name)] = ("int", f"CELLWISE_{bit.name}")
    return found


def program(read: list[StepModule], options: Options) -> Program:
    """Everything that is printed, functions in the order of their calls."""
    structs: dict[str, dict[str, str]] = {
        name: {f.name: "float" if f.type == "f4" else "int" for f in table}
        for name, table in layout.RECORDS.items()
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
        structs=structs,
        constants=constants(),
        columns={f.name.upper(): f.name for f in layout.ROW},
        sizes={
            f.name: size_of(f) for f in (*layout.CONSTANTS, *layout.RECORDS["Sketch"]) if f.size
        },
        temperatures=options.temperatures > 1,
        public=PUBLIC,
        requirements=REQUIREMENTS,
    )
    for source in read:
        for node in source.tree.body:
            if not isinstance(node, ast.FunctionDef) or node.lineno < source.first:
                continue
            if node.name not in READS:
                made.functions[node.name] = Function(node, made, source.behind)
    flags = flags_of(options)
    used = {n for n in PUBLIC if all(flags[o] for o in ASKED.get(n, ()))} | set(ALWAYS)
    for name in reversed(made.functions):
        if name in used:
            used |= made.functions[name].uses
    made.functions = {n: f for n, f in made.functions.items() if n in used}
    return made


def size_of(field: layout.Field) -> str:
    """Elements of an array."""
    most = f"CELLWISE_{field.size.upper()}"
    return f"({most} - {field.fewer}u)" if field.fewer else most


def struct(name: str, fields: list[tuple[str, str, str]]) -> list[str]:
    """A struct from types, names and meanings."""
    lines = []
    for kind, text, meaning in fields:
        line = f"    {kind} {text};"
        said = [f"{line} /* {meaning} */"] if meaning else [line]
        lines += said if len(said[0]) <= WIDTH else [*comment(meaning, 4), line]
    return ["typedef struct {", *lines, f"}} {name};"]


def record(name: str, table: tuple[layout.Field, ...], options: Options) -> list[str]:
    """A struct of the layout."""
    fields = []
    for f in layout.fields_of(table, options):
        kind = "float" if f.type == "f4" else "uint32_t"
        array = f"[{size_of(f).strip('()')}]" if f.size else ""
        fields.append((kind, f.name + array, f.meaning))
    return struct(name, fields)


def named_tuple(node: ast.ClassDef, fields: dict[str, str]) -> list[str]:
    """A named tuple as a struct."""
    found = [(SCALARS.get(k, f"cellwise_{k.lower()}"), name, "") for name, k in fields.items()]
    return [
        *comment(ast.get_docstring(node) or ""), *struct(f"cellwise_{node.name.lower()}", found),
    ]  # fmt: skip


def defines(read: StepModule, made: Program) -> Iterator[str]:
    """Constants that the step uses."""
    used: set[str] = set().union(*(f.uses for f in made.functions.values()))
    for node in read.tree.body:
        if not isinstance(node, ast.Assign):
            continue
        targets = node.targets[0]
        names = targets.elts if isinstance(targets, ast.Tuple) else [targets]
        for target in names:
            name = ast.unparse(target)
            if name not in used or name not in made.constants:
                continue
            value = SINGLE.get(name, getattr(arithmetic, name))
            if isinstance(value, np.float32):
                text, note = float_literal(value), ""
                if text.startswith("0x1."):
                    note = f"{float(value):.6g}"
                text = f"({text})" if value < 0 else text
            else:
                text, note = f"{int(value)}u" if value < 0x10000 else f"0x{int(value):X}u", ""
                if value >= 0x10000 and int(value) % 10000 == 0:
                    text = f"{int(value)}u"
            note = ": ".join(n for n in (note, read.behind.get(node.lineno, "")) if n)
            yield f"#define {name} {text}" + (f" /* {note} */" if note else "")


@lru_cache(maxsize=8)
def print_files(options: Options) -> dict[str, str]:
    """Names and texts of all that is printed: both headers, the parts, what includes them."""
    read = sources(options)
    made = program(read, options)
    found = print_headers(made, options)
    parts = {name: lines for name, lines in parts_of(read, made).items() if lines}
    before = "float"
    for name, lines in parts.items():
        guard = f"CELLWISE_{name.upper()}_H"
        text = [
            *headed(f"Part of cellwise_ekf.c. {PARTS[name]}"), f"#ifndef {guard}",
            f"#define {guard}", "", f'#include "cellwise_{before}.h"', "", *lines, "#endif", "",
        ]  # fmt: skip
        found[f"cellwise_{name}.h"] = "\n".join(text)
        before = name
    names = ("ekf", "soh", "sketch", "float", *parts)
    includes = [f'#include "cellwise_{name}.h"' for name in names]
    found["cellwise_ekf.c"] = "\n".join([*headed(WHOLE), *includes, ""])
    return found


def headed(about: str) -> list[str]:
    """The first lines of a printed file."""
    return comment(
        f"{about} Printed from src/cellwise/estimate by `python -m cellwise.printing`; do not edit."
    )


def parts_of(read: list[StepModule], made: Program) -> dict[str, list[str]]:
    """Lines of every part: what C has of the module, or modules, from its first function on."""
    parts: dict[str, list[str]] = {name: [] for name in PARTS}
    numbers = (line for source in read[:2] for line in defines(source, made))
    parts["arithmetic"] += [*numbers, ""]
    for source in read:
        file = source.name.rsplit("/", 1)[-1]
        part = FIRST.get(file, file.removesuffix(".py"))
        for node in source.tree.body:
            name = getattr(node, "name", "")
            part = FIRST.get(name, part)
            if isinstance(node, ast.ClassDef) and is_used(node, made):
                parts[part] += [*named_tuple(node, made.structs[name]), ""]
            elif isinstance(node, ast.FunctionDef) and name in made.functions:
                public = PUBLIC.get(name, name)
                parts[part] += [*made.functions[name].text(public, name not in PUBLIC), ""]
    return parts


def is_used(node: ast.ClassDef, made: Program) -> bool:
    """Whether a function that is printed takes or fills a struct."""
    kinds = (k for f in made.functions.values() for k in (f.returns, *f.parameters.values()))
    return node.name in kinds


def print_headers(made: Program, options: Options) -> dict[str, str]:
    """The public headers: the templates with what is printed into them."""
    blocks = {"status": status_bits(), "row": record("cellwise_row", layout.ROW, options)}
    for kind, table in layout.RECORDS.items():
        name = layout.c_name(kind)
        there = kind != "Sketch" or options.sketch
        blocks[name.removeprefix("cellwise_")] = record(name, table, options) if there else []
    for name, public in PUBLIC.items():
        blocks[public] = []
        if name in made.functions:
            f = made.functions[name]
            said = f.signature(public, False)
            blocks[public] = [*comment(ast.get_docstring(f.node) or ""), *said[:-1], said[-1] + ";"]
    found = {}
    for file, about in HEADERS.items():
        text = (Path(__file__).parent / f"{file}.in").read_text(encoding="utf-8")
        blocks["head"] = headed(about)
        for name, lines in blocks.items():
            text = text.replace(f"[{name}]\n", "".join(f"{line}\n" for line in lines))
        found[file] = re.sub(r"\n{3,}", "\n\n", text)
    return found


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
                    lines += [note] if len(note) <= WIDTH else [*comment(notes[bit.lineno]), line]
    return lines

"""The loop of fixed steps: compiled once for every set of options.

Every function of a step reads options as global constants; here it gets the globals of one set of
options, and numba drops what they rule out before it looks at types. What is called is inlined by
LLVM, not by numba, which would copy whole functions for every block of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import FunctionType, ModuleType
from typing import Any

from numba import njit

from cellwise.cell.compiled import cached
from cellwise.estimate.cells import fixed_cells
from cellwise.estimate.cells.fixed_cells import (
    cell_of,
    mean_voltage,
    pack_power,
    start_cells,
    step_cells,
)
from cellwise.estimate.fixed import (
    arithmetic,
    correct,
    covariance,
    innovation,
    lookup,
    predict,
    search,
    sensing,
    state,
)
from cellwise.estimate.fixed import step as whole_step
from cellwise.estimate.fixed.arithmetic import F, U
from cellwise.estimate.fixed.layout import ROW, Model, row_names
from cellwise.estimate.fixed.options import Options, flags_of
from cellwise.estimate.fixed.state import set_health
from cellwise.estimate.fixed.step import init, step
from cellwise.estimate.power import fixed_power, fixed_remaining
from cellwise.estimate.power.fixed_power import power
from cellwise.estimate.power.fixed_remaining import remaining

STRICT: dict[str, Any] = {"error_model": "numpy", "fastmath": False}
# Called by compiled code alone: what would let Python call it takes a third of the time to compile.
INNER = {**STRICT, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# In the order of their calls; the C is printed in it, too.
STEP_MODULES = (
    arithmetic,
    lookup,
    covariance,
    state,
    predict,
    search,
    sensing,
    innovation,
    correct,
    whole_step,
    fixed_power,
    fixed_remaining,
    fixed_cells,
)


def functions_of(module: ModuleType) -> list[FunctionType]:
    """The functions that a module defines, in order."""
    return [
        f for f in vars(module).values()
        if isinstance(f, FunctionType) and f.__module__ == module.__name__
    ]  # fmt: skip


def rows(constants: Any, table: Any, state: Any, samples: Any, outputs: Any) -> None:
    """Step every sample; ``state`` has one record and is stepped in place. Nothing is allocated."""
    m = Model(constants[0], table)
    for k in range(samples.size):
        step(m, state[0], samples[k], outputs[k])


def begin(constants: Any, table: Any, state: Any, soc: float, soc_variance: float) -> None:
    """Start the one record of ``state``."""
    init(Model(constants[0], table), state[0], F(soc), F(soc_variance))


def ability(constants: Any, table: Any, state: Any, out: Any) -> None:
    """State of power of the one record of ``state`` into the one record of ``out``."""
    power(Model(constants[0], table), state[0], out[0])


def outlook(
    constants: Any, table: Any, state: Any, load_A: float, holds_power: bool, out: Any
) -> None:
    """Time and energy to empty of the one record of ``state`` into the one record of ``out``."""
    remaining(Model(constants[0], table), state[0], F(load_A), holds_power, out[0])


def history(constants: Any, table: Any, state: Any, share: float, scale: float) -> Any:
    """What a history says of the one record of ``state``."""
    return set_health(Model(constants[0], table), state[0], F(share), F(scale))


def begin_cells(constants: Any, table: Any, cells: Any) -> None:
    """Start the records of ``cells``."""
    start_cells(Model(constants[0], table), cells, U(cells.size))


def pack_rows(
    constants: Any, table: Any, state: Any, cells: Any, samples: Any, cell_V: Any, outputs: Any
) -> None:
    """Step every sample of a pack: ``cell_V`` (samples, cells); the samples take its means."""
    m = Model(constants[0], table)
    count = U(cells.size)
    for k in range(samples.size):
        samples[k].voltage_V = mean_voltage(m, cells, cell_V[k], count)
        step(m, state[0], samples[k], outputs[k])
        step_cells(m, state[0], samples[k], cells, cell_V[k], count)


def cells_now(constants: Any, table: Any, state: Any, cells: Any, out: Any) -> None:
    """What is known of every cell, into records of CELL_OUTPUT."""
    m = Model(constants[0], table)
    for k in range(cells.size):
        cell_of(m, state[0], cells[k], out[k])


def pack_ability(constants: Any, table: Any, state: Any, cells: Any, out: Any) -> None:
    """State of power of the pack into the one record of ``out``."""
    pack_power(Model(constants[0], table), state[0], cells, U(cells.size), out[0])


@lru_cache
def specialised(options: Options) -> dict[str, Any]:
    """Every function of the step with the globals of one set of options, compiled when called."""
    columns = {field.name.upper(): U(0) for field in ROW}
    columns |= {name.upper(): U(k) for k, name in enumerate(row_names(options))}
    made: dict[str, Any] = {}
    absent = set() if options.power or options.remaining or options.cells else {fixed_power}
    absent |= set() if options.remaining else {fixed_remaining}
    absent |= set() if options.cells else {fixed_cells}
    modules = [module for module in STEP_MODULES if module not in absent]
    for f in [f for module in modules for f in functions_of(module)]:
        scope = {**f.__globals__, **columns, **flags_of(options), **made}
        own = FunctionType(f.__code__, scope, f.__name__)
        made[f.__name__] = njit(forceinline=not hasattr(f, "apart"), **INNER)(own)
    return made


def _outer(function: FunctionType, options: Options) -> Callable[..., None]:
    scope = {**function.__globals__, **specialised(options)}
    own = FunctionType(function.__code__, scope, function.__name__)
    compiled: Callable[..., None]
    compiled = cached(nogil=True, **STRICT)(own)
    return compiled


@lru_cache
def compiled(function: Callable[..., Any], options: Options) -> Callable[..., Any]:
    """One of the functions of this module for one set of options."""
    return _outer(function, options)  # type: ignore[arg-type]

"""The compiled code of a fixed step with its tables: numba's, or that of the C.

Every function of a step reads options as global constants; here it gets the globals of one set of
options, and numba drops what they rule out before it looks at types. What is called is inlined by
LLVM, not by numba, which would copy whole functions for every block of them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import lru_cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cellwise.arguments import shown
from cellwise.cell.compiled import cached
from cellwise.cell.simulate import check_soc0, check_soc0_std
from cellwise.errors import InputError
from cellwise.estimate.cells import fixed_cells
from cellwise.estimate.cells.fixed_cells import (
    cell_of,
    mean_voltage,
    pack_power,
    start_cells,
    step_cells,
)
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.fixed import (
    arithmetic,
    covariance,
    innovation,
    lookup,
    sensing,
    state,
)
from cellwise.estimate.fixed import step as whole_step
from cellwise.estimate.fixed.arithmetic import F, U
from cellwise.estimate.fixed.layout import (
    INPUT,
    OUTPUT,
    ROW,
    Model,
    row_names,
    state_type,
)
from cellwise.estimate.fixed.options import Options, flags_of
from cellwise.estimate.fixed.state import set_health
from cellwise.estimate.fixed.step import init, step
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.noise import Noise
from cellwise.estimate.power import fixed_power, fixed_remaining
from cellwise.estimate.power.fixed_power import power
from cellwise.estimate.power.fixed_remaining import plan, remaining
from cellwise.estimate.status import VOLTAGE_INVALID

MOST_VARIANCE = 1.0
# What a step may be made with: what it is, and how.
MADE_WITH = {
    "power": (
        "state of power",
        "FixedStep(..., power=power_settings(model, horizons_s=(10.0,), hold='current'))",
    ),
    "remaining": ("remaining time", "FixedStep(..., remaining_V=3.0)"),
    "health": ("capacity and resistance of a history", "FixedStep(..., health=True)"),
}


STRICT: dict[str, Any] = {"error_model": "numpy", "fastmath": False}
# Called by compiled code alone: what would let Python call it takes a third of the time to compile.
INNER = {**STRICT, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# In the order of their calls; the C is printed in it, too.
STEP_MODULES = (
    arithmetic,
    lookup,
    covariance,
    state,
    sensing,
    innovation,
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


# ---- what Python calls: as `firmware_ref/port/host_rows.c` has it ----


def rows(constants: Any, table: Any, state: Any, samples: Any, outputs: Any, count: int) -> None:
    """Step every sample; ``state`` has one record and is stepped in place. Nothing is allocated."""
    m = Model(constants[0], table)
    for k in range(count):
        step(m, state[0], samples[k], outputs[k])


def begin(constants: Any, table: Any, state: Any, soc: float, soc_variance: float) -> None:
    """Start the one record of ``state``."""
    init(Model(constants[0], table), state[0], F(soc), F(soc_variance))


def power_of(constants: Any, table: Any, state: Any, out: Any) -> None:
    """State of power of the one record of ``state`` into the one record of ``out``."""
    power(Model(constants[0], table), state[0], out[0])


def remaining_of(
    constants: Any, table: Any, state: Any, load_A: float, holds_power: bool, out: Any
) -> None:
    """Time and energy to empty of the one record of ``state`` into the one record of ``out``."""
    remaining(Model(constants[0], table), state[0], F(load_A), holds_power, out[0])


def plan_of(
    constants: Any,
    table: Any,
    state: Any,
    phases: Any,
    count: int,
    holds_power: bool,
    above: float,
    out: Any,
) -> None:
    """Where a plan, records of PHASE, takes the one record of ``state``; into that of ``out``."""
    plan(Model(constants[0], table), state[0], phases, U(count), holds_power, F(above), out[0])


def set_health_of(constants: Any, table: Any, state: Any, share: float, scale: float) -> Any:
    """What a history says of the one record of ``state``."""
    return set_health(Model(constants[0], table), state[0], F(share), F(scale))


def cells_begin(constants: Any, table: Any, cells: Any, count: int) -> None:
    """Start the records of ``cells``."""
    start_cells(Model(constants[0], table), cells, U(count))


def pack_rows(
    constants: Any,
    table: Any,
    state: Any,
    cells: Any,
    count: int,
    samples: Any,
    cell_V: Any,
    outputs: Any,
    steps: int,
) -> None:
    """Step every sample of a pack: ``cell_V`` (samples, cells); the samples take its means."""
    m = Model(constants[0], table)
    many = U(count)
    for k in range(steps):
        samples[k].voltage_V = mean_voltage(m, cells, cell_V[k], many)
        step(m, state[0], samples[k], outputs[k])
        step_cells(m, state[0], samples[k], cells, cell_V[k], many)


def cells_of(constants: Any, table: Any, state: Any, cells: Any, count: int, out: Any) -> None:
    """What is known of every cell, into records of CELL_OUTPUT."""
    m = Model(constants[0], table)
    for k in range(count):
        cell_of(m, state[0], cells[k], out[k])


def pack_power_of(constants: Any, table: Any, state: Any, cells: Any, count: int, out: Any) -> None:
    """State of power of the pack into the one record of ``out``."""
    pack_power(Model(constants[0], table), state[0], cells, U(count), out[0])


CALLED = {
    f.__name__: f
    for f in (
        rows, begin, power_of, remaining_of, plan_of, set_health_of, cells_begin, pack_rows,
        cells_of, pack_power_of,
    )
}  # fmt: skip


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
        own = FunctionType(_single(f.__code__), scope, f.__name__)
        made[f.__name__] = njit(forceinline=not hasattr(f, "noinline"), **INNER)(own)
    return made


def _single(code: CodeType) -> CodeType:
    """The same code with its numbers in float32."""
    return code.replace(
        co_consts=tuple(F(c) if isinstance(c, float) else c for c in code.co_consts)
    )


@lru_cache
def compiled(function: Callable[..., Any], options: Options) -> Callable[..., Any]:
    """One of the functions of this module for one set of options."""
    scope = {**function.__globals__, **specialised(options)}
    own = FunctionType(function.__code__, scope, function.__name__)
    made: Callable[..., Any] = cached(nogil=True, **STRICT)(own)
    return made


class Stepper:
    """Tables with the compiled code that steps them: numba's or C's.

    Parameters
    ----------
    call : callable       a name of CALLED and what it is handed; what few ask for is compiled when
                          it is asked for
    """

    def __init__(self, tables: FixedStepTables, call: Callable[..., Any]) -> None:
        self.tables = tables
        self.call = call

    def need(self, option: str) -> Stepper:
        """The same, or a refusal of what is not compiled in.

        Raises
        ------
        InputError        made without ``power``, ``remaining`` or ``health``
        """
        if not getattr(self.tables.options, option):
            what, how = MADE_WITH[option]
            raise InputError(f"no {what} in this fixed step", how, "Make it with that.")
        return self

    def answer(self, name: str, kind: np.dtype[Any], *handed: Any, count: int = 1) -> NDArray[Any]:
        """What one of CALLED says: records of a kind, shape (count,)."""
        out = np.zeros(count, dtype=kind)
        self.call(name, *handed, out)
        return out

    def state(self) -> NDArray[Any]:
        """An empty state."""
        return np.zeros(1, dtype=state_type(self.tables.options))

    def begin(self, state: NDArray[Any], soc: float, soc_variance: float) -> None:
        """Start a state."""
        self.call("begin", state, soc, soc_variance)

    def rows(self, state: NDArray[Any], samples: NDArray[Any]) -> NDArray[Any]:
        """Step every sample: records of OUTPUT, shape (samples,)."""
        outputs = np.zeros(samples.size, dtype=OUTPUT)
        if samples.size:
            samples = np.ascontiguousarray(samples, dtype=INPUT)
            self.call("rows", state, samples, outputs, samples.size)
        return outputs

    def pack_rows(
        self, state: NDArray[Any], cells: NDArray[Any], samples: NDArray[Any], cell_V: NDArray[Any]
    ) -> NDArray[Any]:
        """Step a pack: ``cell_V`` (samples, cells); records of OUTPUT of the mean cell."""
        outputs = np.zeros(samples.size, dtype=OUTPUT)
        if samples.size:
            volts = np.ascontiguousarray(cell_V, dtype=np.float32)
            handed = state, cells, cells.size, samples, volts, outputs
            self.call("pack_rows", *handed, samples.size)
        return outputs


def numba_stepper(tables: FixedStepTables) -> Stepper:
    """The step in numba."""

    def call(name: str, *handed: Any) -> Any:
        function = compiled(CALLED[name], tables.options)
        return function(tables.constants, tables.table, *handed)

    return Stepper(tables, call)


def start_state(stepper: Stepper, soc0: float, soc0_std: float) -> NDArray[Any]:
    """A state record at rest; see :meth:`FixedStep.init`."""
    check_soc0(soc0)
    check_soc0_std(soc0_std)
    state = stepper.state()
    stepper.begin(state, float(soc0), min(max(float(soc0_std) ** 2, 1e-11), MOST_VARIANCE))
    return state


def check_record(state: object, tables: FixedStepTables, name: str) -> None:
    """Refuse what is no state of these tables: the kernel would read past it.

    Raises
    ------
    InputError        another type, another layout, more than one record
    """
    wanted = state_type(tables.options)
    if not (isinstance(state, np.ndarray) and state.dtype == wanted and state.shape == (1,)):
        raise InputError(
            f"state = {shown(state)}",
            f"one record of {wanted.itemsize} bytes, as init(soc0) of this {name} gives it",
            "Begin with init(soc0), and pass on its own.",
        )


def sequence_number(sequence: object) -> int:
    """A sequence number as the record holds it.

    Raises
    ------
    InputError        no whole number
    """
    try:
        return operator.index(sequence) % 2**32  # type: ignore[arg-type]
    except TypeError:
        raise InputError(
            f"sequence = {shown(sequence)}", "a whole number", "int the time steps from 0."
        ) from None


def info_of(out: NDArray[Any], noise: Noise) -> EkfInfo:
    """A record of OUTPUT for people: innovation and test ratio are NaN without a voltage."""
    innovation, ratio = float("nan"), float("nan")
    variance = float(out["innovation_variance_V2"])
    if not int(out["status"]) & VOLTAGE_INVALID:
        innovation = float(out["innovation_V"])
        ratio = innovation**2 / (noise.gate**2 * variance)
    return EkfInfo(
        float(out["soc"]),
        float(np.sqrt(out["soc_variance"])),
        float(out["voltage_V"]),
        innovation,
        variance,
        ratio,
        int(out["status"]),
    )

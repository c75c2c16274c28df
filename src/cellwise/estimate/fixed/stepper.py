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
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cellwise.arguments import shown
from cellwise.cell.compiled import BY, cached
from cellwise.cell.equations import scalar
from cellwise.cell.simulate import check_soc0, check_soc0_std
from cellwise.errors import InputError
from cellwise.estimate.capacity import fixed_capacity, fixed_rests
from cellwise.estimate.capacity.fixed_rests import step_soh
from cellwise.estimate.equations import bank as whole_bank
from cellwise.estimate.equations import components, constants, evidence, offset, sensors, weighing
from cellwise.estimate.equations import covariance as whole_covariance
from cellwise.estimate.equations import start as whole_start
from cellwise.estimate.filters.filter_state import EkfInfo
from cellwise.estimate.fixed import (
    arithmetic,
    bank,
    covariance,
    fixed_cells,
    innovation,
    lookup,
    sensing,
    state,
)
from cellwise.estimate.fixed import step as whole_step
from cellwise.estimate.fixed.arithmetic import *
from cellwise.estimate.fixed.bank import step_bank
from cellwise.estimate.fixed.fixed_cells import cell_of, mean_voltage, step_cells
from cellwise.estimate.fixed.layout import (
    INPUT,
    OUTPUT,
    ROW,
    Model,
    bank_type,
    row_names,
    state_type,
)
from cellwise.estimate.fixed.options import Options, flags_of
from cellwise.estimate.fixed.step import step
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.noise import Noise
from cellwise.estimate.power import fixed_power, fixed_remaining
from cellwise.estimate.sketch import accumulate
from cellwise.estimate.sketch.accumulate import add_to_sketch
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
    "soh": ("capacity between rests", "FixedStep(..., soh=True)"),
    "sketch": ("a sketch of the residual", "FixedStep(..., sketch=1024)"),
}


STRICT: dict[str, Any] = {"error_model": "numpy", "fastmath": False}
# Called by compiled code alone: no machine code of its own, and nothing that lets Python call it.
INNER = {**STRICT, **BY["part"], "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# In the order of their calls; the C is printed in it, too.
STEP_MODULES = (
    constants,
    arithmetic,
    scalar,
    evidence,
    sensors,
    components,
    offset,
    whole_covariance,
    whole_start,
    weighing,
    lookup,
    covariance,
    state,
    sensing,
    innovation,
    whole_step,
    whole_bank,
    bank,
    fixed_power,
    fixed_remaining,
    fixed_cells,
    fixed_capacity,
    fixed_rests,
    accumulate,
)


def functions_of(module: ModuleType) -> list[FunctionType]:
    """The functions that a module defines, in order: of those compiled in float64 the text."""
    found = (getattr(f, "py_func", f) for f in vars(module).values())
    return [f for f in found if isinstance(f, FunctionType) and f.__module__ == module.__name__]


# The equations' numbers in float32, as every function of the step sees them.
SINGLE = {
    name: (F if isinstance(value, float) else U)(value)
    for name, value in vars(constants).items()
    if name.isupper()
}


# ---- what `firmware_ref/port/host_rows.c` has, too ----


def rows(m: Model, x: State, samples: Samples, outputs: Outputs, count: int) -> None:
    """Step every sample. Nothing is allocated."""
    for k in range(count):
        step(m, x, samples[k], outputs[k])


def bank_rows(
    m: Model, b: Bank, of: States, count: int, samples: Samples, outputs: Outputs, steps: int
) -> None:
    """Step every sample by a bank of ``count`` components."""
    for k in range(steps):
        step_bank(m, b, of, count, samples[k], outputs[k])


def pack_rows(
    m: Model,
    x: State,
    cells: Cells,
    count: int,
    samples: Samples,
    cell_V: Floats,
    outputs: Outputs,
    steps: int,
) -> None:
    """Step every sample of a pack: ``cell_V`` (samples, cells); the samples take its means."""
    for k in range(steps):
        samples[k].voltage_V = mean_voltage(m, cells, cell_V[k], count)
        step(m, x, samples[k], outputs[k])
        step_cells(m, x, samples[k], cells, cell_V[k], count)


def sketch_rows(
    m: Model, x: State, k: Sketch, samples: Samples, outputs: Outputs, steps: int
) -> None:
    """Step every sample, and sketch it."""
    for row in range(steps):
        step(m, x, samples[row], outputs[row])
        add_to_sketch(m, x, k, samples[row])


def cells_of(m: Model, x: State, cells: Cells, count: int, outputs: Outputs) -> None:
    """What is known of every cell."""
    for k in range(count):
        cell_of(m, x, cells[k], outputs[k])


def soh_rows(m: Model, x: State, a: Soh, samples: Samples, outputs: Outputs, count: int) -> None:
    """Step every sample, and what follows each for the capacity."""
    for k in range(count):
        step(m, x, samples[k], outputs[k])
        step_soh(m, x, a, samples[k])


inner: Callable[..., Any] = step  # in `entry` the function that it is compiled for


def entry(constants: Any, table: Any, *handed: Any) -> Any:
    """What Python calls of a function of the step."""
    return inner(Model(constants[0], table), *handed)


ARRAYS = ("States", "Cells", "Floats", "Phases", "Samples", "Outputs")
FUNCTIONS = {
    f.__name__: f for module in STEP_MODULES for f in functions_of(module)
} | {
    f.__name__: f for f in (rows, bank_rows, pack_rows, cells_of, soh_rows, sketch_rows)
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
    absent |= set() if options.sketch else {accumulate}
    absent |= set() if options.bank else {whole_bank, bank}
    absent |= set() if options.soh else {fixed_capacity, fixed_rests}
    gone = {module.__name__ for module in absent}
    for f in FUNCTIONS.values():
        if f.__module__ not in gone:
            scope = {
                **f.__globals__,
                **columns,
                **flags_of(options),
                **SINGLE,
                **made,
                "F": F,
                "U": U,
                "Count": U,
            }
            own = FunctionType(_single(f.__code__), scope, f.__name__)
            made[f.__name__] = njit(forceinline=not hasattr(f, "noinline"), **INNER)(own)
    return made


def _single(code: CodeType) -> CodeType:
    """The same code with its numbers in float32."""
    numbers = (F(c) if isinstance(c, float) else c for c in code.co_consts)
    return code.replace(co_consts=tuple(numbers))


@lru_cache
def compiled(name: str, options: Options) -> Callable[..., Any]:
    """A function of the step for one set of options, as Python calls it."""
    scope = {**globals(), "inner": specialised(options)[name]}
    own = FunctionType(entry.__code__, scope, name)
    own.__qualname__ = name  # by which numba keeps it
    made: Callable[..., Any] = cached(nogil=True, **STRICT)(own)
    return made


def _handed(kind: str, value: Any) -> Any:
    """An argument as a function of the step takes it: a number, the one record of an array, all."""
    if isinstance(value, np.ndarray):
        return value if kind in ARRAYS else value[0]
    if isinstance(value, tuple):
        return value
    return value if kind == "bool" else (F if kind == "float" else U)(value)


class FilterMemory(NamedTuple):
    """What an application keeps: the record of a bank, if there is one, and states.

    The estimate is the first state, components stand behind it; without a bank it is alone.
    """

    bank: NDArray[Any] | None
    states: NDArray[Any]


class Stepper:
    """Tables with the compiled code that steps them: numba's or C's.

    Parameters
    ----------
    call : callable       the name of a function of the step and what it is handed after the model;
                          what few ask for is compiled when it is asked for
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
        """What a function of the step says: records of a kind, shape (count,)."""
        out = np.zeros(count, dtype=kind)
        self.call(name, *handed, out)
        return out

    def state(self) -> NDArray[Any]:
        """An empty state."""
        return np.zeros(1, dtype=state_type(self.tables.options))

    def begin(self, state: NDArray[Any], soc: float, soc_variance: float) -> None:
        """Start a state."""
        self.call("init", state, soc, soc_variance)

    def rows(self, state: NDArray[Any], samples: NDArray[Any]) -> NDArray[Any]:
        """Step every sample: records of OUTPUT, shape (samples,)."""
        outputs = np.zeros(samples.size, dtype=OUTPUT)
        if samples.size:
            samples = np.ascontiguousarray(samples, dtype=INPUT)
            self.call("rows", state, samples, outputs, samples.size)
        return outputs

    def start_bank(
        self, count: int, soc: float, soc_variance: float
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """A bank and its states: the estimate, and behind it ``count`` components."""
        one = np.zeros(1, dtype=bank_type(self.tables.options))
        states = np.zeros(1 + count, dtype=state_type(self.tables.options))
        self.call("start_bank", one, states, count, soc, soc_variance)
        return one, states

    def bank_rows(
        self, one: NDArray[Any], states: NDArray[Any], samples: NDArray[Any]
    ) -> NDArray[Any]:
        """Step every sample by a bank: records of OUTPUT, shape (samples,)."""
        outputs = np.zeros(samples.size, dtype=OUTPUT)
        if samples.size:
            samples = np.ascontiguousarray(samples, dtype=INPUT)
            count = states.size - 1
            self.call("bank_rows", one, states, count, samples, outputs, samples.size)
        return outputs

    def start_filter(self, components: int, soc0: float, soc0_std: float) -> FilterMemory:
        """A cell at rest at ``soc0``: by a bank of so many where one is compiled in.

        Raises
        ------
        InputError        soc0 outside 0..1, soc0_std not above zero
        """
        state = start_state(self, soc0, soc0_std)
        if not self.tables.options.bank:
            return FilterMemory(None, state)
        first = state[0]
        return FilterMemory(*self.start_bank(components, first["soc"], first["ss"]))

    def filter_rows(self, memory: FilterMemory, samples: NDArray[Any]) -> NDArray[Any]:
        """Step every sample as an application does: records of OUTPUT, shape (samples,)."""
        if memory.bank is None:
            return self.rows(memory.states, samples)
        return self.bank_rows(memory.bank, memory.states, samples)

    def rows_beside(
        self, name: str, state: NDArray[Any], record: NDArray[Any], samples: NDArray[Any]
    ) -> NDArray[Any]:
        """Step every sample, and what is kept beside it: records of OUTPUT, shape (samples,).

        ``name`` is soh_rows or sketch_rows, ``record`` what that one keeps.
        """
        outputs = np.zeros(samples.size, dtype=OUTPUT)
        if samples.size:
            samples = np.ascontiguousarray(samples, dtype=INPUT)
            self.call(name, state, record, samples, outputs, samples.size)
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
        kinds = list(FUNCTIONS[name].__annotations__.values())[1:]
        given = map(_handed, kinds, handed)
        return compiled(name, tables.options)(tables.constants, tables.table, *given)

    return Stepper(tables, call)


def start_state(stepper: Stepper, soc0: float, soc0_std: float) -> NDArray[Any]:
    """A state record at rest; see :meth:`FixedStep.init`."""
    soc0 = check_soc0(soc0)
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

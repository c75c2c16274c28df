"""What a fixed step costs: instructions on emulated cores, nanoseconds on this machine."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.example_cell import SAMPLES, START_SOC, load_log, three_branches, two_branches
from benchmarks.figures import Figure, Progress, clock, missing
from benchmarks.parts import each_case
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import bank_type, sketch_type
from cellwise.estimate.fixed.stepper import Stepper, numba_stepper, start_state
from cellwise.estimate.fixed.tables import FixedStepTables, fixed_step_tables
from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import power_settings
from cellwise.export.accuracy import WorstCase, worst_case
from cellwise.export.cross import COMPONENTS, Cost, cores_here, run_on_target

DT_S = 1.0
POINTS = 101
STEPS = 5000
# Steps between two that are counted. A count repeats exactly and depends on little but the branch
# a step takes: 100 steps of a drive give the mean of 500 within 0.4 %, 20 calls beside it, each of
# them many steps long, that of more within 0.1 %.
EVERY = 50
CALL_EVERY = 250
SKETCH_EVERY = 16  # beside rows every 15 steps: every step between two rows in turn
BANK_STEPS = 300
BANK_EVERY = 3
START_STD = 0.01
HORIZON_S = 10.0
CUTOFF_V = 2.8
POWER_LIMITS = (2.8, 4.2, 15.0, 5.0)
HOST_NS = 100.0
# Instructions, code [B], stack [B], state [B] that three states with --lean are held to.
LIMITS = {"cortex-m4f": (520.0, 2048.0, 96.0, 64.0), "cortex-m0plus": (16_500.0, None, None, 64.0)}
SHOWN = tuple(f"{core}: {name}" for core in LIMITS for name in ("3 states, --lean", "4 states"))
DESIGN = {
    "cortex-m4f": "prototype: 457 to 502 instructions, 1.75 kB at -O2, stack 80 B, state 48 B",
    "cortex-m0plus": "prototype: 15,500 instructions",
}


def configurations() -> dict[str, tuple[CellModel, FixedStepTables]]:
    """What is compiled in, by name."""
    two, three = two_branches(), three_branches()
    return {
        "3 states, --lean": (two, _tables(two, lean=True)),
        "4 states, --lean": (three, _tables(three, lean=True)),
        "3 states": (two, _tables(two)),
        "4 states": (three, _tables(three)),
    }


def _tables(model: CellModel, *, lean: bool = False) -> FixedStepTables:
    return fixed_step_tables(model, DT_S, points=POINTS, wide=not lean)


def target_figures(data: Path | None, say: Progress) -> list[Figure]:
    """Every configuration on every core; targets where the design sets them."""
    if not cores_here():
        return [missing("Firmware", "emulated cores", "", "no cross tools: make firmware")]
    steps = (
        (f"{core}: {name}", partial(_step_cost, core, name, *made))
        for core in cores_here()
        for name, made in configurations().items()
    )
    return each_case(steps, say)


def calls_figures(data: Path | None, say: Progress) -> list[Figure]:
    """State of power, remaining time and plan on every core: no page shows these."""
    if not cores_here():
        return [missing("Firmware", "emulated cores", "", "no cross tools: make firmware")]
    models = {"3 states": two_branches(), "4 states": three_branches()}
    calls = (
        (f"{core}: {name}, --lean", partial(_calls_cost, core, name, model))
        for core in cores_here()
        for name, model in models.items()
    )
    sketches = (
        (f"{core}: {name}, a sketch", partial(_sketch_cost, core, name, model))
        for core in cores_here()
        for name, model in models.items()
    )
    return each_case((*calls, *sketches), say)


def _sketch_cost(core: str, name: str, model: CellModel) -> list[Figure]:
    """What `cellwise_sketch_add` adds to a step, in both sizes."""
    records = samples_of(model, load_log(STEPS), DT_S).records
    measured = partial(run_on_target, core_name=core, samples=records, soc=START_SOC,
                       soc_variance=START_STD**2, measure_every=SKETCH_EVERY)  # fmt: skip
    step = measured(fixed_step_tables(model, DT_S, points=POINTS)).cost
    figures = []
    for most in (256, 1024):
        tables = fixed_step_tables(model, DT_S, points=POINTS, sketch=most)
        cost = measured(tables, of="sketch").cost
        group = f"{core}: {name}, --sketch {most}"
        share = cost.instructions_mean / step.instructions_mean
        figures += [
            Figure(group, "mean of a drive", cost.instructions_mean, "instructions"),
            Figure(group, "share of a step", 100.0 * share, "%", target=15.0),
            Figure(group, "most on it", cost.instructions_most, "instructions"),
            Figure(group, "stack", cost.stack_bytes, "B"),
            Figure(group, "bytes kept", float(sketch_type(tables.options).itemsize), "B"),
        ]
    return figures


def _step_cost(core: str, name: str, model: CellModel, tables: FixedStepTables) -> list[Figure]:
    """A step of one configuration, and that of its bank."""
    records = samples_of(model, load_log(STEPS), DT_S).records
    cost = run_on_target(tables, core, records, START_SOC, START_STD**2, measure_every=EVERY).cost
    worst = worst_case(model, tables, core)
    held = LIMITS.get(core) if name == "3 states, --lean" else None
    figures = _cost(f"{core}: {name}", cost, worst, held, DESIGN.get(core, ""))
    if tables.options.bank:
        bank = run_on_target(
            tables, core, records[:BANK_STEPS], START_SOC - 0.3, 0.15**2,
            measure_every=BANK_EVERY, of="bank",
        ).cost  # fmt: skip
        memory = (1 + COMPONENTS) * bank.state_bytes + bank_type(tables.options).itemsize
        figures += _bank_cost(f"{core}: {name}, a bank of {COMPONENTS}", bank, memory)
    return figures


def _bank_cost(group: str, cost: Cost, memory: int) -> list[Figure]:
    """A step while a bank looks for a start that is 30 points off."""
    note = f"{cost.measured} of the first {BANK_STEPS} steps of the drive, counted in QEMU"
    return [
        Figure(group, "mean", cost.instructions_mean, "instructions", note=note),
        Figure(group, "most", cost.instructions_most, "instructions"),
        Figure(group, "stack", cost.stack_bytes, "B"),
        Figure(group, "memory", float(memory), "B", note="states and the record of the bank"),
    ]


def _calls_cost(core: str, name: str, model: CellModel) -> list[Figure]:
    """What a call of `cellwise_power`, `cellwise_remaining` and `cellwise_plan` costs."""
    lean = partial(fixed_step_tables, model, DT_S, points=POINTS, wide=False)
    limits = OperatingLimits(*POWER_LIMITS)
    asked = power_settings(model, horizons_s=(HORIZON_S,), limits=limits, hold="current")
    records = samples_of(model, load_log(STEPS), DT_S).records
    measured = partial(run_on_target, core_name=core, samples=records, soc=START_SOC,
                       soc_variance=START_STD**2, measure_every=CALL_EVERY)  # fmt: skip
    step = measured(lean()).cost
    power, remaining = f"--power {HORIZON_S:g}", f"--remaining {CUTOFF_V:g}"
    able, left = lean(power=asked), lean(remaining_V=CUTOFF_V)
    figures: list[Figure] = []
    for option, function, run, note in (
        (power, "cellwise_power", measured(able, of="power"), "both ways, value and lower bound"),
        (remaining, "cellwise_remaining", measured(left, of="remaining"),
         "a power held, with its band"),
        (remaining, "cellwise_plan", measured(left, of="plan"), "four phases, powers"),
    ):  # fmt: skip
        figures += _call_cost(f"{core}: {name}, --lean {option}", function, run.cost, step, note)
    return figures


def _call_cost(group: str, function: str, cost: Cost, step: Cost, note: str) -> list[Figure]:
    """A call, beside the step that the package has without it."""
    return [
        Figure(group, f"{function}, mean of a drive", cost.instructions_mean, "instructions",
               note=f"{cost.measured} calls counted in QEMU; {note}"),
        Figure(group, f"{function}, most on it", cost.instructions_most, "instructions"),
        Figure(group, "code beside the step's", cost.text_bytes - step.text_bytes, "B"),
        Figure(group, "stack", cost.stack_bytes, "B"),
        Figure(group, "tables beside the step's", cost.model_bytes - step.model_bytes, "B"),
    ]  # fmt: skip


def _cost(
    group: str,
    cost: Cost,
    worst: WorstCase,
    held: tuple[float | None, ...] | None,
    design: str,
) -> list[Figure]:
    instructions, text, stack, state = held or (None, None, None, None)
    stack_bytes = float(max(cost.stack_bytes or 0, worst.stack_bytes))
    note = (
        f"{cost.measured} steps counted in QEMU, not cycles; "
        f"most under stress {worst.stress:,.0f}; "
        f"code {cost.text_bytes:,} B, stack {stack_bytes:,.0f} B, state {cost.state_bytes:,} B"
    )
    shown = group in SHOWN
    return [
        Figure(group, "mean of a drive", cost.instructions_mean, "instructions", note=note,
               headline=shown),
        Figure(group, "most on it", cost.instructions_most, "instructions", target=instructions,
               note=design if held else ""),
        Figure(group, "most under stress", worst.stress, "instructions", target=instructions,
               note="any bits, every fault"),
        Figure(group, "after a lock-out", worst.reset, "instructions"),
        Figure(group, "code", float(cost.text_bytes), "B", target=text, note="-Os"),
        Figure(group, "stack", stack_bytes, "B", target=stack),
        Figure(group, "state", float(cost.state_bytes), "B", target=state),
        Figure(group, "static RAM", float(cost.ram_bytes), "B", target=0.0 if held else None),
        Figure(group, f"tables of {POINTS} points", float(cost.model_bytes), "B"),
    ]  # fmt: skip


def host_figures(data: Path | None, say: Progress) -> list[Figure]:
    """Nanoseconds per step of numba and of the C that this machine's compiler makes."""
    group = f"Fixed step on this machine, {SAMPLES:,} samples at 1 Hz, start 30 points wrong"
    log = load_log()
    figures = []
    for name, (model, tables) in configurations().items():
        records = samples_of(model, log, DT_S).records
        for who, make in (("numba", numba_stepper), ("C, -O2", _host)):
            say(f"{who}, {name}")
            try:
                stepper = make(tables)
            except InputError as error:
                figures.append(missing(group, f"{who}, {name}", "ns/step", str(error)))
                continue
            start = start_state(stepper, START_SOC - 0.3, 0.15)

            def work(stepper: Stepper = stepper, start: np.ndarray = start) -> None:
                stepper.rows(start.copy(), records)  # noqa: B023

            timing = clock(work)
            figures.append(
                Figure(
                    group,
                    f"{who}, {name}",
                    1e9 * timing.best / SAMPLES,
                    "ns/step",
                    target=HOST_NS,
                    note=f"best of {timing.runs}, median {1e9 * timing.median / SAMPLES:.0f}",
                )
            )
    return figures


def _host(tables: FixedStepTables) -> Stepper:
    from cellwise.export.firmware import HostLibrary

    return HostLibrary(tables)

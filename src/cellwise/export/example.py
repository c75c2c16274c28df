"""What an engineer finds beside the sources: a README, an example that checks itself, a vector."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from string import Template
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import PHASE, PLAN_RESULT, hex_float, state_type
from cellwise.estimate.fixed.stepper import Stepper, numba_stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export.c_tables import comment, filled, firmware_folder, initialiser
from cellwise.export.firmware import HostLibrary
from cellwise.logs.cell_log import CellLog


class Vector(NamedTuple):
    """The samples of the example: so many, every so manyth printed; the cell's SOC, the filter's.

    A plan lands ``above`` this SOC.
    """

    samples: int = 200
    every: int = 20
    true_soc: float = 0.7
    soc: float = 0.5
    variance: float = 0.0225
    above: float = 0.5


VECTOR = Vector()
# Rest, discharge, rest, charge: parts of the vector, and their currents as a multiple of C.
LOADS = ((20, 0.0), (60, 1.0), (40, 0.0), (50, -0.5), (30, 0.0))
# A plan from the vector's end on: seconds, and power as a multiple of what a C rate gives at 3.7 V.
PLAN = ((300.0, 1.0), (60.0, 0.0), (600.0, 0.5), (120.0, -0.3))

BUILD = (
    "    cc -std=c99 -O2 -ffp-contract=off example.c cellwise_ekf.c cellwise_store.c cell_table.c "
    "-o example\n    ./example | diff - expected_output.txt"
)


def example_files(
    model: CellModel, tables: FixedStepTables, description: Mapping[str, Any]
) -> Iterator[tuple[str, str]]:
    """Names and texts of README, example, test vector and what the example prints."""
    inputs, outputs, *plan = vector(model, tables)
    yield "README.md", readme(description)
    yield "example.c", (firmware_folder() / "example.c").read_text(encoding="utf-8")
    yield "test_vector.h", vector_text(inputs, outputs, *plan)
    yield "expected_output.txt", expected_text(outputs)


def vector(model: CellModel, tables: FixedStepTables) -> tuple[NDArray[Any], ...]:
    """Samples of a simulated cell, and what the filter makes of them from a wrong start.

    With the remaining time in, a plan of loads and where it ends from there.
    By this machine's C where there is a compiler, else by numba: both give the same bits.
    """
    current = np.concatenate([np.full(n, rate * model.capacity_Ah) for n, rate in LOADS])
    time_s = np.arange(VECTOR.samples, dtype=np.float64) * float(tables.dt_s)
    log = CellLog(time_s, current, np.full(VECTOR.samples, 3.7))
    log = CellLog(time_s, current, simulate(model, log, VECTOR.true_soc).voltage_V)
    inputs = samples_of(model, log, tables.dt_s).records
    state = np.zeros(1, dtype=state_type(tables.options))
    try:
        stepper: Stepper = HostLibrary(tables)
    except InputError:
        stepper = numba_stepper(tables)
    stepper.begin(state, VECTOR.soc, VECTOR.variance)
    outputs = stepper.rows(state, inputs)
    if not tables.options.remaining:
        return inputs, outputs
    cell_W = 3.7 * model.capacity_Ah
    plan = np.array([(seconds, share * cell_W) for seconds, share in PLAN], dtype=PHASE)
    landing = stepper.answer("plan", PLAN_RESULT, state, plan, plan.size, True, VECTOR.above)
    return inputs, outputs, plan, landing


def vector_text(
    inputs: NDArray[Any],
    outputs: NDArray[Any],
    plan: NDArray[Any] | None = None,
    landing: NDArray[Any] | None = None,
) -> str:
    """test_vector.h: every number a hex float; without a plan its part is compiled out."""

    def lines(records: NDArray[Any] | None) -> str:
        each = () if records is None else records
        return "\n".join(f"    {initialiser(record)}," for record in each)

    marks = {
        "@SAMPLES@": str(inputs.size),
        "@SOC@": hex_float(VECTOR.soc),
        "@VARIANCE@": hex_float(float(np.float32(VECTOR.variance))),
        "@INPUTS@": lines(inputs),
        "@OUTPUTS@": lines(outputs),
        "@COUNT@": str(0 if plan is None else plan.size),
        "@ABOVE@": hex_float(VECTOR.above),
        "@PHASES@": lines(plan),
        "@PLAN_RESULT@": "{0}" if landing is None else initialiser(landing[0]),
    }
    return filled((firmware_folder() / "test_vector.h.in").read_text(encoding="utf-8"), marks)


def expected_text(outputs: NDArray[Any]) -> str:
    """What the example prints."""
    lines = [
        f"{k + 1:3d}  soc {float(out['soc']):.6f}  variance {float(out['soc_variance']):.3e}  "
        f"status {int(out['status'])}"
        for k, out in enumerate(outputs)
        if k % VECTOR.every == VECTOR.every - 1
    ]
    return "\n".join([*lines, "every bit as expected", ""])


def readme(description: Mapping[str, Any]) -> str:
    """README.md of the folder."""
    options = [k for k, v in description["options"].items() if v]
    wide = description["options"].get("wide")
    text, parking = (
        (firmware_folder() / name).read_text(encoding="utf-8")
        for name in ("EXPORT.md", "parking.md" if wide else "parking_lean.md")
    )
    noise, (shortest_s, longest_s) = description["noise"], description["dt_limits_s"]
    return Template(text).substitute(
        model=comment(str(description["model"])) or "unnamed",
        sha256=description["model_sha256"],
        dt_s=f"{description['dt_s']:g}",
        options=", ".join(options),
        soc_grid=description["soc_grid"]["text"],
        model_bytes=f"{description['model_bytes']:,}",
        state_bytes=description["state_bytes"],
        components=description["components"],
        build=BUILD,
        parking=Template(parking.strip()).substitute(gap_soc=f"{noise['gap_soc']:g}"),
        current_A=f"{noise['current_A']:.3g}",
        voltage_V=f"{noise['voltage_V']:.3g}",
        branch_share=f"{100.0 * noise['branch_share']:.3g}",
        hold_s=f"{noise['hold_s']:g}",
        shortest_s=f"{shortest_s:.2g}",
        longest_s=f"{longest_s:g}",
    )

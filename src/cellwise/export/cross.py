"""Build the exported C for a Cortex-M and run it in QEMU: its outputs, its size, its instructions.

What is counted are instructions, not cycles: QEMU with ``-icount shift=0`` lets one pass per
nanosecond, SysTick counts them, and the count repeats exactly.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.estimate.fixed_step_c import STRICT_FLAGS, firmware_folder, write_sources
from cellwise.estimate.fixed_step_layout import INPUT, OUTPUT, state_type
from cellwise.estimate.fixed_step_tables import FixedStepTables

GCC = "arm-none-eabi-gcc"
SIZE = "arm-none-eabi-size"
QEMU = "qemu-system-arm"
REPEATS = 64  # as in target_main.c
OPTIMISE = "-Os"  # smaller than -O2, and here no slower: constants are loaded less often
FINDINGS = struct.Struct("<8I")
TIMEOUT_S = 1800.0


@dataclass(frozen=True)
class Core:
    """A processor: compiler flags, the machine of QEMU, nanoseconds per tick of its SysTick."""

    name: str
    flags: tuple[str, ...]
    machine: str
    tick_ns: float


CORES = {
    core.name: core
    for core in (
        Core(
            "cortex-m4f",
            ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"),
            "mps2-an386",
            40.0,
        ),
        Core("cortex-m0plus", ("-mcpu=cortex-m0plus", "-mthumb"), "microbit", 62.5),
    )
}


@dataclass(frozen=True, eq=False)
class Cost:
    """What a step costs on a core.

    ``text_bytes`` is the code of ``cellwise_ekf.c``, ``model_bytes`` the tables in flash,
    ``ram_bytes`` static data (always 0), ``state_bytes`` what the caller holds for a cell.
    Instructions and stack come from the samples that were measured, None without.
    """

    core: str
    text_bytes: int
    ram_bytes: int
    state_bytes: int
    model_bytes: int
    stack_bytes: int | None = None
    instructions_mean: float | None = None
    instructions_most: float | None = None
    measured: int = 0


@dataclass(frozen=True, eq=False)
class TargetRun:
    """Outputs of every sample (records of OUTPUT), the final state, and what was measured."""

    outputs: NDArray[Any]
    state: NDArray[Any]
    cost: Cost


def has_tools() -> bool:
    """Whether compiler and emulator are installed."""
    return all(shutil.which(tool) for tool in (GCC, SIZE, QEMU))


def check_tools() -> None:
    """Refuse to go on without compiler and emulator.

    Raises
    ------
    InputError        one of them is missing
    """
    if not has_tools():
        raise InputError(
            f"no {GCC} or no {QEMU}",
            "a cross compiler and an emulator",
            "Install them: apt-get install --no-install-recommends gcc-arm-none-eabi "
            "libnewlib-arm-none-eabi qemu-system-arm.",
        )


def build(tables: FixedStepTables, core: Core, folder: Path, optimise: str = OPTIMISE) -> Path:
    """Compile the C of a model with the test program for a core; the path of the ELF file."""
    for name, text in write_sources(tables, "0" * 64):
        (folder / name).write_text(text, encoding="utf-8")
    port = firmware_folder() / "port"
    for path in port.iterdir():
        shutil.copy(path, folder)
    flags = [*core.flags, optimise, *STRICT_FLAGS, "-ffreestanding", "-ffunction-sections"]
    objects = []
    for source in ("cellwise_ekf", "cell_table", "target_main", "semihosting", "startup"):
        made = folder / f"{source}.o"
        extra = ["-fno-builtin"] if source == "startup" else []
        _run([GCC, *flags, *extra, "-c", str(folder / f"{source}.c"), "-o", str(made)])
        objects.append(str(made))
    elf = folder / "target.elf"
    libraries = ["-Wl,--gc-sections", "-lc", "-lgcc"]
    link = [GCC, *core.flags, "-nostartfiles", f"-T{folder / f'{core.name}.ld'}"]
    _run([*link, *objects, *libraries, "-o", str(elf)])
    return elf


def run_on_target(
    tables: FixedStepTables,
    core_name: str,
    samples: NDArray[Any],
    soc: float,
    soc_variance: float,
    *,
    measure_every: int = 0,
    optimise: str = OPTIMISE,
) -> TargetRun:
    """Step samples on an emulated core.

    Parameters
    ----------
    samples : (n,) records of INPUT
    soc, soc_variance : float      where the state starts
    measure_every : int            count instructions and stack of every so many samples; 0: none

    Raises
    ------
    InputError        no tools, or a core that is not known
    """
    check_tools()
    core = known_core(core_name)
    samples = np.ascontiguousarray(samples, dtype=INPUT)
    with tempfile.TemporaryDirectory(prefix="cellwise-") as name:
        folder = Path(name)
        elf = build(tables, core, folder, optimise)
        asked = struct.pack("<ffII", soc, soc_variance, measure_every, 0)
        (folder / "in.bin").write_bytes(asked + samples.tobytes())
        command = [QEMU, "-M", core.machine, "-nographic", "-monitor", "none", "-serial", "none"]
        command += ["-semihosting-config", "enable=on,target=native"]
        command += ["-icount", "shift=0"] if measure_every else []
        _run([*command, "-kernel", str(elf)], folder)
        data = (folder / "out.bin").read_bytes()
        text, ram = section_bytes(folder / "cellwise_ekf.o")
    kind = state_type(tables.options)
    ends = samples.size * OUTPUT.itemsize
    outputs = np.frombuffer(data[:ends], dtype=OUTPUT)
    state = np.frombuffer(data[ends : ends + kind.itemsize], dtype=kind)
    found = FINDINGS.unpack(data[ends + kind.itemsize :])
    return TargetRun(outputs, state, _cost(core, text, ram, found))


def cost_without_run(tables: FixedStepTables, core_name: str) -> Cost:
    """Sizes on a core, without counting instructions."""
    check_tools()
    with tempfile.TemporaryDirectory(prefix="cellwise-") as name:
        folder = Path(name)
        build(tables, known_core(core_name), folder)
        text, ram = section_bytes(folder / "cellwise_ekf.o")
    state = state_type(tables.options).itemsize
    return Cost(core_name, text, ram, state, tables.flash_bytes)


def known_core(name: str) -> Core:
    """A core by its name; raises InputError for another."""
    if name not in CORES:
        raise InputError(f"core '{name}'", f"one of {', '.join(CORES)}", "Choose one of them.")
    return CORES[name]


def section_bytes(path: Path) -> tuple[int, int]:
    """Code with its constants, and static data, of an object file."""
    line = _run([SIZE, str(path)]).splitlines()[1].split()
    return int(line[0]), int(line[1]) + int(line[2])


def _cost(core: Core, text: int, ram: int, found: Sequence[int]) -> Cost:
    measured, low, high, most, empty, stack, state, model = found
    if not measured:
        return Cost(core.name, text, ram, state, model)
    mean_ticks = ((high << 32) + low) / measured

    def instructions(ticks: float) -> float:
        return max(ticks - empty, 0.0) * core.tick_ns / REPEATS

    return Cost(
        core.name, text, ram, state, model, stack, instructions(mean_ticks), instructions(most),
        measured,
    )  # fmt: skip


def _run(command: list[str], folder: Path | None = None) -> str:
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"{command[0]}, which did not end within {TIMEOUT_S:g} s",
            "a run that ends",
            "Give fewer samples.",
        ) from error
    if done.returncode != 0:
        raise InputError(
            f"{command[0]}, which failed: {(done.stderr or done.stdout).strip()[:400]}",
            "a tool chain that builds and runs the exported C",
            "Check its version, and report what it says.",
        )
    return done.stdout

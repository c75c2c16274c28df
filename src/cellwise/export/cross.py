"""Build the exported C for a Cortex-M or a RISC-V and run it in QEMU: outputs, size, instructions.

What is counted are instructions, not cycles: QEMU with ``-icount shift=0`` lets one pass per
nanosecond, SysTick or minstret counts them, and the count repeats exactly.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import CELL, INPUT, OUTPUT, state_type
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export.c_tables import STRICT_FLAGS, firmware_folder, put, write_sources

Measured = Literal["step", "bank", "power", "remaining", "plan", "soh", "sketch"]
COMPONENTS = 7  # of the bank that is measured, as in target_main.c
REPEATS = 48  # as in target_main.c
OPTIMISE = "-Os"  # smaller than -O2, and here no slower: constants are loaded less often
FINDINGS = struct.Struct("<8I")
TIMEOUT_S = 1800.0


@dataclass(frozen=True)
class Core:
    """A processor: compiler flags, the machine of QEMU, nanoseconds per tick of its counter.

    ``tools`` is the prefix of compiler and binutils, ``qemu`` the emulator with its options,
    ``startup`` the source of its reset, ``script`` that of the linker.
    """

    name: str
    flags: tuple[str, ...]
    machine: str
    tick_ns: float
    script: str
    tools: str = "arm-none-eabi-"
    qemu: tuple[str, ...] = ("qemu-system-arm",)
    startup: str = "startup"
    libraries: tuple[str, ...] = ("-lc", "-lgcc")


M4_FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
M0_FLAGS = ("-mcpu=cortex-m0plus", "-mthumb")
RISC_V = ("virt", 1.0, "riscv32.ld", "riscv64-unknown-elf-",
          ("qemu-system-riscv32", "-bios", "none"), "startup_riscv", ("-lgcc",))  # fmt: skip
CORES = {
    core.name: core
    for core in (
        Core("cortex-m4f", M4_FLAGS, "mps2-an386", 40.0, "cortex-m4f.ld"),
        Core("cortex-m0plus", M0_FLAGS, "microbit", 62.5, "cortex-m0plus.ld"),
        *(
            Core(name, (f"-march={name}", f"-mabi={abi}", "-mcmodel=medany"), *RISC_V)
            for name, abi in (("rv32imac", "ilp32"), ("rv32imafc", "ilp32f"))
        ),
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
    """Outputs of every sample (records of OUTPUT), the final state, and what was measured.

    ``cells`` are the records of a pack's cells, none without a pack.
    """

    outputs: NDArray[Any]
    state: NDArray[Any]
    cost: Cost
    cells: NDArray[Any]


def has_tools(core_name: str) -> bool:
    """Whether compiler and emulator of a core are installed; an unknown core is refused."""
    core = known_core(core_name)
    tools = f"{core.tools}gcc", f"{core.tools}size", core.qemu[0]
    return all(map(shutil.which, tools))


def cores_here() -> list[str]:
    """Cores whose compiler and emulator are installed."""
    return [name for name in CORES if has_tools(name)]


def build(
    tables: FixedStepTables,
    core: Core,
    folder: Path,
    optimise: str = OPTIMISE,
    of: Measured = "step",
    cells: int = 0,
) -> Path:
    """Compile the C of a model with the test program for a core; the path of the ELF file."""
    put(write_sources(tables, "0" * 64), folder)
    port = firmware_folder() / "port"
    for path in port.iterdir():
        shutil.copy(path, folder)
    flags = [*core.flags, optimise, *STRICT_FLAGS, "-ffreestanding", "-ffunction-sections"]
    objects = []
    gcc = f"{core.tools}gcc"
    for source in ("cellwise_ekf", "cell_table", "target_main", "semihosting", core.startup):
        made = folder / f"{source}.o"
        extra = ["-fno-builtin"] if source == core.startup else []
        extra += [f"-DMEASURE_{of.upper()}"] if of != "step" else []
        extra += [f"-DMEASURE_CELLS={cells}u"] if cells else []
        _run([gcc, *flags, *extra, "-c", str(folder / f"{source}.c"), "-o", str(made)])
        objects.append(str(made))
    elf = folder / "target.elf"
    link = [gcc, *core.flags, "-nostdlib", f"-T{folder / core.script}", "-Wl,--gc-sections"]
    _run([*link, *objects, *core.libraries, "-o", str(elf)])
    return elf


def run_on_target(
    tables: FixedStepTables,
    core_name: str,
    samples: NDArray[Any],
    soc: float,
    soc_variance: float,
    *,
    measure_every: int = 0,
    measure_first: int = 0,
    optimise: str = OPTIMISE,
    of: Measured = "step",
    cells: int = 0,
) -> TargetRun:
    """Step samples on an emulated core.

    Parameters
    ----------
    samples : (n,) records of INPUT
    soc, soc_variance : float      where the state starts
    measure_every : int            count instructions and stack of every so many samples; 0: none
    measure_first : int            the first of them
    of : str                       measure the ``step``, that of a ``bank`` of COMPONENTS, the state
                                   of ``power``, the ``remaining`` time, a ``plan`` of four
                                   phases, what follows a step for the ``soh``
                                   or the ``sketch``
    cells : int                    measure a sample of a pack of so many cells; 0: of one

    Raises
    ------
    InputError        no tools, or a core that is not known
    """
    core = known_core(core_name)
    if not has_tools(core_name):
        raise InputError(
            f"no {core.tools}gcc or no {core.qemu[0]}",
            "a cross compiler and an emulator",
            "Install them: apt-get install --no-install-recommends gcc-arm-none-eabi "
            "libnewlib-arm-none-eabi qemu-system-arm; gcc-riscv64-unknown-elf qemu-system-misc for "
            "RISC-V.",
        )
    samples = np.ascontiguousarray(samples, dtype=INPUT)
    with tempfile.TemporaryDirectory(prefix="cellwise-") as name:
        folder = Path(name)
        elf = build(tables, core, folder, optimise, of, cells)
        asked = struct.pack("<ffII", soc, soc_variance, measure_every, measure_first)
        (folder / "in.bin").write_bytes(asked + samples.tobytes())
        command = [*core.qemu, *f"-M {core.machine} -nographic -monitor none -serial none".split()]
        command += ["-semihosting-config", "enable=on,target=native"]
        command += ["-icount", "shift=0"] if measure_every else []
        _run([*command, "-kernel", str(elf)], folder)
        data = (folder / "out.bin").read_bytes()
        text, ram = section_bytes(core, folder / "cellwise_ekf.o")
    kind = state_type(tables.options)
    ends = samples.size * OUTPUT.itemsize
    outputs = np.frombuffer(data[:ends], dtype=OUTPUT)
    state = np.frombuffer(data[ends : ends + kind.itemsize], dtype=kind)
    ends += kind.itemsize
    differences = np.frombuffer(data[ends : ends + cells * CELL.itemsize], dtype=CELL)
    found = FINDINGS.unpack(data[ends + differences.nbytes :])
    return TargetRun(outputs, state, _cost(core, text, ram, found), differences)


def known_core(name: str) -> Core:
    """A core by its name; raises InputError for another."""
    if name not in CORES:
        raise InputError(f"core '{name}'", f"one of {', '.join(CORES)}", "Choose one of them.")
    return CORES[name]


def section_bytes(core: Core, path: Path) -> tuple[int, int]:
    """Code with its constants, and static data, of an object file."""
    line = _run([f"{core.tools}size", str(path)]).splitlines()[1].split()
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

"""The C twin as an FMU: FMI 3.0 co-simulation of the estimator, or of the cell alone.

Source: Functional Mock-up Interface Specification 3.0, https://fmi-standard.org/docs/3.0/.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.estimate.fixed.options import Options
from cellwise.estimate.status import VOLTAGE_INVALID, VOLTAGE_LOST
from cellwise.export.c_tables import (
    STRICT_FLAGS,
    comment,
    filled,
    firmware_folder,
    put,
    write_sources,
    zipped,
)
from cellwise.export.firmware import compile_c, host_compiler, need_package
from cellwise.export.package import Export
from cellwise.files import write_atomically
from cellwise.notices import Notice

SUFFIXES = (".fmu",)
STATUS, FIRST_SET, FIRST_PARAMETER = 12, 20, 23  # value references, as in cellwise_fmu.c
CELL_STD = 1e-3  # of a cell's initial SOC, which is known: nothing follows from it


class Variable(NamedTuple):
    """A Float64 of the FMU: value reference, name, unit, meaning, and what has it.

    ``of`` is empty for both, else one of the two, or the option of the estimator that it needs.
    """

    reference: int
    name: str
    unit: str
    meaning: str
    of: str = ""

    @property
    def causality(self) -> str:
        """``input``, ``parameter`` or ``output``."""
        if self.reference < FIRST_SET:
            return "output"
        return "input" if self.reference < FIRST_PARAMETER else "parameter"


VARIABLES = (
    Variable(1, "soc", "", "state of charge, 0 to 1"),
    Variable(2, "soc_std", "", "standard deviation of soc", "estimator"),
    Variable(3, "voltage_V", "V", "terminal voltage", "cell"),
    Variable(3, "predicted_voltage_V", "V", "before the measured one was used", "estimator"),
    Variable(4, "innovation_V", "V", "measured minus predicted", "estimator"),
    Variable(5, "discharge_W", "W", "what the cell can give for the horizon", "power"),
    Variable(6, "discharge_low_W", "W", "and sustains with 95 %", "power"),
    Variable(7, "charge_W", "W", "what it can take for the horizon, without sign", "power"),
    Variable(8, "charge_low_W", "W", "and sustains with 95 %", "power"),
    Variable(9, "remaining_s", "s", "until the present power reaches the cutoff", "remaining"),
    Variable(10, "remaining_low_s", "s", "two deviations less", "remaining"),
    Variable(11, "remaining_high_s", "s", "two deviations more", "remaining"),
    Variable(20, "current_A", "A", "positive on discharge"),
    Variable(21, "temperature_C", "degC", "of the surface"),
    Variable(22, "voltage_V", "V", "measured at the terminals", "estimator"),
    Variable(23, "soc0", "", "initial SOC; a cell is at rest then"),
    Variable(24, "soc0_std", "", "standard deviation of soc0", "estimator"),
)


def variables_of(what: str, options: Options) -> list[Variable]:
    """What an importer sees, beside time and status."""
    there = {"", what}
    if what == "estimator":
        there |= {name for name in ("power", "remaining") if getattr(options, name)}
    return [v for v in VARIABLES if v.of in there]


def starts(model: CellModel, what: str) -> tuple[float, ...]:
    """Start values of inputs and parameters, from the reference FIRST_SET on."""
    half_V = float(np.interp(0.5, model.soc, model.ocv_V[0]))
    start = (1.0, CELL_STD) if what == "cell" else (0.5, 0.15)
    return 0.0, model.usual_temperature_C, half_V, *start


def check(_: str) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        no C compiler, no FMI headers (package fmpy)
    """
    host_compiler()
    need_package("fmpy")


def write(export: Export, path: str) -> tuple[list[Path], list[Notice]]:
    """Write the FMU: description, C sources, a binary for this machine; where, and what to know.

    Of the ``estimator`` current, voltage and temperature go in and SOC comes out, of the ``cell``
    current and temperature go in, voltage and SOC come out.

    Raises
    ------
    InputError        no C compiler, no FMI headers (package fmpy), a path that cannot be written
    """
    model, tables, what, description = export.model, export.tables, export.what, export.description
    name, start = identifier(model, what), starts(model, what)
    variables = variables_of(what, tables.options)
    state = json.dumps(description, sort_keys=True, default=str) + what
    outputs = sorted([v.reference for v in variables if v.causality == "output"] + [STATUS])
    sources = dict(write_sources(tables, str(description["model_sha256"]), model.name))
    sources = {k: v for k, v in sources.items() if "store" not in k}
    c_files = [*(k for k in sources if k.endswith(".c")), "cellwise_fmu.c"]
    marks = {
        "@TITLE@": quoteattr(f"cellwise {what}: {comment(model.name) or 'unnamed cell'}"),
        "@IDENTIFIER@": name,
        "@TOKEN@": hashlib.sha256(state.encode()).hexdigest(),
        "@DT_S@": repr(tables.dt_s),
        "@STOP_S@": repr(3600 * tables.dt_s),
        "@STATUS@": str(STATUS),
        "@VARIABLES@": "\n".join(variable_text(v, start) for v in variables),
        "@STRUCTURE@": "\n".join(
            f'    <{kind} valueReference="{r}"/>'
            for kind in ("Output", "InitialUnknown")
            for r in outputs
        ),
        "@FILES@": "".join(f'<SourceFile name="{file}"/>' for file in c_files),
        "@CELL@": str(int(what == "cell")),
        "@HIDDEN@": str(VOLTAGE_INVALID | VOLTAGE_LOST if what == "cell" else 0),
        "@START@": ", ".join(map(repr, start)),
    }
    made = {
        place.name: filled(place.read_text(encoding="utf-8"), marks)
        for place in sorted((firmware_folder() / "fmu").iterdir())
    }
    sources |= {k: v for k, v in made.items() if k.endswith((".c", ".h"))}
    with tempfile.TemporaryDirectory(prefix="cellwise-") as folder:
        binary = built(sources, Path(folder))
    files: dict[str, str | bytes] = {
        "modelDescription.xml": made["modelDescription.xml"],
        **{f"sources/{file}": text for file, text in sources.items()},
        "sources/buildDescription.xml": made["buildDescription.xml"],
        binary_place(name): binary,
        "extra/org.cellwise/cellwise_export.json": json.dumps(description, indent=1) + "\n",
    }
    return [write_atomically(path, zipped(files))], []


def identifier(model: CellModel, what: str) -> str:
    """Name of the binary: a name of C."""
    return re.sub(r"\W", "_", f"cellwise_{what}_{comment(model.name)}".strip("_"))


def variable_text(v: Variable, start: tuple[float, ...]) -> str:
    """A variable of modelDescription.xml."""
    more = f' unit="{v.unit}"' if v.unit else ""
    more += f' start="{start[v.reference - FIRST_SET]!r}"' if v.reference >= FIRST_SET else ""
    more += ' initial="exact"' if v.causality == "parameter" else ""
    kind = {"input": "continuous", "output": "discrete", "parameter": "fixed"}[v.causality]
    return (
        f'    <Float64 name="{v.name}" valueReference="{v.reference}" causality="{v.causality}"\n'
        f'      variability="{kind}"{more} description={quoteattr(v.meaning)}/>'
    )


def binary_place(name: str) -> str:
    """Where FMI wants the binary of this machine: binaries/x86_64-linux/NAME.so, say."""
    machine, system = platform.machine().lower(), platform.system()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    suffix = {"Windows": ".dll", "Darwin": ".dylib"}.get(system, ".so")
    return f"binaries/{machine}-{system.lower()}/{name}{suffix}"


def built(sources: Mapping[str, str], folder: Path) -> bytes:
    """Compile the sources into a shared library: its bytes.

    Raises
    ------
    InputError        no compiler, no headers, or C that does not compile
    """
    headers = f"-I{need_package('fmpy')[0]}/c-code"
    put(sources, folder)
    library = folder / "fmu.so"
    c_files = [str(folder / f) for f in sources if f.endswith(".c")]
    command = [*host_compiler(), *STRICT_FLAGS, "-s", "-shared", "-fPIC", headers]
    compile_c([*command, "-o", str(library), *c_files, "-lm"])
    return library.read_bytes()

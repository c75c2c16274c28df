"""The C twin as an FMU: FMI 3.0 co-simulation of the estimator, or of the cell alone.

Source: Functional Mock-up Interface Specification 3.0, https://fmi-standard.org/docs/3.0/.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import model_temperature_C
from cellwise.errors import InputError
from cellwise.estimate.fixed.options import Options
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.status import VOLTAGE_INVALID, VOLTAGE_LOST
from cellwise.export.c_tables import STRICT_FLAGS, comment, firmware_folder, write_sources
from cellwise.export.firmware import host_compiler
from cellwise.files import write_atomically

What = Literal["estimator", "cell"]
# Exponents of SI base units, and what is added for the base unit.
UNITS = {
    "A": 'A="1"',
    "V": 'kg="1" m="2" s="-3" A="-1"',
    "degC": 'K="1" offset="273.15"',
    "W": 'kg="1" m="2" s="-3"',
    "s": 's="1"',
}
FIRST_INPUT, FIRST_PARAMETER, STATUS = 20, 30, 12
CELL_VARIANCE = 1e-6  # of a cell's initial SOC, which is known: nothing follows from it
ADAPTER = "cellwise_fmu.c"


@dataclass(frozen=True)
class Variable:
    """A Float64 of the FMU: its number and name in C, its name, unit, meaning and start value."""

    reference: int
    key: str
    name: str
    unit: str
    meaning: str
    start: float | None = None

    @property
    def causality(self) -> str:
        """``input``, ``parameter`` or ``output``."""
        if self.reference >= FIRST_PARAMETER:
            return "parameter"
        return "input" if self.reference >= FIRST_INPUT else "output"


def variables_of(model: CellModel, what: What, options: Options) -> list[Variable]:
    """What an importer sees, beside time and status."""
    found = [
        Variable(1, "SOC", "soc", "", "state of charge, 0 to 1"),
        Variable(20, "CURRENT_A", "current_A", "A", "positive on discharge", 0.0),
    ]
    warm = model_temperature_C(model)
    warmth = Variable(21, "TEMPERATURE_C", "temperature_C", "degC", "of the surface", warm)
    if what == "cell":
        return [
            *found,
            Variable(3, "PREDICTED_V", "voltage_V", "V", "terminal voltage"),
            warmth,
            Variable(30, "SOC0", "soc0", "", "initial SOC of a cell at rest", 1.0),
        ]
    half_V = float(np.interp(0.5, model.soc, model.ocv_V[0]))
    found += [
        Variable(2, "SOC_STD", "soc_std", "", "standard deviation of soc"),
        Variable(3, "PREDICTED_V", "predicted_voltage_V", "V", "before the measured one was used"),
        Variable(4, "INNOVATION_V", "innovation_V", "V", "measured minus predicted"),
        warmth,
        Variable(22, "VOLTAGE_V", "voltage_V", "V", "measured at the terminals", half_V),
        Variable(30, "SOC0", "soc0", "", "initial SOC", 0.5),
        Variable(31, "SOC0_STD", "soc0_std", "", "standard deviation of soc0", 0.15),
    ]
    if options.power:
        held = "for the horizon of the export"
        found += [
            Variable(5, "DISCHARGE_W", "discharge_W", "W", f"what the cell can give {held}"),
            Variable(6, "DISCHARGE_LOW_W", "discharge_low_W", "W", "and sustains with 95 %"),
            Variable(7, "CHARGE_W", "charge_W", "W", f"what it can take {held}, without sign"),
            Variable(8, "CHARGE_LOW_W", "charge_low_W", "W", "and sustains with 95 %"),
        ]
    if options.remaining:
        load = "until the present power reaches the cutoff"
        found += [
            Variable(9, "REMAINING_S", "remaining_s", "s", load),
            Variable(10, "REMAINING_LOW_S", "remaining_low_s", "s", "two deviations less"),
            Variable(11, "REMAINING_HIGH_S", "remaining_high_s", "s", "two deviations more"),
        ]
    return found


def write_fmu(
    model: CellModel,
    tables: FixedStepTables,
    path: str | Path,
    description: Mapping[str, Any],
    what: What = "estimator",
) -> Path:
    """Write the FMU: description, C sources, a binary for this machine.

    Parameters
    ----------
    description : mapping     what `cellwise export` says of the tables
    what : str                ``estimator`` (current, voltage, temperature in; SOC out) or ``cell``
                              (current and temperature in; voltage and SOC out)

    Raises
    ------
    InputError        no C compiler, no FMI headers (package fmpy), a path that cannot be written
    """
    headers = header_folder()
    compiler = host_compiler()
    name = identifier(model, what)
    variables = sorted(variables_of(model, what, tables.options), key=lambda v: v.reference)
    token = hashlib.sha256(
        (json.dumps(description, sort_keys=True, default=str) + what).encode()
    ).hexdigest()
    sources = dict(write_sources(tables, str(description["model_sha256"]), model.name))
    sources = {k: v for k, v in sources.items() if "store" not in k}
    sources["fmu_variables.h"] = variables_header(variables, what, token, tables.dt_s)
    sources[ADAPTER] = (firmware_folder() / "fmu" / ADAPTER).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="cellwise-") as folder:
        binary = built(sources, Path(folder), compiler, headers)
    files: dict[str, str | bytes] = {
        "modelDescription.xml": model_description(model, variables, what, token, tables.dt_s),
        **{f"sources/{file}": text for file, text in sources.items()},
        "sources/buildDescription.xml": build_description(name, sources),
        f"binaries/{platform_tuple()}/{name}{library_suffix()}": binary,
        "extra/org.cellwise/cellwise_export.json": json.dumps(dict(description), indent=1) + "\n",
    }

    def write(place: Path) -> None:
        with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, content in files.items():
                archive.writestr(zipfile.ZipInfo(file), content, zipfile.ZIP_DEFLATED)

    return write_atomically(path, write)


def header_folder() -> Path:
    """Folder of the FMI 3.0 headers, which the package fmpy brings.

    Raises
    ------
    InputError        fmpy is missing
    """
    from importlib.util import find_spec

    found = find_spec("fmpy")
    places = list(found.submodule_search_locations or ()) if found is not None else []
    folder = Path(places[0]) / "c-code" if places else Path()
    if not (folder / "fmi3Functions.h").is_file():
        raise InputError(
            "no FMI headers in this Python",
            "the package fmpy, which brings them",
            "Install it: pip install 'cellwise[fmu]'.",
        )
    return folder


def identifier(model: CellModel, what: What) -> str:
    """Name of the binary: a name of C."""
    return re.sub(r"\W", "_", f"cellwise_{what}_{comment(model.name)}".strip("_"))


def variables_header(variables: list[Variable], what: What, token: str, dt_s: float) -> str:
    """fmu_variables.h: numbers of the variables, start values, which of the two it is."""

    def starts(first: int) -> str:
        found = [repr(v.start) for v in variables if first <= v.reference < first + 10]
        return "{" + ", ".join(found) + "}"

    outputs = [v.reference for v in variables if v.causality == "output"]
    inside = " || ".join(f"(r) == {k}u" for k in [0, *outputs])
    cell = what == "cell"
    variance = f"{CELL_VARIANCE!r}f" if cell else "(float)((p)[1] * (p)[1])"
    measured = "NAN" if cell else "(float)(in)[FMU_VOLTAGE_V - FMU_FIRST_INPUT]"
    lines = [
        "/* Written by `cellwise export`; do not edit. */",
        "#ifndef FMU_VARIABLES_H",
        "#define FMU_VARIABLES_H",
        "",
        f"#define CELLWISE_FMU_CELL {int(cell)}",
        f'#define FMU_TOKEN "{token}"',
        f"#define FMU_DT_S {dt_s!r}",
        *(f"#define FMU_{v.key} {v.reference}u" for v in variables),
        f"#define FMU_STATUS {STATUS}u",
        f"#define FMU_STATUS_NOT_SHOWN {VOLTAGE_INVALID | VOLTAGE_LOST if cell else 0}u",
        f"#define FMU_IS_OUTPUT(r) ({inside})",
        f"#define FMU_VOLTAGE_OF(in) {measured}",
        f"#define FMU_START_VARIANCE(p) {variance}",
    ]
    for key, first in (("INPUT", FIRST_INPUT), ("PARAMETER", FIRST_PARAMETER)):
        lines += [
            f"#define FMU_FIRST_{key} {first}u",
            f"#define FMU_{key}S {sum(first <= v.reference < first + 10 for v in variables)}u",
            f"#define FMU_START_{key}S {starts(first)}",
        ]
    return "\n".join([*lines, "", "#endif", ""])


def model_description(
    model: CellModel, variables: list[Variable], what: What, token: str, dt_s: float
) -> str:
    """modelDescription.xml."""
    title = f"cellwise {what}: {comment(model.name) or 'unnamed cell'}"
    said = (
        "A sample is taken every time step, with the inputs as they were set before the step; "
        "current is positive on discharge."
    )
    outputs = sorted([v.reference for v in variables if v.causality == "output"] + [STATUS])
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(title)}',
            f'  instantiationToken="{token}" description={quoteattr(said)}',
            '  generationTool="cellwise" variableNamingConvention="flat">',
            f'  <CoSimulation modelIdentifier="{identifier(model, what)}"',
            '    canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"',
            f'    canSerializeFMUState="true" fixedInternalStepSize="{dt_s!r}"/>',
            "  <UnitDefinitions>",
            *(f'    <Unit name="{u}"><BaseUnit {base}/></Unit>' for u, base in UNITS.items()),
            "  </UnitDefinitions>",
            f'  <DefaultExperiment startTime="0" stopTime="{3600 * dt_s!r}" stepSize="{dt_s!r}"/>',
            "  <ModelVariables>",
            '    <Float64 name="time" valueReference="0" causality="independent"',
            '      variability="continuous" unit="s"/>',
            *map(variable_text, variables),
            f'    <UInt32 name="status" valueReference="{STATUS}" causality="output"',
            '      variability="discrete" description="bits as in cellwise_ekf.h"/>',
            "  </ModelVariables>",
            "  <ModelStructure>",
            *(f'    <Output valueReference="{r}"/>' for r in outputs),
            *(f'    <InitialUnknown valueReference="{r}"/>' for r in outputs),
            "  </ModelStructure>",
            "</fmiModelDescription>",
            "",
        ]
    )


def variable_text(variable: Variable) -> str:
    """A variable of modelDescription.xml."""
    v = variable
    more = f' unit="{v.unit}"' if v.unit else ""
    more += "" if v.start is None else f' start="{v.start!r}"'
    more += ' initial="exact"' if v.causality == "parameter" else ""
    kind = {"input": "continuous", "output": "discrete", "parameter": "fixed"}[v.causality]
    return (
        f'    <Float64 name="{v.name}" valueReference="{v.reference}" causality="{v.causality}"\n'
        f'      variability="{kind}"{more} description={quoteattr(v.meaning)}/>'
    )


def build_description(name: str, sources: Mapping[str, str]) -> str:
    """sources/buildDescription.xml."""
    files = "".join(f'<SourceFile name="{f}"/>' for f in sources if f.endswith(".c"))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{name}">\n'
        f'    <SourceFileSet language="C99" compilerOptions="-ffp-contract=off">{files}'
        '</SourceFileSet>\n    <Library name="m" external="true"/>\n  </BuildConfiguration>\n'
        "</fmiBuildDescription>\n"
    )


def platform_tuple() -> str:
    """The machine as FMI names it, x86_64-linux say."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    return f"{machine}-{platform.system().lower()}"


def library_suffix() -> str:
    """Suffix of a shared library here."""
    return {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")


def built(sources: Mapping[str, str], folder: Path, compiler: list[str], headers: Path) -> bytes:
    """Compile the sources into a shared library: its bytes.

    Raises
    ------
    InputError        the compiler refuses
    """
    for file, text in sources.items():
        (folder / file).write_text(text, encoding="utf-8")
    library = folder / f"fmu{library_suffix()}"
    c_files = [str(folder / f) for f in sources if f.endswith(".c")]
    command = [*compiler, *STRICT_FLAGS, "-s", "-shared", "-fPIC", f"-I{headers}"]
    done = subprocess.run(
        [*command, "-o", str(library), *c_files, "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise InputError(
            f"C that {compiler[0]} does not compile: {done.stderr.strip()[:300]}",
            "a C99 compiler with IEEE 754 float",
            "Set $CC to another compiler.",
        )
    return library.read_bytes()

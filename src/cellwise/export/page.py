"""The C twin in a browser: compiled to WebAssembly, with a page about it, in one file."""

from __future__ import annotations

import base64
import html
import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.simulate import simulate
from cellwise.data import load_dataset
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import state_type
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.estimate.status import Status
from cellwise.export.c_tables import (
    STRICT_FLAGS,
    filled,
    firmware_folder,
    put,
    write_sources,
    zipped,
)
from cellwise.export.firmware import compile_c
from cellwise.export.package import Export
from cellwise.files import write_atomically
from cellwise.forecast.remaining import cutoff_of
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Notice

SUFFIXES = (".html", ".htm")
STEP_S = 1.0  # where none is stated
EXPORTED = (
    *("cellwise_init", "cellwise_rows", "cellwise_remaining"),
    *("cellwise_cell", "__heap_base"),
)
WASM_FLAGS = (
    *("--target=wasm32", "-O2", "-ffreestanding", "-nostdlib", "-mbulk-memory"),
    *("-Wl,--no-entry", "-Wl,--strip-all", *(f"-Wl,--export={name}" for name in EXPORTED)),
)


class Example(NamedTuple):
    """The page's example: noise of its voltages, SOC at its start, samples at the most."""

    noise_V: float = 0.002
    soc: float = 0.9
    samples: int = 4000


EXAMPLE = Example()


def write(export: Export, path: str) -> tuple[list[Path], list[Notice]]:
    """Write the page, with the remaining time, and the C package for who opens it.

    Raises
    ------
    InputError        no clang that compiles to WebAssembly; a path that cannot be written
    """
    cutoff_V = cutoff_of(export.model, export.asked.remaining_V)
    export = replace(
        export, dt_s=export.dt_s or STEP_S, asked=replace(export.asked, remaining_V=cutoff_V)
    )
    model, tables, description = export.model, export.tables, export.description
    package = export.files(description)
    name = model.name or "a cell"
    data = {
        "model_sha256": description["model_sha256"],
        "dt_s": tables.dt_s,
        "ocv_V": np.round(model.ocv_V[len(model.ocv_V) // 2], 6).tolist(),
        "temperature_C": model.usual_temperature_C,
        "least_load_A": float(tables.constants["remaining_least_A"][0]),
        "state_bytes": state_type(tables.options).itemsize,
        "status": {str(bit.name): int(bit) for bit in Status},
        "wasm": _text_of(compiled(tables)),
        "package": _text_of(zipped({f"cellwise/{k}": v for k, v in package.items()})),
        "package_name": f"cellwise-{tables.dt_s:g}s.zip",
        "example": _text_of(example(model, tables.dt_s)),
        "example_name": "Example: the model itself under a drive's current, with 2 mV of noise",
    }
    folder = firmware_folder() / "page"
    text = (folder / "page.html").read_text(encoding="utf-8")
    marks = {
        "@TITLE@": html.escape(name),
        "@DT@": f"{tables.dt_s:g}",
        "@CSS@": (folder / "page.css").read_text(encoding="utf-8"),
        "@JS@": (folder / "page.js").read_text(encoding="utf-8"),
        "@DATA@": json.dumps(data, allow_nan=False).replace("<", "\\u003c"),
    }
    return [write_atomically(path, filled(text, marks))], []


def check(_: str = "") -> str:
    """The clang that compiles to WebAssembly.

    Raises
    ------
    InputError        no clang, or no wasm-ld
    """
    clang = shutil.which("clang")
    if clang is None or shutil.which("wasm-ld") is None:
        raise InputError(
            f"no {'wasm-ld' if clang else 'clang'}",
            "clang and lld, which compile to WebAssembly",
            "Install them: apt-get install clang lld.",
        )
    return clang


def compiled(tables: FixedStepTables) -> bytes:
    """The C of a model as a WebAssembly module.

    Raises
    ------
    InputError        no compiler, or C that it does not compile
    """
    clang = check()
    with tempfile.TemporaryDirectory(prefix="cellwise-") as name:
        folder = Path(name)
        rows = "port/host_rows.c"
        put(write_sources(tables, "0" * 64), folder)
        put({rows: (firmware_folder() / rows).read_text(encoding="utf-8")}, folder)
        module = folder / "cellwise.wasm"
        sources = [str(folder / f) for f in ("cellwise_ekf.c", "cell_table.c", rows)]
        compile_c([clang, *STRICT_FLAGS, *WASM_FLAGS, *sources, "-o", str(module)])
        return module.read_bytes()


def example(model: CellModel, dt_s: float) -> bytes:
    """Currents of the embedded drive, scaled to the cell, and the model's voltages: float32."""
    drive = load_dataset("nmc_drive_b")
    records = samples_of(model, drive, dt_s).records[: EXAMPLE.samples]
    current = records["current_A"].astype(np.float64)
    least = max(float(np.sum(current)) * dt_s / 3600.0, 1e-3)
    current *= min(model.capacity_Ah * (EXAMPLE.soc - 0.1) / least, 3.0)
    time_s = dt_s * np.arange(current.size, dtype=np.float64)
    log = CellLog(time_s, current, np.full(current.size, float(model.ocv_V[0, -1])))
    voltage = simulate(model, log, EXAMPLE.soc).voltage_V
    voltage = voltage + np.random.default_rng(0).normal(0.0, EXAMPLE.noise_V, voltage.size)
    return np.stack([current, voltage], axis=1).astype("<f4").tobytes()


def _text_of(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")

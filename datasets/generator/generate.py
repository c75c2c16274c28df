"""Generate the embedded data: physics, tester, instrument, file, catalogue."""

from __future__ import annotations

import tomllib
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .instrument import Instrument, Recording, measure
from .physics import PhysicsCell
from .protocols import HOUR, RELAX, ROOM_C, TESTS, Test, charge_full
from .tester import Rest, VirtualTester
from .writing import sha256, write_catalogue, write_parquet

SEED = 20240725
CATALOGUE = "catalogue.toml"
HEAD = """Embedded data of cellwise, one table per file. Written by the generator; do not edit.
initial_soc is the truth of the physics model: lithium inventory between the open-circuit
voltages of the window. true_capacity_Ah is the charge between the same two states."""

Progress = Callable[[str, int, int], None]


def record(test: Test, seed: int = SEED) -> tuple[Recording, dict[str, float]]:
    """Run one test from a freshly charged cell.

    The cell starts in equilibrium at 90 %, is charged full at 25 degC, soaks in the chamber for
    three hours where that has another temperature, and only then is the recorder switched on.
    Route and noise depend on the test's name and the seed alone, so each file can be made again
    without the others.

    Returns
    -------
    Recording
    dict          initial_soc, final_soc, true_capacity_Ah
    """
    rng = np.random.default_rng([seed, zlib.crc32(test.name.encode())])
    cell = PhysicsCell(test.cell, soc=0.9, ambient_C=ROOM_C)
    tester = VirtualTester(cell, test.cell.lower_V, test.cell.upper_V)
    tester.run([*charge_full(test.cell), Rest(0.1 * HOUR, RELAX)])
    if test.ambient_C != ROOM_C:
        cell.ambient_C = test.ambient_C
        tester.run([Rest(3.0 * HOUR, RELAX)])
    tester.start_recording()
    initial = cell.soc
    tester.run(test.steps(rng))
    truth = {
        "initial_soc": round(initial, 5),
        "final_soc": round(cell.soc, 5),
        "true_capacity_Ah": round(cell.capacity_Ah, 5),
    }
    instrument = Instrument(range_A=test.range_A)
    return measure(tester.true_log(), instrument, test.cell.has_thermocouple, rng), truth


def file_of(test: Test) -> str:
    """Path of a test's file below the data folder, with forward slashes."""
    return f"{test.cell.key}/{test.name.removeprefix(test.cell.key + '_')}.parquet"


def entry(test: Test, truth: Mapping[str, float], rows: int, path: Path) -> dict[str, Any]:
    """Describe one file for the catalogue."""
    cell = test.cell
    described: dict[str, Any] = {
        "name": test.name,
        "file": file_of(test),
        "cell": cell.cell,
        "chemistry": cell.chemistry,
        "parameter_set": cell.parameter_set,
        "parameter_doi": cell.parameter_doi,
        "nominal_Ah": cell.nominal_Ah,
        "window_V": [cell.lower_V, cell.upper_V],
        "kind": test.kind,
    }
    if test.rate:
        described["rate"] = test.rate
    return described | {
        "temperature_C": test.ambient_C,
        **truth,
        "rows": rows,
        "bytes": path.stat().st_size,
        "sha256": sha256(path),
        "description": test.description,
    }


def select(only: list[str] | None) -> list[Test]:
    """Tests by name, or by cell ("nmc", "lfp"); all without a selection.

    Raises
    ------
    ValueError       where a name is unknown
    """
    if only is None:
        return list(TESTS)
    known = {test.name for test in TESTS} | {test.cell.key for test in TESTS}
    unknown = sorted(set(only) - known)
    if unknown:
        raise ValueError(f"unknown data sets {unknown}; known are {sorted(known)}")
    return [test for test in TESTS if test.name in only or test.cell.key in only]


def generate(
    out_dir: Path, only: list[str] | None = None, progress: Progress | None = None
) -> list[Path]:
    """Generate data sets and bring the catalogue beside them up to date.

    Parameters
    ----------
    out_dir : Path                  folder that gets `<cell>/<test>.parquet` and `catalogue.toml`
    only : list of str, optional    names of tests or cells
    progress : callable, optional   called with (name, done, total) before each test and at the end

    Returns
    -------
    list of Path                    the files written, in the order of the catalogue
    """
    tests = select(only)
    catalogue = out_dir / CATALOGUE
    entries = _read_entries(catalogue)
    written: list[Path] = []
    for done, test in enumerate(tests):
        if progress is not None:
            progress(test.name, done, len(tests))
        recording, truth = record(test)
        path = out_dir / file_of(test)
        write_parquet(recording, path)
        entries[test.name] = entry(test, truth, recording.time_s.size, path)
        write_catalogue(HEAD, [entries[t.name] for t in TESTS if t.name in entries], catalogue)
        written.append(path)
    if progress is not None:
        progress("done", len(tests), len(tests))
    return written


def _read_entries(catalogue: Path) -> dict[str, dict[str, Any]]:
    if not catalogue.exists():
        return {}
    tables = tomllib.loads(catalogue.read_text(encoding="utf-8")).get("dataset", [])
    return {table["name"]: table for table in tables}

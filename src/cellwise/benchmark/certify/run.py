"""Run an exported filter over a virtual fleet: on all cores, and from where a run was cut off."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.benchmark.certify.certificate import BINS, Certificate, Limits, certificate_of
from cellwise.benchmark.certify.exported import Exported
from cellwise.benchmark.certify.virtual_cells import Sensor, VirtualCell, draw_cell, usual_sensor
from cellwise.benchmark.faults import faulty_log
from cellwise.cell.protocol import run_protocol
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.files import made_folder
from cellwise.logs.cell_log import CellLog
from cellwise.threads import usable_cores
from cellwise.typing import BoolArray, FloatArray

SETTLED_S = 3600.0  # what a filter has to find its start is not scored
ROWS_FILE = "cells.jsonl"
NEAR = 0.03  # points within which a discharge ends well, the measure of gauges' makers


def certify(
    exported: Exported,
    cells: int = 200,
    hours: float = 100.0,
    *,
    sensor: Sensor | None = None,
    seed: int = 1,
    limits: Limits | None = None,
    folder: str | Path | None = None,
    follow: Callable[[int, int], None] | None = None,
) -> Certificate:
    """SOC error and coverage of the exported C over cells that vary, age and have faults.

    Parameters
    ----------
    exported : Exported
    cells, hours : int, float     cells, and hours of each
    sensor : Sensor or None       what the target's sensors are off by; None: as vehicles have them
    seed : int                    of everything drawn: the same seed gives the same certificate
    limits : Limits or None       what it is judged against; None: no verdict
    folder : path or None         finished cells are kept there, and a run goes on where it stopped
    follow : callable or None     called with how many cells are done, and of how many

    Raises
    ------
    InputError        no cell, no hour; a folder of a run with other settings
    """
    if cells < 1 or not (math.isfinite(hours) and hours > SETTLED_S / 3600.0):
        raise InputError(
            f"{cells} cells of {hours:g} h",
            "one cell at least, and more than the hour that a filter has to find its start",
            "Give e.g. `cells=200, hours=100`.",
        )
    used = usual_sensor(exported.model) if sensor is None else sensor
    settings = {
        "model_sha256": exported.description["model_sha256"],
        "dt_s": exported.dt_s,
        "options": exported.description["options"],
        "noise": exported.description["noise"],
        "hours": hours,
        "seed": seed,
        "sensor": asdict(used),
    }
    kept = _Kept(folder, settings)
    rows = {k: row for k, row in kept.rows.items() if k < cells}
    waiting = [k for k in range(cells) if k not in rows]
    with ThreadPoolExecutor(usable_cores()) as pool:
        futures = [pool.submit(run_cell, exported, k, seed, hours, used) for k in waiting]
        try:
            for future in as_completed(futures):
                row = future.result()
                rows[row["cell"]] = row
                kept.add(row)
                if follow is not None:
                    follow(len(rows), cells)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    ordered = [rows[k] for k in sorted(rows)]
    return certificate_of(ordered, settings, exported.description, limits or Limits())


def run_cell(
    exported: Exported, index: int, seed: int, hours: float, sensor: Sensor
) -> dict[str, Any]:
    """One cell's life through the C: what it was, and how wrong the filter was."""
    cell = draw_cell(exported.model, index, seed, hours, exported.dt_s, sensor)
    log, soc = true_life(cell, exported.dt_s, hours)
    rng = np.random.default_rng([seed, index, 1])
    seen = faulty_log(cell.fault, log, cell.truth.capacity_Ah, rng)
    samples = samples_of(exported.model, seen, exported.dt_s)
    outputs = exported.run(samples.records, cell.given_soc0, cell.given_std)
    error = np.asarray(outputs["soc"], dtype=np.float64)[samples.row_sample] - soc
    std = np.sqrt(np.asarray(outputs["soc_variance"], dtype=np.float64))[samples.row_sample]
    scored = log.time_s >= SETTLED_S
    ends = _ends_of_drives(log) & scored
    size = np.abs(error[scored])
    worst = int(np.argmax(np.where(scored, np.abs(error), -1.0)))
    return {
        "cell": index,
        "source": "model",
        "age": round(cell.age, 4),
        "capacity_Ah": cell.truth.capacity_Ah,
        "temperature_C": round(cell.temperature_C, 2),
        "fault": cell.fault_name,
        "soc0": cell.soc0,
        "started_at": cell.given_soc0,
        "hours": float(log.duration_s / 3600.0),
        "rows": int(scored.sum()),
        "squares": float(np.sum(size**2)),
        "inside": float(np.mean(size <= 2.0 * std[scored])),
        "worst": float(size.max()),
        "worst_h": float(log.time_s[worst] / 3600.0),
        "ends": int(ends.sum()),
        "ends_near": int(np.sum(np.abs(error[ends]) <= NEAR)),
        "counts": np.histogram(size, BINS)[0].tolist(),
    }


def true_life(cell: VirtualCell, dt_s: float, hours: float) -> tuple[CellLog, FloatArray]:
    """What an ideal instrument would log of a cell, and its true SOC, shape (n,)."""
    log = run_protocol(cell.truth, cell.steps, cell.soc0, dt_s, cell.temperature_C)
    log = log.part(0, int(np.searchsorted(log.time_s, 3600.0 * hours, side="right")))
    used = np.where(log.current_A > 0.0, 1.0, cell.truth.charge_efficiency) * log.current_A
    moved_As = np.cumsum(used * np.diff(log.time_s, prepend=log.time_s[0]))
    return log, cell.soc0 - moved_As / (3600.0 * cell.truth.capacity_Ah)


def _ends_of_drives(log: CellLog) -> BoolArray:
    """Rows at which a discharge gives way to a rest."""
    flows = log.current_A > 0.0
    idle = np.append(log.current_A[1:] == 0.0, True)
    long_ago = np.append(flows[1:], False)
    return np.asarray(flows & idle & ~long_ago)


class _Kept:
    """Rows of finished cells in a folder: a line each, the first line what they were made with."""

    def __init__(self, folder: str | Path | None, settings: dict[str, Any]) -> None:
        self.rows: dict[int, dict[str, Any]] = {}
        self._file = None if folder is None else made_folder(folder, "the certificate") / ROWS_FILE
        if self._file is None:
            return
        lines = self._file.read_text(encoding="utf-8").split("\n") if self._file.exists() else []
        whole = lines[:-1]  # what a cut-off run left of a line is done again
        if whole and json.loads(whole[0]) != settings:
            raise InputError(
                f"cells in '{folder}' of a run with other settings",
                "the export, hours, sensor and seed of that run, to go on with it",
                "Name another folder.",
            )
        for line in whole[1:]:
            row = json.loads(line)
            self.rows[row["cell"]] = row
        text = [json.dumps(settings), *(json.dumps(row) for row in self.rows.values())]
        self._file.write_text("\n".join([*text, ""]), encoding="utf-8")

    def add(self, row: dict[str, Any]) -> None:
        """One more finished cell."""
        if self._file is not None:
            with self._file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")

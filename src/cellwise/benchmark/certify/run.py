"""Run an exported filter through lives: on all cores or a cluster, from where a run was cut off."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.benchmark.certify.causes import own_causes, to_correct
from cellwise.benchmark.certify.certificate import Certificate, Limits, life_error
from cellwise.benchmark.certify.export_restarts import run_restarted
from cellwise.benchmark.certify.exported import Exported
from cellwise.benchmark.certify.gauge import Gauge
from cellwise.benchmark.certify.gauge_lives import (
    Lived,
    fleet_causes,
    is_split,
    life_events,
    live,
    scored_rows,
    without_each,
)
from cellwise.benchmark.certify.lives import (
    PHYSICS_HOURS,
    SETTLED_S,
    CertifiedLife,
    Fleet,
)
from cellwise.benchmark.certify.physics_cells import has_pybamm
from cellwise.benchmark.certify.restarts import RESTARTS, restart_loss
from cellwise.benchmark.certify.virtual_cells import START_STD
from cellwise.benchmark.row_store import KeptRows, key_of
from cellwise.benchmark.suite_logs import JudgedLog
from cellwise.errors import InputError, MachineError, not_installed
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.sensor import CAR, Sensor, assumed
from cellwise.export.patch import patched_rows, taken
from cellwise.files import made_folder
from cellwise.fleet.engine import LOCAL, connected, rows_of
from cellwise.logs.cell_log import CellLog
from cellwise.logs.writing import write_log
from cellwise.typing import BoolArray
from cellwise.wording import arg

ROWS_FILE, WORST_FOLDER = "cells.jsonl", "worst"
NEAR = 0.03  # points within which a discharge ends well, the measure of gauges' makers
PAUSE_S = 600.0  # without a load, after which a discharge has ended
PHYSICS_PART = 20  # a cell of porous electrodes beside so many of the model


def certify(
    exported: Exported | Gauge,
    cells: int = 200,
    hours: float = 100.0,
    *,
    sensor: Sensor | None = None,
    seed: int = 1,
    limits: Limits | None = None,
    physics: int | None = None,
    measured: Sequence[JudgedLog] = (),
    scheduler: str = LOCAL,
    folder: str | Path | None = None,
    keep_logs: int = 0,
    patch: bytes | None = None,
    follow: Callable[[int, int], None] | None = None,
) -> Certificate:
    """SOC error and coverage of the exported C over cells that vary, age and have faults.

    Parameters
    ----------
    exported : Exported or Gauge     a gauge restarts too, and its error is split by causes
    cells, hours : int, float     cells of the exported model, and hours of each
    sensor : Sensor or None       what the target's sensors are off by; None: what the export was
                                  made for, a car's unless it says so
    seed : int                    of everything drawn: the same seed gives the same certificate
    limits : Limits or None       what it is judged against; None: no verdict
    physics : int or None         cells of porous electrodes beside, at most 20 h each; None: one
                                  for twenty of the model, none where PyBaMM is not installed
    measured : sequence of JudgedLog     of this cell: each is run as it is and with each fault
    scheduler : str               where it runs: as for `run_fleet`
    folder : path or None         finished cells are kept there, and a run of the same settings goes
                                  on where it stopped
    keep_logs : int               what the filter saw in so many of the worst lives is written there
    patch : bytes or None         of the export: every life is run without and with it, and the
                                  limits are those of the run with it
    follow : callable or None     called with how many lives are done, and of how many

    Raises
    ------
    InputError        no cell, no hour; physics without PyBaMM; logs to keep, and no folder; a patch
                      of a gauge, or one that the export does not take
    MachineError      a life that could not be run
    """
    if cells < 1 or not (math.isfinite(hours) and hours > SETTLED_S / 3600.0):
        raise InputError(
            f"{cells} cells of {hours:g} h",
            "one cell at least, and more than the hour that a filter has to find its start",
            "Give e.g. " + arg("cells", letter="200, hours=100") + ".",
        )
    if keep_logs and folder is None:
        raise InputError("logs to keep, and no folder", "a folder for them", "Name one.")
    if patch is not None:
        check_patch(exported, patch)
    capacity_Ah = exported.model.capacity_Ah
    stated = exported.sensor if sensor is None else sensor
    used = (stated or CAR).of_cell(capacity_Ah)
    fleet = Fleet(cells, _physics(physics, cells), tuple(measured), hours, seed, used)
    settings = {
        "model_sha256": exported.description["model_sha256"],
        **{k: v for k, v in exported.description.items() if k.startswith(("gauge", "components"))},
        "dt_s": exported.dt_s,
        "options": exported.description["options"],
        "noise": exported.description["noise"],
        "hours": hours,
        "physics_hours": min(hours, PHYSICS_HOURS),
        "pybamm": version("pybamm") if fleet.physics else None,
        "measured": [[one.log.name, one.soc0, one.reference_Ah] for one in measured],
        "restarts": RESTARTS,
        "seed": seed,
        "sensor": assumed(stated, capacity_Ah),
        **({} if patch is None else {"patch_sha256": hashlib.sha256(patch).hexdigest()}),
    }
    place = None if folder is None else made_folder(folder, "the certificate")
    kept = KeptRows(place and place / ROWS_FILE)
    keys = {name: key_of([settings, name]) for name in (f"{s} {k}" for s, k in fleet.names)}
    waiting = [name for name, key in keys.items() if key not in kept.rows]
    task = LifeTask(exported, fleet, patch)
    with connected(scheduler, None) as client:
        for found in rows_of(client, task, exported.folder, waiting, 1):
            for row in found:
                _check(row)
                kept.add({keys[f"{row['source']} {row['cell']}"]: row})
                if follow is not None:
                    follow(sum(key in kept.rows for key in keys.values()), len(keys))
    rows = sorted((kept.rows[k] for k in keys.values()), key=lambda r: (r["source"], r["cell"]))
    split = None
    if isinstance(exported, Gauge):
        split = split_error(exported, sensor, seed, rows)
    certificate = Certificate(rows, settings, exported.description, limits or Limits(), split)
    if keep_logs and place is not None:
        place = made_folder(place / WORST_FOLDER, "the worst lives' logs")
        for row in certificate.worst[:keep_logs]:
            life = fleet.life(exported.model, row["source"], row["cell"], exported.dt_s)
            file = write_log(_with_truth(life), place / f"{row['source']}_{row['cell']}.csv.gz")
            row["log"] = f"{WORST_FOLDER}/{file.name}"
    return certificate


@dataclass(frozen=True, eq=False)
class LifeTask:
    """Lives of a fleet by name, as the fleet's engine wants it."""

    exported: Exported | Gauge
    fleet: Fleet
    patch: bytes | None = None

    def rows(self, folder: str, names: Sequence[str]) -> list[dict[str, Any]]:
        """A row for each life; what could not be run says why."""
        return [self._row(name) for name in names]

    def _row(self, name: str) -> dict[str, Any]:
        source, number = name.split()
        exported = self.exported
        try:
            life = self.fleet.life(exported.model, source, int(number), exported.dt_s)
            found = run_life(exported, life, self.fleet.seed, self.patch)
            if isinstance(exported, Gauge) and is_split(self.fleet, int(number)):
                found["without"] = without_each(exported, self.fleet, life)
            return found
        except Exception as error:  # whatever a solver does: said with the life's name
            return self.failed_row(exported.folder, name, f"{type(error).__name__}: {error}")

    def failed_row(self, folder: Path, name: str, reason: str) -> dict[str, Any]:
        """What stands for a life that could not be run."""
        return {"name": name, "problem": reason}


def run_life(
    exported: Exported | Gauge, life: CertifiedLife, seed: int, patch: bytes | None = None
) -> dict[str, Any]:
    """One life through the C: what it was, and how wrong the filter was.

    A row of which a gauge says nothing, or no number, counts as wrong by all there is. With a
    ``patch`` what the same life is with it, too.
    """
    if isinstance(exported, Gauge):
        said = live(exported, life, seed)
    else:
        said = lived(exported, life, seed)
    row = {
        **life.about,
        "soc0": float(life.soc[0]),
        "hours": float(life.log.duration_s / 3600.0),
        **life_figures(life, said),
        "restart_loss": said.restart_loss,
    }
    if isinstance(exported, Gauge):
        return {**row, "failure": said.problem}
    if patch is not None:
        row["patched"] = life_figures(life, stepped(exported, life, patch))
    return row


def life_figures(life: CertifiedLife, said: Lived) -> dict[str, Any]:
    """How wrong a life's SOC was."""
    log = life.log
    error = np.where(np.isfinite(said.soc), said.soc - life.soc, 1.0)
    scored = scored_rows(life) & said.on
    ends = ends_of_discharges(log) & scored
    size = np.abs(error[scored])
    std = np.where(np.isfinite(said.soc), said.std, 0.0)[scored]
    worst = int(np.argmax(np.where(scored, np.abs(error), -1.0)))
    return {
        **life_error(size),
        "inside": float(np.mean(size <= 2.0 * std)) if np.any(np.isfinite(said.std)) else math.nan,
        "worst_h": float((log.time_s[worst] - log.time_s[0]) / 3600.0),
        "ends": int(ends.sum()),
        "ends_near": int(np.sum(np.abs(error[ends]) <= NEAR)),
    }


def stepped(exported: Exported, life: CertifiedLife, patch: bytes | None = None) -> Lived:
    """What the exported C says at each row of a life, without a loss of power."""
    samples = samples_of(exported.model, life.seen, exported.dt_s)
    start = (life.about["started_at"], START_STD)
    outputs = exported.run(samples.records, *start, patch)[samples.row_sample]
    std = np.sqrt(outputs["soc_variance"].astype(np.float64))
    return Lived(outputs["soc"].astype(np.float64), std, np.ones(std.size, np.bool_), 0.0, "")


def lived(exported: Exported, life: CertifiedLife, seed: int) -> Lived:
    """What the exported C says at each row of a life; what it loses where the power is lost."""
    samples = samples_of(exported.model, life.seen, exported.dt_s)
    start = (life.about["started_at"], START_STD)
    event, on, truth = life_events(life, samples, exported.dt_s, seed)
    handed = samples.records[on]
    again, written = run_restarted(exported, handed, event[on], start, life.truth.capacity_Ah)
    lost = restart_loss(event[on], written, again["soc"] - truth[on], truth[on])
    return stepped(exported, life)._replace(restart_loss=lost)


def check_patch(exported: Exported | Gauge, patch: bytes) -> None:
    """Refuse before cells are drawn what the C would refuse.

    Raises
    ------
    InputError        a gauge, an export without health, a patch that is not of the export
    """
    if isinstance(exported, Gauge):
        raise InputError(
            "a patch of a gauge",
            "a patch of an export",
            "Leave out " + arg("patch", letter="FILE") + ".",
        )
    if not exported.stepper.tables.options.health:
        raise InputError(
            f"a patch, and '{exported.folder}' exported without health",
            "an export that takes patches",
            "Export again with " + arg("health", True) + ".",
        )
    start = exported.started(0.5, START_STD)
    block = taken(patch, exported.stepper.tables)
    patched_rows(exported.stepper, block, start, np.zeros(0, dtype=INPUT))


def split_error(
    gauge: Gauge, sensor: Sensor | None, seed: int, rows: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """A gauge's error by causes: its own on the model's cells, then those of the fleet."""
    own, error, left = own_causes(gauge, sensor, seed)
    return {
        "causes": [cause.to_dict() for cause in own],
        "to_correct": to_correct(own, error),
        "own_error": error,
        "tuning": left,
        "fleet_causes": fleet_causes(rows),
        "failures": [
            {"name": row["name"], "fault": row["fault"], "problem": row["failure"]}
            for row in rows
            if row["failure"]
        ],
    }


def _physics(asked: int | None, cells: int) -> int:
    """How many cells of porous electrodes there are."""
    if has_pybamm():
        return cells // PHYSICS_PART if asked is None else asked
    if asked:
        raise not_installed("pybamm", f"{asked} cells of porous electrodes", "PyBaMM")
    return 0


def _check(row: dict[str, Any]) -> None:
    if "problem" in row:
        raise MachineError(
            f"the life '{row['name']}' that could not be run ({row['problem']})",
            "lives that end",
            "Run again, what is done stays done; another `seed` draws other lives.",
        )


def _with_truth(life: CertifiedLife) -> CellLog:
    """What the filter saw, and beside it a counter that knows the truth."""
    return replace(life.seen, charge_Ah=(life.soc[0] - life.soc) * life.about["capacity_Ah"])


def ends_of_discharges(log: CellLog) -> BoolArray:
    """Rows after which nothing is taken for a while, or ever; a stop at a light is no end."""
    rows = np.flatnonzero(log.current_A > 0.0)
    ends = np.zeros(len(log), dtype=np.bool_)
    if rows.size:
        pauses = np.diff(log.time_s[rows], append=math.inf)
        ends[rows[pauses > PAUSE_S]] = True
    return ends

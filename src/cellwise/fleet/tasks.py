"""What has one row: a log replayed or diagnosed, all logs of a pack, of a cell over its life."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.errors import InputError, MachineError
from cellwise.estimate.estimators import Estimator, make_estimator
from cellwise.estimate.replay import Replay, replay
from cellwise.fleet.store import BY_LOG, DIAGNOSE, HISTORY, PACK, REPLAY, failure, read_prepared
from cellwise.history.ageing import ageing_history
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import verify_sign
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.reading import read_pack
from cellwise.logs.stated import Stated, in_order
from cellwise.notices import texts
from cellwise.pack.pack_estimate import estimate_pack
from cellwise.wording import joined_texts

# From where on the model does not know a log, and its sign is worth a look.
SURPRISED_SHARE = 0.02  # of the voltages that are rejected
SURPRISED_TIMES = 4.0  # the model's usual error
LEAST_USUAL_V = 2e-3  # which counts as this at least


@dataclass(frozen=True)
class LogTask:
    """How logs of a fleet are read.

    Parameters
    ----------
    model : CellModel
    soc0 : float or None      initial SOC of every log; None: found in each
    read : mapping            arguments of `read_log`
    cache : str               folder for logs that were read and checked before; empty: none
    stated : Stated or None   what is known of every log
    """

    kind: ClassVar[str] = ""
    unit: ClassVar[str] = "files"  # what has a row each
    columns: ClassVar[Mapping[str, type]] = {}

    model: CellModel
    soc0: float | None = None
    read: Mapping[str, Any] = field(default_factory=dict)
    cache: str = ""
    stated: Stated | None = None

    def settings(self) -> dict[str, Any]:
        """What must be the same when a run is resumed, as JSON values."""
        names = [f.name for f in fields(self) if f.name not in ("model", "cache", "stated")]
        said = {name: getattr(self, name) for name in names}
        if self.stated is not None:
            said["stated"] = [self.stated.temperature_C, self.stated.soc0]
        return {"kind": self.kind, **json.loads(json.dumps(said, default=str))}

    def places(self, logs: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, int]]:
        """What has a row each, with its size and time of change: here every log."""
        return dict(logs)

    def identity(self, folder: Path, name: str) -> dict[str, Any]:
        """Which log a row is of; its cell is the folder that it lies in, else its own name."""
        try:
            status = os.stat(f"{folder}/{name}")
            size, modified = status.st_size, status.st_mtime_ns
        except OSError:
            size = modified = -1
        parent, _, own_name = name.rpartition("/")
        cell = parent or own_name.partition(".")[0]
        return {"log": name, "cell": cell, "bytes": size, "modified_ns": modified, "error": None}

    def failed_row(self, folder: Path, name: str, reason: str) -> dict[str, Any]:
        """A row of one that could not be finished."""
        row = self.identity(folder, name)
        return row | {"error": reason, "failed_by": BY_LOG, "seconds": math.nan}

    def rows(self, folder: str, names: Sequence[str]) -> list[dict[str, Any]]:
        """One row for each log; one that fails is a row with its error."""
        work = self.begin()
        return [self.row(work, Path(folder), name) for name in names]

    def row(self, work: Any, folder: Path, name: str) -> dict[str, Any]:
        """The row of one."""
        began = time.perf_counter()
        row = self.identity(folder, name)
        try:
            row |= work(self.given(folder, name))
        except Exception as error:
            row |= failure(error)
        return row | {"seconds": time.perf_counter() - began}

    def given(self, folder: Path, name: str) -> Any:
        """What a row is made of: here the log."""
        log = self.log(folder / name)
        check_cells_in_series(self.model, log)
        return log

    def log(self, path: Path) -> Any:
        """A log as it was read or prepared before, with what is stated of it."""
        log = read_prepared(path, self.cache, **self.read)
        return log if self.stated is None else self.stated.applied(log)

    def begin(self) -> Any:
        """What makes columns of what is given; made once for several rows."""
        return self.columns_of

    def columns_of(self, given: Any) -> dict[str, Any]:
        """The columns of one row but those of its identity."""
        raise NotImplementedError


@dataclass(frozen=True)
class ReplayTask(LogTask):
    """SOC over each log, and how it did.

    Parameters
    ----------
    estimator : str                       a name of `ESTIMATORS`
    soc0_std : float or None              how sure ``soc0`` is
    reference_soc0 : float or None        true SOC at every log's first row
    reference_capacity_Ah : float or None     charge between SOC 1 and 0, for the error of SOC
    """

    kind: ClassVar[str] = "replay"
    columns: ClassVar[Mapping[str, type]] = REPLAY

    estimator: str = "ekf"
    soc0_std: float | None = None
    reference_soc0: float | None = None
    reference_capacity_Ah: float | None = None

    def begin(self) -> Any:
        """An estimator for some logs in a row."""
        filter_ = make_estimator(self.estimator, self.model)
        return lambda log: self._replay(filter_, log)

    def _replay(self, filter_: Estimator, log: CellLog) -> dict[str, Any]:
        found = replay(
            self.model,
            log,
            filter_,
            soc0=self.soc0,
            soc0_std=self.soc0_std,
            reference_soc0=self.reference_soc0,
            reference_capacity_Ah=self.reference_capacity_Ah,
        )
        return {**_of_log(log), **self._figures(found), "notices": _joined(texts(found.notices))}

    def _figures(self, found: Replay) -> dict[str, Any]:
        figures = found.to_dict()
        settled, estimated = figures.pop("settled"), figures.pop("parameters", None) or {}
        start = figures.pop("soc0")
        trace = found.trace
        row = {
            **figures,
            "soc0": start["value"],
            "soc0_std": start["std"],
            "soc0_how": start["how"],
            "soc_min": float(np.min(trace.soc)),
            "soc_max": float(np.max(trace.soc)),
            "settled_rmse": None if settled is None else settled["rmse"],
            "rejected_share": trace.rejected,
            "status": int(np.bitwise_or.reduce(trace.status)),
            "sign": self._sign(found, trace.rejected),
        }
        for name in ("offset_A", "capacity_Ah"):
            if name in estimated:
                stem, _, unit = name.rpartition("_")
                row[name] = estimated[name]["value"]
                row[f"{stem}_std_{unit}"] = estimated[name]["std"]
        if estimated:
            row["resistance_scale"] = estimated["resistance_scale"]["value"]
            row |= {k: estimated[k] for k in ("soh_capacity", "soh_resistance")}
        return row

    def _sign(self, found: Replay, rejected: float) -> str:
        """The sign's verdict where the filter is surprised; elsewhere the filter has shown it."""
        usual_V = max(float(np.median(self.model.error.at(self.model.soc))), LEAST_USUAL_V)
        known = found.voltage_rmse_V <= SURPRISED_TIMES * usual_V and rejected <= SURPRISED_SHARE
        return "not checked" if known else verify_sign(found.log).verdict


@dataclass(frozen=True)
class DiagnoseTask(LogTask):
    """What the model gets wrong about each log, and why.

    Parameters
    ----------
    causes : sequence of str or None      only these causes
    baseline : sequence of CellLog        logs of the same kind that are known to be good
    """

    kind: ClassVar[str] = "diagnose"
    columns: ClassVar[Mapping[str, type]] = DIAGNOSE

    causes: Sequence[str] | None = None
    baseline: Sequence[CellLog] = ()

    def settings(self) -> dict[str, Any]:
        """As of every task; of the baseline, the names."""
        return {**super().settings(), "baseline": [log.name for log in self.baseline]}

    def columns_of(self, log: CellLog) -> dict[str, Any]:
        """The diagnosis of one log."""
        from cellwise.diagnose.diagnosis import diagnose

        found = diagnose(
            self.model,
            log,
            baseline=tuple(self.baseline),
            soc0=self.soc0,
            causes=self.causes,
        ).to_dict()
        causes = found["causes"]
        row = {
            **_of_log(log),
            "sign": verify_sign(log).verdict,
            "verdict": found["verdict"],
            "causes": ",".join(c["name"] for c in causes),
            "parameters": json.dumps({k: v for c in causes for k, v in c["parameters"].items()}),
            "next_test": found["next_test"],
        }
        if causes:
            low, high = causes[-1]["gain_ci95"]
            row |= {
                "gain": causes[-1]["gain"],
                "gain_low": low,
                "gain_high": high,
                "rmse_before_V": causes[0]["holdout_rmse_before_V"],
                "rmse_after_V": causes[-1]["holdout_rmse_after_V"],
            }
        return row


@dataclass(frozen=True)
class FolderTask(LogTask):
    """Every folder that holds logs is one pack or one cell, and has one row.

    Parameters
    ----------
    pattern : str     of the file names, as `run_fleet` is given it
    """

    unit: ClassVar[str] = "folders"

    pattern: str = "*"

    def places(self, logs: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, int]]:
        """Folders of logs: all sizes together, and when the last one changed."""
        found: dict[str, tuple[int, int]] = {}
        for name, (size, changed) in logs.items():
            folder = Path(name).parent.as_posix()
            before, last = found.get(folder, (0, 0))
            found[folder] = before + size, max(last, changed)
        return found

    def identity(self, folder: Path, name: str) -> dict[str, Any]:
        """Which folder a row is of: its cell is the folder's own name."""
        states = [path.stat() for path in self.files(folder / name)]
        return {
            "log": name,
            "cell": (folder / name).resolve().name,
            "bytes": sum(s.st_size for s in states),
            "modified_ns": max((s.st_mtime_ns for s in states), default=-1),
            "error": None,
        }

    def files(self, folder: Path) -> list[Path]:
        """Logs of a folder in the order of the days in their names, else of the names."""
        found = [p for p in folder.glob(self.pattern) if p.is_file() and p.name[0] not in "._"]
        return sorted(found, key=in_order)

    def given(self, folder: Path, name: str) -> tuple[dict[str, Any], list[Any]]:
        """Columns of every folder, and its logs in the order of time.

        Raises
        ------
        InputError        none of them can be read
        MachineError      the machine failed to read one
        """
        logs, unread = [], []
        for path in self.files(folder / name):
            try:
                logs.append(self.log(path))
            except MachineError:
                raise  # none of the log: the folder is tried again
            except InputError as error:
                unread.append(f"{path.name}: " + error.text)
        if not logs:
            raise InputError(
                f"{len(unread)} file(s), none of them a log that can be read (the first: "
                + unread[0]
                + ")",
                "logs of one pack or cell",
                "Check how they are read.",
            )
        samples = sum(len(log) for log in logs)
        return {"logs": len(logs), "samples": samples, "unread": _joined(unread)}, logs


@dataclass(frozen=True)
class PackTask(FolderTask):
    """Every cell of each pack after all its logs; ``read`` holds arguments of `read_pack`."""

    kind: ClassVar[str] = "pack"
    columns: ClassVar[Mapping[str, type]] = PACK

    def log(self, path: Path) -> PackLog:
        """A log with a voltage for each cell."""
        return read_pack(path, **self.read)

    def columns_of(self, given: tuple[dict[str, Any], list[PackLog]]) -> dict[str, Any]:
        """The estimate of one pack."""
        row, logs = given
        found = estimate_pack(self.model, logs).to_dict()
        capacity = np.array([cell["capacity_Ah"] for cell in found["per_cell"]])
        std = np.array([cell["capacity_std_Ah"] for cell in found["per_cell"]])
        scale = np.array([cell["resistance_scale"] for cell in found["per_cell"]])
        causes = dict.fromkeys(f"{c['cell']} {c['name']}" for c in found["causes"])
        return {
            **row,
            "cells": found["cells"],
            **{f"soc_{k}": v for k, v in found["soc"].items()},
            "capacity_min_Ah": float(np.nanmin(capacity)),
            "capacity_mean_Ah": float(np.nanmean(capacity)),
            "capacity_std_Ah": float(np.nanmedian(std)),
            "resistance_max": float(np.nanmax(scale)),
            **{k: found[k] for k in ("usable_Ah", "usable_Wh", "left_Ah", "balancing_gain_Ah")},
            **{f"weakest_{k}": v for k, v in found["weakest"].items()},
            "weak": ", ".join(found["weak"]) or None,
            "causes": ", ".join(causes) or None,
            "voltage_rmse_V": found["logs"][-1]["mean_voltage_rmse_V"],
            "notices": _joined(found["notices"]),
        }


@dataclass(frozen=True)
class HistoryTask(FolderTask):
    """Capacity and resistance of each cell over all its logs; the model is that of the new cell."""

    kind: ClassVar[str] = "history"
    columns: ClassVar[Mapping[str, type]] = HISTORY

    def columns_of(self, given: tuple[dict[str, Any], list[CellLog]]) -> dict[str, Any]:
        """The life of one cell."""
        row, logs = given
        found = ageing_history(self.model, logs).to_dict()
        days = [one["start"] for one in found["logs"] if one["start"] is not None]
        trend = found["trend"]
        of_logs = (n for one in found["logs"] for n in one["notices"])
        notices = dict.fromkeys((*found["notices"], *of_logs))
        return {
            **row,
            "first_day": days[0] if days else None,
            "last_day": days[-1] if days else None,
            "throughput_Ah": sum(one["throughput_Ah"] for one in found["logs"]),
            "capacity_share": trend["capacity_share"][-1],
            **trend["use"],
            "knee": trend["knee"],
            "next_reference": trend["next_reference"],
            "notices": _joined(notices),
        }


def _of_log(log: CellLog) -> dict[str, Any]:
    return {
        "samples": len(log),
        "duration_s": log.duration_s,
        "gaps": int(np.count_nonzero(log.gap_rows)),
        "format": log.format,
        "notices": _joined(texts(log.notices)),
    }


def _joined(texts: Iterable[str]) -> str | None:
    """Texts of a cell of the table; None where there are none."""
    return joined_texts(texts) or None

"""What is done with all logs of a folder: one pack's or one cell's, in order, to one row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cellwise.errors import InputError, MachineError
from cellwise.fleet.store import HISTORY, PACK
from cellwise.fleet.tasks import LogTask
from cellwise.history.life import life_of
from cellwise.logs.cell_log import CellLog
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.packs.pack_reading import read_pack
from cellwise.logs.stated import in_order
from cellwise.pack.pack_estimate import estimate_pack


@dataclass(frozen=True)
class Files:
    """Logs of one folder in the order of time, those that could not be read, and why."""

    logs: tuple[Any, ...]
    unread: tuple[str, ...]

    def row(self) -> dict[str, Any]:
        """Columns of every folder."""
        return {
            "logs": len(self.logs),
            "samples": sum(len(log) for log in self.logs),
            "unread": "; ".join(self.unread) or None,
        }


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

    def given(self, folder: Path, name: str) -> Files:
        """All logs of a folder.

        Raises
        ------
        InputError        none of them can be read
        MachineError      the machine failed to read one
        """
        logs, unread = [], []
        for path in self.files(folder / name):
            try:
                logs.append(self.one(path))
            except MachineError:
                raise  # none of the log: the folder is tried again
            except InputError as error:
                unread.append(f"{path.name}: {error}")
        if not logs:
            raise InputError(
                f"{len(unread)} file(s), none of them a log that can be read (the first: "
                f"{unread[0].rstrip('.')})",
                "logs of one pack or cell",
                "Check how they are read.",
            )
        return Files(tuple(logs), tuple(unread))

    def one(self, path: Path) -> CellLog | PackLog:
        """One log of the folder."""
        return self.log(path)


@dataclass(frozen=True)
class PackTask(FolderTask):
    """Every cell of each pack after all its logs; ``read`` holds arguments of `read_pack`."""

    kind: ClassVar[str] = "pack"
    columns: ClassVar[Mapping[str, type]] = PACK

    read: Mapping[str, Any] = field(default_factory=dict)

    def one(self, path: Path) -> PackLog:
        """A log with a voltage for each cell."""
        return read_pack(path, **self.read)

    def begin(self) -> Callable[[Files], dict[str, Any]]:
        """The estimate of one pack."""
        return self._estimate

    def _estimate(self, files: Files) -> dict[str, Any]:
        estimate = estimate_pack(self.model, files.logs)
        found = estimate.to_dict()
        capacity = np.array([cell["capacity_Ah"] for cell in found["per_cell"]])
        std = np.array([cell["capacity_std_Ah"] for cell in found["per_cell"]])
        scale = np.array([cell["resistance_scale"] for cell in found["per_cell"]])
        causes = dict.fromkeys(f"{c['cell']} {c['name']}" for c in found["causes"])
        return {
            **files.row(),
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
            "notices": "; ".join(found["notices"]) or None,
        }


@dataclass(frozen=True)
class HistoryTask(FolderTask):
    """Capacity and resistance of each cell over all its logs; the model is that of the new cell."""

    kind: ClassVar[str] = "history"
    columns: ClassVar[Mapping[str, type]] = HISTORY

    def begin(self) -> Callable[[Files], dict[str, Any]]:
        """The life of one cell."""
        return self._life

    def _life(self, files: Files) -> dict[str, Any]:
        life = life_of(self.model, files.logs)
        found = life.to_dict()
        days = [one["start"] for one in found["logs"] if one["start"] is not None]
        trend = found["trend"]
        of_logs = (n for one in found["logs"] for n in one["notices"])
        notices = dict.fromkeys((*found["notices"], *of_logs))
        return {
            **files.row(),
            "first_day": days[0] if days else None,
            "last_day": days[-1] if days else None,
            "throughput_Ah": sum(one["throughput_Ah"] for one in found["logs"]),
            "capacity_share": trend["capacity_share"][-1],
            **trend["use"],
            "knee": trend["knee"],
            "next_reference": trend["next_reference"],
            "notices": "; ".join(notices) or None,
        }

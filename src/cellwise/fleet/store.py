"""What a fleet keeps on disk: result columns, parts of parquet, and logs that were read before."""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import InputError, MachineError
from cellwise.files import made_folder, write_atomically
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.logs.writing import read_rows, write_rows

BY_LOG, BY_MACHINE, BY_US = "log", "machine", "cellwise"  # whose fault a failure is

# Which log this is, and whether it is done; `log` is the path below the fleet's folder.
IDENTITY: Mapping[str, type] = {
    "log": str,
    "cell": str,
    "bytes": int,
    "modified_ns": int,
    "error": str,
    "failed_by": str,
    "seconds": float,
}
LOG: Mapping[str, type] = {
    "samples": int,
    "duration_s": float,
    "gaps": int,
    "format": str,
    "sign": str,
    "notices": str,
}
REPLAY: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    "estimator": str,
    "soc0": float,
    "soc0_std": float,
    "soc0_how": str,
    "soc_final": float,
    "soc_final_std": float,
    "soc_min": float,
    "soc_max": float,
    "soc_rmse": float,
    "soc_mae": float,
    "soc_max_error": float,
    "convergence_s": float,
    "settled_rmse": float,
    "coverage_2sigma": float,
    "nis_mean": float,
    "voltage_rmse_V": float,
    "rejected_share": float,
    "status": int,
    "ns_per_step": float,
    "offset_A": float,
    "offset_std_A": float,
    "capacity_Ah": float,
    "capacity_std_Ah": float,
    "resistance_scale": float,
    "soh_capacity": float,
    "soh_resistance": float,
}
DIAGNOSE: Mapping[str, type] = {
    **IDENTITY,
    **LOG,
    "verdict": str,
    "causes": str,
    "parameters": str,
    "gain": float,
    "gain_low": float,
    "gain_high": float,
    "rmse_before_V": float,
    "rmse_after_V": float,
    "next_test": str,
}
# Of a folder of logs: one pack's or one cell's, in order.
FOLDER: Mapping[str, type] = {
    **IDENTITY,
    "logs": int,
    "samples": int,
    "unread": str,
    "notices": str,
}
PACK: Mapping[str, type] = {
    **FOLDER,
    "cells": int,
    "soc_min": float,
    "soc_mean": float,
    "soc_max": float,
    "capacity_min_Ah": float,
    "capacity_mean_Ah": float,
    "capacity_std_Ah": float,
    "resistance_max": float,
    "usable_Ah": float,
    "usable_Wh": float,
    "left_Ah": float,
    "balancing_gain_Ah": float,
    "weakest_by_soc": str,
    "weakest_by_capacity": str,
    "weakest_by_resistance": str,
    "weak": str,
    "causes": str,
    "voltage_rmse_V": float,
}
HISTORY: Mapping[str, type] = {
    **FOLDER,
    "first_day": str,
    "last_day": str,
    "throughput_Ah": float,
    "capacity_share": float,
    "capacity_Ah": float,
    "capacity_std_Ah": float,
    "resistance_scale": float,
    "resistance_std": float,
    "knee": str,
    "next_reference": str,
}


VERSION = 3
CHANNELS = ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah")
HEAD = struct.Struct("<8sQ")
MAGIC = b"cellwise"
MAPPED_FROM = 250_000  # bytes; above, a map of the system's own copy is quicker than another


def read_prepared(path: Path, cache: str | Path = "", **options: Any) -> CellLog:
    """`read_log` of a file, from the cache if it is there and the file is the same.

    Parameters
    ----------
    path : Path
    cache : str or Path     folder of prepared logs; empty: none
    options                 of `read_log`; without a cache the sign is not checked, for the
                            sake of speed

    Returns
    -------
    CellLog                 without the tester's steps

    Raises
    ------
    InputError              as `read_log`
    """
    if not cache:
        return read_log(path, check_sign=False, **options)
    place = Path(cache) / f"{_key(path, options)}.log"
    if place.is_file():
        found = _load(place, path)
        if found is not None:
            return found
    log = replace(read_log(path, **options), step=None)
    try:
        made_folder(cache)
        write_atomically(place, lambda target: _store(log, target))
    except MachineError as error:
        # What is wrong with the cache is not wrong with the log.
        return log.with_notices((*log.notices, f"not kept in the cache: {error.found}"))
    return log


def _key(path: Path, options: dict[str, Any]) -> str:
    """A name that changes with the file, and with how it is read."""
    try:
        status = os.stat(path)
    except OSError:
        return "none"
    what = [
        VERSION,
        os.path.abspath(path),
        status.st_size,
        status.st_mtime_ns,
        sorted(options.items()),
    ]
    return hashlib.sha256(json.dumps(what, default=str).encode()).hexdigest()[:24]


def _store(log: CellLog, target: Path) -> None:
    """Length of a description, the description, then the channels one after another."""
    names = [f for f in CHANNELS if getattr(log, f) is not None]
    fields = {
        "name": log.name,
        "format": log.format,
        "current_meaning": log.current_meaning,
        "notices": log.notices,
        "rows": len(log),
        "gap_rows": np.flatnonzero(log.gap_rows).tolist(),
        "typical_voltage_V": log.typical_voltage_V,
        "channels": names,
    }
    text = json.dumps(fields).encode()
    text += b" " * (-(len(text) + HEAD.size) % 8)  # the channels begin at a multiple of 8
    with target.open("wb") as file:
        file.write(HEAD.pack(MAGIC, len(text)) + text)
        for name in names:
            file.write(np.ascontiguousarray(getattr(log, name), dtype="<f8").tobytes())


def _load(place: Path, path: Path) -> CellLog | None:
    """The log as it was kept; None for a file that is not whole."""
    try:
        data = _content(place)
        magic, length = HEAD.unpack_from(data)
        if magic != MAGIC:
            return None
        fields = json.loads(bytes(data[HEAD.size : HEAD.size + length]))
        rows, names = int(fields.pop("rows")), fields.pop("channels")
        gap_rows = np.zeros(rows, dtype=np.bool_)
        gap_rows[fields.pop("gap_rows")] = True
        typical_V = float(fields.pop("typical_voltage_V"))
        start, size = HEAD.size + length, 8 * rows
        if len(data) != start + size * len(names):
            return None
        channels = {
            name: np.frombuffer(data, "<f8", rows, start + k * size) for k, name in enumerate(names)
        }
        fields["notices"] = tuple(fields["notices"])
        log = CellLog.checked_before(**channels, source=str(path), **fields)
        # What `cached_property` would look for again.
        vars(log).update(gap_rows=gap_rows, typical_voltage_V=typical_V)
        return log
    except (OSError, IndexError, KeyError, TypeError, ValueError, struct.error):
        return None


def _content(place: Path) -> bytes | mmap.mmap:
    """A small file read; a larger one mapped, which is quicker and needs no memory."""
    with place.open("rb", buffering=0) as file:
        if os.fstat(file.fileno()).st_size < MAPPED_FROM:
            return file.read()
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


MANIFEST = "_fleet.json"
PART = "part-{:06d}.parquet"


def all_rows(place: Path) -> dict[str, list[Any]]:
    """The rows of all parts of a folder of results, column by column."""
    rows: dict[str, list[Any]] = {}
    for part in sorted(place.glob("part-[0-9]*.parquet")):
        for name, values in read_rows(part).items():
            rows.setdefault(name, []).extend(values)
    return rows


class ResultFolder:
    """Parts appear whole or not at all, so whatever ends a run leaves only finished rows.

    Parameters
    ----------
    place : Path
    columns : mapping       name to type, the same in every part
    settings : mapping      JSON values that must be the same when a run goes on
    fresh : bool            start again: drop the parts of another run

    Raises
    ------
    InputError              a folder of something else, or of a run with other settings; a place
                            that cannot be written to
    """

    def __init__(
        self,
        place: Path,
        columns: Mapping[str, type],
        settings: Mapping[str, Any],
        *,
        fresh: bool = False,
    ) -> None:
        self.place = place
        self._columns = columns
        self._settings = dict(settings)
        self._check(fresh)
        self._next = 0

    def begin(self) -> None:
        """Make the folder, if it is not there."""
        made_folder(self.place, "the results")
        text = json.dumps(self._settings, indent=1, sort_keys=True)
        write_atomically(self.place / MANIFEST, text)
        self._next = 1 + max((int(p.stem[5:]) for p in self.parts()), default=-1)

    def parts(self) -> list[Path]:
        """The parts that are there."""
        return sorted(self.place.glob("part-[0-9]*.parquet"))

    def done(
        self, still: Mapping[str, tuple[int, int]], *, retry_failed: bool = False
    ) -> tuple[set[str], set[str]]:
        """Logs that have their row, and those of them whose row is an error.

        Rows of logs that have changed since are dropped, and those of which the machine failed.

        Parameters
        ----------
        still : mapping         log to its size and time of change now
        retry_failed : bool     drop the rows with an error too
        """
        found: set[str] = set()
        wrong: set[str] = set()
        for part in self.parts():
            rows = read_rows(part)
            by = rows.setdefault("failed_by", [None] * len(rows["log"]))
            keys = zip(rows["log"], rows["bytes"], rows["modified_ns"], strict=True)
            keep = [
                still.get(log) in (None, (size, changed))
                and not (retry_failed and error)
                and whose != BY_MACHINE
                for (log, size, changed), error, whose in zip(keys, rows["error"], by, strict=True)
            ]
            kept = {name: [v for v, k in zip(values, keep, strict=True) if k]
                    for name, values in rows.items()}  # fmt: skip
            found.update(kept["log"])
            wrong.update(
                log for log, error in zip(kept["log"], kept["error"], strict=True) if error
            )
            if not kept["log"]:
                part.unlink()
            elif not all(keep):
                write_rows(kept, self._columns, part)
        return found, wrong & set(still)

    def drop(self) -> None:
        """Take away what a run has written, and the folder if nothing else is in it."""
        for path in (*self.parts(), self.place / MANIFEST):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.place.rmdir()

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """One more part."""
        rows = list(rows)
        if not rows:
            return
        table = {name: [row.get(name) for row in rows] for name in self._columns}
        write_rows(table, self._columns, self.place / PART.format(self._next))
        self._next += 1

    def _check(self, fresh: bool) -> None:
        place = self.place
        if place.exists() and not place.is_dir():
            raise InputError(f"a file at '{place}'", "a folder", "Name another one.")
        if not place.is_dir() or not any(place.iterdir()):
            return
        manifest = place / MANIFEST
        if not manifest.is_file():
            raise InputError(
                f"a folder '{place}' that holds something else",
                "an empty folder, or one that this command wrote",
                "Name another one.",
            )
        if fresh:
            for part in self.parts():
                part.unlink()
            return
        try:
            before = json.loads(manifest.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            before = {}
        if before != self._settings:
            wrong = [k for k in self._settings if before.get(k) != self._settings[k]]
            raise InputError(
                f"results in '{place}' of a run with another {', '.join(wrong) or 'setting'}",
                "the settings of that run, to go on with it",
                "Start again with `fresh=True`, or name another folder.",
            )

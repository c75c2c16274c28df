"""Logs that were read and checked before: arrays as they lie in memory, not parsed.

Reading a log, checking its units, counter and sign takes longer than a filter over it. Whoever goes
through the same logs again and again, with another model or filter, need not do it again.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.errors import MachineError
from cellwise.files import made_folder, write_atomically
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log

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

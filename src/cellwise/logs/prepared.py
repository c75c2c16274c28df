"""Logs that were read and checked before: arrays in a file that is mapped, not parsed.

Reading a log, checking its units, counter and sign takes longer than a filter over it. Whoever goes
through the same logs again and again, with another model or filter, need not do it again.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.files import write_atomically
from cellwise.logs.arrow_arrays import from_numpy, to_numpy
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log

VERSION = 1
CHANNELS = ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah")
NOTE = b"cellwise"


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
    InputError              as `read_log`; a cache that cannot be written to
    """
    if not cache:
        return read_log(path, check_sign=False, **options)
    place = Path(cache) / f"{_key(path, options)}.arrow"
    if place.is_file():
        found = _load(place, path)
        if found is not None:
            return found
    log = read_log(path, **options)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"'{cache}', which cannot be made ({error.strerror})", "a folder", "Choose another."
        ) from None
    write_atomically(place, lambda target: _store(log, target))
    return replace(log, step=None)


def _key(path: Path, options: dict[str, Any]) -> str:
    """A name that changes with the file, and with how it is read."""
    try:
        told = path.stat()
    except OSError:
        return "none"
    what = [VERSION, str(path.resolve()), told.st_size, told.st_mtime_ns, sorted(options.items())]
    return hashlib.sha256(json.dumps(what, default=str).encode()).hexdigest()[:24]


def _store(log: CellLog, target: Path) -> None:
    import pyarrow as pa

    told = {
        "name": log.name,
        "format": log.format,
        "current_meaning": log.current_meaning,
        "notices": log.notices,
    }
    fields = [f for f in CHANNELS if getattr(log, f) is not None]
    arrays = [from_numpy(getattr(log, f)) for f in fields]
    schema = pa.schema([(f, pa.float64()) for f in fields], {NOTE: json.dumps(told).encode()})
    with pa.OSFile(str(target), "wb") as file, pa.ipc.new_file(file, schema) as writer:
        writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema))


def _load(place: Path, path: Path) -> CellLog | None:
    """The log, its arrays mapped from the file; None for a file that is not whole."""
    import pyarrow as pa

    try:
        with pa.memory_map(str(place)) as file:
            reader = pa.ipc.open_file(file)
            told = json.loads(reader.schema.metadata[NOTE])
            batch = reader.get_batch(0)
        channels: dict[str, Any] = {
            name: to_numpy(batch.column(name)) for name in batch.schema.names
        }
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError):
        return None
    told["notices"] = tuple(told["notices"])
    return CellLog(**channels, source=str(path), **told)

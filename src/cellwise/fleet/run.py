"""A folder of logs to a folder of results."""

from __future__ import annotations

import stat
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.cell.model_file import model_mark
from cellwise.errors import InputError
from cellwise.fleet.engine import LOCAL, WORKER_DIED, connected, rows_of
from cellwise.fleet.store import BY_LOG, BY_MACHINE, ResultFolder
from cellwise.fleet.tasks import LogTask
from cellwise.threads import usable_cores


class Portions(NamedTuple):
    """How a run is cut: what is lost with a worker, and what is written at once.

    No more than ``most`` logs a batch, ``batches`` for each worker, so that all end together; a
    part of the results from so many ``rows`` or seconds on.
    """

    most: int = 32
    batches: int = 16
    rows: int = 2_000
    part_s: float = 10.0


PORTIONS = Portions()

# Called with the logs done, those that failed, and all there are.
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class FleetResult:
    """What a run did.

    ``logs`` counts what has a row each: logs, or folders of them. ``resumed`` of them had their row
    before; ``failed`` of all have one with an error, of which ``machine`` are to be tried again:
    the machine failed, not the log.
    """

    folder: Path
    logs: int
    resumed: int
    done: int
    failed: int
    machine: int
    samples: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON values, keys as the command prints them."""
        rate = self.samples / self.seconds if self.seconds > 0 else None
        return {**vars(self), "folder": str(self.folder), "samples_per_s": rate}


def run_fleet(
    task: LogTask,
    folder: Path | str,
    out: Path | str,
    *,
    scheduler: str = LOCAL,
    workers: int | None = None,
    pattern: str = "*",
    batch: int | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    progress: Progress | None = None,
) -> FleetResult:
    """Do the same with every log of a folder, one row for each, into a folder of parquet parts.

    Parameters
    ----------
    task : LogTask            what is done
    folder : path             searched with its subfolders; a worker must see it at the same path
    out : path                folder of the results; a run that was interrupted goes on there
    scheduler : str           ``local`` (threads of this process), ``processes``, or an address
    workers : int or None     of the first two; None: one for each core
    pattern : str             of the file names
    batch : int or None       logs that are sent together; None: by their number
    fresh : bool              start again
    retry_failed : bool       do the logs again that have a row with an error
    progress : callable       called with the logs done, those that failed, and all

    Raises
    ------
    InputError                no folder, no logs in it, none that can be read; results of other
                              settings; no scheduler
    """
    began = time.perf_counter()
    place, target = Path(folder), Path(out)
    if (batch is not None and batch < 1) or (workers is not None and workers < 1):
        raise InputError(f"batch {batch}, workers {workers}", "numbers from 1 up", "Correct them.")
    there = task.places(find_logs(place, pattern, target))
    settings = {**task.settings(), "model": model_mark(task.model)}
    store = ResultFolder(target, task.columns, settings, fresh=fresh)
    store.begin()
    ready, wrong_before = store.done(there, retry_failed=retry_failed)
    names = [name for name in there if name not in ready]
    together = batch or min(
        max(len(names) // (PORTIONS.batches * (workers or usable_cores())), 1), PORTIONS.most
    )
    done = samples = machine = 0
    failed = len(wrong_before)
    refusals: list[str] = []
    kept: list[dict[str, Any]] = []
    written_s = time.monotonic()
    if names:
        with connected(scheduler, workers) as client:
            try:
                for rows in rows_of(client, task, place.resolve(), names, together):
                    kept += rows
                    done += len(rows)
                    failed += sum(row["error"] is not None for row in rows)
                    machine += sum(row.get("failed_by") == BY_MACHINE for row in rows)
                    samples += sum(row.get("samples") or 0 for row in rows)
                    refusals += refused(rows)
                    if progress is not None:
                        progress(len(ready) + done, failed, len(there))
                    if (
                        len(kept) >= PORTIONS.rows
                        or time.monotonic() - written_s >= PORTIONS.part_s
                    ):
                        store.add(kept)
                        kept, written_s = [], time.monotonic()
            finally:
                store.add(kept)
    if len(refusals) == len(there):
        store.drop()
        raise InputError(
            f"none of the {len(there)} {task.unit} of '{place}' with a log that can be read (the "
            f"first: {refusals[0].rstrip('.')})",
            "a folder with logs in it",
            "Check the folder, `pattern=...`, and how the logs are read.",
        )
    seconds = time.perf_counter() - began
    resumed = len(there) - len(names)
    return FleetResult(target, len(there), resumed, done, failed, machine, samples, seconds)


def refused(rows: list[dict[str, Any]]) -> list[str]:
    """Errors of the logs that were refused, not of those that something of ours broke on."""
    return [
        row["error"]
        for row in rows
        if row.get("failed_by") == BY_LOG and not row["error"].startswith(WORKER_DIED)
    ]


def find_logs(folder: Path, pattern: str, out: Path) -> dict[str, tuple[int, int]]:
    """Path below the folder, size and time of change of every file, in order of the paths.

    Raises
    ------
    InputError        no folder, or no such file in it
    """
    if not folder.is_dir():
        raise InputError(f"no folder '{folder}'", "a folder of logs", "Check the path.")
    own = out.resolve()
    found = {}
    outside: dict[Path, bool] = {}  # a folder that is neither hidden nor the results'
    for path in sorted(folder.rglob(pattern)):
        place = path.parent
        if place not in outside:
            hidden = any(map(_is_hidden, place.relative_to(folder).parts))
            inside = place.resolve()
            outside[place] = not hidden and own != inside and own not in inside.parents
        if not outside[place] or _is_hidden(path.name):
            continue
        try:
            status = path.stat()
        except OSError:  # a link to nothing
            continue
        if stat.S_ISREG(status.st_mode):
            found[path.relative_to(folder).as_posix()] = (status.st_size, status.st_mtime_ns)
    if not found:
        raise InputError(
            f"no file '{pattern}' in '{folder}'",
            "logs",
            "Check the folder and `pattern=...`.",
        )
    return found


def _is_hidden(name: str) -> bool:
    return name.startswith((".", "_"))

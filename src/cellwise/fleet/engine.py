"""A folder of logs to a folder of results, in batches.

On Dask: in this process, in processes of this machine, or on a cluster.
"""

from __future__ import annotations

import pickle
import stat
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from cellwise.cell.model_file import model_mark
from cellwise.errors import InputError, MachineError, not_installed
from cellwise.fleet.store import BY_LOG, BY_MACHINE, ResultFolder
from cellwise.fleet.tasks import LogTask
from cellwise.threads import usable_cores
from cellwise.wording import arg

LOCAL, PROCESSES = "local", "processes"
WORKER_DIED = "the worker died"


class Patience(NamedTuple):
    """How long is waited for workers, and how many batches are in hand at a time.

    Every ``poll_s`` for what ends without a call back; after ``without_s`` without any worker,
    asked for each ``ask_s``, the run ends.
    """

    poll_s: float = 0.25
    ask_s: float = 2.0
    without_s: float = 300.0
    in_hand: int = 256


PATIENCE = Patience()

# Dask gives a worker up for good that is not there so long after it died, although its nanny is
# just starting it again: one that dies again and again is then missed by chance. We wait ourselves.
PATIENT = {"distributed.deploy.lost-worker-timeout": "1 day"}

Rows = list[dict[str, Any]]


class Task(Protocol):
    """What is done with one name: a log, a cell."""

    def rows(self, folder: str, names: Sequence[str], /) -> Rows:
        """A row for each name."""

    def failed_row(self, folder: Path, name: str, reason: str, /) -> dict[str, Any]:
        """What stands for one that has cost several workers their life."""


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ModuleNotFoundError:
        raise not_installed("distributed", "a fleet", "dask.distributed") from None


class Cluster(NamedTuple):
    """Where work is done: how it is handed over, and how many workers are there now.

    Threads of this process have no count: a scheduler would cost a third of what the kernels take.
    """

    submit: Callable[..., Any]
    workers: Callable[[], int] | None = None


def _of(client: Any) -> Cluster:
    def workers() -> int:
        return len(client.scheduler_info()["workers"])

    return Cluster(partial(client.submit, pure=False), workers)


@contextmanager
def connected(scheduler: str, workers: int | None) -> Iterator[Cluster]:
    """Workers: threads, processes, or those of a scheduler of Dask.

    Parameters
    ----------
    scheduler : str         ``local``: threads of this process; ``processes``: one process for each
                            worker; else the address of a scheduler
    workers : int or None   of the first two; None: one for each core

    Raises
    ------
    InputError              Dask is not installed, there is no answer at the address
    """
    count = workers or usable_cores()
    if scheduler == LOCAL:
        with ThreadPoolExecutor(count, thread_name_prefix="fleet") as pool:
            yield Cluster(pool.submit)
        return
    distributed = _distributed()
    if scheduler == PROCESSES:
        with (
            import_module("dask").config.set(PATIENT),
            distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address=":0",  # any port that is free
                silence_logs="CRITICAL",
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield _of(client)
        return
    try:
        client = distributed.Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no scheduler of Dask at '{scheduler}' ({type(error).__name__})",
            "local, processes, or an address such as tcp://10.0.0.1:8786",
            "Start one with `dask scheduler`, and workers that see the same folder.",
        ) from None
    with client:
        yield _of(client)


def rows_of(
    cluster: Cluster, task: Task, folder: Path, names: Sequence[str], batch: int
) -> Iterator[Rows]:
    """Rows of all logs, batch by batch as they are finished.

    A batch whose worker dies is done again elsewhere. Where one has cost several workers their
    life, its logs are done at the end, one at a time so that no log fails for its neighbour;
    the log that does it becomes a row with that error. Only some batches are in hand at a time,
    however many logs there are.

    Raises
    ------
    MachineError      no worker for `PATIENCE.without_s`
    """
    waiting = deque(tuple(names[k : k + batch]) for k in range(0, len(names), batch))
    suspects: deque[str] = deque()
    flying: dict[Any, tuple[str, ...]] = {}
    # The task goes along each time: what was handed out once would die with its worker.
    remote = cluster.workers is not None
    packed = import_module("cloudpickle").dumps(task) if remote else task
    finished = threading.Event()
    asked_s = seen_s = time.monotonic()
    suspected: set[str] = set()
    while waiting or suspects or flying:
        while (waiting and len(flying) < PATIENCE.in_hand) or (suspects and not flying):
            logs = waiting.popleft() if waiting else (suspects.popleft(),)
            future = cluster.submit(_rows, packed, str(folder), logs)
            flying[future] = logs
            future.add_done_callback(lambda _: finished.set())
        future = next((f for f in flying if f.done()), None)
        if future is None:
            # Not `as_completed`: it waits for ever for what was cancelled with its worker.
            finished.wait(PATIENCE.poll_s)
            finished.clear()
            now_s = time.monotonic()
            if cluster.workers is not None and now_s - asked_s > PATIENCE.ask_s:
                asked_s = now_s
                seen_s = now_s if cluster.workers() > 0 else seen_s
                if now_s - seen_s > PATIENCE.without_s:
                    raise MachineError(
                        f"no worker for {PATIENCE.without_s:.0f} s, while logs wait",
                        "workers of Dask that start again after a failure",
                        "Look at the workers' messages, then run again: what is done stays done.",
                    )
            continue
        logs = flying.pop(future)
        try:
            yield future.result()
        except Exception as error:  # of Dask: those of the logs are rows
            if len(logs) == 1 and logs[0] in suspected:
                reason = f"{WORKER_DIED} on it ({type(error).__name__})"
                yield [task.failed_row(folder, logs[0], reason)]
            else:
                suspected.update(logs)
                suspects.extend(logs)


@lru_cache(maxsize=2)
def _unpacked(task: bytes) -> Task:
    """The task, once for all batches of a process."""
    found: Task = pickle.loads(task)
    return found


def _rows(task: Task | bytes, folder: str, names: Sequence[str]) -> Rows:
    known = _unpacked(task) if isinstance(task, bytes) else task
    return known.rows(folder, names)


# How a run is cut: what is lost with a worker, and what is written at once.
MOST_IN_BATCH = 32  # logs
BATCHES = 16  # for each worker, so that all end together
PART_S = 10.0  # from which on a part of the results is written


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
        max(len(names) // (BATCHES * (workers or usable_cores())), 1), MOST_IN_BATCH
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
                    if time.monotonic() - written_s >= PART_S:
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
            "Check the folder, " + arg("pattern", letter="...") + ", and how the logs are read.",
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
            "Check the folder and " + arg("pattern", letter="...") + ".",
        )
    return found


def _is_hidden(name: str) -> bool:
    return name.startswith((".", "_"))

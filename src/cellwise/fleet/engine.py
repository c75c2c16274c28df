"""Batches of logs on Dask: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.fleet.tasks import LogTask, failed_row

LOCAL, PROCESSES = "local", "processes"
WORKER_DIED = "the worker died"
POLL_S = 0.01
AHEAD = 3  # batches in hand for each thread: enough to keep it busy, few enough to stay small

# The profile of a cluster in this machine is not used, and little can have changed in 10 s.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "10s",
    "distributed.admin.system-monitor.interval": "10s",
}

Rows = list[dict[str, Any]]


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ModuleNotFoundError:
        raise InputError(
            "a fleet, for which dask.distributed is not installed",
            "the extra fleet",
            "Install it: pip install 'cellwise[fleet]'.",
        ) from None


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def connected(scheduler: str, workers: int | None) -> Iterator[Any]:
    """A client of Dask.

    Parameters
    ----------
    scheduler : str         ``local``: threads of this process; ``processes``: one process for each
                            worker; else the address of a scheduler
    workers : int or None   of the first two; None: one for each core

    Raises
    ------
    InputError              Dask is not installed, there is no answer at the address
    """
    distributed = _distributed()
    count = workers or usable_cores()
    if scheduler in (LOCAL, PROCESSES):
        threads = scheduler == LOCAL
        with (
            import_module("dask").config.set(QUIET),
            distributed.LocalCluster(
                n_workers=1 if threads else count,
                threads_per_worker=count if threads else 1,
                processes=not threads,
                dashboard_address=":0",  # any port that is free
                silence_logs="CRITICAL",
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client
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
        yield client


def rows_of(
    client: Any, task: LogTask, folder: Path, names: Sequence[str], batch: int
) -> Iterator[Rows]:
    """Rows of all logs, batch by batch as they are finished.

    A batch whose worker dies is done again elsewhere. Where one has cost several workers their
    life, its logs are done at the end, one at a time so that no log fails for its neighbour;
    the log that does it becomes a row with that error. Only a few batches are in hand at a time,
    however many logs there are.
    """
    waiting: deque[tuple[str, ...]] = deque(
        tuple(names[k : k + batch]) for k in range(0, len(names), batch)
    )
    suspects: deque[str] = deque()
    flying: dict[Any, tuple[str, ...]] = {}

    def send() -> None:
        threads = sum(w["nthreads"] for w in client.scheduler_info()["workers"].values())
        while waiting and len(flying) < AHEAD * max(threads, 1):
            _fly(waiting.popleft())
        if suspects and not flying:
            _fly((suspects.popleft(),))

    def _fly(logs: tuple[str, ...]) -> None:
        # The task goes along each time: what was handed out once would die with its worker.
        future = client.submit(_rows, task, str(folder), logs, pure=False)
        flying[future] = logs

    suspected: set[str] = set()
    send()
    while flying:
        future = next((f for f in flying if f.done()), None)
        if future is None:
            # Not `as_completed`: it waits for ever for what was cancelled with its worker.
            time.sleep(POLL_S)
            continue
        logs = flying.pop(future)
        try:
            yield future.result()
        except Exception as error:  # of Dask: those of the logs are rows
            if len(logs) == 1 and logs[0] in suspected:
                reason = f"{WORKER_DIED} on it ({type(error).__name__})"
                yield [failed_row(folder, logs[0], reason)]
            else:
                suspected.update(logs)
                suspects.extend(logs)
        future.release()
        send()


def _rows(task: LogTask, folder: str, names: Sequence[str]) -> Rows:
    return task.rows(folder, names)

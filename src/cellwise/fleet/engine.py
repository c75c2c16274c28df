"""Batches of logs on Dask: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from cellwise.errors import InputError, MachineError
from cellwise.threads import usable_cores

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
        raise InputError(
            "a fleet, for which dask.distributed is not installed",
            "the extra fleet",
            "Install it: pip install 'cellwise[fleet]'.",
        ) from None


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

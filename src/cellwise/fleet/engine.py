"""Batches of logs on Dask: in this process, in processes of this machine, or on a cluster."""

from __future__ import annotations

import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from cellwise.errors import InputError, MachineError
from cellwise.threads import usable_cores

LOCAL, PROCESSES = "local", "processes"
WORKER_DIED = "the worker died"


class Patience(NamedTuple):
    """How long is waited for workers.

    Every ``poll_s`` for what ends without a call back; after ``ask_s`` it is asked again how many
    there are, and after ``without_s`` without one the run ends. So many batches are in hand
    ``ahead`` for each thread: enough to keep it busy, few enough to stay small.
    """

    poll_s: float = 0.25
    ask_s: float = 2.0
    without_s: float = 300.0
    ahead: int = 3


PATIENCE = Patience()

# The profile of a cluster in this machine is not used, and little can have changed in 10 s.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "10s",
    "distributed.admin.system-monitor.interval": "10s",
}
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


class Threads:
    """Threads of this process behind the calls of a client of Dask that are used here.

    A scheduler in this process would cost a third of what the kernels take.
    """

    def __init__(self, pool: ThreadPoolExecutor, count: int) -> None:
        self._pool = pool
        self._count = count

    def submit(self, work: Callable[..., Rows], *arguments: Any, pure: bool = False) -> Any:
        """Do the work in a thread."""
        return self._pool.submit(work, *arguments)

    def scheduler_info(self) -> dict[str, Any]:
        """One worker of so many threads."""
        return {"workers": {"threads": {"nthreads": self._count}}}


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
    count = workers or usable_cores()
    if scheduler == LOCAL:
        with ThreadPoolExecutor(count, thread_name_prefix="fleet") as pool:
            yield Threads(pool, count)
        return
    distributed = _distributed()
    if scheduler == PROCESSES:
        with (
            import_module("dask").config.set(QUIET | PATIENT),
            distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
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
    client: Any, task: Task, folder: Path, names: Sequence[str], batch: int
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
    threads = _Threads(client)
    packed = task if isinstance(client, Threads) else import_module("cloudpickle").dumps(task)
    finished = threading.Event()

    def send() -> None:
        while waiting and len(flying) < PATIENCE.ahead * threads.now():
            _fly(waiting.popleft())
        if suspects and not flying:
            _fly((suspects.popleft(),))

    def _fly(logs: tuple[str, ...]) -> None:
        # The task goes along each time: what was handed out once would die with its worker.
        future = client.submit(_rows, packed, str(folder), logs, pure=False)
        flying[future] = logs
        future.add_done_callback(lambda _: finished.set())

    suspected: set[str] = set()
    send()
    while flying:
        future = next((f for f in flying if f.done()), None)
        if future is None:
            # Not `as_completed`: it waits for ever for what was cancelled with its worker.
            finished.wait(PATIENCE.poll_s)
            finished.clear()
            threads.check()
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
        if not isinstance(client, Threads):
            future.release()
        send()


class _Threads:
    """Threads of all workers, asked for now and then: an answer costs as much as a log."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._count = 0
        self._asked_s = 0.0
        self._seen_s = time.monotonic()

    def now(self) -> int:
        """How many there are, at least one."""
        if self._count == 0 or time.monotonic() - self._asked_s > PATIENCE.ask_s:
            workers = self._client.scheduler_info()["workers"].values()
            self._count = sum(w["nthreads"] for w in workers)
            self._asked_s = time.monotonic()
            if self._count > 0:
                self._seen_s = self._asked_s
        return max(self._count, 1)

    def check(self) -> None:
        """Do not wait for ever for workers that nobody starts again.

        Raises
        ------
        MachineError      no worker for `PATIENCE.without_s`
        """
        self.now()
        if time.monotonic() - self._seen_s > PATIENCE.without_s:
            raise MachineError(
                f"no worker for {PATIENCE.without_s:.0f} s, while logs wait",
                "workers of Dask that start again after a failure",
                "Look at the workers' messages, then run again: what is done stays done.",
            )


@lru_cache(maxsize=2)
def _unpacked(task: bytes) -> Task:
    """The task, once for all batches of a process."""
    found: Task = pickle.loads(task)
    return found


def _rows(task: Task | bytes, folder: str, names: Sequence[str]) -> Rows:
    known = _unpacked(task) if isinstance(task, bytes) else task
    return known.rows(folder, names)

"""Files read in a process of their own, where the library that reads them cannot be trusted.

A library that reads a damaged or hostile file may take all memory, loop for ever, or end the
process it runs in. Such formats are read by a process that is kept for the next file and can be
ended: a limit that is exceeded is one refusal of one file. It is no pool of `concurrent.futures`:
those run the user's own script once more, and one that dies takes every other file with it.
"""

from __future__ import annotations

import atexit
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, damaged
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.source import LogSource, RawLog, ReadOptions, open_source

GRACE_S = 5.0  # of processor time, beyond what the asking side waits
KEPT_BYTES = 300_000_000  # a process that has grown beyond gives its memory back by ending

_SERVE = "from cellwise.logs.isolated import serve; serve()"
_FOR_MEMORY = {-int(getattr(signal, name, 0)) for name in ("SIGABRT", "SIGKILL")} - {0}
_FOR_TIME = -int(getattr(signal, "SIGXCPU", 0))

_idle: list[_Process] = []


class Request(NamedTuple):
    """One file to read: how, as which format, within which limits, from which folder."""

    path: Path
    options: ReadOptions
    format: str
    limits: Limits
    wants_progress: bool
    folder: str


def read_channels(source: LogSource, known: Format) -> RawLog:
    """A reader's channels, by a process of its own where the format wants one.

    Raises
    ------
    InputError        as the format's reader; limits of memory, time or rows; a library that ended
                      its process
    """
    # An interpreter that is built into a program cannot be started once more.
    can_start = bool(sys.executable) and not getattr(sys, "frozen", False)
    if not (known.isolated and can_start):
        return known.read(source, known)
    limits = Limits.of(source.size)
    process = _taken()
    try:
        answer = process.ask(source, known, limits)
    except BaseException:
        process.end()
        raise
    if answer["last"]:
        process.end()
    else:
        _idle.append(process)
    if "refusal" in answer:
        raise answer["refusal"]
    raw: RawLog = answer["raw"]
    return raw


def _taken() -> _Process:
    """An idle process, else a new one; each thread has its own."""
    while True:
        try:
            process = _idle.pop()
        except IndexError:
            return _Process()
        if process.owner == os.getpid() and process.alive():
            return process


class _Process:
    """One process that reads files, one at a time."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
        self._child = subprocess.Popen(
            [sys.executable, "-c", _SERVE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": paths},
            start_new_session=True,  # an interrupt is this side's to handle
        )
        self._expired = False

    def alive(self) -> bool:
        """It has not ended."""
        return self._child.poll() is None

    def ask(self, source: LogSource, known: Format, limits: Limits) -> dict[str, Any]:
        """What came of a file: ``raw`` or ``refusal``, and whether it was the ``last``."""
        wants_progress = source.progress is not None
        request = Request(
            source.path, source.options, known.name, limits, wants_progress, os.getcwd()
        )
        timer = threading.Timer(limits.seconds, self._expire)
        timer.daemon = True
        timer.start()
        into: IO[bytes] = self._child.stdin  # type: ignore[assignment]
        out: IO[bytes] = self._child.stdout  # type: ignore[assignment]
        try:
            with suppress(BrokenPipeError):
                _send(request, into)
            while "done" in (answer := pickle.load(out)):
                source.report(answer["done"], answer["total"])
            found: dict[str, Any] = answer
            return found
        except (EOFError, pickle.UnpicklingError, OSError):
            raise self._ended(source, known, limits) from None
        finally:
            timer.cancel()

    def _ended(self, source: LogSource, known: Format, limits: Limits) -> InputError:
        """Why there is no answer."""
        self.end()
        code = self._child.returncode
        if self._expired or code == _FOR_TIME:
            return limits.too_slow(source.where)
        if code in _FOR_MEMORY:
            return limits.too_big(source.where)
        return damaged(source, f"{known.name} file", f"its library ended with code {code}")

    def _expire(self) -> None:
        self._expired = True
        self._child.kill()

    def end(self) -> None:
        """End it, whatever it is doing."""
        self._child.kill()
        self._child.wait()
        for stream in (self._child.stdin, self._child.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()


@atexit.register
def _end_idle() -> None:
    for process in _idle:
        if process.owner == os.getpid():
            process.end()
    _idle.clear()


def serve() -> None:
    """The other side: read what is asked for on standard input until nobody asks any more."""
    out = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)  # what a library prints is no answer
    requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    last = False
    while not last:
        answer = _answer(requests.get(), out)
        answer["last"] = last = _peak_bytes() > KEPT_BYTES
        _send(answer, out)


def _listen(requests: queue.SimpleQueue[Request]) -> None:
    """Pass requests on; end the process when the asking side has ended."""
    while True:
        try:
            requests.put(pickle.load(sys.stdin.buffer))
        except BaseException:
            os._exit(0)


def _answer(request: Request, out: IO[bytes]) -> dict[str, Any]:
    from cellwise.logs.formats import FORMATS

    known = next(known for known in FORMATS if known.name == request.format)

    def progress(done: int, total: int) -> None:
        _send({"done": done, "total": total}, out)

    try:
        with suppress(OSError):
            os.chdir(request.folder)
        _confine(request.limits)
        wanted = progress if request.wants_progress else None
        source = open_source(request.path, wanted, request.options)
        raw = known.read(source, known)
        rows = max((values.size for values in raw.channels.values()), default=0)
        request.limits.check_rows(rows, source.where)
    except InputError as refusal:
        return {"refusal": refusal}
    except MemoryError:
        return {"refusal": request.limits.too_big(f"'{request.path}'")}
    return {"raw": raw}


def _send(message: Any, out: IO[bytes]) -> None:
    pickle.dump(message, out, pickle.HIGHEST_PROTOCOL)
    out.flush()


def _confine(limits: Limits) -> None:
    """Bound memory and processor time, where the system can."""
    try:
        import resource
    except ImportError:  # not on Windows: there the time alone is bounded, by the asking side
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(used.ru_utime + used.ru_stime + limits.seconds + GRACE_S)
    bounds = {"RLIMIT_DATA": limits.memory_bytes, "RLIMIT_CPU": seconds, "RLIMIT_CORE": 0}
    for name, bound in bounds.items():
        kind = getattr(resource, name)
        _, hard = resource.getrlimit(kind)
        most = bound if hard == resource.RLIM_INFINITY else min(bound, hard)
        resource.setrlimit(kind, (most, hard))


def _peak_bytes() -> int:
    """Most memory that this process has held; 0 where the system does not say.

    Not by ``getrusage``, which on Linux begins with the peak of the process that started this one.
    """
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        peak = next(line for line in lines if line.startswith("VmHWM:"))
        return 1024 * int(peak.split()[1])
    return 0

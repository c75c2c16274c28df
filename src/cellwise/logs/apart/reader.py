"""The side that asks: one file is read in another process, within its limits.

A library that reads a damaged or hostile file may take all memory, loop for ever, or end the
process it runs in. Such formats are read by a process that is kept for the next file and can be
ended: a limit that is exceeded is one refusal of one file.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, Any

from cellwise.errors import InputError
from cellwise.logs.files.format import Format, damaged
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.source import LogSource, RawLog

_MODULE = "cellwise.logs.apart.worker"
_FOR_MEMORY = {-int(getattr(signal, name, 0)) for name in ("SIGABRT", "SIGKILL")} - {0}
_FOR_TIME = -int(getattr(signal, "SIGXCPU", 0))

_idle: list[_Process] = []


def read_channels(source: LogSource, known: Format) -> RawLog:
    """A reader's channels, by a process of its own where the format wants one.

    Raises
    ------
    InputError        as the format's reader; limits of memory, time or rows; a library that ended
                      its process
    """
    if not (known.apart and _can_start()):
        return known.read(source, known)
    limits = Limits.of(source.size)
    process = _taken()
    try:
        answer = process.ask(source, known, limits)
    except BaseException:
        process.end()
        raise
    if answer.get("last"):
        process.end()
    else:
        _idle.append(process)
    if "refusal" in answer:
        raise answer["refusal"]
    raw: RawLog = answer["raw"]
    return raw


def _can_start() -> bool:
    """Whether the interpreter can be started once more: not where it is built into a program."""
    return bool(sys.executable) and not getattr(sys, "frozen", False)


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
            [sys.executable, "-m", _MODULE],
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
        request = (
            *(source.path, source.options, known.name, limits),
            source.progress is not None,
            os.getcwd(),
        )
        timer = threading.Timer(limits.seconds, self._expire)
        timer.daemon = True
        timer.start()
        try:
            into: IO[bytes] = self._child.stdin  # type: ignore[assignment]
            with suppress(BrokenPipeError):
                pickle.dump(request, into, pickle.HIGHEST_PROTOCOL)
                into.flush()
            return self._answer(source)
        except (EOFError, pickle.UnpicklingError, OSError):
            raise self._ended(source, known, limits) from None
        finally:
            timer.cancel()

    def _answer(self, source: LogSource) -> dict[str, Any]:
        out: IO[bytes] = self._child.stdout  # type: ignore[assignment]
        while True:
            answer: dict[str, Any] = pickle.load(out)
            if "done" not in answer:
                return answer
            source.report(answer["done"], answer["total"])

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

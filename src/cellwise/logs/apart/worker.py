"""The side that reads: files from standard input's requests, channels to standard output."""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from cellwise.errors import InputError
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.options import ReadOptions
from cellwise.logs.files.source import open_source
from cellwise.logs.formats import FORMATS

Request = tuple[Path, ReadOptions, str, Limits, bool, str]

GRACE_S = 5.0  # of processor time, beyond what the asking side waits
KEPT_BYTES = 300_000_000  # a process that has grown beyond gives its memory back by ending


def main() -> None:
    """Read what is asked for until nobody asks any more."""
    out = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)  # what a library prints is no answer
    requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    while True:
        request = requests.get()
        answer = _answer(request, out)
        answer["last"] = last = _peak_bytes() > KEPT_BYTES
        _send(answer, out)
        if last:
            return


def _listen(requests: queue.SimpleQueue[Request]) -> None:
    """Pass requests on; end the process when the asking side has ended."""
    while True:
        try:
            requests.put(pickle.load(sys.stdin.buffer))
        except BaseException:
            os._exit(0)


def _answer(request: Request, out: IO[bytes]) -> dict[str, Any]:
    path, options, name, limits, wants_progress, folder = request
    known = next(known for known in FORMATS if known.name == name)

    def progress(done: int, total: int) -> None:
        _send({"done": done, "total": total}, out)

    try:
        with suppress(OSError):
            os.chdir(folder)
        _confine(limits)
        source = open_source(path, progress if wants_progress else None, options)
        raw = known.read(source, known)
        rows = max((values.size for values in raw.channels.values()), default=0)
        limits.check_rows(rows, source.where)
    except InputError as refusal:
        return {"refusal": refusal}
    except MemoryError:
        return {"refusal": limits.too_big(f"'{path}'")}
    return {"raw": raw}


def _send(answer: dict[str, Any], out: IO[bytes]) -> None:
    pickle.dump(answer, out, pickle.HIGHEST_PROTOCOL)
    out.flush()


def _confine(limits: Limits) -> None:
    """Bound memory and processor time, where the system can."""
    try:
        import resource
    except ImportError:  # not on Windows: there the time alone is bounded, by the asking side
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(used.ru_utime + used.ru_stime + limits.seconds + GRACE_S)
    bounds = {"RLIMIT_DATA": limits.memory_bytes, "RLIMIT_CPU": seconds}
    for name, bound in bounds.items():
        kind = getattr(resource, name)
        _, hard = resource.getrlimit(kind)
        most = bound if hard == resource.RLIM_INFINITY else min(bound, hard)
        resource.setrlimit(kind, (most, hard))
    if hasattr(resource, "RLIMIT_CORE"):
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def _peak_bytes() -> int:
    """Most memory that this process has held; 0 where the system does not say.

    Not by ``getrusage``, which on Linux begins with the peak of the process that started this one.
    """
    with suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        peak = next(line for line in lines if line.startswith("VmHWM:"))
        return 1024 * int(peak.split()[1])
    return 0


if __name__ == "__main__":
    main()

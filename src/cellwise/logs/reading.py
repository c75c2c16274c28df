"""Read a measured log, whatever its format; in a process of its own where a library is not trusted.

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
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Literal, NamedTuple

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.assembly import Origin, assemble, complete
from cellwise.logs.files.format import Format, damaged, detect_format
from cellwise.logs.files.source import (
    FROM_FILE,
    Limits,
    LogSource,
    Progress,
    RawLog,
    ReadOptions,
    open_source,
)
from cellwise.logs.formats import FORMATS
from cellwise.logs.packs.cells import CellColumn
from cellwise.logs.packs.pack_log import columns_of_table, pack_of
from cellwise.logs.stated import Stated, plain_name

TIDY = ("tidy-parquet", "tidy-csv")
AS_MEAN_CELL = "read as their mean cell"  # marks the notice


def read_log(
    path: str | Path | Stated,
    *,
    sign: str = "auto",
    name: str | None = None,
    progress: Progress | None = None,
    series: int | Literal["auto"] = 1,
    parallel: int = 1,
    channels: Mapping[str, str] | None = None,
    instance: int | None = None,
    dbc: str | Path | None = None,
    partial: bool = False,
    check_sign: bool = True,
    decimal: str = "auto",
) -> CellLog:
    """Read a log in the tidy form or in a native format detected from its content.

    The tidy form has the columns ``time_s, current_A, voltage_V[, temperature_C]
    [, ampere_hours][, step]`` in any order, as CSV (plain or gzip) or parquet, positive current =
    discharge. Other units are converted when the name gives them (``current_mA``, ``time_h``, ...).
    `FORMATS` holds the others; what they need beyond pyarrow is in the extra ``importers``.

    Parameters
    ----------
    path : str, Path or Stated      a string may state what is known of the log behind an @
                        (``"LOG@temperature_C=-20,soc0=1"``); a Path is taken as it is
    sign : str          ``auto`` trusts the format's sign and verifies it; the other two,
                        ``charge-positive`` and ``discharge-positive``, override the format
    name : str          for people; the file's name without suffix if not given
    progress : callable     called with what is done and the total, while reading
    series : int or "auto"  cells in series, to read a pack as its mean cell; ``auto``: the number
                            that the file states. A table with a voltage for each cell is read as
                            their mean cell without it
    parallel : int          cells in parallel
    channels : mapping      which column or signal is which: a tidy name, which gives the unit, to
                            the name in the file (``{"current_mA": "I_pack"}``)
    instance : int          which battery of a file that holds several, counted from 0
    dbc : str or Path       database of the frames of a CAN log
    partial : bool          read a recording that was cut off (loss of power) as far as it goes
    check_sign : bool       verify the sign from the data, which takes longer than reading

    Returns
    -------
    CellLog             its ``notices`` say what was converted, left out or looks wrong

    Raises
    ------
    InputError          the file cannot be read as a log: see the message for what to do
    """
    stated = path if isinstance(path, Stated) else Stated(str(path))
    if isinstance(path, str):
        stated = Stated.parse(path)
    options = ReadOptions(
        series=series,
        parallel=parallel,
        channels=dict(channels or {}),
        instance=instance,
        dbc=None if dbc is None else Path(dbc),
        partial=partial,
        decimal=decimal,
    )
    source = open_source(stated.path, progress, options)
    known = detect_format(source, FORMATS)
    pack = columns_of_table(source, known)
    counts = (FROM_FILE, sum(c.kind == "cell" for c in pack)) if known.name in TIDY else ()
    if pack and options.series in (1, *counts):
        mean = _mean_of_pack(source, known, pack, sign, name, check_sign)
        return stated.applied(mean)
    raw = complete(read_channels(source, known), known.sign, source.where)
    raw = to_cell(raw, options, source.where)
    origin = Origin(
        name=plain_name(source.path) if name is None else name,
        source=str(source.path),
        format=known.name,
        sign=known.sign,
        current_meaning=known.current_meaning,
    )
    log = assemble(raw, origin, sign, check_sign=check_sign)
    return stated.applied(log)


def _mean_of_pack(
    source: LogSource,
    known: Format,
    columns: tuple[CellColumn, ...],
    sign: str,
    name: str | None,
    check_sign: bool,
) -> CellLog:
    """The mean cell of a table with a voltage for each cell, and a notice that says so."""
    name = plain_name(source.path) if name is None else name
    pack = pack_of(source, known, columns, sign=sign, name=name, check_sign=check_sign)
    warm = sum(c.kind == "temperature" for c in columns)
    cells = f"{pack.cells} cells" + (f" and {warm} temperatures" if warm > 1 else "")
    said = f"a table of {cells}, {AS_MEAN_CELL} (`cellwise pack` sees each)"
    return pack.mean.with_notices((*pack.notices, said))


def to_cell(raw: RawLog, options: ReadOptions, where: str) -> RawLog:
    """Divide a pack's voltage by the cells in series, current and counter by those in parallel.

    Raises
    ------
    InputError        the file does not state the cells in series
    """
    series = options.series
    if series == FROM_FILE:
        if raw.cells is None:
            raise InputError(
                f"`series='auto'` for {where}, which does not state its cells in series",
                "a number of cells",
                "Give it: `series=4`, say.",
            )
        series = raw.cells
    notices = list(raw.notices)
    if raw.cells is not None and raw.cells > 1 and options.series == 1:
        notices.append(
            f"the file states {raw.cells} cells in series: `series='auto'` reads their mean cell"
        )
    elif raw.cells is not None and raw.cells != series:
        notices.append(
            f"the file states {raw.cells} cells in series, {series} were stated by the user"
        )
    channels = dict(raw.channels)
    if series > 1:
        channels["voltage_V"] = channels["voltage_V"] / series
    if options.parallel > 1:
        for field in ("current_A", "charge_Ah"):
            if field in channels:
                channels[field] = channels[field] / options.parallel
    if series > 1 or options.parallel > 1:
        notices.append(
            f"a pack of {series} in series, {options.parallel} in parallel, read as its mean cell"
        )
    return RawLog(channels, tuple(notices), raw.cells)


GRACE_S = 5.0  # of processor time, beyond what the asking side waits
KEPT_BYTES = 300_000_000  # a process that has grown beyond gives its memory back by ending

_SERVE = "from cellwise.logs.reading import serve; serve()"
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

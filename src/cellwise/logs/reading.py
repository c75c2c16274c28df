"""Read a measured log, whatever its format; in a process of its own where a library is not trusted.

A library that reads a damaged or hostile file may take all memory, loop for ever, or end the
process it runs in. Such formats are read by a process that is kept for the next file and can be
ended: a limit that is exceeded is one refusal of one file. It is no pool of `concurrent.futures`:
those run the user's own script once more, and one that dies takes every other file with it.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Literal

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.assembly import assemble, complete
from cellwise.logs.files.choice import MissingColumnsError
from cellwise.logs.files.columns import Channel
from cellwise.logs.files.format import Format, damaged, detect_format, one_battery
from cellwise.logs.files.source import (
    FROM_FILE,
    LogSource,
    Progress,
    RawLog,
    ReadLimits,
    ReadOptions,
    open_source,
)
from cellwise.logs.formats import FORMATS
from cellwise.logs.formats.workbook import in_workbook
from cellwise.logs.packs.cells import to_cell
from cellwise.logs.packs.pack_log import PackLog, columns_of_table, pack_columns, pack_of
from cellwise.logs.proposals import tried
from cellwise.logs.stated import Stated, plain_name
from cellwise.notices import Code, Notice


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
    stated = Stated.of(path)
    options = ReadOptions(
        series=series,
        parallel=parallel,
        channels=dict(channels or {}),
        instance=stated.instance if instance is None else instance,
        dbc=None if dbc is None else Path(dbc),
        partial=partial,
        decimal=decimal,
    )
    source = open_source(stated.path, progress, options)
    named = plain_name(source.path) if name is None else name
    if stated.instance is not None and name is None:
        named += f"@{stated.instance}"

    def read(source: LogSource) -> CellLog:
        return _log_of(source, sign, named, check_sign)

    try:
        return stated.applied(read(source))
    except MissingColumnsError as refusal:
        raise tried(refusal, source, read) from None


def _log_of(source: LogSource, sign: str, named: str, check_sign: bool) -> CellLog:
    """The log of a file that has been opened."""
    known, series = detect_format(source, FORMATS), source.options.series
    columns = columns_of_table(source, known)
    cells = sum(c.kind == "cell" for c in columns)
    if cells and series in (1, FROM_FILE, cells):
        pack = pack_of(
            source, known, columns, read_channels, sign=sign, name=named, check_sign=check_sign
        )
        sensors = sum(c.kind == "temperature" for c in columns)
        what = f"{pack.cells} cells" + (f" and {sensors} temperatures" if sensors > 1 else "")
        said = f"a table of {what}", ", read as their mean cell (`cellwise pack` sees each)"
        noted = Notice(Code.PACK_AS_MEAN_CELL, said)
        return pack.mean.with_notices((*pack.notices, noted))
    raw = one_battery(read_channels(source, known), source, known)
    if raw.form:
        known = in_workbook(next(one for one in FORMATS if one.name == raw.form))
    raw = to_cell(complete(raw, known.sign, source.where, sign), source.options, source.where)
    return assemble(raw, known, source.path, named, sign, check_sign=check_sign)


def read_pack(
    path: str | Path | Stated,
    *,
    sign: str = "auto",
    parallel: int = 1,
    channels: Mapping[str, str] | None = None,
    instance: int | None = None,
    name: str | None = None,
) -> PackLog:
    """Read a log with a voltage for each cell.

    The tidy form is ``time_s, current_A, cell_01_V, cell_02_V, ...`` (or ``cell_01_mV``), with
    ``voltage_V`` (of the pack), ``temperature_C`` or ``temperature_1_C``, ... and
    ``cell_01_balancing``, ... where they were recorded. Columns ``CP1``, ... of LeafSpy and the
    cells of a PX4 ULog are known too.

    Parameters
    ----------
    path : str, Path or Stated      a string may state temperature and initial SOC behind an @
    sign : str                      ``auto``, ``charge-positive`` or ``discharge-positive``
    parallel : int                  cells in parallel that the model is not for: divides the current
    channels : mapping              which column is which, as of `read_log`
    instance : int                  which battery of a file that holds several

    Raises
    ------
    InputError        no cell voltages, or whatever `read_log` refuses
    """
    stated = Stated.of(path)
    instance = stated.instance if instance is None else instance
    options = ReadOptions(parallel=parallel, channels=dict(channels or {}), instance=instance)
    source = open_source(stated.path, None, options)
    known = detect_format(source, FORMATS)
    columns = pack_columns(source, known)
    name = source.path.name.split(".")[0] if name is None else name
    pack = pack_of(source, known, columns, read_channels, sign=sign, name=name)
    return replace(pack, mean=stated.applied(pack.mean))


GRACE_S = 5.0  # of processor time, beyond what the asking side waits
KEPT_BYTES = 20_000_000  # what a library has taken for a larger file is given back

_SERVE = "from cellwise.logs.reading import serve; serve()"
_FOR_MEMORY = {-int(getattr(signal, name, 0)) for name in ("SIGABRT", "SIGKILL")} - {0}
_FOR_TIME = -int(getattr(signal, "SIGXCPU", 0))

_idle: list[subprocess.Popen[bytes]] = []  # they end with this process, whose pipes then close
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # they are the parent's


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
    process, limits = _process(), ReadLimits.of(source.size)
    timer = threading.Timer(limits.seconds, process.kill)
    timer.daemon = True
    timer.start()
    into: IO[bytes] = process.stdin  # type: ignore[assignment]
    out: IO[bytes] = process.stdout  # type: ignore[assignment]
    try:
        with suppress(BrokenPipeError):
            asked = source.path, source.options, known.name, known.channels, limits
            _send((os.getcwd(), *asked), into)
        while isinstance(answer := pickle.load(out), tuple):
            source.report(*answer)
    except BaseException as error:
        with suppress(OSError), process:
            process.kill()
        if not isinstance(error, (EOFError, pickle.UnpicklingError, OSError)):
            raise
        raise _why_ended(process.returncode, source, known, limits) from None
    finally:
        timer.cancel()
    if source.size > KEPT_BYTES:
        with process:
            process.kill()
    else:
        _idle.append(process)
    if isinstance(answer, RawLog):
        return answer
    raise answer


def _process() -> subprocess.Popen[bytes]:
    """An idle process, else a new one; each reads one file at a time."""
    with suppress(IndexError):
        while True:
            process = _idle.pop()
            if process.poll() is None:
                return process
    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
    return subprocess.Popen(
        [sys.executable, "-c", _SERVE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": paths},
        start_new_session=True,  # an interrupt is this side's to handle
    )


def _why_ended(code: int, source: LogSource, known: Format, limits: ReadLimits) -> InputError:
    if code == _FOR_TIME or limits.time_is_over:
        return limits.too_slow(source.where)
    if code in _FOR_MEMORY:
        return limits.too_big(source.where)
    return damaged(source, f"{known.name} file", f"its library ended with code {code}")


def serve() -> None:
    """The other side: read what is asked for on standard input until nobody asks any more."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a library prints is no answer
    with suppress(EOFError, BrokenPipeError):
        while True:
            _send(_answer(out, *pickle.load(sys.stdin.buffer)), out)


def _answer(
    out: IO[bytes],
    folder: str,
    path: Path,
    options: ReadOptions,
    name: str,
    channels: Sequence[Channel],
    limits: ReadLimits,
) -> RawLog | InputError:
    known = replace(next(one for one in FORMATS if one.name == name), channels=channels)
    try:
        with suppress(OSError):
            os.chdir(folder)
        _confine(limits)
        source = open_source(path, lambda *done: _send(done, out), options)
        raw = known.read(source, known)
        rows = max((values.size for values in raw.channels.values()), default=0)
        limits.check(source.where, rows)
    except InputError as refusal:
        return refusal
    except MemoryError:
        return limits.too_big(f"'{path}'")
    return raw


def _send(message: Any, out: IO[bytes]) -> None:
    pickle.dump(message, out, pickle.HIGHEST_PROTOCOL)
    out.flush()


def _confine(limits: ReadLimits) -> None:
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

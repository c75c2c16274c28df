"""A file as it lies there, what a user says of it, what reading it may take, and what is taken."""

from __future__ import annotations

import gzip
import os
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import IO, Literal, cast

from cellwise.errors import InputError, MachineError
from cellwise.logs.files.columns import folded
from cellwise.logs.files.words import words_in
from cellwise.notices import Notice
from cellwise.typing import FloatArray
from cellwise.wording import arg

# Called with the bytes (or columns) done and the number there are in all.
Progress = Callable[[int, int], None]

HEAD_BYTES = 65_536  # read at a time; of a line no more
GZIP_MAGIC = b"\x1f\x8b"
TEXT_CONTROLS = b"\t\n\r\f"
NO_TEXT = bytes(byte for byte in range(32) if byte not in TEXT_CONTROLS)
MOST_HEADER_LINES = 400
CHARACTER_SETS = ("gb18030", "cp932", "big5", "cp949", "cp1251")
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


FROM_FILE: Literal["auto"] = "auto"


@dataclass(frozen=True)
class ReadOptions:
    """How a log is to be read.

    Parameters
    ----------
    series : int or "auto"      cells in series: the voltage is divided by it; ``auto`` takes the
                                number that the file states
    parallel : int              cells in parallel: current and counter are divided by it
    channels : mapping          tidy column name, which gives the unit, to the name in the file:
                                ``{"current_mA": "I_pack"}``
    instance : int or None      which battery of a file that has several, counted from 0
    dbc : Path or None          the database of the CAN frames
    partial : bool              read a recording that was cut off as far as it goes
    decimal : str               decimal sign of a text: ``.``, ``,``, or ``auto`` by its first rows

    Raises
    ------
    InputError                  counts below one, an instance below zero, another decimal sign
    """

    series: int | Literal["auto"] = 1
    parallel: int = 1
    channels: Mapping[str, str] = field(default_factory=dict)
    instance: int | None = None
    dbc: Path | None = None
    partial: bool = False
    decimal: str = FROM_FILE

    def __post_init__(self) -> None:
        for name, count in (("series", self.series), ("parallel", self.parallel)):
            if count != FROM_FILE and not (isinstance(count, int) and count >= 1):
                raise InputError(
                    f"{name} = {count}",
                    "a number of cells from 1 up",
                    "Give " + arg(name, 4) + ", say.",
                )
        if self.instance is not None and self.instance < 0:
            raise InputError(
                f"instance {self.instance}", "a battery's number from 0 up", "Count from 0."
            )
        if self.decimal not in (FROM_FILE, ".", ","):
            raise InputError(
                f"a decimal sign '{self.decimal}'",
                "'.', ',' or 'auto'",
                "Give " + arg("decimal", ",") + ", say.",
            )
        if self.dbc is not None and not Path(self.dbc).is_file():
            raise InputError(f"no DBC file '{self.dbc}'", "a CAN database", "Check the path.")


NOTHING_SAID = ReadOptions()


@dataclass(frozen=True)
class LogSource:
    """A log file before anything is known of its format."""

    path: Path
    size: int
    gzipped: bool
    progress: Progress | None = None
    options: ReadOptions = NOTHING_SAID
    content: bytes | None = None  # in place of the file's own: a sheet of a workbook as text

    @property
    def where(self) -> str:
        """The file, for messages."""
        return f"'{self.path}'"

    @cached_property
    def head(self) -> bytes:
        """The first bytes of the content, decompressed when the file is gzip.

        Raises
        ------
        InputError        damaged gzip
        """
        try:
            with self.open() as stream:
                return stream.read(HEAD_BYTES)
        except (OSError, EOFError, zlib.error) as error:
            # What can still be decompressed from the beginning.
            with suppress(zlib.error), self.path.open("rb") as file:
                begins = file.read(HEAD_BYTES)
                if head := zlib.decompressobj(wbits=31).decompress(begins, HEAD_BYTES):
                    return head
            raise damaged_gzip(self, str(error)) from None

    @cached_property
    def is_text(self) -> bool:
        """The file's beginning has no byte that text has not."""
        if b"\0" in self.head:
            return False
        return len(self.head.translate(None, NO_TEXT)) == len(self.head)

    @cached_property
    def first_lines(self) -> tuple[str, ...]:
        """The first lines of a text, stripped; none of another file."""
        if not self.is_text:
            return ()
        lines = decoded(self.head, self.encoding).splitlines()[:MOST_HEADER_LINES]
        return tuple(line.strip() for line in lines)

    @cached_property
    def folded_lines(self) -> tuple[str, ...]:
        """The first lines as names are compared: every format looks for its own there."""
        return tuple(map(folded, self.first_lines))

    @cached_property
    def encoding(self) -> str:
        """The character set of a text: that in which its head has most of the words known.

        Old programs write that of their country; without any such word it is Latin-1.
        """
        try:
            self.head.decode("utf-8")
        except UnicodeDecodeError as error:
            if error.start < len(self.head) - 3:  # else cut within a character
                text = self.head.splitlines()[:MOST_HEADER_LINES]
                found = {one: words_in(_as(text, one)) for one in CHARACTER_SETS}
                best = max(found, key=lambda one: found[one])
                return best if found[best] else "latin-1"
        return "utf-8"

    def raw(self) -> IO[bytes]:
        """The content as it lies there."""
        return self.path.open("rb") if self.content is None else BytesIO(self.content)

    def open(self) -> IO[bytes]:
        """The content as a binary stream, decompressed."""
        return self.content_of(self.raw())

    def of_text(self, text: str) -> LogSource:
        """The same file with a text as its content."""
        held = text.encode("utf-8")
        return LogSource(self.path, len(held), False, self.progress, self.options, held)

    def content_of(self, file: IO[bytes]) -> IO[bytes]:
        """The content of an open file, decompressed."""
        return cast("IO[bytes]", gzip.open(file, "rb")) if self.gzipped else file

    def report(self, done: int, total: int) -> None:
        """Report progress if anybody listens."""
        if self.progress is not None:
            self.progress(min(done, total), total)


@dataclass(frozen=True)
class RawLog:
    """What a reader takes from a file: channels by field of `CellLog`, in the channel's own unit.

    ``channels["time_s"]``, ``["current_A"]`` and ``["voltage_V"]`` are there once `complete` has
    seen it; missing values are NaN; the sign is still the format's, if it is ``signed``: else
    nobody says what it means. ``cells`` is the number of cells in series that the file states.
    ``form`` is the format of what a container holds (a workbook's sheet).
    """

    channels: dict[str, FloatArray]
    notices: tuple[Notice, ...] = ()
    cells: int | None = None
    signed: bool = True
    form: str = ""
    series: int = 1
    parallel: int = 1

    def noted(self, notices: Iterable[Notice]) -> RawLog:
        """The same with more notices."""
        return replace(self, notices=(*self.notices, *notices))


def open_source(
    path: str | Path, progress: Progress | None = None, options: ReadOptions | None = None
) -> LogSource:
    """Look at a file's first bytes.

    Raises
    ------
    InputError        nothing there, a folder, not readable, empty, or damaged gzip
    """
    place = Path(path)
    try:
        if place.is_dir():
            raise InputError(f"a folder at '{place}'", "a log file", "Name one of the files in it.")
        size = place.stat().st_size
        with place.open("rb") as file:
            magic = file.read(2)
    except FileNotFoundError:
        raise InputError(f"no file '{place}'", "a log file", _near_files(place)) from None
    except OSError as error:
        raise MachineError(
            f"'{str(place)[:200]}', which cannot be read ({error.strerror})",
            "a readable log file",
            "Check its permissions and that the disk is there.",
        ) from None
    source = LogSource(place, size, magic == GZIP_MAGIC, progress, options or NOTHING_SAID)
    if magic in UTF_16 and size <= USUAL_BYTES and size % 2 == 0:
        with suppress(UnicodeDecodeError):
            source = source.of_text(place.read_bytes().decode("utf-16"))
    if not source.head:
        raise InputError(
            f"the empty file '{place}'",
            "a log with a header and rows",
            "Check the export, or the copy, that wrote it.",
        )
    return source


def decoded(text: bytes, encoding: str) -> str:
    """Bytes as text; what is cut within a character ends before it."""
    return text.decode(encoding, errors="ignore")


def _as(lines: Iterable[bytes], encoding: str) -> str:
    try:
        return "\n".join(line.decode(encoding) for line in lines)
    except UnicodeDecodeError:
        return ""


def damaged_gzip(source: LogSource, reason: str) -> InputError:
    """The refusal of a gzip file that ends early or does not decompress."""
    return InputError(
        f"a cut off or damaged gzip file '{source.path}' ({reason.rstrip('.')})",
        "a complete file",
        "Copy or download it again; 'gzip -t' checks that it is whole.",
    )


def _near_files(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        return f"There is no folder '{folder}' either: check the path."
    near = get_close_matches(path.name, [p.name for p in folder.iterdir()], n=3)
    if near:
        return f"Did you mean {' or '.join(repr(name) for name in near)} in the same folder?"
    return "Check the path."


USUAL_BYTES = 100_000_000
# Of a file of up to so many bytes; a larger one may take more, in proportion.
_USUAL = {"MEMORY_GB": 1.5, "SECONDS": 60.0, "ROWS": 10_000_000}
_VARIABLES = tuple(f"CELLWISE_READ_{name}" for name in _USUAL)


@dataclass(frozen=True)
class ReadLimits:
    """What reading one file may take.

    Parameters
    ----------
    memory_bytes : int      of the process of its own that some formats are read in
    seconds : float         from the first byte to the last
    rows : int              of a log
    began_s : float         when reading began, by `time.monotonic`
    """

    memory_bytes: int
    seconds: float
    rows: int
    began_s: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, size: int) -> ReadLimits:
        """The limits of a file of so many bytes.

        ``CELLWISE_READ_MEMORY_GB``, ``CELLWISE_READ_SECONDS`` and ``CELLWISE_READ_ROWS`` of the
        environment stand in place of the usual ones.

        Raises
        ------
        InputError        one of these is no number above 0
        """
        memory, seconds, rows = (
            _stated(name, usual * max(1.0, size / USUAL_BYTES))
            for name, usual in zip(_VARIABLES, _USUAL.values(), strict=True)
        )
        return cls(int(1e9 * memory), seconds, int(rows))

    def check(self, where: str, rows: int = 0) -> None:
        """Refuse to go on.

        Raises
        ------
        InputError        more rows than these, or no time left
        """
        if rows > self.rows:
            raise InputError(
                f"{rows:,} rows or more in {where}",
                f"up to {self.rows:,} rows in a file of its size",
                f"Split it; if it is that long, allow more with {_VARIABLES[2]}.",
            )
        if self.time_is_over:
            raise self.too_slow(where)

    @property
    def time_is_over(self) -> bool:
        """Reading has taken all the time that it may."""
        return time.monotonic() > self.began_s + self.seconds

    def too_slow(self, where: str) -> InputError:
        """The refusal of a file that takes longer."""
        return InputError(
            f"no end of {where} after {self.seconds:.0f} s of reading (the limit of time)",
            "a whole file",
            f"It is most likely damaged; if it is that long, allow more with {_VARIABLES[1]}.",
        )

    def too_big(self, where: str) -> InputError:
        """The refusal of a file that needs more memory."""
        return InputError(
            f"{where}, which needs more than {self.memory_bytes / 1e9:.1f} GB of memory to read "
            "(the limit of memory)",
            "a file whose content fits",
            f"It is most likely damaged; if it is that large, allow more with {_VARIABLES[0]}.",
        )


def _stated(name: str, usual: float) -> float:
    text = os.environ.get(name, "")
    if not text:
        return usual
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise InputError(f"{name}={text} in the environment", "a number above 0", "Correct it.")
    return value


class TimedStream:
    """The content, decompressed; as much of a file as pyarrow needs.

    A small file may decompress to anything: only time ends that. ``skipped`` bytes at its beginning
    and what stands from ``end`` on are left out.
    """

    def __init__(
        self, source: LogSource, limits: ReadLimits, skipped: int = 0, end: int | None = None
    ) -> None:
        self._source = source
        self._limits = limits
        self._file: IO[bytes] = source.raw()
        self._content = source.content_of(self._file)
        self.closed = False
        self._left = None if end is None else end - skipped
        while skipped > 0 and (part := self._content.read(min(skipped, HEAD_BYTES))):
            skipped -= len(part)

    def read(self, size: int = -1) -> bytes:
        """As of a file.

        Raises
        ------
        InputError        the time is over
        """
        self._limits.check(self._source.where)
        if self._left is None:
            return self._content.read(size)
        part = self._content.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(part)
        return part

    def done(self) -> int:
        """Bytes of the file that have been read, as they lie there."""
        return self._file.tell()

    def close(self) -> None:
        """As of a file."""
        self.closed = True
        self._content.close()
        self._file.close()

    def readable(self) -> bool:
        """It can be read."""
        return True


LOOK_ROWS = 10_000  # between two looks at the limits


def lines_of(source: LogSource, skipped: int = 0) -> Iterator[str]:
    """The lines of a text from a byte on, within the limits of reading."""
    limits = ReadLimits.of(source.size)
    with source.open() as file:
        file.read(skipped)
        for number, line in enumerate(file):
            if number % LOOK_ROWS == 0:
                limits.check(source.where, number)
            yield decoded(line, source.encoding)

"""What reading one file may take: memory, time, rows; a stream that ends when its time is over."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import IO

from cellwise.errors import InputError
from cellwise.logs.files.source import LogSource

USUAL_BYTES = 100_000_000
# Of a file of up to so many bytes; a larger one may take more, in proportion.
_USUAL = {"MEMORY_GB": 1.5, "SECONDS": 60.0, "ROWS": 10_000_000}
_VARIABLES = tuple(f"CELLWISE_READ_{name}" for name in _USUAL)


@dataclass(frozen=True)
class Limits:
    """What reading one file may take.

    Parameters
    ----------
    memory_bytes : int      of the process of its own that some formats are read in
    seconds : float         from the first byte to the last
    rows : int              of a log
    """

    memory_bytes: int
    seconds: float
    rows: int

    @classmethod
    def of(cls, size: int) -> Limits:
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

    def check_rows(self, rows: int, where: str) -> None:
        """Refuse a log of more rows.

        Raises
        ------
        InputError        more rows than this
        """
        if rows > self.rows:
            raise InputError(
                f"{rows:,} rows or more in {where}",
                f"up to {self.rows:,} rows in a file of its size",
                f"Split it; if it is that long, allow more with {_VARIABLES[2]}.",
            )

    def check(self, deadline: float, rows: int, where: str) -> None:
        """Refuse to go on beyond the rows or the time.

        Raises
        ------
        InputError        more rows than these, or later than the deadline
        """
        self.check_rows(rows, where)
        if time.monotonic() > deadline:
            raise self.too_slow(where)

    def deadline(self) -> float:
        """When reading that begins now has to be done, by `time.monotonic`."""
        return time.monotonic() + self.seconds

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
        self, source: LogSource, limits: Limits, skipped: int = 0, end: int | None = None
    ) -> None:
        self._source = source
        self._limits = limits
        self._deadline = limits.deadline()
        self._file: IO[bytes] = source.path.open("rb")
        self._content = source.content_of(self._file)
        self.closed = False
        self._left = None if end is None else end - skipped
        while skipped > 0 and (part := self._content.read(min(skipped, 65_536))):
            skipped -= len(part)

    def read(self, size: int = -1) -> bytes:
        """As of a file.

        Raises
        ------
        InputError        the time is over
        """
        self.check_time()
        if self._left is None:
            return self._content.read(size)
        part = self._content.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(part)
        return part

    def check_time(self) -> None:
        """Refuse to go on when the time is over.

        Raises
        ------
        InputError        it is
        """
        self._limits.check(self._deadline, 0, self._source.where)

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

    def writable(self) -> bool:
        """It cannot be written."""
        return False

    def seekable(self) -> bool:
        """It has no way back."""
        return False

"""A file's content as a stream that ends reading when its time is over."""

from __future__ import annotations

from typing import IO

from cellwise.logs.files.limits import Limits
from cellwise.logs.files.source import LogSource

SKIP_BYTES = 1 << 16


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
        while skipped > 0 and (part := self._content.read(min(skipped, SKIP_BYTES))):
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

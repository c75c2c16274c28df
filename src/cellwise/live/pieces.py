"""Bytes of a pipe or a growing file as they come, without waiting for ever."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from cellwise.errors import InputError

POLL_S = 0.2
PIECE_BYTES = 65_536
STDIN = "-"


class Pieces:
    """Pieces of a stream; an empty one after every ``POLL_S`` in which nothing came.

    Parameters
    ----------
    place : str           a path, or ``-`` for standard input
    follow : bool         at a file's end wait for more, as of a file that is being written

    Raises
    ------
    InputError            no such file
    """

    def __init__(self, place: str, *, follow: bool = False) -> None:
        self.name = "standard input" if place == STDIN else f"'{place}'"
        self._follow = follow
        self._owned: IO[bytes] | None = None
        if place == STDIN:
            self._file: IO[bytes] = sys.stdin.buffer
        else:
            try:
                self._file = self._owned = Path(place).open("rb")  # noqa: SIM115 -- closed below
            except OSError as error:
                raise InputError(
                    f"no stream '{place}' ({error.strerror})",
                    "a file, a pipe, or - for standard input",
                    "Check the path.",
                ) from None

    def __iter__(self) -> Iterator[bytes]:
        number = _descriptor(self._file)
        while True:
            if number is None:
                piece = self._file.read(PIECE_BYTES)
            else:
                # Not the buffered reader: it would wait for a whole buffer.
                ready, _, _ = select.select([number], [], [], POLL_S)
                if not ready:
                    yield b""
                    continue
                piece = os.read(number, PIECE_BYTES)
            if piece:
                yield piece
            elif self._follow:
                time.sleep(POLL_S)
                yield b""
            else:
                return

    def close(self) -> None:
        """Close the file; standard input stays."""
        if self._owned is not None:
            self._owned.close()


def _descriptor(file: IO[bytes]) -> int | None:
    """What `select` can wait for; None for a stream in memory, or where pipes cannot be waited for.

    On Windows only sockets can: there a read waits for the next bytes.
    """
    if sys.platform == "win32":
        return None
    try:
        return file.fileno()
    except (OSError, ValueError, AttributeError):
        return None

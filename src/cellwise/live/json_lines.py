"""One JSON object per line, as scripts and gateways write them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

from cellwise.live.channels import ObjectReader
from cellwise.live.pieces import Pieces
from cellwise.live.sample import Sample, Stray
from cellwise.logs.files.source import ReadOptions

LONGEST_LINE = 65_536


class JsonLines:
    """``{"time_s": 12.5, "current_A": 1.2, "voltage_V": 3.91, "temperature_C": 25}`` per line."""

    def __init__(self, pieces: Pieces, options: ReadOptions, sign: str, cells: int = 0) -> None:
        self.name = f"JSON lines from {pieces.name}"
        self._pieces = pieces
        self._reader = ObjectReader(options, sign, cells)

    def __iter__(self) -> Iterator[Sample | Stray | None]:
        kept = b""
        for piece in self._pieces:
            if not piece:
                yield None
                continue
            *lines, kept = (kept + piece).split(b"\n")
            arrived_s = time.time()
            for line in lines:
                if line.strip():
                    yield self._read(line, arrived_s)
            if len(kept) > LONGEST_LINE:
                kept = b""
                yield Stray("a line without an end")
        if kept.strip():
            yield self._read(kept, time.time())

    def close(self) -> None:
        """Close what was opened."""
        self._pieces.close()

    def _read(self, line: bytes, arrived_s: float) -> Sample | Stray:
        try:
            found = json.loads(line)
        except (ValueError, RecursionError):
            return Stray("not JSON")
        return self._reader.read(found, arrived_s)

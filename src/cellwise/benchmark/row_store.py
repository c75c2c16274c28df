"""Rows of finished runs in a file, so that a run that was cut off goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class KeptRows:
    """Rows by a key that changes with whatever they depend on.

    Parameters
    ----------
    path : Path or None      of the file, a line for each row; None: nothing is kept
    columns : collection     what a row has to hold to be taken over
    """

    def __init__(self, path: Path | None, columns: Collection[str] = ()) -> None:
        self.rows: dict[str, Row] = {}
        self._path = path
        text = path.read_text(encoding="utf-8") if path is not None and path.is_file() else ""
        self._begin = "\n" if text and not text.endswith("\n") else ""  # after a line cut off
        for line in text.splitlines():
            try:
                kept = json.loads(line)
                if set(columns) <= set(kept["row"]):
                    self.rows[str(kept["key"])] = kept["row"]
            except (ValueError, KeyError, TypeError):  # that line, or another version's
                continue

    def add(self, rows: Mapping[str, Row]) -> None:
        """More finished rows by their keys; each is in the file when this returns."""
        self.rows.update(rows)
        if self._path is not None:
            lines = [json.dumps({"key": key, "row": row}) for key, row in rows.items()]
            with self._path.open("a", encoding="utf-8") as file:
                file.write(self._begin + "".join(f"{line}\n" for line in lines))
            self._begin = ""


def key_of(parts: Any) -> str:
    """A key that changes with any of the parts, which JSON can hold."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:24]

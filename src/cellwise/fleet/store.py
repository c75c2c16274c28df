"""The folder of a fleet's results: parts of parquet, and what they were made with."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.fleet.columns import BY_MACHINE
from cellwise.logs.writing import read_rows, write_rows

MANIFEST = "_fleet.json"
PART = "part-{:06d}.parquet"


def all_rows(place: Path) -> dict[str, list[Any]]:
    """The rows of all parts of a folder of results, column by column."""
    rows: dict[str, list[Any]] = {}
    for part in sorted(place.glob("part-[0-9]*.parquet")):
        for name, values in read_rows(part).items():
            rows.setdefault(name, []).extend(values)
    return rows


class ResultFolder:
    """Parts appear whole or not at all, so whatever ends a run leaves only finished rows.

    Parameters
    ----------
    place : Path
    columns : mapping       name to type, the same in every part
    settings : mapping      JSON values that must be the same when a run goes on
    fresh : bool            start again: drop the parts of another run

    Raises
    ------
    InputError              a folder of something else, or of a run with other settings; a place
                            that cannot be written to
    """

    def __init__(
        self,
        place: Path,
        columns: Mapping[str, type],
        settings: Mapping[str, Any],
        *,
        fresh: bool = False,
    ) -> None:
        self.place = place
        self._columns = columns
        self._settings = dict(settings)
        self._check(fresh)
        self._next = 0

    def begin(self) -> None:
        """Make the folder, if it is not there."""
        made_folder(self.place, "the results")
        text = json.dumps(self._settings, indent=1, sort_keys=True)
        write_atomically(self.place / MANIFEST, text)
        self._next = 1 + max((int(p.stem[5:]) for p in self.parts()), default=-1)

    def parts(self) -> list[Path]:
        """The parts that are there."""
        return sorted(self.place.glob("part-[0-9]*.parquet"))

    def done(
        self, still: Mapping[str, tuple[int, int]], *, retry_failed: bool = False
    ) -> tuple[set[str], set[str]]:
        """Logs that have their row, and those of them whose row is an error.

        Rows of logs that have changed since are dropped, and those of which the machine failed.

        Parameters
        ----------
        still : mapping         log to its size and time of change now
        retry_failed : bool     drop the rows with an error too
        """
        found: set[str] = set()
        wrong: set[str] = set()
        for part in self.parts():
            rows = read_rows(part)
            by = rows.setdefault("failed_by", [None] * len(rows["log"]))
            keys = zip(rows["log"], rows["bytes"], rows["modified_ns"], strict=True)
            keep = [
                still.get(log) in (None, (size, changed))
                and not (retry_failed and error)
                and whose != BY_MACHINE
                for (log, size, changed), error, whose in zip(keys, rows["error"], by, strict=True)
            ]
            kept = {name: [v for v, k in zip(values, keep, strict=True) if k]
                    for name, values in rows.items()}  # fmt: skip
            found.update(kept["log"])
            wrong.update(
                log for log, error in zip(kept["log"], kept["error"], strict=True) if error
            )
            if not kept["log"]:
                part.unlink()
            elif not all(keep):
                write_rows(kept, self._columns, part)
        return found, wrong & set(still)

    def drop(self) -> None:
        """Take away what a run has written, and the folder if nothing else is in it."""
        for path in (*self.parts(), self.place / MANIFEST):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.place.rmdir()

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """One more part."""
        rows = list(rows)
        if not rows:
            return
        table = {name: [row.get(name) for row in rows] for name in self._columns}
        write_rows(table, self._columns, self.place / PART.format(self._next))
        self._next += 1

    def _check(self, fresh: bool) -> None:
        place = self.place
        if place.exists() and not place.is_dir():
            raise InputError(f"a file at '{place}'", "a folder", "Name another one.")
        if not place.is_dir() or not any(place.iterdir()):
            return
        manifest = place / MANIFEST
        if not manifest.is_file():
            raise InputError(
                f"a folder '{place}' that holds something else",
                "an empty folder, or one that this command wrote",
                "Name another one.",
            )
        if fresh:
            for part in self.parts():
                part.unlink()
            return
        try:
            before = json.loads(manifest.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            before = {}
        if before != self._settings:
            wrong = [k for k in self._settings if before.get(k) != self._settings[k]]
            raise InputError(
                f"results in '{place}' of a run with another {', '.join(wrong) or 'setting'}",
                "the settings of that run, to go on with it",
                "Start again with `fresh=True`, or name another folder.",
            )

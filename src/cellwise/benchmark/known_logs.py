"""Logs of a frozen suite: known by what they hold, whatever their files are called."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from cellwise.data import CATALOGUE, list_datasets
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.wording import arg

# Another reader of the same original drops a repeated stamp and rounds in its own way; another
# log differs by more in one of these at least.
ROWS_SHARE = 2e-3
SHARE = 2e-3
SECOND, AMPERE_HOUR, VOLT = 0.1, 2e-3, 2e-3


@dataclass(frozen=True)
class KnownLog:
    """What a log of a frozen suite holds.

    Parameters
    ----------
    log : str                the location by which the suite names it
    original : str           its name in the registry, for whoever has to fetch it
    sha256 : str             of the file that the suite was frozen with
    rows : int
    duration_s : float
    charge_Ah : float        by the tester's counter, last row less first; nan without one
    throughput_Ah : float    of both directions
    lowest_V, mean_V, highest_V : float
    """

    log: str
    sha256: str
    rows: int
    duration_s: float
    charge_Ah: float
    throughput_Ah: float
    lowest_V: float
    mean_V: float
    highest_V: float
    original: str = ""

    @property
    def held(self) -> tuple[float, ...]:
        """What a copy of the log holds as well: rows, duration, charge moved, mean voltage."""
        parts = (self.duration_s, self.throughput_Ah, self.mean_V)
        return (self.rows, *(round(value, 3) for value in parts))


def known_log(location: str, path: Path, original: str = "") -> KnownLog:
    """What a suite that is frozen now says of a log."""
    log = read_log(path)
    return KnownLog(location, file_digest(path), *_content(log), original)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def find_known(known: KnownLog, places: tuple[Path, ...], data: Path | None) -> tuple[Path, bool]:
    """The file that holds a known log, and whether it is that very file.

    Parameters
    ----------
    places : of Path        where its own name may lead to
    data : Path or None     folder of measured data: whatever `cellwise data import` wrote below it
                            is looked through

    Raises
    ------
    InputError              a file of that name that holds something else; none that holds it
    """
    there = next((path for path in places if path.is_file()), None)
    if there is not None:
        if file_digest(there) == known.sha256:
            return there, True
        other = differs(known, read_log(there))
        if other is None:
            return there, False
        raise InputError(
            f"'{there}' with {other}",
            f"the log '{known.log}' that the suite was frozen with",
            "Fetch and import the original again, or name a folder that has it.",
        )
    for path in () if data is None else _imported(data, known):
        if differs(known, read_log(path)) is None:
            return path, False
    name = known.original or "NAME"
    raise InputError(
        f"no file that holds '{known.log}'" + ("" if data is None else f" below '{data}'"),
        f"the rows of it that the suite was frozen with ({known.rows} of {known.duration_s:.0f} s)",
        f"Get it: cellwise data fetch {name} -o raw, cellwise data import {name} raw -o "
        f"DATA/{name}; then " + arg("data", letter="DATA") + ".",
    )


def differs(known: KnownLog, log: CellLog) -> str | None:
    """What of a log is not as it is known; None where it is the same."""
    rows, *found = _content(log)
    if abs(rows - known.rows) > max(2, ROWS_SHARE * known.rows):
        return f"{rows} rows, {known.rows} expected"
    names = [f.name for f in fields(KnownLog)[3:-1]]
    for name, value in zip(names, found, strict=True):
        expected = float(getattr(known, name))
        unit = name.rpartition("_")[2]
        floor = {"s": SECOND, "Ah": AMPERE_HOUR, "V": VOLT}[unit]
        near = abs(value - expected) <= max(floor, SHARE * abs(expected) if unit == "Ah" else 0.0)
        if not near and not (np.isnan(value) and np.isnan(expected)):
            return f"{name.rpartition('_')[0]} {value:.6g} {unit}, {expected:.6g} expected"
    return None


def _content(log: CellLog) -> tuple[int, float, float, float, float, float, float]:
    """The fields of a :class:`KnownLog` that a log has, in order."""
    charge = log.charge_Ah
    counted = float("nan")
    if charge is not None and np.isfinite(charge).any():
        finite = charge[np.isfinite(charge)]
        counted = float(finite[-1] - finite[0])
    moved = float(np.nansum(np.abs(log.interval_current_A) * log.interval_s) / 3600.0)
    voltage = log.voltage_V
    return (
        len(log),
        log.duration_s,
        counted,
        moved,
        float(np.nanmin(voltage)),
        float(np.nanmean(voltage)),
        float(np.nanmax(voltage)),
    )


def _imported(data: Path, known: KnownLog) -> Iterator[Path]:
    """Files below a folder that an import says are as long as a known log."""
    for folder, entries in _catalogues(data):
        for entry in entries:
            rows, duration_s = int(entry["rows"]), float(entry["duration_s"])
            as_long = abs(rows - known.rows) <= max(2, ROWS_SHARE * known.rows)
            if as_long and abs(duration_s - known.duration_s) <= SECOND:
                yield folder / str(entry["file"])


@lru_cache(maxsize=4)
def _catalogues(data: Path) -> list[tuple[Path, list[dict[str, str]]]]:
    return [(p.parent, list_datasets(p.parent)) for p in sorted(data.rglob(CATALOGUE))]

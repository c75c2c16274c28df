"""What each file of a folder is: which test, of how large a cell, read with which options."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.validity import ONE_CELL, cells_in_series
from cellwise.errors import InputError, MachineError
from cellwise.identify.test_kind import kind_of
from cellwise.logs import CellLog, read_log
from cellwise.logs.reading import AS_MEAN_CELL
from cellwise.logs.stated import SUFFIXES, in_order

FLIGHTS = ("px4-ulog", "ardupilot-dataflash")
DATABASES = (".dbc", ".arxml", ".kcd", ".sym")
STEADY = ("ocv", "capacity", "charge")
CAN_LOGS = (".blf", ".asc", ".log", ".trc", ".mf4")
MISSING = re.compile(r"; missing: (.+)$", re.DOTALL)  # columns that a refused table lacks
# A temperature in a name: _p25, _n10, -10degC.
NAMED_C = re.compile(r"[_-]([pn])(\d\d)(?=[_.-]|$)|([-_]|_-)(\d{1,2}) ?deg", re.IGNORECASE)


class _End(NamedTuple):
    """The last per cent of a low-rate test, its dither too: of a whole discharge, and its rates."""

    moved: float = 0.05
    rates: tuple[float, float] = (0.01, 0.5)


END = _End()


@dataclass(frozen=True)
class FoundFile:
    """A file and what it is taken for.

    ``kind``: hppc, ocv, capacity, charge, drive, rest; end (of a low-rate test); pack (a voltage
    for each cell), flight; unread (refused, ``why`` says for what), other (no log by its name).
    ``moved_Ah`` through one string of cells, ``whole_Ah`` by a discharge at one current,
    ``current_A``; ``highest_V`` of one cell; ``usual_C`` as measured, ``named_C`` a temperature
    that only the name states.
    """

    path: Path
    kind: str
    why: str
    series: int = 1
    moved_Ah: float = 0.0
    whole_Ah: float = 0.0
    current_A: float = 0.0
    largest_A: float = 0.0
    highest_V: float = 0.0
    usual_C: float | None = None
    named_C: float | None = None

    @property
    def stated(self) -> str:
        """The path as a command takes it, with the temperature that only its name states."""
        return str(self.path) if self.named_C is None else f"{self.path}@{self.named_C:g}"


def look_at(
    folder: Path, arguments: argparse.Namespace, follow: Callable[..., None]
) -> list[FoundFile]:
    """Every file of a folder, in the order of time; those of folders in it are left alone.

    Raises
    ------
    InputError        no such folder
    """
    if not folder.is_dir():
        raise InputError(f"no folder '{folder}'", "a folder with logs", "Check the path.")
    places = sorted((p for p in folder.iterdir() if p.is_file()), key=in_order)
    places = [p for p in places if p.name[0] not in "._"]
    databases = [p for p in places if p.suffix.lower() in DATABASES]
    dbc = databases[0] if len(databases) == 1 else None
    found = []
    for k, place in enumerate(places):
        follow(f"reading {place.name}", k, len(places))
        found.append(_look_at_one(place, arguments, dbc))
    return [_end_of_test(one, found) for one in found]


def _end_of_test(one: FoundFile, files: list[FoundFile]) -> FoundFile:
    """A slow test that moves hardly anything beside a whole discharge in the folder."""
    low, high = END.rates
    whole = (f.whole_Ah for f in files if f.series == one.series and f.kind in STEADY)
    size = max((w for w in whole if low * w < one.largest_A < high * w), default=0.0)
    if one.kind not in ("hppc", "ocv", "capacity", "drive") or one.moved_Ah >= END.moved * size:
        return one
    share = one.moved_Ah / size
    return replace(one, kind="end", why=f"{share:.1%} of {size:.3g} Ah, slowly: not used")


def _look_at_one(place: Path, arguments: argparse.Namespace, dbc: Path | None) -> FoundFile:
    if not place.name.lower().endswith(SUFFIXES):
        return FoundFile(place, "other", "no log by its name")
    try:
        log, series = _read(place, arguments, dbc)
    except MachineError:
        raise
    except InputError as error:
        return FoundFile(place, "unread", _why_unread(error))
    return replace(_taken_for(log, series, arguments.nominal_ah), path=place)


def _why_unread(error: InputError) -> str:
    """What was found and what to do; of a table that lacks most columns only what it lacks."""
    missing = MISSING.search(error.found)
    if missing is None or "," not in missing[1]:
        return f"{error.found}. {error.action}"
    return f"a table without {missing[1]}: no log"


def _read(place: Path, arguments: argparse.Namespace, dbc: Path | None) -> tuple[CellLog, int]:
    """A log as one cell, and the cells in series that this takes."""
    dbc = dbc if place.suffix.lower() in CAN_LOGS else None
    log = read_log(place, sign=arguments.sign, dbc=dbc)
    if log.typical_voltage_V <= ONE_CELL.largest_V:
        return log, 1
    series = cells_in_series(log, ONE_CELL.full_V)
    return replace(log, voltage_V=log.voltage_V / series), series


def _taken_for(log: CellLog, series: int, nominal_Ah: float | None) -> FoundFile:
    test = kind_of(log, nominal_Ah)
    kind: str = test.kind
    why = test.why if series == 1 else f"{series} cells in series; {test.why}"
    mean = next((n for n in log.notices if AS_MEAN_CELL in n), None)
    moved_Ah = float(np.ptp(log.counted_charge_Ah()))
    if mean is not None:  # what a test is called by its load says nothing of a day on the road
        hours = log.duration_s / 3600.0
        kind = "pack"
        why = f"{mean.partition(',')[0]}; {moved_Ah:.3g} Ah moved within {hours:.3g} h"
    elif log.format in FLIGHTS:
        kind = "flight"
    return FoundFile(
        path=Path(log.source),
        kind=kind,
        why=why,
        series=series,
        moved_Ah=moved_Ah,
        whole_Ah=test.charge_Ah,
        current_A=test.current_A,
        largest_A=float(np.nanmax(np.abs(log.current_A))),
        usual_C=None if log.temperature_C is None else float(np.nanmedian(log.temperature_C)),
        highest_V=float(np.nanmax(log.voltage_V)),
        named_C=_named_C(log),
    )


def _named_C(log: CellLog) -> float | None:
    """The temperature that the name states, of a log that measured none."""
    said = None if log.temperature_C is not None else NAMED_C.search(log.name)
    if said is None:
        return None
    if said[1]:
        return float(said[2]) * (-1.0 if said[1].lower() == "n" else 1.0)
    return float(said[4]) * (-1.0 if said[3].endswith("-") else 1.0)

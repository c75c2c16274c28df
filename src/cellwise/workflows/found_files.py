"""What each file of a folder is: which test, of how large a cell, read with which options."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.validity import FULL_V, cells_in_series
from cellwise.errors import InputError, MachineError
from cellwise.identify.measured_capacity import hppc_reaches_empty
from cellwise.identify.test_kind import kind_of
from cellwise.logs import CellLog, read_log
from cellwise.logs.checks.units import LARGEST_V
from cellwise.logs.files.choice import MissingColumnsError
from cellwise.logs.files.format import SeveralLogsError
from cellwise.logs.stated import SUFFIXES, in_order
from cellwise.notices import Code, coded
from cellwise.wording import arg

FLIGHTS = ("px4-ulog", "ardupilot-dataflash", "blackbox")
DATABASES = (".dbc", ".arxml", ".kcd", ".sym")
CAN_LOGS = (".blf", ".asc", ".log", ".trc", ".mf4")
# A temperature in a name: _p25, _n10, -10degC.
NAMED_C = re.compile(r"[_-]([pn])(\d\d)(?=[_.-]|$)|([-_]|_-)(\d{1,2}) ?deg", re.IGNORECASE)
TESTS = ("hppc", "ocv", "capacity")
# What else lies about, by how its name ends.
OTHERS = {
    **dict.fromkeys(DATABASES, "a database of CAN frames, by which their logs are read"),
    ".jsonl": "samples of a stream: cellwise live " + arg("source", "json:FILE"),
    ".json": "a model, a state or settings",
    **dict.fromkeys((".zip", ".7z", ".tar", ".rar", ".bz2", ".xz"), "an archive: unpack it"),
    **dict.fromkeys((".html", ".pdf", ".docx", ".md", ".rst"), "a document"),
    **dict.fromkeys((".png", ".jpg", ".jpeg", ".svg"), "a picture"),
}
MOST_IN_FILE = 12  # logs of one file that are looked at one by one

# The last per cent of a low-rate test, its dither too.
END_MOVED = 0.05  # of a whole discharge
END_RATES = (0.01, 0.5)  # of that discharge


@dataclass(frozen=True)
class FoundFile:
    """A file and what it is taken for.

    ``kind``: hppc, ocv, capacity, charge, drive, rest; end (of a low-rate test); pack (a voltage
    for each cell), flight; unread (refused, ``why`` says for what), other (no log by its name).
    ``moved_Ah`` through one string of cells, ``whole_Ah`` by a discharge at one current,
    ``current_A``, or by pulses that end empty; ``highest_V`` of one cell; ``usual_C`` as measured,
    ``named_C`` a temperature that only the name states; ``other_sign`` what the current's sign
    would have to mean where the voltage contradicts it; ``instance``: which of several logs in the
    file; ``channels`` the names under which an unread one reads.
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
    other_sign: str = ""
    instance: int | None = None
    channels: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """Of the file, and which of its logs."""
        return self.path.name + ("" if self.instance is None else f"@instance={self.instance}")

    @property
    def stated(self) -> str:
        """The path as a command takes it, with the temperature that only its name states."""
        said = [] if self.named_C is None else [f"{self.named_C:g}"]
        said += [] if self.instance is None else [f"instance={self.instance}"]
        return f"{self.path}@{','.join(said)}" if said else str(self.path)


class FolderContents(NamedTuple):
    """The files of a folder, and the sign by which all of them were read."""

    files: list[FoundFile]
    sign: str


def look_at(
    folder: Path,
    sign: str = "auto",
    nominal_Ah: float | None = None,
    follow: Callable[..., object] = lambda *_: None,
) -> FolderContents:
    """Every file of a folder, in the order of time; those of folders in it are left alone.

    Parameters
    ----------
    sign : str          as of `read_log`; where ``auto`` contradicts all files alike, the other one
    nominal_Ah : float or None    of the cell, by which tests are distinguished
    follow : callable   what is read, how many are, of how many

    Raises
    ------
    InputError        no such folder
    """
    if not folder.is_dir():
        raise InputError(f"no folder '{folder}'", "a folder with logs", "Check the path.")
    places = [p for p in folder.iterdir() if p.is_file() and p.name[0] not in "._"]
    places.sort(key=in_order)
    databases = [p for p in places if p.suffix.lower() in DATABASES]
    dbc = databases[0] if len(databases) == 1 else None

    def read_as(sign: str) -> list[FoundFile]:
        found = []
        for k, place in enumerate(places):
            follow(f"reading {place.name}", k, len(places))
            found += _look_at_one(place, sign, nominal_Ah, dbc)
        return found

    found = read_as(sign)
    others = {one.other_sign for one in found if one.other_sign}
    if sign == "auto" and len(others) == 1:
        again = read_as(other := others.pop())
        if not any(one.other_sign for one in again):
            sign, said = other, f"; {other}, by its voltage"
            found = [
                replace(now, why=now.why + said) if before.other_sign else now
                for before, now in zip(found, again, strict=True)
            ]
    found = [_with_a_wrong_sign(one) if one.other_sign else one for one in found]
    return FolderContents([_end_of_test(one, found) for one in found], sign)


def _with_a_wrong_sign(one: FoundFile) -> FoundFile:
    """Of no use beside files whose sign is another's."""
    why = "the sign of the current looks wrong: read it by itself, with "
    why += arg("sign", one.other_sign)
    return replace(one, kind="unread", why=why)


def _end_of_test(one: FoundFile, files: list[FoundFile]) -> FoundFile:
    """A slow test that moves hardly anything beside a whole discharge in the folder."""
    low, high = END_RATES
    steady = [f for f in files if f.kind in ("ocv", "capacity", "charge")]
    whole = (f.whole_Ah for f in steady if f.series == one.series)
    size = max((w for w in whole if low * w < one.largest_A < high * w), default=0.0)
    if one.kind not in (*TESTS, "drive") or one.moved_Ah >= END_MOVED * size:
        return one
    share = one.moved_Ah / size
    return replace(one, kind="end", why=f"{share:.1%} of {size:.3g} Ah, slowly: not used")


def _look_at_one(
    place: Path, sign: str, nominal_Ah: float | None, dbc: Path | None, nth: int | None = None
) -> list[FoundFile]:
    """A file; where it holds several logs, each of them."""
    if not place.name.lower().endswith(SUFFIXES):
        return [FoundFile(place, "other", OTHERS.get(place.suffix.lower(), "no log by its name"))]
    try:
        dbc = dbc if place.suffix.lower() in CAN_LOGS else None
        log = read_log(place, sign=sign, dbc=dbc, instance=nth)
    except MachineError:
        raise
    except SeveralLogsError as several:
        if not 0 < len(several.numbers) <= MOST_IN_FILE:
            why = f"{len(several.numbers)} logs: `cellwise history` takes all, FILE@instance=K one"
            return [FoundFile(place, "several", why)]
        each = (_look_at_one(place, sign, nominal_Ah, dbc, k) for k in several.numbers)
        return [one for found in each for one in found]
    except InputError as error:
        fitting = error.fitting if isinstance(error, MissingColumnsError) else {}
        named = tuple(fitting.items())
        return [FoundFile(place, "unread", _to_do(error), instance=nth, channels=named)]
    series = 1
    if log.typical_voltage_V > LARGEST_V:
        series = cells_in_series(log, FULL_V)
    found = _taken_for(place, replace(log, voltage_V=log.voltage_V / series), series, nominal_Ah)
    return [replace(found, instance=nth)]


def _to_do(error: InputError) -> str:
    """What a file that was refused is, and the one thing to do about it."""
    if isinstance(error, MissingColumnsError):
        if error.fitting:
            return "a log under other names"
        if len(error.missing) > 1:  # most columns: only what it lacks
            return f"a table without {', '.join(error.missing)}: no log"
    return error.found + ". " + error.action


def _taken_for(place: Path, log: CellLog, series: int, nominal_Ah: float | None) -> FoundFile:
    """What a log of one cell, of so many in series, is."""
    test = kind_of(log, nominal_Ah)
    kind: str = "flight" if log.format in FLIGHTS else test.kind
    why = test.why if series == 1 else f"{series} cells in series; {test.why}"
    moved_Ah = float(np.ptp(log.counted_charge_Ah()))
    whole_Ah = test.charge_Ah
    if kind == "hppc" and hppc_reaches_empty(log):
        whole_Ah = moved_Ah
    for mean in coded(log.notices, Code.PACK_AS_MEAN_CELL):
        # What a test is called by its load says nothing of a day on the road.
        hours = log.duration_s / 3600.0
        kind = "pack"
        why = f"{mean.head}; {moved_Ah:.3g} Ah moved within {hours:.3g} h"
    return FoundFile(
        place,
        kind,
        why,
        series,
        moved_Ah,
        whole_Ah,
        test.current_A,
        largest_A=float(np.nanmax(np.abs(log.current_A))),
        highest_V=float(np.nanmax(log.voltage_V)),
        usual_C=None if log.temperature_C is None else float(np.nanmedian(log.temperature_C)),
        named_C=_named_C(log),
        other_sign=next((str(n.value) for n in coded(log.notices, Code.SIGN_CONTRADICTED)), ""),
    )


def _named_C(log: CellLog) -> float | None:
    """The temperature that the name states, of a log that measured none."""
    said = None if log.temperature_C is not None else NAMED_C.search(log.name)
    if said is None:
        return None
    if said[1]:
        return float(said[2]) * (-1.0 if said[1].lower() == "n" else 1.0)
    return float(said[4]) * (-1.0 if said[3].endswith("-") else 1.0)

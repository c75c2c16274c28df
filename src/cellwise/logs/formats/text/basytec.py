"""Basytec text: lines with a tilde before the rows, between tabs or blanks, charge positive."""

from __future__ import annotations

import numpy as np

from cellwise.logs.files.columns import MILLI, OWN, TURNED, TURNED_MILLI, Channel, Unit
from cellwise.logs.files.csv_layout import has_names, header_cells
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog, decoded
from cellwise.logs.files.text_cells import labels

_UNITS = {"h": Unit(3600.0), "min": Unit(60.0), "s": OWN}
_TIME = {f"{mark}Time[{unit}]": u for unit, u in _UNITS.items() for mark in ("~", "#", "")}
_VOLTAGE = {"U[V]": OWN, "U[mV]": MILLI}
_STATE = labels(Charge=-1.0, Discharge=1.0, Pause=0.0, Rest=0.0)
_DATE = "DateTime"


def _header(source: LogSource) -> str:
    return next((line for line in source.first_lines if "U[" in line and "Time[" in line), "")


def _matches(source: LogSource) -> bool:
    line = _header(source)
    return has_names(source, tuple(_TIME), tuple(_VOLTAGE)) or any(
        name in line.split() for name in _TIME
    )


def _read(source: LogSource, known: Format) -> RawLog:
    line = _header(source)
    if len(header_cells(line)) > 1 and "\t" in line:
        return read_csv(source, known)
    return _read_blanks(source, known, line.split())


def _read_blanks(source: LogSource, known: Format, header: list[str]) -> RawLog:
    """Cells between blanks; a date and its time are two of them."""
    wide = [x for name in header for x in ((name, f"{name} time") if name == _DATE else (name,))]
    limits = Limits.of(source.size)
    deadline = limits.deadline()
    rows: list[list[str]] = []
    skipped = 0
    begun = False
    with source.open() as file:
        for number, raw in enumerate(file):
            cells = decoded(raw).split()
            if not begun:
                begun = cells == header
                continue
            if len(cells) in (len(wide), len(header)):
                rows.append(cells)
            else:
                skipped += bool(cells)
            if number % 10_000 == 0:
                limits.check(deadline, len(rows), source.where)
    names = wide if rows and len(rows[0]) == len(wide) else header
    whole = [row for row in rows if len(row) == len(names)]
    skipped += len(rows) - len(whole)
    arrays = {name: np.array([row[k] for row in whole]) for k, name in enumerate(names)}
    raw_log = channels_of(arrays, source, known)
    said = (f"{skipped} line(s) of another width left out",) if skipped else ()
    return RawLog(raw_log.channels, (*raw_log.notices, *said))


BASYTEC_TEXT = Format(
    name="basytec-text",
    matches=_matches,
    channels=(
        Channel("time_s", _TIME, required=True),
        Channel("current_A", {"I[A]": OWN, "I[mA]": MILLI}, required=True),
        Channel("voltage_V", _VOLTAGE, required=True),
        Channel("temperature_C", {"T1[°C]": OWN, "T1[C]": OWN, "T1[øC]": OWN}),
        Channel("charge_Ah", {"Ah[Ah]": TURNED, "Ah[mAh]": TURNED_MILLI, "mAh[mAh]": TURNED_MILLI}),
        Channel("step", {"Line": OWN}),
        Channel("direction", {"Command": _STATE}),
    ),
    known=(
        *("DataSet", _DATE, f"{_DATE} time", "Date", "Time", "t-Step[h]", "t-Set[h]", "t-Cyc[h]"),
        *("t-Step[s]", "t-Set[s]", "t-Cyc[s]", "State", "Ah-Step", "Ah-Set", "Ah-Ch-Set"),
        *("Ah-Dis-Set", "Ah-Cyc-Charge-0", "Ah-Cyc-Discharge-0", "Wh[Wh]", "R-DC", "R-AC"),
        *("Cyc-Count", "Count", "Set", "Ah-Step[Ah]", "Ah-Set[Ah]", "Ri[Ohm]", "Energy[Wh]"),
    ),
    read=_read,
    sign="charge-positive",
)

"""Workbooks that Arbin's software writes: channels on sheets, the columns of its CSV."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import folded
from cellwise.logs.files.extras import need
from cellwise.logs.files.format import Format, library_at_work
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.arbin import ARBIN_CSV

_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
_INSIDE_XLSX = (b"xl/", b"[Content_Types].xml")
_TIME = {folded(name) for name in ARBIN_CSV.channels[0].names}


def _is_workbook(source: LogSource) -> bool:
    head = source.head
    if head.startswith(_XLSX):
        return any(name in head for name in _INSIDE_XLSX)
    return head.startswith(_XLS)


def _read(source: LogSource, known: Format) -> RawLog:
    calamine = need("python_calamine", "an Excel workbook", "python-calamine")
    with library_at_work(source, "Excel workbook"), source.open() as stream:
        book = calamine.CalamineWorkbook.from_filelike(stream)
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    parts = [rows for rows in sheets.values() if rows and _is_channel(rows[0])]
    if not parts:
        names = ", ".join(list(sheets)[:8])
        raise InputError(
            f"no sheet with Test_Time(s) in {source.where}, which has {names or 'no sheet'}",
            "a workbook as Arbin's software exports it",
            "Export the sheet of the channel as CSV.",
        )
    header = [str(name) for name in parts[0][0]]
    # A long test goes on, on further sheets with the same header.
    rows = [row for part in parts if [str(n) for n in part[0]] == header for row in part[1:]]
    arrays = {
        name: np.array([_number(row[k]) if k < len(row) else np.nan for row in rows])
        for k, name in enumerate(header)
        if name and any(isinstance(row[k], (int, float)) for row in rows[:50] if k < len(row))
    }
    if not rows:
        raise InputError(f"no rows in {source.where}", "rows of numbers", "Check the export.")
    return channels_of(arrays, source, known)


def _is_channel(header: Any) -> bool:
    return bool(_TIME.intersection(folded(str(name)) for name in header))


def _number(cell: Any) -> float:
    return float(cell) if isinstance(cell, (int, float)) else np.nan


ARBIN_EXCEL = Format(
    name="arbin-excel",
    matches=_is_workbook,
    channels=ARBIN_CSV.channels,
    known=ARBIN_CSV.known,
    read=_read,
    sign="charge-positive",
    apart=True,
)

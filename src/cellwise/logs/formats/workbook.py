"""Excel workbooks: a sheet is a table of text like any other, in whatever form its names are."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from io import StringIO
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.choice import MissingColumnsError
from cellwise.logs.files.columns import TIDY_CHANNELS, listed
from cellwise.logs.files.format import Format, detect_format, library_at_work, need
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.notices import Code, Notice

_INSIDE_XLSX = (b"xl/", b"[Content_Types].xml")
_LEAST_ROWS = 2


def in_workbook(known: Format) -> Format:
    """A form of text as it stands in a workbook."""
    return replace(known, name=f"{known.name.rpartition('-')[0]}-excel")


def is_workbook(source: LogSource) -> bool:
    """An Excel workbook, of today's form or the old one."""
    if source.head.startswith(b"PK\x03\x04"):
        return any(name in source.head for name in _INSIDE_XLSX)
    return source.head.startswith(b"\xd0\xcf\x11\xe0")


def workbook(formats: Sequence[Format]) -> Format:
    """The format of workbooks whose sheets are in one of these forms."""
    return Format(
        "excel", is_workbook, TIDY_CHANNELS, _reader(formats), "discharge-positive", isolated=True
    )


def _reader(formats: Sequence[Format]) -> Callable[[LogSource, Format], RawLog]:
    def read(source: LogSource, known: Format) -> RawLog:
        """The first sheet that reads; what goes on on further sheets of the same names."""
        tables = _tables(source)
        refusals: list[tuple[int, InputError]] = []
        for name, rows in tables.items():
            view = source.of_text(_text(rows))
            form = detect_format(view, formats)
            try:
                raw = form.read(view, form)
            except InputError as refusal:
                refusals.append((len(rows), refusal))
                continue
            others = [other for other in tables if other != name]
            text = f"sheet '{name}' was read, not {listed(others)}"
            said = [Notice(Code.SHEET_CHOSEN, text)] if others else []
            return replace(raw.noted(said), form=form.name)
        names = listed(list(tables)) or "none with rows"
        missing = [one for one in refusals if isinstance(one[1], MissingColumnsError)]
        if not missing:
            raise InputError(
                f"no sheet that is a log in {source.where}, whose sheets are {names}"
                + (f" ({refusals[0][1].found})" if refusals else ""),
                "a sheet with columns of time, current and voltage",
                "Export the sheet of the measurement as CSV.",
            )
        raise max(missing, key=lambda one: one[0])[1]

    return read


def _tables(source: LogSource) -> dict[str, list[list[Any]]]:
    """The rows of every sheet; sheets of the same first row are one table."""
    calamine = need("python_calamine", "an Excel workbook", "python-calamine")
    with library_at_work(source, "Excel workbook"), source.open() as stream:
        book = calamine.CalamineWorkbook.from_filelike(stream)
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    tables: dict[str, list[list[Any]]] = {}
    for name, rows in sheets.items():
        first = next((k for k, t in tables.items() if rows and t[0] == rows[0]), None)
        if first is not None:
            tables[first] += rows[1:]
        elif len(rows) > _LEAST_ROWS:
            tables[name] = rows
    return tables


def _text(rows: Sequence[Sequence[Any]]) -> str:
    out = StringIO()
    csv.writer(out, lineterminator="\n").writerows([_cell(cell) for cell in row] for row in rows)
    return out.getvalue()


def _cell(cell: Any) -> str:
    """A cell as text: dates and clocks as they are written, numbers to their last digit."""
    if isinstance(cell, datetime):
        return cell.isoformat(" ")
    if isinstance(cell, timedelta):
        seconds = cell.total_seconds()
        return f"{int(seconds // 3600)}:{int(seconds // 60) % 60:02d}:{np.mod(seconds, 60.0):09.6f}"
    return str(cell)

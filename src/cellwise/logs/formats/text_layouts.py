"""Texts that are more than a header and rows: Basytec between blanks, Neware's levels, LeafSpy."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.csv_layout import has_names, header_cells
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.named_columns import channels_of
from cellwise.logs.files.source import LogSource, RawLog, decoded
from cellwise.logs.formats.column_maps import mapped, marks

LOOK_ROWS = 10_000  # between two looks at the limits


def _lines(source: LogSource) -> Iterator[str]:
    """The lines of a text, within the limits of reading."""
    limits = Limits.of(source.size)
    deadline = limits.deadline()
    with source.open() as file:
        for number, line in enumerate(file):
            if number % LOOK_ROWS == 0:
                limits.check(deadline, number, source.where)
            yield decoded(line)


# Basytec: lines with a tilde before the rows, cells between tabs or blanks.
_DATE = "DateTime"


def _basytec_header(source: LogSource) -> str:
    return next((line for line in source.first_lines if "U[" in line and "Time[" in line), "")


def _is_basytec(source: LogSource) -> bool:
    channels = {c.field: c.names for c in BASYTEC_TEXT.channels}
    return has_names(source, channels["time_s"], channels["voltage_V"]) or any(
        name in _basytec_header(source).split() for name in channels["time_s"]
    )


def _read_basytec(source: LogSource, known: Format) -> RawLog:
    line = _basytec_header(source)
    if "\t" in line:
        return read_csv(source, known)
    header = line.split()
    # A date and its time are two cells between blanks.
    wide = [x for name in header for x in ((name, f"{name} time") if name == _DATE else (name,))]
    rows = (text.split() for text in _lines(source))
    next((cells for cells in rows if cells == header), None)
    below = [cells for cells in rows if cells]
    first = next((cells for cells in below if len(cells) in (len(wide), len(header))), header)
    names = wide if len(first) == len(wide) else header
    whole = [cells for cells in below if len(cells) == len(names)]
    arrays = {name: np.array([row[k] for row in whole]) for k, name in enumerate(names)}
    raw = channels_of(arrays, source, known)
    skipped = len(below) - len(whole)
    return raw.noted([f"{skipped} line(s) of another width left out"] if skipped else [])


BASYTEC_TEXT = mapped("basytec-text", matches=_is_basytec, read=_read_basytec)


# Neware's levels: a row for a cycle, below it its steps, below these their records. The first step
# of a cycle may stand in the row of the cycle, behind its cells.
_CYCLE, _STEP, _RECORD = (
    ("Cycle ID", "Cycle Index"),
    ("Step ID", "Step Index"),
    ("Record ID", "DataPoint", "Record Index"),
)
_STEP_NAMES = ("Step Name", "Step Type", "State")


def _level_headers(source: LogSource) -> list[list[str]] | None:
    """The three header lines; None of another file."""
    lines = [line for line in source.first_lines[:6] if line]
    if len(lines) < 3:
        return None
    rows = [[cell.strip() for cell in header_cells(line)] for line in lines[:3]]
    for level, (row, wanted) in enumerate(zip(rows, (_CYCLE, _STEP, _RECORD), strict=True)):
        if len(row) <= level or row[level] not in wanted or any(row[:level]):
            return None
    return rows


def _read_levels(source: LogSource, known: Format) -> RawLog:
    cycle_header, step_header, header = _level_headers(source) or ([], [], [])
    cycle_cells = max((k + 1 for k, name in enumerate(cycle_header) if name), default=0)
    place = next((k for k, name in enumerate(step_header) if name in _STEP_NAMES), None)
    columns = {name: k for k, name in enumerate(header) if name}
    cells: dict[str, list[str]] = {name: [] for name in columns}
    steps: list[float] = []
    states: list[str] = []
    step, state = 0, ""
    for row in _level_rows(source, len(header)):
        if row[0]:
            row = ["", *row[cycle_cells:], ""]
            if not row[1]:
                continue
        if row[1]:
            step += 1
            state = row[place] if place is not None and place < len(row) else ""
        elif row[2]:
            for name, k in columns.items():
                cells[name].append(row[k] if k < len(row) else "")
            steps.append(step)
            states.append(state)
    arrays = {name: _numbers(values) for name, values in cells.items()}
    arrays["Step Index"] = np.array(steps)
    if place is not None:
        arrays["Step Type"] = np.array(states)
    return channels_of(arrays, source, known)


def _level_rows(source: LogSource, width: int) -> Iterator[list[str]]:
    """Cells of the rows below the headers."""
    delimiter = max(",;\t", key=source.first_lines[2].count)
    try:
        for number, row in enumerate(csv.reader(_lines(source), delimiter=delimiter)):
            if number >= 3 and len(row) >= 3:
                yield [cell.strip() for cell in row]
    except csv.Error as error:
        raise InputError(
            f"text in {source.where} that cannot be read as a table ({error})",
            f"rows of {width} cells",
            "Check the export.",
        ) from None


def _numbers(values: list[str]) -> np.ndarray:
    """Numbers where all cells are, else the texts."""
    try:
        return np.array([float(v) if v not in ("", "-", "--") else np.nan for v in values])
    except ValueError:
        return np.array(values)


NEWARE_LEVELS = mapped(
    "neware-levels",
    matches=lambda source: _level_headers(source) is not None,
    read=_read_levels,
)


def _read_leafspy(source: LogSource, known: Format) -> RawLog:
    """The pack's channels, and how many cells in series the header names."""
    raw = read_csv(source, known)
    header = next(line for line in source.first_lines if "Pack Amps" in line or "Pack amps" in line)
    cells = sum(bool(re.fullmatch(r"CP\d+", name.strip())) for name in header_cells(header))
    return replace(raw, cells=cells or None)


LEAFSPY_CSV = mapped("leafspy-csv", read=_read_leafspy)


def _is_mpt(source: LogSource) -> bool:
    lines = source.first_lines
    begins = ("EC-Lab ASCII FILE", "BT-Lab ASCII FILE")
    if lines and lines[0].lstrip("\ufeff").startswith(begins):
        return True
    return has_names(source, *marks("biologic"))


BIOLOGIC_MPT = mapped("biologic", "biologic-mpt", matches=_is_mpt)

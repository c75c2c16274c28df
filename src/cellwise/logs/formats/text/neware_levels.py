"""Neware CSV of three levels: a row for a cycle, below it its steps, below these their records.

The first step of a cycle may stand in the row of the cycle, behind its cells.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import MILLI, OWN, Channel
from cellwise.logs.files.csv_layout import header_cells
from cellwise.logs.files.format import Format
from cellwise.logs.files.limits import Limits
from cellwise.logs.files.named_arrays import channels_of
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.formats.neware import NEWARE_CSV

_CYCLE, _STEP, _RECORD = (
    ("Cycle ID", "Cycle Index"),
    ("Step ID", "Step Index"),
    ("Record ID", "DataPoint", "Record Index"),
)
_STEP_NAMES = ("Step Name", "Step Type", "State")
_CHARGED = {"Capacitance_Chg(mAh)": MILLI, "Cap_Chg(mAh)": MILLI, "Capacitance_Chg(Ah)": OWN}
_DISCHARGED = {"Capacitance_DChg(mAh)": MILLI, "Cap_DChg(mAh)": MILLI, "Capacitance_DChg(Ah)": OWN}


def _headers(source: LogSource) -> list[list[str]] | None:
    """The three header lines; None of another file."""
    lines = [line for line in source.first_lines[:6] if line]
    if len(lines) < 3:
        return None
    rows = [[cell.strip() for cell in header_cells(line)] for line in lines[:3]]
    for level, (row, wanted) in enumerate(zip(rows, (_CYCLE, _STEP, _RECORD), strict=True)):
        if len(row) <= level or row[level] not in wanted or any(row[:level]):
            return None
    return rows


def _read(source: LogSource, known: Format) -> RawLog:
    cycle_header, step_header, header = _headers(source) or ([], [], [])
    cycle_cells = max((k + 1 for k, name in enumerate(cycle_header) if name), default=0)
    place = next((k for k, name in enumerate(step_header) if name in _STEP_NAMES), None)
    names = [name for name in header if name]
    columns = [k for k, name in enumerate(header) if name]
    cells: list[list[str]] = [[] for _ in columns]
    steps: list[float] = []
    states: list[str] = []
    step, state = 0, ""
    for row in _rows(source, len(header)):
        if row[0]:
            row = ["", *row[cycle_cells:], ""]
            if not row[1]:
                continue
        if row[1]:
            step += 1
            state = row[place] if place is not None and place < len(row) else ""
            continue
        if not row[2]:
            continue
        for into, k in zip(cells, columns, strict=True):
            into.append(row[k] if k < len(row) else "")
        steps.append(step)
        states.append(state)
    arrays = {name: _numbers(values) for name, values in zip(names, cells, strict=True)}
    arrays["Step Index"] = np.array(steps)
    if place is not None:
        arrays["Step Type"] = np.array(states)
    return channels_of(arrays, source, known)


def _rows(source: LogSource, width: int) -> Iterator[list[str]]:
    """Cells of the rows below the headers."""
    limits = Limits.of(source.size)
    deadline = limits.deadline()
    delimiter = max(",;\t", key=source.first_lines[2].count)
    with io.TextIOWrapper(source.open(), encoding="utf-8", errors="replace", newline="") as file:
        try:
            for number, row in enumerate(csv.reader(file, delimiter=delimiter)):
                if number % 10_000 == 0:
                    limits.check(deadline, number, source.where)
                cells = [cell.strip() for cell in row]
                if number < 3 or len(cells) < 3:
                    continue
                yield cells
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


def _channels() -> Iterator[Channel]:
    for channel in NEWARE_CSV.channels:
        if channel.field == "charged_Ah":
            yield Channel("charged_Ah", {**channel.names, **_CHARGED})
        elif channel.field == "discharged_Ah":
            yield Channel("discharged_Ah", {**channel.names, **_DISCHARGED})
        elif channel.field == "temperature_C":
            yield Channel("temperature_C", {**channel.names, "Temperature(C)": OWN})
        else:
            yield channel


NEWARE_LEVELS = Format(
    name="neware-levels",
    matches=lambda source: _headers(source) is not None,
    channels=tuple(_channels()),
    known=(
        *(NEWARE_CSV.known or ()),
        *("Engy_Chg(mWh)", "Engy_DChg(mWh)", "DCIR(O)", "Capacity Density(mAh/g)", "Avg-T(C)"),
        *("Contact IR(O)", "Channel", "CmpCap(mAh/g)"),
    ),
    read=_read,
    sign="charge-positive",
)

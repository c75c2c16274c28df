"""Where a text table's rows begin and end, what separates its cells, how numbers are written."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from cellwise.errors import InputError
from cellwise.logs.files.columns import folded
from cellwise.logs.files.source import FROM_FILE, LogSource, decoded

DELIMITERS = ",;\t|"
MOST_UNIT_ROWS = 2
MOST_FOOTER_LINES = 20

DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
DIGIT_FIRST = re.compile(r"\s*[-+.]?\d")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")


@dataclass(frozen=True)
class CsvLayout:
    """How one CSV file is laid out.

    ``offset`` is the first byte of the rows, ``line`` the (1-based) line they begin in.
    """

    header: tuple[str, ...]
    delimiter: str
    decimal: str
    offset: int
    line: int


def csv_layout(source: LogSource) -> CsvLayout:
    """Find header, delimiter and decimal sign in the first bytes of a file.

    A byte order mark, blank lines and comment lines beginning with ``#`` may stand before the
    header; where there is no header but a commented one, that is taken.

    Raises
    ------
    InputError        no line with column names
    """
    lines = _head_lines(source.head)
    offset, number, comment = 0, 0, ""
    for raw in lines:
        text = raw.decode("utf-8", errors="replace").lstrip("\ufeff").strip()
        if text and not text.startswith("#"):
            break
        comment = text or comment
        offset += len(raw)
        number += 1
    else:
        raise InputError(
            f"only blank lines and comments at the beginning of '{source.path}'",
            "a line with column names and rows of numbers",
            "Check the export that wrote it.",
        )
    header_line, rows = text, lines[number:]
    if is_numeric(text):
        header_line = comment.lstrip("# ")
        if not header_line or is_numeric(header_line):
            raise InputError(
                f"no column names in '{source.path}': its first row reads '{text[:60]}'",
                "a first line with the names time_s, current_A, voltage_V",
                "Put a line with the column names at the top.",
            )
    else:
        offset += len(lines[number])
        number += 1
        rows = lines[number:]
    delimiter = _delimiter(header_line)
    header = next(csv.reader([header_line], delimiter=delimiter, skipinitialspace=True))
    cells = [row for row in _cells(rows[:50], delimiter) if row]
    decimal = _decimal(cells, delimiter, source.options.decimal)
    return CsvLayout(_as_wide(header, cells), delimiter, decimal, offset, number + 1)


def native_layout(source: LogSource, names: Collection[str]) -> CsvLayout:
    """Find the header below a program's own preamble: the line with most of the names it knows.

    Rows between the header and the first row with a digit (units) are passed over.

    Parameters
    ----------
    source : LogSource
    names : collection of str       column names of the format

    Raises
    ------
    InputError        no line holds two of them
    """
    wanted = {folded(name) for name in names}
    lines = _head_lines(source.head)
    best, found, header = 1, -1, list[str]()
    for k, raw in enumerate(lines):
        names_there = header_cells(decoded(raw))
        score = len(wanted.intersection(folded(name) for name in names_there))
        if score > best:
            best, found, header = score, k, names_there
    if found < 0:
        raise InputError(
            f"no line with column names at the beginning of '{source.path}'",
            "a header line",
            "Check the export that wrote it.",
        )
    first = found + 1
    units = 0
    while first < len(lines) and units <= MOST_UNIT_ROWS and not _has_digit(lines[first]):
        units += bool(lines[first].strip())
        first += 1
    delimiter = _delimiter(decoded(lines[found]))
    cells = [row for row in _cells(lines[first : first + 50], delimiter) if any(row)]
    offset = sum(len(raw) for raw in lines[:first])
    decimal = _decimal(cells, delimiter, source.options.decimal)
    return CsvLayout(_as_wide(header, cells), delimiter, decimal, offset, first + 1)


def first_cells(source: LogSource, layout: CsvLayout) -> list[list[str]]:
    """Cells of the first rows below the header, as text."""
    rows = _head_lines(source.head[layout.offset :])[:50]
    return [row for row in _cells(rows, layout.delimiter) if any(row)]


def footer_below(
    source: LogSource, layout: CsvLayout, place: int, text: str
) -> tuple[int, str] | None:
    """Where lines below the data begin, of which the first has this text in its cell ``place``.

    Returns
    -------
    (int, str)      first byte of that line, and the line
    None            it is not there, or numbers follow: a row among the data
    """
    sought = text.strip().encode()
    end, first, lines = 0, "", 0
    with source.open() as file:
        file.read(layout.offset)
        at = layout.offset
        for raw in file:
            if first or sought in raw:
                cells = next(csv.reader([decoded(raw)], delimiter=layout.delimiter), [])
                cell = cells[place].strip() if place < len(cells) else ""
                if DIGIT_FIRST.match(decoded(raw)):
                    if first or cell == text.strip():
                        return None  # a row of the data
                elif not first and cell == text.strip():
                    end, first = at, decoded(raw).strip()
                elif lines == MOST_FOOTER_LINES:
                    return None
                lines += bool(first)
            at += len(raw)
    return (end, first) if first else None


def header_cells(line: str) -> list[str]:
    """The cells of a line, by the delimiter it has most of."""
    text = line.rstrip("\r\n").lstrip("\ufeff")
    return next(csv.reader([text], delimiter=_delimiter(text), skipinitialspace=True), [])


def header_names(source: LogSource, names: Collection[str]) -> int:
    """Most of these names that one of a text's first lines holds."""
    wanted = {folded(name) for name in names}
    return max(
        (len(wanted.intersection(map(folded, header_cells(line)))) for line in source.first_lines),
        default=0,
    )


def has_names(source: LogSource, *groups: Collection[str]) -> bool:
    """One of a text's first lines holds a name of each group."""
    sought = [{folded(name) for name in group} for group in groups]
    for line in source.first_lines:
        text = folded(line)
        if all(any(name in text for name in group) for group in sought):
            cells = {folded(cell) for cell in header_cells(line)}
            if all(group & cells for group in sought):
                return True
    return False


def _as_wide(header: Sequence[str], cells: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """A header as wide as the rows, where only one of the two ends with a delimiter."""
    wide = len(header)
    if cells and all(len(row) == wide + 1 and not row[-1].strip() for row in cells):
        return (*header, "")
    if cells and not header[-1].strip() and all(len(row) == wide - 1 for row in cells):
        return tuple(header[:-1])
    return tuple(header)


def _delimiter(line: str) -> str:
    return max(DELIMITERS, key=line.count)


def _has_digit(line: bytes) -> bool:
    return any(48 <= byte <= 57 for byte in line)


def _head_lines(head: bytes) -> list[bytes]:
    """Lines with their ends; a cut off last one only if it is the only one."""
    lines = head.splitlines(keepends=True)
    if len(lines) > 1 and not lines[-1].endswith((b"\n", b"\r")):
        return lines[:-1] if len(lines) > 2 else lines
    return lines


def _cells(rows: Sequence[bytes], delimiter: str) -> list[list[str]]:
    text = [row.decode("utf-8", errors="replace") for row in rows]
    return list(csv.reader(text, delimiter=delimiter))


def _decimal(cells: Sequence[Sequence[str]], delimiter: str, stated: str) -> str:
    """As stated, else a comma where cells are written so and none has a decimal point.

    Between commas a cell can only hold one in quotation marks.
    """
    if stated != FROM_FILE:
        return stated
    flat = [cell.strip() for row in cells for cell in row]
    commas = any(DECIMAL_COMMA.fullmatch(cell) for cell in flat)
    points = any("." in cell and _NUMBER.fullmatch(cell) for cell in flat)
    return "," if commas and not points else "."


def is_numeric(line: str) -> bool:
    """Every cell of the line is a number or empty."""
    cells = [cell.strip() for cell in re.split(r"[,;\t|]", line)]
    return any(cells) and all(not c or _NUMBER.fullmatch(c) for c in cells)

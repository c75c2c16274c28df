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
FOOTER_BYTES = 8192
LOOKED_AT = 50  # rows below the header

DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_DIGIT_FIRST = re.compile(r"\s*[-+.]?\d")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")


@dataclass(frozen=True)
class CsvLayout:
    """How one CSV file is laid out.

    ``offset`` is the first byte of the rows; ``cells`` are those of the first rows, as text.
    """

    header: tuple[str, ...]
    delimiter: str
    decimal: str
    offset: int
    cells: tuple[tuple[str, ...], ...]


def csv_layout(source: LogSource, names: Collection[str] = ()) -> CsvLayout:
    """Find header, delimiter and decimal sign in the first bytes of a file.

    The header is the line with most of ``names``, which a program's own export has below whatever
    preamble, and rows of units below it are passed over. Without two of these it is the first line
    that is not blank and no comment (``#``), or the comment above rows of numbers.

    Raises
    ------
    InputError        no line with column names
    """
    lines = _head_lines(source.head)
    texts = [decoded(raw.removeprefix(b"\xef\xbb\xbf")) for raw in lines]
    at, line = _first_names(texts)
    if (best := _most_names(texts, names)) is not None:
        at, line = best, texts[best]
    if at is None or not line:
        shown = next((text.strip() for text in texts if text.strip("# \r\n")), "")
        raise InputError(
            f"no column names in '{source.path}', which begins with '{shown[:60]}'"
            if shown and not shown.startswith("#")
            else f"only blank lines and comments at the beginning of '{source.path}'",
            "a line with the names time_s, current_A, voltage_V and rows of numbers",
            "Put a line with the column names at the top, or check the export that wrote it.",
        )
    first = at + 1
    while names and first < min(len(lines), at + 2 + MOST_UNIT_ROWS) and not _digits(texts[first]):
        first += 1
    delimiter = _delimiter(line)
    rows = csv.reader(texts[first : first + LOOKED_AT], delimiter=delimiter)
    cells = tuple(tuple(row) for row in rows if any(row))
    return CsvLayout(
        _as_wide(header_cells(line), cells),
        delimiter,
        _decimal(cells, source.options.decimal),
        sum(len(raw) for raw in lines[:first]),
        cells,
    )


def _most_names(texts: Sequence[str], names: Collection[str]) -> int | None:
    """The line with most of the names, two at least."""
    wanted = {folded(name) for name in names}
    scores = [len(wanted.intersection(map(folded, header_cells(text)))) for text in texts]
    best = max(scores, default=0)
    return scores.index(best) if best > 1 else None


def _first_names(texts: Sequence[str]) -> tuple[int | None, str]:
    """The line above the rows, and the names: its own, or the comment's that it is."""
    comment = ""
    for k, line in enumerate(texts):
        text = line.strip()
        if text and not text.startswith("#"):
            if not is_numeric(text):
                return k, text
            name = comment.lstrip("# ")
            return k - 1, "" if is_numeric(name) else name
        comment = text or comment
    return None, ""


def data_end(source: LogSource, layout: CsvLayout, place: int) -> tuple[int | None, str]:
    """Where lines below the data begin [byte], and the first of them; None: there are none.

    They begin with no number and have none in the cell ``place``, which is that of the time. Of a
    packed file the end is not known beforehand.
    """
    if source.gzipped:
        return None, ""
    with source.path.open("rb") as file:
        file.seek(max(layout.offset, source.size - FOOTER_BYTES))
        lines = file.read().splitlines(keepends=True)
    end, first, count = source.size, "", 0
    for raw in reversed(lines):
        text = decoded(raw)
        cells = next(csv.reader([text], delimiter=layout.delimiter), [])
        time = cells[place] if place < len(cells) else ""
        if _DIGIT_FIRST.match(text) or _DIGIT_FIRST.match(time):
            return (end, first) if first else (None, "")
        end -= len(raw)
        count += bool(text.strip())
        first = text.strip() or first
        if count > MOST_FOOTER_LINES:
            break
    return None, ""


def header_cells(line: str) -> list[str]:
    """The cells of a line, by the delimiter it has most of."""
    text = line.rstrip("\r\n").lstrip("\ufeff")
    return next(csv.reader([text], delimiter=_delimiter(text), skipinitialspace=True), [])


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


def _digits(line: str) -> bool:
    return any(character in "0123456789" for character in line)


def _head_lines(head: bytes) -> list[bytes]:
    """Lines with their ends; a cut off last one only if it is the only one."""
    lines = head.splitlines(keepends=True)
    cut = len(lines) > 2 and not lines[-1].endswith((b"\n", b"\r"))
    return lines[:-1] if cut else lines


def _decimal(cells: Sequence[Sequence[str]], stated: str) -> str:
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

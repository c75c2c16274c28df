"""Lines of a text: which are names, which are rows, what stands between their cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from functools import cache

from cellwise.logs.files.columns import REQUIRED, folded
from cellwise.logs.files.source import MOST_HEADER_LINES, LogSource, lines_of
from cellwise.logs.files.words import PART, is_unit, likeness

DELIMITERS = ",;\t|"
NO_DELIMITER = re.compile(r",(?= )|(?<=\d),(?=\d)")
MOST_NAME_ROWS = 3
DIGIT_FIRST = re.compile(r"\s*[-+.]?\d")
NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")
_DATE_AND_CLOCK = re.compile(r"(\d[-./]\d+[-./]\d+) (\d+:\d)")


def most_names(texts: Sequence[str], names: Collection[str]) -> int | None:
    """The line with most of the names, two at least."""
    wanted = {folded(name) for name in names}
    if len(wanted) < 2:  # thousands of lines are not cut into cells for nothing
        return None
    scores = [len(wanted.intersection(map(folded, header_cells(text)))) for text in texts]
    best = max(scores, default=0)
    return scores.index(best) if best > 1 else None


def first_names(texts: Sequence[str]) -> tuple[int | None, str]:
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


def has_rows(texts: Sequence[str], at: int | None, line: str) -> bool:
    """The line below the names is a row of values, or there is none."""
    below = [] if at is None else [text for text in texts[at + 1 :] if text.strip()][:1]
    return not below or (
        below[0].count(delimiter_of(line)) > 0
        and abs(below[0].count(delimiter_of(line)) - line.count(delimiter_of(line))) <= 1
        and _values(header_cells(below[0])) > 0
    )


def quantities(names: Sequence[str]) -> int:
    """Of how many needed channels some name speaks."""
    return sum(any(likeness(field, name) >= PART for name in names) for field in REQUIRED)


def between_tabs(source: LogSource) -> LogSource:
    """A text whose cells stand between blanks, with tabs; another text as it is."""
    rows = [line.split() for line in source.first_lines]
    for j in range(1, len(rows) - 2):
        cells, *others = map(_joined_dates, source.first_lines[j : j + 3])
        width = len(cells.split())
        if width < 2 or _values(cells.split()) < width - 1 or any(d in cells for d in DELIMITERS):
            continue
        if all(len(other.split()) == width for other in others):
            lines = map(_joined_dates, lines_of(source))
            apart = (
                re.split(r"\s{2,}|\t", t) if len(t.split()) != width else t.split() for t in lines
            )
            return source.of_text("\n".join("\t".join(cells) for cells in apart))
    return source


def _joined_dates(line: str) -> str:
    """A line without blanks between a date and its clock."""
    return _DATE_AND_CLOCK.sub(r"\1T\2", line.strip())


def _values(cells: Sequence[str]) -> int:
    return sum(bool(DIGIT_FIRST.match(cell)) for cell in cells)


def above_rows(texts: Sequence[str]) -> tuple[str, int, list[str]] | None:
    """Delimiter, first of the first rows of numbers, and the names above them."""

    @cache
    def cells_of(k: int) -> tuple[str, list[str]]:
        return delimiter_of(texts[k]), header_cells(texts[k])

    for j in range(1, min(len(texts), MOST_HEADER_LINES) - 1):
        delimiter, cells = cells_of(j)
        if not all(
            len(row) == len(cells) > 1 and _values(row) > 1 and other == delimiter
            for other, row in map(cells_of, range(j, min(j + 3, len(texts))))
        ):
            continue
        stack: list[list[str]] = []
        above = j
        while above > 0 and not texts[above - 1].strip():
            above -= 1
        for text in reversed(texts[max(0, above - 1 - MOST_NAME_ROWS) : above]):
            row = next(
                csv.reader([text.strip("\r\n")], delimiter=delimiter, skipinitialspace=True), []
            )
            fits = abs(len(row) - len(cells)) <= 1 and any(cell.strip() for cell in row)
            if not fits or _values(row) > 1:
                break
            stack.insert(0, [*(cell.strip() for cell in row), ""][: len(cells)])
        if stack:
            return delimiter, j, _joined(stack)
    return None


def _joined(stack: Sequence[Sequence[str]]) -> list[str]:
    """One name for each column of several lines: what stands above it, its name, its unit."""
    rows = list(stack)
    units = [""] * len(rows[0])
    plain = [cell.strip("()[] ") for cell in rows[-1]]
    known = sum(is_unit(cell) for cell in plain if cell)
    if len(rows) > 1 and known and 2 * known >= sum(map(bool, plain)):
        units = plain
        rows.pop()
    names = []
    for k, unit in enumerate(units):
        name = " ".join(dict.fromkeys(row[k] for row in rows if row[k]))
        names.append(f"{name} ({unit})" if unit and name else name)
    return names


def header_cells(line: str) -> list[str]:
    """The cells of a line, by the delimiter it has most of."""
    text = line.rstrip("\r\n").lstrip("\ufeff")
    return next(csv.reader([text], delimiter=delimiter_of(text), skipinitialspace=True), [])


def has_names(source: LogSource, *groups: Collection[str]) -> bool:
    """One of a text's first lines holds a name of each group."""
    sought = [{folded(name) for name in group} for group in groups]
    for line, text in zip(source.first_lines, source.folded_lines, strict=True):
        if all(any(name in text for name in group) for group in sought):
            cells = {folded(cell) for cell in header_cells(line)}
            if all(group & cells for group in sought):
                return True
    return False


def delimiter_of(line: str) -> str:
    """The delimiter that a line has most of.

    Beside another one a comma before a blank is part of a name (`Zeit, s;Spannung, V`), and one
    between digits a decimal comma.
    """
    others = any(mark in line for mark in DELIMITERS if mark != ",")
    return max(DELIMITERS, key=(NO_DELIMITER.sub("", line) if others else line).count)


def is_numeric(line: str) -> bool:
    """Every cell of the line is a number or empty."""
    cells = [cell.strip() for cell in re.split(r"[,;\t|]", line)]
    return any(cells) and all(not c or NUMBER.fullmatch(c) for c in cells)

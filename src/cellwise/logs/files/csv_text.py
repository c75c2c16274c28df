"""CSV as testers, spreadsheets and programs write it: its layout, its rows in record batches."""

from __future__ import annotations

import csv
import re
import zlib
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cellwise.errors import InputError
from cellwise.logs.files.choice import choose_columns, has_days, says_its_sign
from cellwise.logs.files.columns import CLOCK, ChosenColumn, folded
from cellwise.logs.files.format import Format, without_late_errors
from cellwise.logs.files.header import (
    DIGIT_FIRST,
    NUMBER,
    above_rows,
    between_tabs,
    delimiter_of,
    first_names,
    has_rows,
    header_cells,
    is_numeric,
    most_names,
    quantities,
)
from cellwise.logs.files.source import (
    FROM_FILE,
    LogSource,
    RawLog,
    ReadLimits,
    TimedStream,
    damaged_gzip,
    decoded,
)
from cellwise.logs.files.tables import LOOKED_AT, arrow_type, column_values
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from pyarrow.csv import InvalidRow

MOST_UNIT_ROWS = 2
MOST_FOOTER_LINES = 20
FOOTER_BYTES = 8192

BLOCK_BYTES = 4 << 20
MOST_ODD_ROWS = 100
_TIMES = ("time_s", "step_time_s")
_OF_CLOCK = re.compile(r"\d:\d\d")
# What loggers and spreadsheets write where there is no value.
MISSING = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "none", "None", "NA", "N/A", "n/a"]
MISSING += ["#N/A", "#NA", "#DIV/0!", "#VALUE!", "-", "--", "---", " -", "unavailable", "unknown"]

DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_DIGIT = re.compile(r"[0-9]")


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
    that is not blank and no comment (``#``), or the comment above rows of numbers; where no row of
    numbers follows it, the lines above the first rows of numbers that have as many cells: names,
    a row of units below them, what is named above them.

    Raises
    ------
    InputError        no line with column names
    """
    lines = _head_lines(source.head)
    texts = [decoded(raw.removeprefix(b"\xef\xbb\xbf"), source.encoding) for raw in lines]
    at, line = first_names(texts)
    best = most_names(texts, names)
    above = None if best is not None else above_rows(texts)
    if above is not None and has_rows(texts, at, line):
        own = header_cells(line)
        better = len(above[2]) > len(own) or quantities(above[2]) > quantities(own)
        above = above if better else None
    if best is not None:
        at, line = best, texts[best]
    if above is None and (at is None or not line):
        shown = next((text.strip() for text in texts if text.strip("# \r\n")), "")
        raise InputError(
            f"no column names in '{source.path}', which begins with '{shown[:60]}'"
            if shown and not shown.startswith("#")
            else f"only blank lines and comments at the beginning of '{source.path}'",
            "a line with the names time_s, current_A, voltage_V and rows of numbers",
            "Put a line with the column names at the top, or check the export that wrote it.",
        )
    if above is not None:
        delimiter, first, header = above
    else:
        first, last = (at or 0) + 1, min(len(lines), (at or 0) + 2 + MOST_UNIT_ROWS)
        while best is not None and first < last and not _DIGIT.search(texts[first]):
            first += 1
        delimiter, header = delimiter_of(line), header_cells(line)
    rows = csv.reader(texts[first : first + LOOKED_AT], delimiter=delimiter)
    cells = tuple(tuple(row) for row in rows if any(row))
    return CsvLayout(
        _as_wide(header, cells),
        delimiter,
        _decimal(cells, source.options.decimal),
        sum(len(raw) for raw in lines[:first]),
        cells,
    )


def data_end(source: LogSource, layout: CsvLayout, place: int) -> tuple[int | None, str]:
    """Where lines below the data begin [byte], and the first of them; None: there are none.

    They begin with no number and have none in the cell ``place``, which is that of the time. Of a
    packed file the end is not known beforehand.
    """
    if source.gzipped:
        return None, ""
    with source.raw() as file:
        file.seek(max(layout.offset, source.size - FOOTER_BYTES))
        lines = file.read().splitlines(keepends=True)
    end, first, count = source.size, "", 0
    for raw in reversed(lines):
        text = decoded(raw, source.encoding)
        cells = next(csv.reader([text], delimiter=layout.delimiter), [])
        time = cells[place] if place < len(cells) else ""
        if DIGIT_FIRST.match(text) or DIGIT_FIRST.match(time):
            return (end, first) if first else (None, "")
        end -= len(raw)
        count += bool(text.strip())
        first = text.strip() or first
        if count > MOST_FOOTER_LINES:
            break
    return None, ""


def _as_wide(header: Sequence[str], cells: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """A header as wide as the rows, where only one of the two ends with a delimiter."""
    wide = len(header)
    if cells and all(len(row) == wide + 1 and not row[-1].strip() for row in cells):
        return (*header, "")
    if cells and not header[-1].strip() and all(len(row) == wide - 1 for row in cells):
        return tuple(header[:-1])
    return tuple(header)


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
    points = any("." in cell and NUMBER.fullmatch(cell) for cell in flat)
    return "," if commas and not points else "."


def read_csv(source: LogSource, known: Format) -> RawLog:
    """Read the channels' columns of a CSV file, a block of 4 MB at a time.

    Raises
    ------
    InputError        columns missing, no rows, text where numbers belong, rows of another length,
                      damaged gzip; a last line that was cut off is dropped with a notice
    """
    where, chosen = source.where, source.options.channels
    source = between_tabs(source)
    names = [*(n for c in known.channels for n in c.names), *(known.known or ())]
    layout = csv_layout(source, [] if known.known is None else [*names, *chosen.values()])
    there = {folded(name) for name in layout.header}
    if known.known is None and not there.issuperset(map(folded, chosen.values())):
        layout = csv_layout(source, [*names, *chosen.values()])

    def look(place: int) -> list[str]:
        return [row[place] for row in layout.cells if place < len(row)]

    columns, notices = choose_columns(
        layout.header, known.channels, where, known=known.known, chosen=chosen, look=look
    )
    if layout.decimal == ",":
        notices.append(Notice(Code.DECIMAL_COMMAS, "decimal commas were read as such"))
    end = None
    for k, column in enumerate(columns):
        if column.field not in _TIMES:
            continue
        if column.unit.kind == "number" and any(map(_OF_CLOCK.search, look(column.index))):
            columns[k] = replace(column, unit=CLOCK)
            text = f"column '{column.name}' holds clocks or dates and was read as such"
            notices.append(Notice(Code.TIME_OF_CLOCKS, text))
        if end is None:
            end, line = data_end(source, layout, column.index)
            if end is not None:
                text = f"what follows the data ('{line[:40]}') was left out"
                notices.append(Notice(Code.TEXT_AFTER_DATA, text))
    odd_rows: list[tuple[int, int, str]] = []
    arrays = _read(source, layout, columns, end, odd_rows, notices)
    rows = next(iter(arrays.values())).size
    if odd_rows:
        notices.append(_cut_off(odd_rows, rows, layout, where))
    if rows == 0:
        raise InputError(
            f"a header but no rows in {where}", "rows of numbers", "Check the export that wrote it."
        )
    return RawLog(arrays, tuple(notices), signed=says_its_sign(columns))


def _read(
    source: LogSource,
    layout: CsvLayout,
    columns: Sequence[ChosenColumn],
    end: int | None,
    odd_rows: list[tuple[int, int, str]],
    notices: list[Notice],
) -> dict[str, FloatArray]:
    """The columns' values by field; rows up to a byte."""
    import pyarrow as pa
    from pyarrow import csv as pa_csv

    names = [f"{k}" for k in range(len(layout.header))]
    types = {names[column.index]: arrow_type(column.unit) for column in columns}
    # Only texts need another character set; a header may stand in the middle once more.
    numbers = all(column.unit.kind == "number" for column in columns)
    again = [name for name in layout.header if name and not NUMBER.fullmatch(name)]

    def keep_odd(row: InvalidRow) -> str:
        if not row.text.strip(f"{layout.delimiter} \t"):
            return "skip"  # a blank line, of delimiters
        odd_rows.append((row.number or 0, row.actual_columns, row.text))
        return "skip" if len(odd_rows) < MOST_ODD_ROWS else "error"

    batches: list[Any] = []
    limits = ReadLimits.of(source.size)
    try:
        with (
            closing(TimedStream(source, limits, layout.offset, end)) as stream,
            without_late_errors(),
        ):
            # One thread: only then do messages carry the row's number, and no slower.
            reader = pa_csv.open_csv(
                pa.PythonFile(stream, mode="r"),
                read_options=pa_csv.ReadOptions(
                    column_names=names,
                    block_size=BLOCK_BYTES,
                    use_threads=False,
                    encoding="utf-8" if numbers else source.encoding,
                ),
                parse_options=pa_csv.ParseOptions(
                    delimiter=layout.delimiter, invalid_row_handler=keep_odd
                ),
                convert_options=pa_csv.ConvertOptions(
                    column_types=types,
                    include_columns=list(types),
                    null_values=[*MISSING, *again, *(f" {name}" for name in again)],
                    strings_can_be_null=True,
                    decimal_point=layout.decimal,
                ),
            )
            rows = 0
            for batch in reader:
                batches.append(batch)
                rows += batch.num_rows
                limits.check(source.where, rows)
                source.report(stream.done(), source.size)
    except pa.ArrowInvalid as error:
        if "Empty CSV file" not in str(error):
            raise _refused(str(error), source, layout, columns) from None
    except (OSError, EOFError, zlib.error) as error:
        if not source.gzipped:
            raise
        raise damaged_gzip(source, str(error)) from None
    table = pa.Table.from_batches(batches, pa.schema(list(types.items())))
    del batches
    noted_in = None if has_days(columns) else notices
    return {
        c.field: column_values(table.column(names[c.index]), c, source.where, noted_in)
        for c in columns
    }


def _refused(
    message: str, source: LogSource, layout: CsvLayout, columns: Sequence[ChosenColumn]
) -> InputError:
    """The refusal of a cell that is no number, or of text that is no table."""
    found = re.search(r"column #(\d+): (?:Row #(\d+): )?.*invalid value '(.*)'", message, re.S)
    if found is None:
        return InputError(
            f"text in '{source.path}' that cannot be read as a table ({message.splitlines()[0]})",
            f"rows of {len(layout.header)} cells, separated by '{layout.delimiter}'",
            "Check the lines' ends and quotation marks; the file may be cut off or not CSV.",
        )
    index, value = int(found[1]), found[3]
    name = next((c.name for c in columns if c.index == index), layout.header[index])
    row = f"row {found[2]} " if found[2] else "a row "
    action = (
        "Correct or blank the cell (a missing value is an empty cell or 'nan'), or remove the row "
        "if it is none of the data."
    )
    if DECIMAL_COMMA.fullmatch(value.strip()) or value.count(".") > 1:
        action = "Write numbers with one decimal point and without thousands separators."
    return InputError(
        f"'{value[:40]}' in column '{name}', {row}after the header of '{source.path}'",
        "a number in every cell of that column",
        action,
    )


def _cut_off(
    odd: Sequence[tuple[int, int, str]], rows: int, layout: CsvLayout, where: str
) -> Notice:
    """Notice about a cut off last line; any other row of another width is refused."""
    number, cells, text = odd[0]
    expected = len(layout.header)
    if len(odd) == 1 and cells < expected and number == rows + 1:
        said = f"the last line is cut off ('{text[:40]}') and was left out"
        return Notice(Code.LINE_CUT_OFF, said)
    action = "Repair or remove these lines."
    if layout.delimiter == "," and cells > expected and is_numeric(text):
        action = "If the numbers are written with decimal commas, separate the cells by semicolons."
    raise InputError(
        f"{cells} cells in row {number} after the header of {where} ('{text[:60]}')"
        + (f" and {len(odd) - 1} or more such rows" if len(odd) > 1 else ""),
        f"{expected} cells as in the header",
        action,
    )

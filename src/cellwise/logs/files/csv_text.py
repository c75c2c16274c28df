"""CSV as testers, spreadsheets and programs write it, read in record batches."""

from __future__ import annotations

import re
import zlib
from array import array
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.cells import DayFirstError, arrow_type, arrow_values, no_clock
from cellwise.logs.files.columns import CLOCK, Column, choose_columns
from cellwise.logs.files.csv_layout import (
    DECIMAL_COMMA,
    DIGIT_FIRST,
    MOST_FOOTER_LINES,
    CsvLayout,
    csv_layout,
    first_cells,
    footer_below,
    header_names,
    is_numeric,
    native_layout,
)
from cellwise.logs.files.format import Format, without_late_errors
from cellwise.logs.files.source import Limits, LogSource, RawLog, TimedStream, damaged_gzip
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from pyarrow.csv import InvalidRow

BLOCK_BYTES = 4 << 20
_TIMES = ("time_s", "step_time_s")
_OF_CLOCK = re.compile(r"\d:\d\d")
# What loggers and spreadsheets write where there is no value.
MISSING = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "none", "None", "NA", "N/A", "n/a"]
MISSING += ["#N/A", "#NA", "#DIV/0!", "#VALUE!", "-", "--", "---"]


def read_csv(source: LogSource, known: Format) -> RawLog:
    """Read the channels' columns of a CSV file, a block of 4 MB at a time.

    Raises
    ------
    InputError        columns missing, no rows, text where numbers belong, rows of another length,
                      damaged gzip; a last line that was cut off is dropped with a notice
    """
    layout = _layout(source, known)
    where = source.where
    columns, notices = choose_columns(
        layout.header, known.channels, where, known=known.known, chosen=source.options.channels
    )
    if layout.decimal == ",":
        notices.append("decimal commas were read as such")
    columns, noted = _timed(columns, source, layout)
    notices += noted
    odd_rows: list[tuple[int, int, str]] = []
    values, noted = _values(source, layout, columns, odd_rows)
    notices += noted
    n = values[0].size
    if odd_rows:
        notices.append(_odd_rows(odd_rows, n, layout, where))
    if n == 0:
        raise InputError(
            f"a header but no rows in {where}", "rows of numbers", "Check the export that wrote it."
        )
    arrays: dict[str, FloatArray] = {}
    for column in columns:
        arrays[column.field] = column.unit.convert(values.pop(0))
    return RawLog(arrays, tuple(notices))


def _layout(source: LogSource, known: Format) -> CsvLayout:
    """The header of a program's own export, else the first line that is none of a comment."""
    chosen = tuple(source.options.channels.values())
    names = (*(name for c in known.channels for name in c.names), *(known.known or ()), *chosen)
    if known.known is not None or (chosen and header_names(source, names) > 1):
        return native_layout(source, names)
    return csv_layout(source)


def _timed(
    columns: list[Column], source: LogSource, layout: CsvLayout
) -> tuple[list[Column], list[str]]:
    """The columns, those of times read as clocks where their first cells hold these."""
    cells = first_cells(source, layout)
    notices = []
    for k, column in enumerate(columns):
        if column.field not in _TIMES or column.unit.kind != "number":
            continue
        texts = [row[column.index] for row in cells if column.index < len(row)]
        if any(_OF_CLOCK.search(text) for text in texts):
            columns[k] = replace(column, unit=CLOCK)
            notices.append(f"column '{column.name}' holds clocks or dates and was read as such")
    return columns, notices


def _values(
    source: LogSource,
    layout: CsvLayout,
    columns: Sequence[Column],
    odd_rows: list[tuple[int, int, str]],
) -> tuple[list[FloatArray], list[str]]:
    """The columns' values, without the lines below the data, and notices of these."""
    day_first, end = False, None
    notices: list[str] = []
    while True:
        odd_rows.clear()
        try:
            values = _read_batches(source, layout, columns, odd_rows, day_first=day_first, end=end)
        except DayFirstError:
            day_first = True
        except _TextForNumberError as odd:
            found = footer_below(source, layout, odd.place, odd.text) if end is None else None
            if found is None:
                raise odd.refusal from None
            end, line = found
            notices.append(f"what follows the data ('{line[:40]}') was left out")
        else:
            return values, notices


class _TextForNumberError(Exception):
    """A cell that holds no number (or time), and the refusal if its row is one of the data."""

    def __init__(self, place: int, text: str, refusal: InputError) -> None:
        super().__init__(text)
        self.place, self.text, self.refusal = place, text, refusal


def _read_batches(
    source: LogSource,
    layout: CsvLayout,
    columns: Sequence[Column],
    odd_rows: list[tuple[int, int, str]],
    *,
    day_first: bool = False,
    end: int | None = None,
) -> list[FloatArray]:
    """The columns' values in the file's unit, in the order of ``columns``; rows up to a byte."""
    import pyarrow as pa
    from pyarrow import csv as pa_csv

    names = [f"{k}" for k in range(len(layout.header))]
    wanted = [names[column.index] for column in columns]
    types = {names[column.index]: arrow_type(column.unit) for column in columns}

    def keep_odd(row: InvalidRow) -> str:
        if not row.text.strip(f"{layout.delimiter} \t"):
            return "skip"  # a blank line, of delimiters
        odd_rows.append((row.number or 0, row.actual_columns, row.text))
        return "skip" if len(odd_rows) < 100 else "error"

    grown = [array("d") for _ in columns]  # grows in place: no second copy at the end
    limits = Limits.of(source.size)
    try:
        with (
            closing(TimedStream(source, limits, layout.offset, end)) as stream,
            without_late_errors(),
        ):
            # One thread: only then do messages carry the row's number, and no slower.
            reader = pa_csv.open_csv(
                pa.PythonFile(stream, mode="r"),
                read_options=pa_csv.ReadOptions(
                    column_names=names, block_size=BLOCK_BYTES, use_threads=False
                ),
                parse_options=pa_csv.ParseOptions(
                    delimiter=layout.delimiter, invalid_row_handler=keep_odd
                ),
                convert_options=pa_csv.ConvertOptions(
                    column_types=types,
                    include_columns=wanted,
                    null_values=MISSING,
                    strings_can_be_null=True,
                    decimal_point=layout.decimal,
                ),
            )
            for batch in reader:
                for into, name, column in zip(grown, wanted, columns, strict=True):
                    values, unread = arrow_values(
                        column.unit, batch.column(name), day_first=day_first
                    )
                    if unread:
                        refusal = no_clock(unread, column.name, source.where)
                        raise _TextForNumberError(column.index, unread, refusal)
                    into.frombytes(values.tobytes())
                limits.check_rows(len(grown[0]), source.where)
                stream.check_time()
                source.report(stream.done(), source.size)
    except pa.ArrowInvalid as error:
        if "Empty CSV file" not in str(error):
            raise _refused(str(error), source, layout, columns) from None
    except (OSError, EOFError, zlib.error) as error:
        if not source.gzipped:
            raise
        raise damaged_gzip(source, str(error)) from None
    return [np.frombuffer(values, np.float64) for values in grown]


def _refused(
    message: str, source: LogSource, layout: CsvLayout, columns: Sequence[Column]
) -> InputError | _TextForNumberError:
    """The refusal of a cell that is no number, or of text that is no table."""
    found = re.search(r"column #(\d+): (?:Row #(\d+): )?.*invalid value '(.*)'", message, re.S)
    if found is None:
        return InputError(
            f"text in '{source.path}' that cannot be read as a table ({message.splitlines()[0]})",
            f"rows of {len(layout.header)} cells, separated by '{layout.delimiter}'",
            "Check the lines' ends and quotation marks; the file may be cut off or not CSV.",
        )
    index = int(found.group(1))
    name = next((c.name for c in columns if c.index == index), layout.header[index])
    row = f"row {found.group(2)} " if found.group(2) else "a row "
    value = found.group(3)
    action = (
        "Correct or blank the cell (a missing value is an empty cell or 'nan'), or remove the row "
        "if it is none of the data."
    )
    if DECIMAL_COMMA.fullmatch(value.strip()) or value.count(".") > 1:
        action = "Write numbers with one decimal point and without thousands separators."
    refusal = InputError(
        f"'{value[:40]}' in column '{name}', {row}after the header of '{source.path}'",
        "a number in every cell of that column",
        action,
    )
    return _TextForNumberError(index, value, refusal)


def _odd_rows(odd: Sequence[tuple[int, int, str]], rows: int, layout: CsvLayout, where: str) -> str:
    """Notice about a cut off last line; anything else is refused."""
    number, cells, text = odd[0]
    expected = len(layout.header)
    words = all(found < expected and not is_numeric(line) for _, found, line in odd)
    if words and number > rows and len(odd) <= MOST_FOOTER_LINES and not DIGIT_FIRST.match(text):
        return f"what follows the data ('{text[:40]}', {len(odd)} line(s)) was left out"
    if len(odd) == 1 and cells < expected and number == rows + 1:
        return f"the last line is cut off ('{text[:40]}') and was left out"
    action = "Repair or remove these lines."
    if layout.delimiter == "," and cells > expected and is_numeric(text):
        action = "If the numbers are written with decimal commas, separate the cells by semicolons."
    raise InputError(
        f"{cells} cells in row {number} after the header of {where} ('{text[:60]}')"
        + (f" and {len(odd) - 1} or more such rows" if len(odd) > 1 else ""),
        f"{expected} cells as in the header",
        action,
    )

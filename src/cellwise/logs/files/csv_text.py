"""CSV as testers, spreadsheets and programs write it, read in record batches."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cellwise.errors import InputError
from cellwise.logs.files.columns import CLOCK, Column, choose_columns
from cellwise.logs.files.csv_layout import (
    DECIMAL_COMMA,
    CsvLayout,
    csv_layout,
    data_end,
    is_numeric,
)
from cellwise.logs.files.format import Format, without_late_errors
from cellwise.logs.files.source import Limits, LogSource, RawLog, TimedStream, damaged_gzip
from cellwise.logs.files.tables import arrow_type, column_values
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from pyarrow.csv import InvalidRow

BLOCK_BYTES = 4 << 20
MOST_ODD_ROWS = 100
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
    where, chosen = source.where, source.options.channels
    names: list[str] = []
    if known.known is not None or chosen:  # of a program's own export, or as stated
        names = [*(n for c in known.channels for n in c.names), *(known.known or ())]
    layout = csv_layout(source, (*names, *chosen.values()))
    columns, notices = choose_columns(
        layout.header, known.channels, where, known=known.known, chosen=chosen
    )
    if layout.decimal == ",":
        notices.append("decimal commas were read as such")
    end = None
    for k, column in enumerate(columns):
        if column.field not in _TIMES:
            continue
        texts = [row[column.index] for row in layout.cells if column.index < len(row)]
        if column.unit.kind == "number" and any(map(_OF_CLOCK.search, texts)):
            columns[k] = replace(column, unit=CLOCK)
            notices.append(f"column '{column.name}' holds clocks or dates and was read as such")
        if end is None:
            end, line = data_end(source, layout, column.index)
            if end is not None:
                notices.append(f"what follows the data ('{line[:40]}') was left out")
    odd_rows: list[tuple[int, int, str]] = []
    arrays = _read(source, layout, columns, end, odd_rows)
    rows = next(iter(arrays.values())).size
    if odd_rows:
        notices.append(_cut_off(odd_rows, rows, layout, where))
    if rows == 0:
        raise InputError(
            f"a header but no rows in {where}", "rows of numbers", "Check the export that wrote it."
        )
    return RawLog(arrays, tuple(notices))


def _read(
    source: LogSource,
    layout: CsvLayout,
    columns: Sequence[Column],
    end: int | None,
    odd_rows: list[tuple[int, int, str]],
) -> dict[str, FloatArray]:
    """The columns' values by field; rows up to a byte."""
    import pyarrow as pa
    from pyarrow import csv as pa_csv

    names = [f"{k}" for k in range(len(layout.header))]
    types = {names[column.index]: arrow_type(column.unit) for column in columns}

    def keep_odd(row: InvalidRow) -> str:
        if not row.text.strip(f"{layout.delimiter} \t"):
            return "skip"  # a blank line, of delimiters
        odd_rows.append((row.number or 0, row.actual_columns, row.text))
        return "skip" if len(odd_rows) < MOST_ODD_ROWS else "error"

    batches: list[Any] = []
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
                    include_columns=list(types),
                    null_values=MISSING,
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
    return {c.field: column_values(table.column(names[c.index]), c, source.where) for c in columns}


def _refused(
    message: str, source: LogSource, layout: CsvLayout, columns: Sequence[Column]
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


def _cut_off(odd: Sequence[tuple[int, int, str]], rows: int, layout: CsvLayout, where: str) -> str:
    """Notice about a cut off last line; any other row of another width is refused."""
    number, cells, text = odd[0]
    expected = len(layout.header)
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

"""Cells of a table as float64: clocks, dates and labels, and arrow's own buffers.

pyarrow's own conversions import pandas whenever it is installed, which takes longer than reading
most logs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import Unit
from cellwise.typing import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    import pyarrow

# 12.5 | 01:02 | 01:02:03.4 | 1d 02:03:04.5 | 1-02:03:04, the decimal sign a point or a comma
_CLOCK = (
    r"^\s*(?:(?P<d>\d+)(?:\s*d\s*|-|\s+))?"
    r"(?:(?P<h>\d+):(?P<m>\d+)(?::(?P<s>\d+(?:[.,]\d*)?))?|"
    r"(?P<n>[-+]?\d+(?:[.,]\d*)?(?:[eE][-+]?\d+)?))\s*$"
)
_SECONDS = {"d": 86_400.0, "h": 3600.0, "m": 60.0, "s": 1.0, "n": 1.0}
# 2024-05-01 10:00:00.5 | 2024/05/01T10:00Z | 01.05.2024 10:00:00 | 05/01/2024 10:00:00 PM
_DATE = (
    r"^\s*(?P<a>\d{1,4})(?P<sep>[-./])(?P<b>\d{1,2})[-./](?P<c>\d{1,4})[T,\s]+"
    r"(?P<h>\d{1,2}):(?P<m>\d{2})(?::(?P<s>\d{2}(?:[.,]\d*)?))?\s*(?P<half>[AaPp][Mm])?"
    r"\s*(?:Z|UTC|[-+]\d{2}:?\d{2})?\s*$"
)
_DATE_MARKS = "-./"
LAST_MONTH = 12


def arrow_type(unit: Unit) -> pyarrow.DataType:
    """The type as which a column of this unit is read from text."""
    import pyarrow as pa

    if unit.kind == "clock":
        return pa.string()
    if unit.kind == "label":
        return pa.dictionary(pa.int32(), pa.string())
    return pa.float64()


def arrow_values(unit: Unit, column: pyarrow.ChunkedArray, name: str, where: str) -> FloatArray:
    """A column as float64 with missing values as NaN; the unit's factor is not applied yet.

    Raises
    ------
    InputError        a cell that holds no time
    """
    import pyarrow as pa

    if unit.kind != "number" and is_text(column.type):
        if unit.kind == "clock":
            return _clock_seconds(column.cast(pa.string()).combine_chunks(), name, where)
        parts = [_word_values(unit, chunk) for chunk in column.chunks]
    else:
        column = column if column.type == pa.float64() else column.cast(pa.float64())
        parts = [to_numpy(chunk) for chunk in column.chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts])


def is_text(kind: pyarrow.DataType) -> bool:
    """Cells of this type are texts, each by itself or by a dictionary."""
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def label_value(unit: Unit, label: str) -> float:
    """The value of a label; NaN for one that the format does not know."""
    return unit.labels.get(" ".join(label.replace("_", " ").split()).casefold(), np.nan)


def _clock_seconds(column: pyarrow.Array, name: str, where: str) -> FloatArray:
    """Seconds of clock texts and of dates (since 1970); a plain number is a number of seconds."""
    import pyarrow as pa
    import pyarrow.compute as pc

    dates = _first_is_date(column)
    parts = pc.extract_regex(column, pattern=_DATE if dates else _CLOCK)

    def numbers(part: str) -> FloatArray:
        text = pc.replace_substring(pc.struct_field(parts, part), ",", ".")
        return to_numpy(pc.cast(pc.if_else(pc.equal(text, ""), "0", text), pa.float64()))

    def says(part: str, text: str) -> BoolArray:
        equal = pc.equal(pc.utf8_lower(pc.struct_field(parts, part)), text)
        return np.asarray(to_numpy(pc.cast(equal, pa.float64())) == 1.0)

    if dates:
        total = _date_seconds(numbers, says)
    else:
        total = np.sum([seconds * numbers(part) for part, seconds in _SECONDS.items()], axis=0)
    unread = np.isnan(total)
    if unread.any() and column.null_count < np.count_nonzero(unread):
        bad = column.filter(pc.and_(pc.is_valid(column), pc.is_null(parts)))
        if text := next((text for text in bad.to_pylist() if text.strip()), ""):
            raise InputError(
                f"'{text[:40]}' in column '{name}' of {where}",
                "a time as 12.5, 02:03:04.5, 1d 02:03:04 or 2024-05-31 02:03:04",
                "Correct the cell, or export the time in seconds.",
            )
    return total


def _first_is_date(column: pyarrow.Array) -> bool:
    first = next((cell.as_py() for cell in column if cell.is_valid), "")
    return ":" in first and sum(first.count(mark) for mark in _DATE_MARKS) >= 2


def _date_seconds(
    numbers: Callable[[str], FloatArray], says: Callable[[str, str], BoolArray]
) -> FloatArray:
    """Seconds since 1970 of dates with a time, by their parts.

    Dates with slashes are month first, unless a number is no month or the log would be longer.
    """
    first, second, third = (numbers(part) for part in ("a", "b", "c"))
    known = np.isfinite(first)
    year_first = first > 31
    slashes = known & says("sep", "/") & ~year_first
    day, month = np.where(year_first, third, first), second
    if slashes.any() and not _is_day_first(first[slashes], second[slashes]):
        day, month = np.where(slashes, second, day), np.where(slashes, first, month)
    year = np.where(year_first, first, third)
    year = np.where(year < 100, year + 2000, year)
    hour, afternoon = numbers("h"), says("half", "pm")
    hour = np.where(afternoon | says("half", "am"), hour % 12 + 12 * afternoon, hour)
    months = (np.where(known, year, 1970) - 1970) * 12 + np.where(known, month, 1) - 1
    days = months.astype(np.int64).astype("datetime64[M]").astype("datetime64[D]")
    total = 86_400.0 * (days.astype(np.int64) + day - 1) + 3600.0 * hour
    total += 60.0 * numbers("m") + numbers("s")
    possible = (month >= 1) & (month <= LAST_MONTH) & (day >= 1) & (day <= 31)
    return np.where(possible, total, np.nan)


def _is_day_first(first: FloatArray, second: FloatArray) -> bool:
    """Of dates such as 05/06/2024: by a number that is no month, else by the shorter time."""
    if np.any(first > LAST_MONTH) or np.any(second > LAST_MONTH):
        return bool(np.any(first > LAST_MONTH))
    return bool(np.ptp(31 * second + first) < np.ptp(31 * first + second))


def _word_values(unit: Unit, column: pyarrow.Array) -> FloatArray:
    """Value of every cell's label, through the dictionary."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not pa.types.is_dictionary(column.type):
        column = pc.dictionary_encode(column)
    meaning = np.array(
        [label_value(unit, w or "") for w in column.dictionary.to_pylist()] + [np.nan]
    )
    index = to_numpy(pc.cast(column.indices, pa.float64()))
    return meaning[np.where(np.isnan(index), meaning.size - 1, index).astype(np.intp)]


def to_numpy(array: pyarrow.Array) -> FloatArray:
    """A float64 array as numpy, nulls as NaN; a view of pyarrow's memory where there are none."""
    valid, data = array.buffers()
    n = len(array)
    values: FloatArray = np.frombuffer(data, np.float64, n, array.offset * 8) if n else np.empty(0)
    if valid is None or array.null_count == 0:
        return values
    bits = np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")
    known = bits[array.offset : array.offset + n].astype(np.bool_)
    return np.where(known, values, np.nan)


def from_numpy(values: FloatArray | IntArray) -> pyarrow.Array:
    """A float64 or int32 array as pyarrow, NaN as null; without a copy of the values."""
    import pyarrow as pa

    whole = np.ascontiguousarray(values)
    kind = pa.int32() if whole.dtype == np.int32 else pa.float64()
    missing = np.isnan(whole) if kind == pa.float64() else np.zeros(0, np.bool_)
    nulls = int(np.count_nonzero(missing))
    known = pa.py_buffer(np.packbits(~missing, bitorder="little")) if nulls else None
    return pa.Array.from_buffers(kind, whole.size, [known, pa.py_buffer(whole)], nulls)

"""Columns of a table, in memory, of text or parquet, to channels: numbers, clocks, dates, labels.

A cell that holds nothing is NaN. pyarrow's own conversions from and to numpy import pandas whenever
it is installed, which takes longer than reading most logs: numbers go by its buffers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import (
    Channel,
    Column,
    Unit,
    choose_columns,
    folded,
    says_its_sign,
)
from cellwise.logs.files.format import (
    FREQUENCIES,
    Format,
    check_no_spectrum,
    library_at_work,
)
from cellwise.logs.files.source import Limits, LogSource, RawLog
from cellwise.typing import BoolArray, FloatArray, IntArray, NamedColumns

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
PARQUET = "parquet file"

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


def table_channels(
    table: NamedColumns, channels: Sequence[Channel], where: str, **options: Any
) -> RawLog:
    """The channels among the columns of a table in memory; options as of `choose_columns`.

    Raises
    ------
    InputError        a required channel is missing or holds no numbers
    """
    header = getattr(table, "column_names", None)  # pyarrow
    if header is None:
        header = getattr(table, "columns", None)  # pandas, polars
    names = list(cast(Iterable[str], table) if header is None else header)
    columns, notices = choose_columns([str(name) for name in names], channels, where, **options)
    found = {c.field: column_values(table[names[c.index]], c, where) for c in columns}
    return RawLog(found, tuple(notices), signed=says_its_sign(columns))


def channels_of(
    arrays: NamedColumns, source: LogSource, known: Format, cells: int | None = None
) -> RawLog:
    """The channels among a native file's arrays; ``cells`` in series, if the file states them.

    Raises
    ------
    InputError              a required channel is missing or holds no numbers; no rows
    """
    where, chosen = source.where, source.options.channels
    names = [str(name) for name in arrays]
    check_no_spectrum(names, lambda k: np.ravel(arrays[names[k]])[:FREQUENCIES], where)
    raw = table_channels(arrays, known.channels, where, known=known.known, chosen=chosen)
    sizes = {field: values.size for field, values in raw.channels.items()}
    if set(sizes.values()) == {0}:
        raise InputError(f"no rows in {where}", "rows of numbers", "Check the recording.")
    if len(set(sizes.values())) > 1:
        raise InputError(
            f"channels of unequal lengths in {where} ({sizes})",
            "one value per row in each",
            "Choose channels of one group with `channels={...}`.",
        )
    return replace(raw, cells=cells)


def is_parquet(source: LogSource) -> bool:
    """The file begins as parquet does."""
    return not source.gzipped and source.head.startswith(PARQUET_MAGIC)


def parquet_names(source: LogSource) -> list[str]:
    """Column names of a parquet file.

    Raises
    ------
    InputError        a file that is not whole
    """
    from pyarrow import parquet

    with library_at_work(source, PARQUET):
        return list(parquet.read_schema(source.path).names)


def parquet_has(source: LogSource, groups: Sequence[Sequence[str]]) -> bool:
    """A parquet file has a column of each group's names."""
    if not is_parquet(source):
        return False
    try:
        names = {folded(name) for name in parquet_names(source)}
    except InputError:
        return False
    return all(names.intersection(map(folded, group)) for group in groups)


def read_parquet(source: LogSource, known: Format) -> RawLog:
    """Read the channels' columns of a parquet file, one after the other.

    Raises
    ------
    InputError        columns missing, not numeric, no rows, a file cut off or damaged
    """
    from pyarrow import parquet

    where, options = source.where, source.options
    arrays: dict[str, FloatArray] = {}
    with library_at_work(source, PARQUET), parquet.ParquetFile(source.path) as file:
        header, rows = file.schema_arrow.names, file.metadata.num_rows
        columns, notices = choose_columns(
            header, known.channels, where, known=known.known, chosen=options.channels
        )
        if rows == 0:
            raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
        Limits.of(source.size).check(where, rows)
        for column in columns:
            _check_type(file.schema_arrow.field(column.index).type, column, where)
        for k, column in enumerate(columns):
            # On this thread alone: there are many small files.
            table = file.read(columns=[header[column.index]], use_threads=False)
            arrays[column.field] = column_values(table.column(0), column, where)
            source.report(k + 1, len(columns))
    return RawLog(arrays, tuple(notices), signed=says_its_sign(columns))


def _check_type(kind: pyarrow.DataType, column: Column, where: str) -> None:
    """Refuse a column of texts where numbers belong before it is read, however large it is."""
    if column.unit.kind == "number" and _is_text(kind):
        raise _no_numbers(column, where, f"of type {kind}")


def _no_numbers(column: Column, where: str, found: str) -> InputError:
    return InputError(
        f"column '{column.name}' {found} in {where}",
        "a column of numbers",
        "Convert it (missing values are nan), or choose another with `channels={...}`.",
    )


def _no_dates(column: Column, where: str) -> InputError:
    return InputError(
        f"no dates in column '{column.name}' of {where}, whose name states no unit",
        "a unit of the time",
        f"Say which: `channels={{'time_s': '{column.name}'}}`, or time_ms, time_min, time_h.",
    )


def column_values(values: Any, column: Column, where: str) -> FloatArray:
    """A column in its channel's own unit; times that are dates or durations in seconds.

    Raises
    ------
    InputError        a cell that holds no number or no time
    """
    import pyarrow as pa

    unit, found = column.unit, values
    try:
        if not isinstance(values, pa.ChunkedArray):
            array = np.asarray(values).ravel()
            if array.dtype.kind in "biuf" and unit.kind != "date":
                return unit.convert(np.asarray(array, dtype=np.float64))
            if array.dtype.kind in "mM":
                array = array.astype(f"{array.dtype.kind}8[us]")
            found = pa.chunked_array([pa.array(array, from_pandas=True)])
        if unit.kind != "number" and _is_text(found.type):
            read = _labels if unit.kind == "label" else _clock_seconds
            return unit.convert(read(found, column, where))
        if column.field == "time_s" and pa.types.is_temporal(found.type):
            return unit.convert(_from_first(found))
        if unit.kind == "date":
            raise _no_dates(column, where)
        parts = [to_numpy(chunk) for chunk in found.cast(pa.float64()).chunks]
    except (pa.ArrowException, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        said = str(error).partition("\n")[0]
        raise _no_numbers(column, where, f"({said})") from None
    return unit.convert(parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts]))


def arrow_type(unit: Unit) -> pyarrow.DataType:
    """The type as which a column of this unit is read from text."""
    import pyarrow as pa

    if unit.kind in ("clock", "date"):
        return pa.string()
    if unit.kind == "label":
        return pa.dictionary(pa.int32(), pa.string())
    return pa.float64()


def _is_text(kind: pyarrow.DataType) -> bool:
    """Cells of this type are texts, each by itself or by a dictionary."""
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _from_first(column: pyarrow.ChunkedArray) -> FloatArray:
    """Seconds of dates, from the first that is there, or of durations."""
    import pyarrow as pa

    kind = pa.duration("us") if pa.types.is_duration(column.type) else pa.timestamp("us")
    whole = column.cast(kind, safe=False).cast(pa.int64()).combine_chunks()
    micros = to_numpy(whole.cast(pa.float64()))
    known = micros[np.isfinite(micros)]
    return 1e-6 * (micros - known[0]) if known.size else micros


def _clock_seconds(found: pyarrow.ChunkedArray, column: Column, where: str) -> FloatArray:
    """Seconds of clock texts and of dates (since 1970); a plain number is a number of seconds."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = found.cast(pa.string()).combine_chunks()
    first = next((cell.as_py() for cell in texts if cell.is_valid), "")
    dates = ":" in first and sum(first.count(mark) for mark in _DATE_MARKS) >= 2
    if column.unit.kind == "date" and first and not dates:
        raise _no_dates(column, where)
    parts = pc.extract_regex(texts, pattern=_DATE if dates else _CLOCK)

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
    if texts.null_count < np.count_nonzero(np.isnan(total)):
        bad = texts.filter(pc.and_(pc.is_valid(texts), pc.is_null(parts)))
        if text := next((text for text in bad.to_pylist() if text.strip()), ""):
            raise InputError(
                f"'{text[:40]}' in column '{column.name}' of {where}",
                "a time as 12.5, 02:03:04.5, 1d 02:03:04 or 2024-05-31 02:03:04",
                "Correct the cell, or export the time in seconds.",
            )
    return total


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


def _labels(found: pyarrow.ChunkedArray, column: Column, where: str) -> FloatArray:
    """Value of every cell's label, NaN for one that the format does not know."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = found.combine_chunks()
    if not pa.types.is_dictionary(texts.type):
        texts = pc.dictionary_encode(texts)
    words = (" ".join((w or "").replace("_", " ").split()) for w in texts.dictionary.to_pylist())
    meaning = np.array([column.unit.labels.get(w.casefold(), np.nan) for w in words] + [np.nan])
    index = to_numpy(pc.cast(texts.indices, pa.float64()))
    return meaning[np.where(np.isnan(index), -1, index).astype(np.intp)]


def to_numpy(array: pyarrow.Array) -> FloatArray:
    """A float64 array as numpy, nulls as NaN; a view of pyarrow's memory where there are none."""
    import pyarrow.compute as pc

    whole = pc.fill_null(array, np.nan) if array.null_count else array
    return np.asarray(np.from_dlpack(whole), dtype=np.float64)


def from_numpy(values: FloatArray | IntArray) -> pyarrow.Array:
    """A float64 or int32 array as pyarrow, NaN as null; without a copy where there is none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    whole = np.ascontiguousarray(values)
    kind = pa.int32() if whole.dtype == np.int32 else pa.float64()
    array = pa.Array.from_buffers(kind, whole.size, [None, pa.py_buffer(whole)])
    if kind == pa.int32() or not np.isnan(whole).any():
        return array
    return pc.if_else(pc.is_nan(array), pa.scalar(None, kind), array)

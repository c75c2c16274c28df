"""Columns of a table, in memory, of text or parquet, to channels: numbers, clocks, dates, labels.

A cell that holds nothing is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.arrow import to_numpy
from cellwise.logs.files.choice import choose_columns, has_days, says_its_sign
from cellwise.logs.files.columns import Channel, ChosenColumn, Unit, folded
from cellwise.logs.files.format import (
    FREQUENCIES,
    Format,
    check_no_spectrum,
    library_at_work,
)
from cellwise.logs.files.source import LogSource, RawLog, ReadLimits
from cellwise.logs.files.times import epoch_unit, seconds_of
from cellwise.logs.files.words import state_of
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray, NamedColumns
from cellwise.wording import arg

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
PARQUET = "parquet file"
LOOKED_AT = 50  # rows


def table_channels(
    table: NamedColumns, channels: Sequence[Channel], where: str, **options: Any
) -> RawLog:
    """The channels among the columns of a table in memory; options as of `choose_columns`.

    Raises
    ------
    InputError        a required channel is missing or holds no numbers
    """
    names = _names_of(table)

    def look(place: int) -> list[str]:
        return first_texts(table[names[place]])

    columns, notices = choose_columns(
        [str(name) for name in names], channels, where, look=look, **options
    )
    noted_in = None if has_days(columns) else notices
    found = {c.field: column_values(table[names[c.index]], c, where, noted_in) for c in columns}
    return RawLog(found, tuple(notices), signed=says_its_sign(columns))


def first_texts(values: Any) -> list[str]:
    """The first cells of a column as they would be written; empty for what is missing."""
    first = values[:LOOKED_AT]
    cells = first.to_pylist() if hasattr(first, "to_pylist") else np.asarray(first).ravel().tolist()
    if getattr(getattr(first, "dtype", None), "kind", "") == "M":
        cells = [str(cell) for cell in np.asarray(first)]
    return ["" if cell is None or cell != cell else str(cell) for cell in cells]


def _names_of(table: NamedColumns) -> list[str]:
    header = getattr(table, "column_names", None)  # pyarrow
    if header is None:
        header = getattr(table, "columns", None)  # pandas, polars
    return list(cast(Iterable[str], table) if header is None else header)


def channels_of(
    arrays: NamedColumns, source: LogSource, known: Format, cells: int | None = None
) -> RawLog:
    """The channels among a native file's arrays; ``cells`` in series, if the file states them.

    Raises
    ------
    InputError              a required channel is missing or holds no numbers; no rows
    """
    where, chosen = source.where, source.options.channels
    names = _names_of(arrays)
    check_no_spectrum(names, lambda k: np.asarray(arrays[names[k]]).ravel()[:FREQUENCIES], where)
    raw = table_channels(arrays, known.channels, where, known=known.known, chosen=chosen)
    sizes = {field: values.size for field, values in raw.channels.items()}
    if set(sizes.values()) == {0}:
        raise InputError(f"no rows in {where}", "rows of numbers", "Check the recording.")
    if len(set(sizes.values())) > 1:
        raise InputError(
            f"channels of unequal lengths in {where} ({sizes})",
            "one value per row in each",
            "Choose channels of one group with " + arg("channels", letter="{...}") + ".",
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

        @cache
        def first() -> pyarrow.RecordBatch | None:
            return next(file.iter_batches(LOOKED_AT, use_threads=False), None)

        def look(place: int) -> list[str]:
            batch = first()
            return [] if batch is None else first_texts(batch.column(place))

        columns, notices = choose_columns(
            header, known.channels, where, known=known.known, chosen=options.channels, look=look
        )
        if rows == 0:
            raise InputError(f"no rows in {where}", "rows of numbers", "Check the export.")
        ReadLimits.of(source.size).check(where, rows)
        for column in columns:
            _check_type(file.schema_arrow.field(column.index).type, column, where)
        for k, column in enumerate(columns):
            # On this thread alone: there are many small files.
            table = file.read(columns=[header[column.index]], use_threads=False)
            noted_in = None if has_days(columns) else notices
            arrays[column.field] = column_values(table.column(0), column, where, noted_in)
            source.report(k + 1, len(columns))
    return RawLog(arrays, tuple(notices), signed=says_its_sign(columns))


def _check_type(kind: pyarrow.DataType, column: ChosenColumn, where: str) -> None:
    """Refuse a column of texts where numbers belong before it is read, however large it is."""
    if column.unit.kind == "number" and _is_text(kind):
        raise _no_numbers(column, where, f"of type {kind}")


def _no_numbers(column: ChosenColumn, where: str, found: str) -> InputError:
    return InputError(
        f"column '{column.name}' {found} in {where}",
        "a column of numbers",
        "Convert it (missing values are nan), or choose another with "
        + arg("channels", letter="{...}")
        + ".",
    )


def column_values(
    values: Any, column: ChosenColumn, where: str, notices: list[Notice] | None = None
) -> FloatArray:
    """A column in its channel's own unit; times that are dates or durations in seconds.

    ``notices`` takes what was done with it; None: the clock stands beside a day.

    Raises
    ------
    InputError        a cell that holds no number or no time
    """
    import pyarrow as pa

    unit, found = column.unit, values
    try:
        if not isinstance(values, pa.ChunkedArray):
            array = np.asarray(values).ravel()
            if array.dtype.kind in "biuf":
                return _converted(np.asarray(array, dtype=np.float64), column)
            if array.dtype.kind in "mM":
                array = array.astype(f"{array.dtype.kind}8[us]")
            found = pa.chunked_array([pa.array(array, from_pandas=True)])
        if unit.kind != "number" and _is_text(found.type):
            if unit.kind == "label":
                return _labels(found, column)
            alone = notices is not None
            seconds, noted = seconds_of(found, column.name, where, alone=alone)
            if notices is not None and noted:
                notices.append(Notice(Code.TIME_PAST_MIDNIGHT, noted))
            return _converted(seconds, column)
        if column.field == "time_s" and pa.types.is_temporal(found.type):
            return unit.convert(_from_first(found))
        parts = [to_numpy(chunk) for chunk in found.cast(pa.float64()).chunks]
    except (pa.ArrowException, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        said = str(error).partition("\n")[0]
        raise _no_numbers(column, where, f"({said})") from None
    whole = parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts])
    return _converted(whole, column)


def _converted(values: FloatArray, column: ChosenColumn) -> FloatArray:
    """Values in the channel's own unit; stamps since 1970 whose unit nobody says, in seconds."""
    if column.unit.kind in ("clock", "date") and (unit := epoch_unit(values)) not in (0.0, 1.0):
        return values * unit
    return column.unit.convert(values)


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


def _labels(found: pyarrow.ChunkedArray, column: ChosenColumn) -> FloatArray:
    """Value of every cell's label, as the format says or else its words; NaN for an unknown one."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = found.combine_chunks()
    if not pa.types.is_dictionary(texts.type):
        texts = pc.dictionary_encode(texts)
    words = (" ".join((w or "").replace("_", " ").split()) for w in texts.dictionary.to_pylist())
    known = column.unit.labels
    values = [known[w.casefold()] if w.casefold() in known else state_of(w) for w in words]
    meaning = np.array([*values, np.nan])
    index = to_numpy(pc.cast(texts.indices, pa.float64()))
    return meaning[np.where(np.isnan(index), -1, index).astype(np.intp)]

"""Named arrays, as the libraries that read native files give them, to a log's channels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import Unit, choose_columns
from cellwise.logs.files.format import Format
from cellwise.logs.files.source import LogSource, RawLog
from cellwise.logs.files.text_cells import DayFirstError, arrow_values, label_value
from cellwise.typing import FloatArray


def channels_of(
    arrays: Mapping[str, Any], source: LogSource, known: Format, cells: int | None = None
) -> RawLog:
    """Choose and convert the channels among arrays of one length.

    Parameters
    ----------
    arrays : mapping        name to array, in the file's order
    source : LogSource      where they come from, and what the user stated of it
    known : Format          the column map
    cells : int or None     cells in series, if the file states them

    Raises
    ------
    InputError              a required channel is missing or holds no numbers; no rows
    """
    names = list(arrays)
    columns, notices = choose_columns(
        names, known.channels, source.where, known=known.known, chosen=source.options.channels
    )
    channels = {c.field: _numbers(arrays[names[c.index]], c.unit, c.name, source) for c in columns}
    lengths = {values.size for values in channels.values()}
    if lengths == {0}:
        raise InputError(f"no rows in {source.where}", "rows of numbers", "Check the recording.")
    if len(lengths) > 1:
        listed = ", ".join(f"{c.name} {channels[c.field].size}" for c in columns)
        raise InputError(
            f"channels of unequal lengths in {source.where} ({listed})",
            "one value per row in each",
            "Choose channels of one group with `channels={...}`.",
        )
    return RawLog(channels, tuple(notices), cells)


def _numbers(values: Any, unit: Unit, name: str, source: LogSource) -> FloatArray:
    array = np.asarray(values)
    if unit.kind == "label":
        meaning = {label: label_value(unit, str(label)) for label in set(array.tolist())}
        return np.array([meaning[label] for label in array.tolist()], dtype=np.float64)
    if unit.kind == "clock" and array.dtype.kind in "UO":
        return unit.convert(_clock(array, unit, name, source))
    try:
        numbers: FloatArray = np.asarray(array, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(
            f"column '{name}' of {source.where} ({error})",
            "a column of numbers",
            "Choose another one with `channels={...}`.",
        ) from None
    return unit.convert(numbers)


def _clock(array: Any, unit: Unit, name: str, source: LogSource) -> FloatArray:
    """Seconds of a column of clocks or dates."""
    import pyarrow as pa

    texts = pa.array([str(text) for text in array.tolist()])
    try:
        values, unread = arrow_values(unit, texts)
    except DayFirstError:
        values, unread = arrow_values(unit, texts, day_first=True)
    if unread:
        raise InputError(
            f"'{unread[:40]}' in column '{name}' of {source.where}",
            "a time as 12.5, 02:03:04.5, 1d 02:03:04 or 2024-05-31 02:03:04",
            "Correct the cell, or choose another column with `channels={...}`.",
        )
    return values

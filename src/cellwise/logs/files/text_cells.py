"""Columns of text that mean numbers: clocks and labels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.logs.files.arrow_arrays import to_numpy
from cellwise.logs.files.columns import Unit
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pyarrow

# 12.5 | 01:02 | 01:02:03.4 | 1d 02:03:04.5 | 1-02:03:04
_CLOCK = (
    r"^\s*(?:(?P<d>\d+)(?:\s*d\s*|-|\s+))?"
    r"(?:(?P<h>\d+):(?P<m>\d+)(?::(?P<s>\d+(?:\.\d*)?))?|(?P<n>[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?))\s*$"
)
_SECONDS = {"d": 86_400.0, "h": 3600.0, "m": 60.0, "s": 1.0, "n": 1.0}


def arrow_type(unit: Unit) -> pyarrow.DataType:
    """The type as which a column of this unit is read from text."""
    import pyarrow as pa

    if unit.kind == "clock":
        return pa.string()
    if unit.kind == "label":
        return pa.dictionary(pa.int32(), pa.string())
    return pa.float64()


def arrow_values(unit: Unit, column: pyarrow.Array) -> tuple[FloatArray, str]:
    """A chunk as float64 with missing values as NaN, and the first cell that could not be read.

    The unit's factor is not applied yet.
    """
    if unit.kind == "clock":
        return _clock_seconds(column)
    if unit.kind == "label":
        return _word_values(unit, column), ""
    return to_numpy(column), ""


def label_value(unit: Unit, label: str) -> float:
    """The value of a label; NaN for one that the format does not know."""
    return unit.labels.get(" ".join(label.replace("_", " ").split()).casefold(), np.nan)


def labels(**values: float) -> Unit:
    """A unit of labels: ``labels(chg=-1.0, dchg=1.0)``; an underscore is a blank."""
    return Unit(kind="label", labels={k.replace("_", " ").casefold(): v for k, v in values.items()})


def _clock_seconds(column: pyarrow.Array) -> tuple[FloatArray, str]:
    """Seconds of clock texts; a plain number is a number of seconds."""
    import pyarrow as pa
    import pyarrow.compute as pc

    parts = pc.extract_regex(column, pattern=_CLOCK)
    total = np.zeros(len(column))
    for name, seconds in _SECONDS.items():
        text = pc.struct_field(parts, name)
        number = pc.cast(pc.if_else(pc.equal(text, ""), "0", text), pa.float64())
        total += seconds * to_numpy(number)
    unread = np.isnan(total)
    if unread.any() and column.null_count < np.count_nonzero(unread):
        bad = column.filter(pc.and_(pc.is_valid(column), pc.is_null(parts)))
        kept = [text for text in bad.to_pylist() if text.strip()]
        return total, kept[0] if kept else ""
    return total, ""


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

"""Between numpy and pyarrow by their buffers.

pyarrow's own conversions import pandas whenever it is installed, which takes longer than reading
most logs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.typing import FloatArray, IntArray

if TYPE_CHECKING:
    import pyarrow


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

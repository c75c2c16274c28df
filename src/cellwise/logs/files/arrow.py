"""Numbers between pyarrow and numpy, without pandas.

pyarrow's own conversions import pandas whenever it is installed, which takes longer than reading
most logs: numbers go by its buffers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.typing import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    import pyarrow


def to_numpy(array: pyarrow.Array) -> FloatArray:
    """A float64 array as numpy, nulls as NaN; a view of pyarrow's memory where there are none."""
    import pyarrow.compute as pc

    whole = pc.fill_null(array, np.nan) if array.null_count else array
    return np.asarray(np.from_dlpack(whole), dtype=np.float64)


def truths(array: pyarrow.Array) -> BoolArray:
    """Truth values as numpy; false where there is none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return np.asarray(to_numpy(pc.cast(array, pa.float64())) == 1.0)


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

"""Types used in every signature."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]
IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

__all__ = ["BoolArray", "FloatArray", "IndexArray", "IntArray", "NamedColumns"]


class NamedColumns(Protocol):
    """Columns by their names: a pandas, polars or arrow frame, a mapping of arrays."""

    def __getitem__(self, name: str, /) -> object:
        """The column of that name."""
        ...

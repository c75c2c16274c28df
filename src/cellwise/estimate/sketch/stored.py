"""The bytes of a sketch as a target keeps them: sealed, read, and as normal equations."""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import sketch_type
from cellwise.estimate.fixed.options import SKETCH_SUMS
from cellwise.estimate.fixed.stepper import Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.typing import FloatArray

MAGIC = 0x534B3031  # `SK01`: the version is part of it
REGRESSORS = 11  # ten causes and, last, the residual
# From the end of the header on, in every sketch of this version.
HEADER = np.dtype([(n, "<u4") for n in ("magic", "model_crc", "generation", "segments", "rows")])


class SketchSums(NamedTuple):
    """Normal equations of one sketch, or of several: products of causes, those with the residual.

    ``products`` (10, 10), ``with_residual`` (10,), both a simulation's mean and over the mean
    square of the residual where that is above one; ``segments`` simulations of ``rows`` blocks.
    """

    products: FloatArray
    with_residual: FloatArray
    segments: int
    rows: int
    generation: int
    model_crc: int

    def head(self) -> dict[str, int]:
        """What it is of, as JSON values."""
        return {n: getattr(self, n) for n in ("generation", "segments", "rows")}


def empty_sketch(stepper: Stepper) -> NDArray[Any]:
    """A sketch of one record, for tables that were made with ``sketch=True``."""
    sketch = np.zeros(1, dtype=sketch_type(stepper.tables.options))
    stepper.call("clear_sketch", sketch)
    return sketch


def sealed(sketch: NDArray[Any], tables: FixedStepTables) -> bytes:
    """What a target keeps: the record with its header and its CRC, as `cellwise_seal_sketch`."""
    sketch["magic"] = MAGIC
    sketch["model_crc"] = zlib.crc32(tables.to_bytes())
    sketch["generation"] += 1
    sketch["crc"] = zlib.crc32(sketch.tobytes()[:-4])
    return sketch.tobytes()


def read_sums(block: bytes, name: str = "sketch") -> SketchSums:
    """The sums in the bytes of a sketch.

    Raises
    ------
    InputError        no sketch, another version, damaged bits; nothing summed
    """
    at = HEADER.itemsize
    if len(block) < at + 8 * SKETCH_SUMS + 4 or int.from_bytes(block[:4], "little") != MAGIC:
        raise _refused(name, f"{len(block)} bytes that are no sketch of this version")
    if zlib.crc32(block[:-4]) != int.from_bytes(block[-4:], "little"):
        raise _refused(name, "bits that are damaged")
    head = np.frombuffer(block, HEADER, 1)[0]
    both = np.frombuffer(block, "<f4", 2 * SKETCH_SUMS, at).astype(float)
    total = both[:SKETCH_SUMS] - both[SKETCH_SUMS:]
    if not np.all(np.isfinite(total)) or not head["segments"]:
        raise _refused(name, "nothing that was summed")
    square = np.zeros((REGRESSORS, REGRESSORS))
    square[np.tril_indices(REGRESSORS)] = total
    square = square + np.tril(square, -1).T
    share = 1.0 / (float(head["segments"]) * max(square[-1, -1] / float(head["rows"]), 1.0))
    found = (int(head[n]) for n in ("segments", "rows", "generation", "model_crc"))
    return SketchSums(share * square[:-1, :-1], share * square[-1, :-1], *found)


def _refused(name: str, what: str) -> InputError:
    return InputError(
        f"'{name}': {what}", "what `cellwise_seal_sketch` sealed", "Read it from the target again."
    )

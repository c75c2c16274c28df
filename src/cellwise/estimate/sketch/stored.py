"""The bytes of a sketch as a target keeps them: sealed, read, and as normal equations."""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.estimate.fixed.layout import sketch_type
from cellwise.estimate.fixed.options import SMALL_SKETCH, WHOLE_SKETCH
from cellwise.estimate.fixed.stepper import Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.typing import FloatArray

MAGIC = 0x534B3230  # `SK20`: its last letters are the version
SIZES = {MAGIC + kept: kept for kept in (SMALL_SKETCH, WHOLE_SKETCH)}  # residual and derivatives
# From the first byte on, in every sketch of this version; the sums follow, last is the CRC.
HEADER = np.dtype(
    [(n, "<u4") for n in ("magic", "model_crc", "unit")]
    + [(n, "<f4") for n in ("degrees", "segments", "rows")]
)


class SketchSums(NamedTuple):
    """Normal equations of one sketch.

    ``products`` (n, n) of the derivatives, ``with_residual`` (n,), both a simulation's mean and
    over the mean square of the residual where that is above one (``excess``); ``segments``
    simulations of ``rows`` rows, faded, at a mean ``temperature_C``; ``unit`` the target's number.
    """

    products: FloatArray
    with_residual: FloatArray
    segments: float
    rows: float
    temperature_C: float
    unit: int
    model_crc: int
    excess: float

    def head(self) -> dict[str, Any]:
        """What it is of, as JSON values."""
        return {n: getattr(self, n) for n in ("unit", "temperature_C", "segments", "rows")}


def empty_sketch(stepper: Stepper, unit: int = 0) -> NDArray[Any]:
    """A sketch of one record of the target with that number, for tables with ``sketch``."""
    sketch = np.zeros(1, dtype=sketch_type(stepper.tables.options))
    stepper.call("clear_sketch", sketch, unit)
    return sketch


def sealed(sketch: NDArray[Any], tables: FixedStepTables) -> bytes:
    """What a target keeps: the record with its header and its CRC, as `cellwise_seal_sketch`."""
    sketch["magic"] = MAGIC + tables.options.sketch
    sketch["model_crc"] = zlib.crc32(tables.to_bytes())
    sketch["crc"] = zlib.crc32(sketch.tobytes()[:-4])
    return sketch.tobytes()


def sketch_bytes(block: bytes) -> int:
    """What the sketch in these bytes was asked for: at most so many bytes.

    Raises
    ------
    InputError        as `read_sums`
    """
    read_sums(block)
    return len(block)


def read_sums(block: bytes, name: str = "sketch") -> SketchSums:
    """The sums in the bytes of a sketch.

    Raises
    ------
    InputError        no sketch, another version, damaged bits; nothing summed
    """
    kept = SIZES.get(int.from_bytes(block[:4], "little"), 0)
    pairs = kept * (kept + 1) // 2
    arrays = 2 if kept == WHOLE_SKETCH else 1  # of simulations before, of this one
    if not kept or len(block) < HEADER.itemsize + 4 * arrays * pairs + 4:
        raise _refused(name, f"{len(block)} bytes that are no sketch of this version")
    if zlib.crc32(block[:-4]) != int.from_bytes(block[-4:], "little"):
        raise _refused(name, "bits that are damaged")
    head = np.frombuffer(block, HEADER, 1)[0]
    both = np.frombuffer(block, "<f4", arrays * pairs, HEADER.itemsize).astype(float)
    total = both[:pairs] + (both[pairs:] if arrays > 1 else 0.0)
    if not np.all(np.isfinite(total)) or not head["segments"] > 0.0:
        raise _refused(name, "nothing that was summed")
    square = np.zeros((kept, kept))
    square[np.tril_indices(kept)] = total
    square = square + np.tril(square, -1).T
    excess = max(float(square[0, 0]) / float(head["rows"]), 1.0)
    share = 1.0 / (float(head["segments"]) * excess)
    return SketchSums(
        share * square[1:, 1:],
        share * square[0, 1:],
        float(head["segments"]),
        float(head["rows"]),
        float(head["degrees"]) / float(head["rows"]),
        int(head["unit"]),
        int(head["model_crc"]),
        excess,
    )


def _refused(name: str, what: str) -> InputError:
    return InputError(
        f"'{name}': {what}", "what `cellwise_seal_sketch` sealed", "Read it from the target again."
    )

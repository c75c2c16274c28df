"""The database of CAN frames, and the values of one signal in many frames at once.

The database library decodes frame by frame; a log has millions. The bits are laid out as a DBC file
says: Intel signals begin at their least significant bit and run upwards, Motorola signals begin at
their most significant bit and run downwards through each byte and on to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellwise.errors import InputError
from cellwise.logs.files.format import need
from cellwise.typing import BoolArray, FloatArray


def can_database(path: Path | None, of: str) -> Any:
    """A database of cantools.

    Parameters
    ----------
    path : Path or None     what the user gave
    of : str                whose frames it describes, for the message

    Raises
    ------
    InputError              none was given, or the file is no such database
    """
    cantools = need("cantools", "a CAN log")
    if path is None:
        raise InputError(of, "the database that describes them", "Give it with `dbc=FILE.dbc`.")
    try:
        return cantools.database.load_file(str(path), strict=False)
    except Exception as error:  # parsers of four formats raise what they like
        text = " ".join(str(error).split())[:160]
        raise InputError(
            f"a file that is no CAN database, '{path}' ({text})",
            "a DBC, ARXML, KCD or SYM file",
            "Choose the database of this log.",
        ) from error


def physical_values(
    message: Any, name: str, payloads: Sequence[bytes]
) -> tuple[FloatArray, BoolArray]:
    """Decode one signal of a message of cantools.

    Parameters
    ----------
    message : cantools message
    name : str                  of the signal
    payloads : sequence         data of its frames

    Returns
    -------
    values : (m,) float         in the signal's unit, of the frames that hold the signal; NaN
                                outside the range that the database gives ("not available")
    whole : (n,) bool           frames that are long enough and, of a multiplexed message, hold it
    """
    signal = message.get_signal_by_name(name)
    length: int = message.length
    whole = np.array([len(data) >= length for data in payloads], dtype=np.bool_)
    kept = b"".join(data[:length] for data in payloads if len(data) >= length)
    frames = np.frombuffer(kept, np.uint8).reshape(-1, max(length, 1))
    holds = np.ones(frames.shape[0], dtype=np.bool_)
    if signal.multiplexer_ids:
        selector = message.get_signal_by_name(signal.multiplexer_signal)
        holds = np.isin(_raw(frames, selector), signal.multiplexer_ids)
    whole[whole] = holds
    raw = _raw(frames[holds], signal)
    values: FloatArray = raw.astype(np.float64) * float(signal.scale) + float(signal.offset)
    low, high = signal.minimum, signal.maximum
    if low is not None and high is not None and low < high:
        slack = 0.5 * abs(float(signal.scale))
        values[(values < float(low) - slack) | (values > float(high) + slack)] = np.nan
    return values, whole


def _raw(frames: NDArray[np.uint8], signal: Any) -> NDArray[Any]:
    """The number in the signal's bits, before scale and offset."""
    if signal.byte_order == "little_endian":
        first = signal.start
        bits = np.unpackbits(frames, axis=1, bitorder="little")[:, first : first + signal.length]
        bits = bits[:, ::-1]
    else:
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        bits = np.unpackbits(frames, axis=1, bitorder="big")[:, first : first + signal.length]
    if signal.is_float:
        packed = np.packbits(bits, axis=1)
        real: NDArray[Any] = packed.view(f">f{signal.length // 8}").ravel()
        return real
    weights = np.uint64(1) << np.arange(signal.length, dtype=np.uint64)[::-1]
    number = (bits.astype(np.uint64) * weights).sum(axis=1, dtype=np.uint64)
    if signal.is_signed:
        shift = np.uint64(64 - signal.length)
        signed: NDArray[Any] = (number << shift).view(np.int64) >> np.int64(64 - signal.length)
        return signed
    unsigned: NDArray[Any] = number
    return unsigned

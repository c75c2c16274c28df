"""What a log format is: one record per format, told by its content, never by its file name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from cellwise.errors import InputError
from cellwise.logs.cell_log import CurrentMeaning
from cellwise.logs.columns import Channel
from cellwise.logs.source import LogSource, RawLog

SignConvention = Literal["discharge-positive", "charge-positive"]


@dataclass(frozen=True)
class Format:
    """One log format.

    Parameters
    ----------
    name : str                  what ``cellwise inspect`` calls it
    matches : callable          whether a file's first bytes are of this format
    channels : sequence         its column map
    read : callable             file and column map to channels
    sign : str                  what its positive current means
    current_meaning : str       which interval the current of a row belongs to
    """

    name: str
    matches: Callable[[LogSource], bool]
    channels: Sequence[Channel]
    read: Callable[[LogSource, Sequence[Channel]], RawLog]
    sign: SignConvention
    current_meaning: CurrentMeaning = "interval_end"


# Content that people feed to a log reader by mistake, and the way out.
_OTHER_CONTENT = (
    (b"PK\x03\x04", "a zip archive or an Excel workbook", "Export the sheet as CSV, or unpack it."),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", "Export the sheet as CSV."),
    (b"\x89HDF", "an HDF5 or MATLAB 7.3 file", "Export time, current and voltage as CSV."),
    (b"MATLAB 5.0", "a MATLAB file", "Export time, current and voltage as CSV."),
    (b"BZh", "a bzip2 file", "Decompress it first."),
    (b"\xfd7zXZ", "an xz file", "Decompress it first."),
    (b"\x28\xb5\x2f\xfd", "a zstd file", "Decompress it first."),
    (b"\xff\xfe", "a file in UTF-16", "Save it as UTF-8."),
    (b"\xfe\xff", "a file in UTF-16", "Save it as UTF-8."),
)


def tell_format(source: LogSource, formats: Sequence[Format]) -> Format:
    """The first format whose content test the file passes.

    Raises
    ------
    InputError        none does
    """
    for known in formats:
        if known.matches(source):
            return known
    what, action = "content of no known format", "Export the log as CSV with a header line."
    for magic, kind, way_out in _OTHER_CONTENT:
        if source.head.startswith(magic):
            what, action = kind, way_out
    raise InputError(
        f"{what} in '{source.path}' (first bytes {source.head[:12]!r})",
        "a log in one of the formats: " + ", ".join(known.name for known in formats),
        action,
    )

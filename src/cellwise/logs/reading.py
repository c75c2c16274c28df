"""Read a measured log, whatever its format."""

from __future__ import annotations

from pathlib import Path

from cellwise.logs.assembly import Origin, assemble
from cellwise.logs.cell_log import CellLog
from cellwise.logs.formats import Format, tell_format
from cellwise.logs.source import Progress, open_source
from cellwise.logs.tidy import TIDY_CSV, TIDY_PARQUET

# In this order: plain text is the last resort.
FORMATS: tuple[Format, ...] = (TIDY_PARQUET, TIDY_CSV)

_SUFFIXES = (".gz", ".csv", ".parquet", ".txt")


def read_log(
    path: str | Path,
    *,
    sign: str = "auto",
    name: str | None = None,
    progress: Progress | None = None,
) -> CellLog:
    """Read a log in the tidy form or in a native format, told by its content.

    The tidy form has the columns ``time_s, current_A, voltage_V[, temperature_C]
    [, ampere_hours][, step]`` in any order, as CSV (plain or gzip) or parquet, positive current =
    discharge. Other units are converted when the name tells them (``current_mA``, ``time_h``, ...).

    Parameters
    ----------
    path : str or Path
    sign : str          ``auto`` trusts the format's sign, verifies it and tells; the other two,
                        ``charge-positive`` and ``discharge-positive``, override the format
    name : str          for people; the file's name without suffix if not given
    progress : callable     called with what is done and the total, while reading

    Returns
    -------
    CellLog             its ``notices`` say what was converted, left out or looks wrong

    Raises
    ------
    InputError          the file cannot be read as a log: see the message for what to do
    """
    source = open_source(path, progress)
    known = tell_format(source, FORMATS)
    raw = known.read(source, known.channels)
    origin = Origin(
        name=_plain_name(source.path) if name is None else name,
        source=str(source.path),
        format=known.name,
        sign=known.sign,
        current_meaning=known.current_meaning,
    )
    return assemble(raw, origin, sign)


def _plain_name(path: Path) -> str:
    name = path.name
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name or path.name

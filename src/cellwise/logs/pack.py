"""From a pack to its mean cell."""

from __future__ import annotations

from cellwise.errors import InputError
from cellwise.logs.files.options import FROM_FILE, ReadOptions
from cellwise.logs.files.source import RawLog


def to_cell(raw: RawLog, options: ReadOptions, where: str) -> RawLog:
    """Divide a pack's voltage by the cells in series, current and counter by those in parallel.

    Raises
    ------
    InputError        the file does not state the cells in series
    """
    series = options.series
    if series == FROM_FILE:
        if raw.cells is None:
            raise InputError(
                f"`series='auto'` for {where}, which does not state its cells in series",
                "a number of cells",
                "Give it: `series=4`, say.",
            )
        series = raw.cells
    notices = list(raw.notices)
    if raw.cells is not None and raw.cells > 1 and options.series == 1:
        notices.append(
            f"the file states {raw.cells} cells in series: `series='auto'` reads their mean cell"
        )
    elif raw.cells is not None and raw.cells != series:
        notices.append(
            f"the file states {raw.cells} cells in series, {series} were stated by the user"
        )
    channels = dict(raw.channels)
    if series > 1:
        channels["voltage_V"] = channels["voltage_V"] / series
    if options.parallel > 1:
        for field in ("current_A", "charge_Ah"):
            if field in channels:
                channels[field] = channels[field] / options.parallel
    if series > 1 or options.parallel > 1:
        notices.append(
            f"a pack of {series} in series, {options.parallel} in parallel, read as its mean cell"
        )
    return RawLog(channels, tuple(notices), raw.cells)

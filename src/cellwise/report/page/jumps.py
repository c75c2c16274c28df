"""Alerts that lead to their rows: the rows and times a notice names become links into the plots."""

from __future__ import annotations

import re
from collections.abc import Iterable

from cellwise.logs.cell_log import CellLog
from cellwise.report.page.markup import Markup, escape

# "row 12", "rows 12 to 40", "rows between 12 and 40", counted from 1; "at 812 s", "from 8.5 s on",
# and hours from the first row, where an error is largest.
PLACES = re.compile(
    r"\brows? (?P<first>\d+)(?: to (?P<last>\d+))?"
    r"|\brows between (?P<low>\d+) and (?P<high>\d+)"
    r"|\b(?:at|from) (?P<second>\d+(?:\.\d+)?) s\b"
    r"|(?<=\d )after (?P<hours>\d+\.\d\d) h\b"
)


ANCHOR = "trace"  # the section of all samples, where a link leads without scripts


def clock_of(log: CellLog) -> str:
    """What the plots of a log share, so that a time in one of them is a time in all."""
    return log.name or "log"


def linked(notice: str, log: CellLog) -> Markup:
    """A notice about a log; the rows and times in it are links that show them in its plots.

    Parameters
    ----------
    notice : str        rows counted from 1, times in the log's own seconds
    log : CellLog       whose rows they are

    Returns
    -------
    Markup        the text, escaped; without links where it names no row that the log has
    """
    parts: list[str] = []
    done = 0
    for found in PLACES.finditer(notice):
        seconds = _seconds(found, log)
        if seconds is None:
            continue
        parts.append(escape(notice[done : found.start()]))
        low, high = (f"{s - log.time_s[0]:.10g}" for s in seconds)
        parts.append(
            f'<a class="jump" href="#{ANCHOR}" data-clock="{escape(clock_of(log))}" '
            f'data-from="{low}" data-to="{high}">{escape(found[0])}</a>'
        )
        done = found.end()
    return Markup("".join([*parts, escape(notice[done:])]))


def linked_among(notice: str, logs: Iterable[CellLog]) -> Markup:
    """A notice that begins with the name of one of several logs, or has it in quotes."""
    for log in logs:
        if log.name and (notice.startswith(f"{log.name}: ") or f"'{log.name}'" in notice):
            return linked(notice, log)
    return escape(notice)


def _seconds(found: re.Match[str], log: CellLog) -> tuple[float, float] | None:
    """First and last time that a place names, none where the log has no such row."""
    if found["second"]:
        second = float(found["second"])
        return (second, second) if log.time_s[0] <= second <= log.time_s[-1] else None
    if found["hours"]:  # to a hundredth
        middle = float(log.time_s[0]) + 3600.0 * float(found["hours"])
        low, high = (
            max(middle - 18.0, float(log.time_s[0])),
            min(middle + 18.0, float(log.time_s[-1])),
        )
        return (low, high) if low <= high else None
    first = int(found["first"] or found["low"])
    last = int(found["last"] or found["high"] or first)
    if not 1 <= first <= last <= len(log):
        return None
    return float(log.time_s[first - 1]), float(log.time_s[last - 1])

"""What a refusal proposes is tried before: it reads, as a cell, and the voltage answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.grave import is_grave
from cellwise.logs.checks.sign import verify_sign
from cellwise.logs.checks.units import CELL
from cellwise.logs.checks.unsigned import NO_SIGN
from cellwise.logs.files.choice import MissingColumnsError
from cellwise.logs.files.source import LogSource, ReadOptions

TRIED_BYTES = 4_000_000  # of a larger text the beginning is tried
LEAST_V = 0.5  # of a cell, typically
ANSWERS, READS = 2, 1


def tried(
    refusal: MissingColumnsError, source: LogSource, read: Callable[[LogSource], CellLog]
) -> InputError:
    """The refusal of columns that are missing, with names that were tried; without, where none do.

    Parameters
    ----------
    refusal : MissingColumnsError        whose proposals nobody has tried
    source : LogSource              the file
    read : callable                 a file, with what is stated of it, to its log
    """
    begin = _beginning(source)
    found: list[tuple[int, Mapping[str, str]]] = []
    for proposal in refusal.proposals:
        stated = replace(source.options, channels={**source.options.channels, **proposal})
        if passed := _passes(begin, stated, read):
            found.append((passed, proposal))
        if passed == ANSWERS:
            break
    if not found:
        return InputError(
            refusal.found,
            refusal.expected,
            "None of them was found to fit. If some do, name them with `channels={...}`. "
            + refusal.action,
        )
    passed, best = max(found, key=lambda one: one[0])
    said = ", ".join(f"{tidy!r}: {name!r}" for tidy, name in best.items())
    why = "it reads, and the voltage answers the current" if passed == ANSWERS else "it reads"
    others = sorted({n for _, p in found for n in p.values()} - set(best.values()))
    also = f" Others that read: {', '.join(others)}." if others else ""
    return InputError(
        refusal.found,
        refusal.expected,
        f"Name the columns with `channels={{{said}}}`, if that is what they hold ({why}).{also} "
        f"Or: {refusal.action[:1].lower()}{refusal.action[1:]}",
    )


def _beginning(source: LogSource) -> LogSource:
    """The file, or of a long text its first lines."""
    if not source.is_text or source.size < TRIED_BYTES:
        return source
    with source.open() as stream:
        text = stream.read(TRIED_BYTES)
    return replace(source, content=text[: text.rfind(b"\n") + 1], gzipped=False, size=len(text))


def _passes(source: LogSource, options: ReadOptions, read: Callable[[LogSource], CellLog]) -> int:
    """2: it reads and the voltage answers; 1: it reads; 0: it does not, or is no cell."""
    try:
        log = read(replace(source, options=options, progress=None))
    except InputError:
        return 0
    usual = float(np.nanmedian(log.voltage_V))
    string = source.options.series == 1 and usual > CELL.largest_V
    for notice in log.notices:
        if is_grave(notice) and not (notice.startswith(NO_SIGN) or (string and "series" in notice)):
            return 0
    if usual < LEAST_V:
        return 0
    check = verify_sign(log)
    if check.verdict != "undetermined":
        return ANSWERS
    return 0 if "does not follow" in check.evidence[0] else READS

"""What a refusal proposes is tried before: it reads, as a cell, and the voltage answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import LEAST_CURRENT_A, verify_sign
from cellwise.logs.checks.units import LARGEST_V
from cellwise.logs.files.choice import MissingColumnsError
from cellwise.logs.files.columns import listed
from cellwise.logs.files.source import LogSource
from cellwise.notices import Code
from cellwise.wording import arg, within

TRIED_BYTES = 2_000_000  # of a larger text the beginning is tried
LEAST_V = 0.5  # of a cell, typically
MOST_A, SLOWEST_S = 300.0, 1000.0  # beyond these another unit is more likely


class TriedProposal(NamedTuple):
    """What speaks for names that read: the voltage answers, is a cell's, the rest is usual."""

    answers: bool
    one_cell: bool
    usual: bool


def tried(
    refusal: MissingColumnsError, source: LogSource, read: Callable[[LogSource], CellLog]
) -> InputError:
    """The refusal of columns that are missing, with names that were tried; without, where none do.

    Parameters
    ----------
    refusal : MissingColumnsError   whose proposals nobody has tried
    source : LogSource              the file
    read : callable                 a file, with what is stated of it, to its log
    """
    begin = _beginning(source)
    found: list[tuple[TriedProposal, Mapping[str, str]]] = []
    for proposal in refusal.proposals:
        stated = replace(source.options, channels={**source.options.channels, **proposal})
        passed = _passes(replace(begin, options=stated, progress=None), read)
        if passed is not None:
            found.append((passed, proposal))
            if all(passed):
                break
    if not found:
        return MissingColumnsError(
            refusal.found,
            refusal.expected,
            "No column was found to fit. Name those that do with "
            + arg("channels", letter="{...}")
            + ". Or: "
            + within(refusal.action),
            refusal.missing,
        )
    passed, best = max(found, key=lambda one: one[0])
    why = "it reads, and the voltage answers the current" if passed.answers else "it reads"
    others = sorted({name for _, one in found for name in one.values()} - set(best.values()))
    also = f" What reads, too: {listed(others)}." if others else ""
    return MissingColumnsError(
        refusal.found,
        refusal.expected,
        "Name the columns with "
        + arg("channels", tuple(best.items()))
        + f", if that is what they hold ({why}).{also} Or: "
        + within(refusal.action),
        refusal.missing,
        fitting=best,
    )


def _beginning(source: LogSource) -> LogSource:
    """The file, or of a long text its first lines."""
    if not source.is_text or source.size < TRIED_BYTES:
        return source
    with source.open() as stream:
        text = stream.read(TRIED_BYTES)
    return replace(source, content=text[: text.rfind(b"\n") + 1], gzipped=False, size=len(text))


def _passes(source: LogSource, read: Callable[[LogSource], CellLog]) -> TriedProposal | None:
    """What speaks for what is stated of a file; None: it does not read, or is no cell's."""
    try:
        log = read(source)
    except InputError:
        return None
    one_cell = log.typical_voltage_V <= LARGEST_V
    pack = source.options.series == 1 and not one_cell  # whose cells nobody has stated
    settled = {Code.NO_SIGN, Code.SIGN_CONTRADICTED}  # by what else is stated of the log
    settled |= {Code.VOLTAGE_OF_PACK, Code.VOLTAGE_UNIT} if pack else set()
    if any(n.is_critical and n.code not in settled for n in log.notices):
        return None
    check = verify_sign(log)
    if log.typical_voltage_V < LEAST_V or not check.follows:
        return None
    peak, every_s = np.nanmax(np.abs(log.current_A)), np.median(log.interval_s[1:])
    usual = bool(LEAST_CURRENT_A <= peak < MOST_A and every_s < SLOWEST_S)
    return TriedProposal(check.verdict != "undetermined", one_cell, usual)

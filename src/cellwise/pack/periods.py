"""A pack's logs in order, and what they say of its cells, period by period."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import NamedTuple

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.logs.packs.pack_log import PackLog
from cellwise.logs.stated import check_order, day_of_name
from cellwise.pack.differences import MeanCell, OcvSlope, Regressors, mean_cell, regressors
from cellwise.pack.evidence import USUAL, PackEvidence, pack_evidence


class _Period(NamedTuple):
    """Logs of so many days are one period, of which so many rows are compared: more say no more."""

    days: float = 30.0
    rows: int = 200_000


PERIOD = _Period()


@dataclass(frozen=True, eq=False)
class PackDay:
    """One log, its mean cell, and on which day it was recorded (None: nobody knows)."""

    log: PackLog
    mean: MeanCell
    day: date | None

    @property
    def ordinal(self) -> float:
        """Days on a common clock; 0 where nobody knows."""
        return 0.0 if self.day is None else float(self.day.toordinal())


def pack_days(
    model: CellModel, logs: Sequence[PackLog], names: tuple[str, ...] | None = None
) -> tuple[PackDay, ...]:
    """The mean cell of every log, in order of time.

    Parameters
    ----------
    names : tuple of str or None      the cells that an earlier state knows

    Raises
    ------
    InputError        no log; other cells in one log than in another; days that run backwards
    """
    if not logs:
        raise InputError("no log", "at least one log with cell voltages", "Name it.")
    expected = logs[0].names if names is None else names
    before = "the saved state" if names is not None else f"'{logs[0].name}'"
    for log in logs:
        if log.names != expected:
            absent = [n for n in expected if n not in log.names][:3]
            added = [n for n in log.names if n not in expected][:3]
            raise InputError(
                f"{log.cells} cells in '{log.name}' and {len(expected)} in {before}"
                + (f", without {', '.join(absent)}" if absent else "")
                + (f", with {', '.join(added)}" if added else ""),
                "the same cells in every log of a pack",
                "Estimate logs with other cells by themselves, or repair the columns.",
            )
    days = [PackDay(log, mean_cell(model, log.mean), day_of_name(log.name)) for log in logs]
    check_order([(one.log.name, one.day) for one in days])
    return tuple(days)


def periods(days: Sequence[PackDay]) -> tuple[tuple[PackDay, ...], ...]:
    """Logs of thirty days together; all together where a day is not known."""
    if any(d.day is None for d in days):
        return (tuple(days),)
    found: list[list[PackDay]] = [[days[0]]]
    for day in days[1:]:
        if day.ordinal - found[-1][0].ordinal >= PERIOD.days:
            found.append([])
        found[-1].append(day)
    return tuple(tuple(part) for part in found)


def period_evidence(model: CellModel, days: Sequence[PackDay]) -> PackEvidence:
    """What the logs of one period say of the cells."""
    middle = 0.5 * (days[0].ordinal + days[-1].ordinal)
    rows = sum(len(d.log) for d in days)
    stride = max(-(-rows // PERIOD.rows), 1)
    parts, differences, known, blocks, logs = [], [], [], [], []
    count = 0
    for number, day in enumerate(days):
        log, mean = day.log, day.mean
        rows_of = regressors(mean, OcvSlope(model, log.mean), day.ordinal - middle)
        ok = np.isfinite(log.cell_V)
        if log.balancing is not None:
            ok &= ~log.balancing  # the bypass current loads the sense wires
        block = (log.mean.time_s // USUAL.block_s).astype(np.int64)
        moved = np.diff(block, prepend=block[0]) + np.abs(np.diff(mean.part, prepend=mean.part[0]))
        block = count + np.cumsum(moved != 0)
        count = int(block[-1]) + 1
        some = slice(None, None, stride)
        parts.append(Regressors(rows_of.rows[some], rows_of.change_V[some], rows_of.used[some]))
        differences.append(log.difference_V[some])
        known.append(ok[some])
        blocks.append(block[some])
        logs.append(np.full(block[some].size, number))
    together = Regressors(
        np.concatenate([p.rows for p in parts]),
        np.concatenate([p.change_V for p in parts]),
        np.concatenate([p.used for p in parts]),
    )
    found = pack_evidence(
        together, *(np.concatenate(c) for c in (differences, known, blocks, logs))
    )
    return replace(found, days=days[-1].ordinal - days[0].ordinal)

"""The page of a fleet's replay: one row a cell, the worst first."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from textwrap import shorten
from typing import Any, NamedTuple

from cellwise.report.page.markup import MOST, lead_of, paragraph, record_table, tiles
from cellwise.report.page.numerals import millivolt, percent, plural, significant
from cellwise.report.page.section import Section, write_page

SAID = 100  # characters of an error or notice that stand in the table
Rows = Mapping[str, Sequence[Any]]


class FleetCell(NamedTuple):
    """A cell over all its logs: the worst errors, the last SOC and health, what failed.

    ``voltage_rmse_V`` and ``soc_rmse`` are the largest of its logs, NaN where none has one.
    """

    name: str
    logs: int
    failed: int
    hours: float
    voltage_rmse_V: float
    worst_log: str
    soc_rmse: float
    soc: float
    soc_std: float
    soh_capacity: float
    soh_resistance: float
    said: str


def cells_of(rows: Rows) -> list[FleetCell]:
    """The cells of a fleet's rows, those with a failure first, then by their voltage error."""
    groups: dict[str, list[int]] = {}
    for k, (cell, log) in enumerate(zip(rows["cell"], rows["log"], strict=True)):
        groups.setdefault(str(cell or log), []).append(k)
    return sorted((_cell(rows, name, own) for name, own in groups.items()), key=_worst_first)


def _worst_first(cell: FleetCell) -> tuple[bool, float]:
    error = cell.voltage_rmse_V
    return cell.failed == 0, -error if math.isfinite(error) else math.inf


def _cell(rows: Rows, name: str, own: Sequence[int]) -> FleetCell:
    def values(column: str) -> list[float]:
        found = (rows[column][k] for k in own)
        return [float(v) for v in found if v is not None and math.isfinite(v)]

    def last(column: str) -> float:
        return (values(column) or [math.nan])[-1]

    errors = [rows["error"][k] for k in own if rows["error"][k]]
    rmse = {float(rows["voltage_rmse_V"][k] or 0.0): str(rows["log"][k]) for k in own}
    notices = [n for k in own if (n := rows["notices"][k])]
    return FleetCell(
        name=name,
        logs=len(own),
        failed=len(errors),
        hours=sum(values("duration_s")) / 3600.0,
        voltage_rmse_V=max(values("voltage_rmse_V"), default=math.nan),
        worst_log=rmse[max(rmse)],
        soc_rmse=max(values("soc_rmse"), default=math.nan),
        soc=last("soc_final"),
        soc_std=last("soc_final_std"),
        soh_capacity=last("soh_capacity"),
        soh_resistance=last("soh_resistance"),
        said=shorten(str((errors or notices or [""])[0]), SAID, placeholder=" ..."),
    )


COLUMNS: tuple[tuple[str, Callable[[FleetCell], object]], ...] = (
    ("cell", lambda c: c.name),
    ("voltage RMSE, worst log [mV]", lambda c: significant(1e3 * c.voltage_rmse_V)),
    ("SOC RMSE, worst [%]", lambda c: significant(100.0 * c.soc_rmse, 2)),
    ("last SOC [%]", lambda c: significant(100.0 * c.soc)),
    ("± [points]", lambda c: significant(200.0 * c.soc_std, 2)),
    ("capacity, of the model's [%]", lambda c: significant(100.0 * c.soh_capacity)),
    ("resistance, of the model's [%]", lambda c: significant(100.0 * c.soh_resistance)),
    ("said first", lambda c: c.said),
    ("logs", lambda c: c.logs),
    ("failed", lambda c: c.failed or ""),
    ("hours", lambda c: significant(c.hours)),
    ("worst log", lambda c: c.worst_log if c.logs > 1 else ""),
)
TEXT = ("cell", "said first", "worst log")


def fleet_page(rows: Rows, path: str | Path) -> Path:
    """Write the page of a fleet's replay.

    Parameters
    ----------
    rows : mapping      columns of `cellwise fleet replay`, one value for each log

    Raises
    ------
    InputError        the path cannot be written
    """
    cells = cells_of(rows)
    failed = sum(cell.failed for cell in cells)
    shown = cells[: MOST.cells]
    known = sorted((c.voltage_rmse_V, c.name) for c in cells if math.isfinite(c.voltage_rmse_V))
    middle = median(size for size, _ in known) if known else math.nan
    finding = f"{plural(len(cells), 'cell')}: {millivolt(middle)} voltage RMSE for the median cell"
    if known:
        finding += f", {millivolt(known[-1][0])} at worst ({known[-1][1]})"
    if failed:
        finding = f"{plural(failed, 'log')} of {len(rows['log'])} failed. {finding}"
    text_columns = [k for k, (head, _) in enumerate(COLUMNS) if head in TEXT]
    table = record_table(shown, *COLUMNS, text_columns=text_columns, sortable=True)
    note = "Those with a log that failed come first, then by the voltage error of their worst log; "
    note += "a click on a column's head sorts by it. Health is that of the adaptive filter."
    if len(shown) < len(cells):
        note += f" The {len(shown)} worst are shown; the parquet beside this page holds all logs."
    facts = [
        ("cells", len(cells)),
        ("logs", len(rows["log"])),
        ("failed", failed),
        ("hours", significant(sum(c.hours for c in cells))),
        ("median cell's voltage RMSE", millivolt(middle)),
    ]
    outside = [c for c in cells if math.isfinite(c.soc_std) and c.soc_std > 0.1]
    lines = [f"{plural(len(outside), 'cell')} with a SOC no better than ± {percent(0.2, 0)}"]
    return write_page(
        path,
        f"{finding}.",
        "A fleet's replay, by cellwise",
        [Section("cells", "Every cell", (paragraph(note, "note"), table))],
        {"cells": [c._asdict() for c in cells]},
        lead=lead_of([], tiles(facts), lines if outside else ()),
    )

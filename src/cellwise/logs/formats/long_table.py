"""A table of one row for each entity and time, as home automation and databases export it."""

from __future__ import annotations

import csv

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.choice import choose_columns, says_its_sign
from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.csv_text import csv_layout
from cellwise.logs.files.format import Format
from cellwise.logs.files.header import header_cells
from cellwise.logs.files.source import LogSource, RawLog, lines_of
from cellwise.logs.files.tables import LOOKED_AT
from cellwise.logs.files.times import epoch_unit, seconds_of, time_kind
from cellwise.logs.files.words import PART, likeness, long_table
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray


def _is_long(source: LogSource) -> bool:
    return any(long_table(header_cells(line)) is not None for line in source.first_lines[:20])


def _read(source: LogSource, known: Format) -> RawLog:
    """A channel from each entity, at the stamps of all; a value holds until the next."""
    import pyarrow as pa

    layout = csv_layout(source)
    entities, value, unit = long_table(layout.header) or ([0], 1, None)

    def worth(k: int) -> int:
        kind = time_kind([row[k] for row in layout.cells if k < len(row)])
        return (
            2 if kind in ("date", "epoch", "clock") else likeness("time_s", layout.header[k]) > PART
        )

    others = [k for k in range(len(layout.header)) if k not in (*entities, value, unit)]
    time = max(others, key=worth) if any(map(worth, others)) else None
    if time is None:
        raise InputError(
            f"a long table without a column of times in {source.where}",
            "stamps in each row",
            "Export it with the time of each row.",
        )
    width = len(layout.header)
    rows = list(csv.reader(lines_of(source, layout.offset), delimiter=layout.delimiter))
    rows = [row for row in rows if len(row) >= width]
    entity = max(entities, key=lambda k: len({row[k] for row in rows}))
    stamps = pa.chunked_array([pa.array([row[time] or None for row in rows], pa.string())])
    seconds, _ = seconds_of(stamps, layout.header[time], source.where)
    seconds = seconds * (epoch_unit(seconds) or 1.0)
    order = np.argsort(seconds, kind="stable")
    of_rows = [
        f"{row[entity]} ({row[unit]})" if unit and row[unit] else row[entity] for row in rows
    ]
    names = list(dict.fromkeys(of_rows))
    texts: dict[str, list[str]] = {name: [] for name in names}
    for name, row in zip(of_rows, rows, strict=True):
        texts[name] += [row[value]] if len(texts[name]) < LOOKED_AT else []
    channels = [c for c in known.channels if c.field != "time_s"]
    columns, notices = choose_columns(
        names,
        channels,
        f"{source.where}, a long table (one row for each entity and time), as its entities",
        chosen=source.options.channels,
        look=lambda k: texts[names[k]],
    )
    found: dict[str, FloatArray] = {}
    of = np.array(of_rows)[order]
    numbers = np.array([_number(row[value], layout.decimal) for row in rows])[order]
    chosen = np.isin(of, [c.name for c in columns])
    times, of, numbers = seconds[order][chosen], of[chosen], numbers[chosen]
    for column in columns:
        at = np.where(of == column.name, np.arange(of.size), -1)
        last = np.maximum.accumulate(at)
        held = np.where(last >= 0, numbers[np.maximum(last, 0)], np.nan)
        found[column.field] = column.unit.convert(held)
    last_of = np.append(np.diff(times) > 0, True)  # what has changed at one stamp is one row
    begun = np.logical_and.accumulate(np.any([np.isnan(x) for x in found.values()], axis=0))
    last_of &= ~begun  # before each entity has its first value
    found = {"time_s": times, **found}
    text = "a long table: each value holds until the next of its entity"
    notices.append(Notice(Code.LONG_TABLE, text))
    return RawLog(
        {field: values[last_of] for field, values in found.items()},
        tuple(n for n in notices if n.code is not Code.COLUMN_UNUSED),
        signed=says_its_sign(columns),
    )


def _number(text: str, decimal: str) -> float:
    try:
        return float(text.replace(decimal, "."))
    except ValueError:  # unavailable, unknown
        return float("nan")


LONG_TABLE = Format(
    "long-table",
    _is_long,
    TIDY_CHANNELS,
    _read,
    "discharge-positive",
    current_meaning="interval_start",
)

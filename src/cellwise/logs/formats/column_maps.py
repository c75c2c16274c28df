"""The column maps of `column_maps.toml`, as formats: a tester's format is data, not code."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from cellwise.logs.files.columns import ANY, REQUIRED, TIDY_NAMES, Channel, Unit, named_units
from cellwise.logs.files.csv_text import read_csv
from cellwise.logs.files.format import Format, Reader
from cellwise.logs.files.header import has_names
from cellwise.logs.files.source import LogSource

PLACE = Path(__file__).with_name("column_maps.toml")

FIELDS = (
    *("time_s", "step_time_s", "current_A", "voltage_V", "working_V", "counter_V"),
    *("temperature_C", "charge_Ah", "charged_Ah", "discharged_Ah", "moved_Ah", "step", "direction"),
    *("instance", "day_s"),
)
_STATES = {"charge": -1.0, "discharge": 1.0, "rest": 0.0}


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(PLACE.read_text(encoding="utf-8"))


def mapped(
    table: str,
    name: str = "",
    *,
    matches: Callable[[LogSource], bool] | None = None,
    read: Reader = read_csv,
    **more: Any,
) -> Format:
    """The format of one table of the file.

    Parameters
    ----------
    table : str         its heading
    name : str          the format's name; empty: the heading
    matches : callable  empty: one line of the text holds a name of each group of ``marks``, and
                        of each channel that is needed and that nobody has stated
    read : callable     the reader
    more                of `Format`
    """
    entry = _tables()[table]
    like = _tables()[entry["like"]] if "like" in entry else {}
    channels = tuple(
        Channel(
            field,
            _names(field, like) | _names(field, entry),
            required=field in REQUIRED,
            instead=(like | entry).get("instead", {}).get(field, ""),
        )
        for field in FIELDS
        if field in entry or field in like
    )

    def has_all(source: LogSource) -> bool:
        return has_names(source, *marks(table), *_needed(channels, source.options.channels))

    return Format(
        name=name or table,
        matches=matches or has_all,
        channels=channels,
        known=ANY if entry.get("any") else (*like.get("unused", ()), *entry["unused"]),
        read=read,
        sign=entry["sign"],
        **{"instances": "instance" in entry, **more},
    )


def _needed(channels: Sequence[Channel], stated: Mapping[str, str]) -> list[list[str]]:
    """Names of each channel that is needed, and of what will do in its place."""
    there = {TIDY_NAMES[tidy][0] for tidy in stated if tidy in TIDY_NAMES}
    return [
        [n for c in channels if c.field in (need.field, need.instead) for n in c.names]
        for need in channels
        if need.required and need.field not in there
    ]


def marked_tables() -> list[str]:
    """The tables of the file that a text can be recognised by, in order."""
    return [name for name, entry in _tables().items() if "marks" in entry]


def marks(table: str) -> list[list[str]]:
    """Groups of names of which a header of this format has one each."""
    found: list[list[str]] = _tables()[table]["marks"]
    return found


def _names(field: str, entry: Mapping[str, Any]) -> dict[str, Unit]:
    """Column names of a channel with their units."""
    if field == "direction" and field in entry:
        states = {label: _STATES[k] for k, found in entry["states"].items() for label in found}
        return dict.fromkeys(entry[field], Unit(kind="label", labels=states))
    return named_units(entry.get(field, ()))

"""Which logs a path means: a file, all logs of a folder, or the files that a pattern matches."""

from __future__ import annotations

import re
from dataclasses import replace
from glob import glob, has_magic
from pathlib import Path
from typing import NamedTuple

from cellwise.errors import InputError
from cellwise.logs.stated import Stated, day_of_name

# What files of logs end in; `read_log` looks at the content, whatever the name.
SUFFIXES = (
    *(".gz", ".csv", ".parquet", ".txt", ".bdf", ".ulg", ".bin", ".mat", ".mf4", ".mdf", ".nda"),
    *(".ndax", ".mpr", ".mpt", ".blf", ".asc", ".log", ".trc", ".res", ".xlsx", ".xls", ".mcap"),
    *(".db3", ".bag"),
)


class Places(NamedTuple):
    """The files that a path means, with what is stated of them; whether it named one file."""

    logs: tuple[Stated, ...]
    named: bool


def logs_of(text: str) -> Places:
    """The logs that a path means, in the order of time.

    A folder means the files in it that end as logs do, a pattern (``drives/*.csv``) whatever it
    matches; what is stated behind an ``@`` holds for each. A file of the very name goes first.

    Raises
    ------
    InputError        no log in the folder, no file that the pattern matches
    """
    stated = Stated.parse(text)
    place = Path(stated.path)
    if _is(place.is_file):
        return Places((stated,), named=True)
    if _is(place.is_dir):
        found = [p for p in place.iterdir() if p.is_file() and p.name.lower().endswith(SUFFIXES)]
        what = f"no log in the folder '{place}'"
    elif has_magic(stated.path):
        found = [Path(p) for p in glob(stated.path, recursive=True) if Path(p).is_file()]
        what = f"no file that matches '{stated.path}'"
    else:
        return Places((stated,), named=True)
    found = sorted((p for p in found if p.name[0] not in "._"), key=in_order)
    if not found:
        raise InputError(what, "logs of one cell", "Check the path.")
    return Places(tuple(replace(stated, path=str(p)) for p in found), named=False)


def in_order(path: Path) -> tuple[int, list[tuple[int, int | str]]]:
    """By the day in the name; without one, numbers in names count as numbers."""
    day = day_of_name(path.name)
    parts = re.split(r"(\d+)", path.name)
    number: list[tuple[int, int | str]] = [(0, int(p)) if p.isdigit() else (1, p) for p in parts]
    return (0 if day is None else day.toordinal()), number


def plain_name(path: Path) -> str:
    """A file's name without what it ends in, for people."""
    name = path.name
    for suffix in SUFFIXES:
        if name.casefold().endswith(suffix):
            name = name[: -len(suffix)]
    return name or path.name


def _is(look: object) -> bool:
    try:
        return bool(look())  # type: ignore[operator]
    except (OSError, ValueError):  # a name that the system refuses
        return False

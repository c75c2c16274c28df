"""What a path means and what is known of its logs: ``LOG@-20,soc0=1``, a folder, a pattern."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from glob import glob, has_magic
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from cellwise.arguments import beyond, check_kind, file_path, held_soc
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice

KEYS = ("temperature_C", "soc0", "instance")
FORM = "LOG@TEMPERATURE or LOG@temperature_C=-20,soc0=1"
_DAY = re.compile(r"(?<!\d)((?:19|20)\d\d)[-_]?([01]\d)[-_]?([0-3]\d)(?!\d)")
VOLT_PER_KELVIN = 0.005  # about what a wrong temperature does at 1C: only the order of notices
OTHER_TEMPERATURE_K = 10.0  # sensors, chambers and the way between them differ by less


@dataclass(frozen=True)
class Stated:
    """A log's path, and what whoever gives it knows of it.

    Parameters
    ----------
    path : str                      of the log
    temperature_C : float or None   of the cell where the log measured none [degC]
    soc0 : float or None            true SOC at the first row, 0..1: it is believed
    instance : int or None          which of several logs or batteries in the file, from 0

    Raises
    ------
    InputError        a temperature outside -80..120 degC, a SOC outside 0..1
    """

    path: str
    temperature_C: float | None = None
    soc0: float | None = None
    instance: int | None = None

    def __post_init__(self) -> None:
        check_temperature(self.temperature_C)
        if self.soc0 is not None and not 0.0 <= held_soc(self.soc0) <= 1.0:
            hint = " Per cent? Divide by 100." if 1.0 < self.soc0 <= 100.0 else ""
            raise InputError(
                f"a stated initial SOC of {self.soc0:g} ('{self.path}')",
                "a fraction from 0 to 1",
                f"Write e.g. LOG@soc0=1.{hint}",
            )

    @classmethod
    def parse(cls, text: str) -> Self:
        """The record of ``LOG``, ``LOG@-20`` or ``LOG@temperature_C=-20,soc0=1``.

        What stands behind the last ``@`` is the statement, unless a file has the whole name or a
        folder's name holds that ``@``.

        Raises
        ------
        InputError        an unknown or repeated key, what is no number or out of range
        """
        check_kind("log", text, str, "Write where the file is: 'a.csv'.")
        path, at, tail = text.rpartition("@")
        if not at or "/" in tail or "\\" in tail or _is(Path(text).exists):
            return cls(text)
        if not path:
            raise InputError(f"'{text}' without a log", FORM, "Put the log before the @.")
        values: dict[str, float] = {}
        for item in tail.split(","):
            name, equals, value = (part.strip() for part in item.partition("="))
            if not equals:
                name, value = "temperature_C", name.removesuffix("C")
            if name not in KEYS:
                raise InputError(
                    f"'{name}' stated of '{path}'", " or ".join(KEYS), f"Write {FORM}."
                )
            if name in values:
                raise InputError(f"{name} stated twice in '{text}'", "one value", "Keep one.")
            try:
                values[name] = float(value)
            except ValueError:
                raise InputError(
                    f"{name} of '{value}' in '{text}', and no file of that name",
                    FORM,
                    "Write e.g. hppc.csv@-10, or correct the file's name.",
                ) from None
        nth = values.pop("instance", None)
        return cls(path, instance=None if nth is None else int(nth), **values)

    @classmethod
    def of(cls, path: str | Path | Stated) -> Stated:
        """What is stated of a log: by a text behind its path; a Path is taken as it is."""
        if isinstance(path, Stated):
            return path
        return cls.parse(path) if isinstance(path, str) else cls(str(file_path("path", path)))

    @property
    def says_nothing(self) -> bool:
        """Nothing is stated."""
        return self.temperature_C is None and self.soc0 is None and self.instance is None

    def applied(self, log: CellLog) -> CellLog:
        """The log with what is stated: a measured temperature stays, an initial SOC is believed."""
        if self.soc0 is not None:
            held = held_soc(self.soc0)
            log = replace(log, soc0=held)
            if held != self.soc0:
                said = Notice(Code.START_HELD, beyond(self.soc0))
                log = log.with_notices((*log.notices, said))
        if self.temperature_C is None:
            return log
        measured = log.temperature_C
        if measured is None or not np.any(np.isfinite(measured)):
            return replace(log, temperature_C=np.full(len(log), self.temperature_C))
        found = other_temperature(log, self.temperature_C)
        return log if found is None else log.with_notices((found, *log.notices))


def other_temperature(log: CellLog, stated_C: float) -> Notice | None:
    """How a stated temperature contradicts all measured ones, and by how much; None: not.

    A cell may warm up by much from what it was stated to be at.
    """
    measured = log.temperature_C
    if measured is None or not np.any(np.isfinite(measured)):
        return None
    coldest, warmest = float(np.nanmin(measured)), float(np.nanmax(measured))
    off_K = max(coldest - stated_C, stated_C - warmest)
    if off_K <= OTHER_TEMPERATURE_K:
        return None
    said = (
        f" is stated to be at {stated_C:g} degC and measured {coldest:.1f} to {warmest:.1f} degC: "
        "its rows keep what was measured"
    )
    size_V = VOLT_PER_KELVIN * off_K
    return Notice(Code.TEMPERATURE_CONTRADICTED, said, log=log.name, size_V=size_V)


def check_temperature(temperature_C: float | None) -> None:
    """Refuse what is no temperature of a cell in degC; None is not stated."""
    if temperature_C is not None and not -80.0 <= temperature_C <= 120.0:
        raise InputError(
            f"a temperature of {temperature_C:g} degC", "degrees Celsius", "Not in kelvin."
        )


def check_order(days: Sequence[tuple[str, date | None]]) -> None:
    """Whether named logs follow in the order of their days, where these are known.

    Raises
    ------
    InputError        days that run backwards
    """
    for (before, first), (name, day) in pairwise(days):
        if first is not None and day is not None and day < first:
            raise InputError(
                f"'{name}' of {day} after '{before}' of {first}",
                "logs in the order in which they were recorded",
                "Sort them.",
            )


def day_of_name(name: str) -> date | None:
    """The day in a name (``leaf_20170330``, ``drive_2017-03-30``); None where there is none."""
    for found in _DAY.finditer(name):
        try:
            return date(*(int(part) for part in found.groups()))
        except ValueError:  # digits that are no day
            continue
    return None


# What files of logs end in; `read_log` looks at the content, whatever the name.
SUFFIXES = (
    *(".gz", ".csv", ".parquet", ".txt", ".bdf", ".ulg", ".bin", ".mat", ".mf4", ".mdf", ".nda"),
    *(".ndax", ".mpr", ".mpt", ".blf", ".asc", ".log", ".trc", ".res", ".xlsx", ".xls", ".mcap"),
    *(".db3", ".bag", ".bbl", ".bfl", ".tsv", ".dat", ".dta"),
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


def _is(look: Callable[[], bool]) -> bool:
    try:
        return look()
    except (OSError, ValueError):  # a name that the system refuses
        return False

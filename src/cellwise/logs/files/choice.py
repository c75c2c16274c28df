"""Which column of a table is which channel of a log: by name, unit, and what its cells can be."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import product
from typing import Any

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.columns import (
    ANY,
    CLOCK,
    DATE,
    MOST_LISTED,
    OWN,
    TIDY_NAME,
    TIDY_NAMES,
    Channel,
    Column,
    Unit,
    folded,
    listed,
    no_such_name,
    tidy_name,
)
from cellwise.logs.files.times import TimeKind, time_kind
from cellwise.logs.files.words import (
    CLEAR,
    PART,
    WORDS,
    likeness,
    name_of,
    names_states,
    of_battery,
    state_of,
    unit_for,
)
from cellwise.notices import Code, Notice

Look = Callable[[int], Sequence[str]]
_NUMBERS = re.compile(r"\d+")
_NUMBER = re.compile(r"\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?\s*")
_STATE = Unit(kind="label")
MOST_PROPOSED = 80
MOST_OF_A_FIELD = 5
# A quantity without a unit, in the order of what loggers write.
_UNSAID = {
    "time_s": ("time_s", "time_ms", "time_h", "time_min", "time_us"),
    "current_A": ("current_A", "current_mA", "current_cA", "current_uA"),
    "voltage_V": ("voltage_V", "voltage_mV", "voltage_cV", "voltage_uV"),
}


@dataclass(frozen=True)
class Evidence:
    """What names and first cells of a table say of its columns."""

    names: Sequence[str]
    look: Look

    def kind(self, k: int) -> TimeKind:
        """How a column's cells are written, if they are times."""
        return time_kind(self.look(k))

    def numeric(self, k: int) -> bool:
        """Most cells of a column are numbers, or nobody looked."""
        cells = [cell for cell in self.look(k) if cell.strip(" -")]
        return 2 * sum(bool(_NUMBER.fullmatch(cell)) for cell in cells) >= len(cells)

    def by_words(self, channel: Channel, taken: Collection[int]) -> tuple[Column | None, list[str]]:
        """The column whose name is a word for the quantity with its unit: 'Strom [mA]'; the others.

        Clocks and dates need no unit. A counter's name does not say its sign.
        """
        field = channel.field
        if field == "time_s":
            return self._time(taken)
        if field not in WORDS or field == "charge_Ah":
            return None, []
        clear = [k for k in self._free(taken) if likeness(field, self.names[k]) >= CLEAR]
        found = [k for k in clear if unit_for(field, self.names[k]) and self.numeric(k)]
        best = [k for k in found if likeness(field, self.names[k]) > CLEAR] or found
        best = [k for k in best if of_battery(self.names[k])] or best
        if len(best) != 1:
            return None, []
        name = self.names[best[0]]
        unit = channel.names.get(tidy_of(field, name))
        column = None if unit is None else Column(field, best[0], name, unit, by_words=True)
        return column, [self.names[k] for k in found if k != best[0]]

    def _free(self, taken: Collection[int]) -> Iterator[int]:
        return (k for k, name in enumerate(self.names) if name and k not in taken)

    def _time(self, taken: Collection[int]) -> tuple[Column | None, list[str]]:
        """The column of times: what is a number of a unit or a date before a clock alone."""
        worth = {"epoch": 3, "date": 3, "clock": 2, "day": 1, "": 0}

        def of(k: int) -> tuple[bool, int, int]:
            kind, like = self.kind(k), likeness("time_s", self.names[k])
            unit = 3 if unit_for("time_s", self.names[k]) and like >= CLEAR else 0
            return like >= CLEAR, max(worth[kind], unit), like

        clear = [k for k in self._free(taken) if of(k)[1] > 1 and of(k)[2] >= PART]
        dates = [k for k in self._free(taken) if self.kind(k) == "date" and of(k)[2] >= 0]
        if not clear and len(dates) != 1:
            return None, []
        place = max(clear or dates, key=of)
        name, kind = self.names[place], self.kind(place)
        unit = TIDY_NAMES.get(tidy_of("time_s", name), ("", OWN))[1]
        column = Column("time_s", place, name, DATE if kind else unit, by_words=True)
        return column, [self.names[k] for k in clear if k != place]

    def completed(self, columns: Sequence[Column]) -> tuple[list[Column], list[Notice]]:
        """The columns with the day of a clock, the state of a tester, two currents for one."""
        found = list(columns)
        notices = []
        at = next((k for k, c in enumerate(found) if c.field == "time_s"), None)
        if at is not None and self.kind(found[at].index) in ("clock", "day"):
            wanted = "day" if self.kind(found[at].index) == "clock" else "clock"
            taken = {c.index for c in found}
            other = next((k for k in self._free(taken) if self.kind(k) == wanted), None)
            if other is not None:
                clock, day = (found[at].index, other)[:: 1 if wanted == "day" else -1]
                found[at] = replace(found[at], index=clock, name=self.names[clock], unit=CLOCK)
                found.append(Column("day_s", day, self.names[day], DATE, by_words=True))
                text = (
                    f"the days of column '{self.names[day]}' and the clock of "
                    f"'{self.names[clock]}' are the time"
                )
                notices.append(Notice(Code.TIME_OF_DAYS, text))
        if not any(c.field == "current_A" for c in found):
            found += self._two_currents({c.index for c in found})
            if two_currents(found):
                names = listed([c.name for c in found[-2:]])
                text = f"the current is the difference of columns {names}"
                notices.append(Notice(Code.CURRENT_OF_TWO, text))
        states = [k for k in self._free({c.index for c in found}) if self._is_state(k)]
        if states and len(found) > 1:
            found.append(Column("state", states[0], self.names[states[0]], _STATE, by_words=True))
        return found, notices

    def _is_state(self, k: int) -> bool:
        labels = {cell.strip() for cell in self.look(k) if cell.strip()}
        known = sum(state_of(label) == state_of(label) for label in labels)
        return names_states(self.names[k]) and not self.numeric(k) and 2 * known > len(labels)

    def _two_currents(self, taken: Collection[int]) -> list[Column]:
        found = []
        for field, state in (("charging_A", -1.0), ("discharging_A", 1.0)):
            for k in self._free(taken):
                name = self.names[k]
                like, unit_said = likeness("current_A", name), unit_for("current_A", name)
                clear = like >= PART or (like >= 0 and unit_said)
                if clear and self.numeric(k) and state_of(name_of(name).phrase) == state:
                    unit = TIDY_NAMES.get(tidy_of("current_A", name), ("", OWN))[1]
                    found.append(Column(field, k, name, unit, by_words=True))
                    break
        return found if two_currents(found) else []

    def proposals(self, fields: Sequence[str], taken: Collection[int]) -> list[dict[str, str]]:
        """What the missing fields may be: tidy names to the file's, what speaks most first."""
        each = [self._candidates(field, taken) for field in fields if field in _UNSAID]
        if not each or not all(each):
            return []
        # What says no unit is in the same part of one: hundredths of both.
        options = sorted(
            product(*each),
            key=lambda some: (
                -round(sum(c[0] for c in some)),
                len({c[3] for c in some if c[3]}) > 1,
                -sum(c[0] for c in some),
            ),
        )
        apart = [some for some in options if len({c[2] for c in some}) == len(some)]
        return [{tidy: name for _, tidy, name, _ in some} for some in apart[:MOST_PROPOSED]]

    def _candidates(self, field: str, taken: Collection[int]) -> list[tuple[float, str, str, str]]:
        """Worth, tidy name, name, and prefix of a unit that the name does not say."""
        found = []
        for k in self._free(taken):
            name, kind = self.names[k], self.kind(k)
            unit, like = unit_for(field, name), float(likeness(field, name))
            time = field == "time_s" and kind in ("date", "clock", "epoch")
            if like < 0 or not (self.numeric(k) or time) or self._is_twice(name):
                continue
            if like == 0.0 and (unit or time):
                like = 0.5
            if like > 0.0 or self._may_be(field, k):
                found.append((like + 0.1 * of_battery(name) + 0.2 * bool(unit or time), k, time))
        found.sort(key=lambda c: -c[0])
        each = []
        for like, k, time in found[:MOST_OF_A_FIELD]:
            name = self.names[k]
            tidy = (tidy_of(field, name),) if unit_for(field, name) else _UNSAID[field]
            for rank, one in enumerate(("time_s",) if time else tidy):
                unsaid = "" if len(tidy) == 1 or time or field == "time_s" else f"{rank}"
                each.append((like - 0.01 * rank, one, name, unsaid))
        return each

    def _is_twice(self, name: str) -> bool:
        return sum(folded(other) == folded(name) for other in self.names) > 1

    def _may_be(self, field: str, k: int) -> bool:
        """A column of no word for anything whose values a time, a voltage can have."""
        name = self.names[k]
        if any(likeness(other, name) != 0 for other in WORDS):
            return False
        cells = [cell.replace(",", ".") for cell in self.look(k) if cell.strip()]
        if len(cells) < 3 or not all(map(_NUMBER.fullmatch, cells)):
            return False
        values = np.array(cells, dtype=np.float64)
        if field == "time_s":
            return bool(np.all(np.diff(values) > 0))
        return field == "current_A" or bool(0.5 < np.median(values) < 1500.0)


def says_its_sign(columns: Sequence[Column]) -> bool:
    """The current's name is a format's, which says what its sign means."""
    return not any(c.by_words and c.field == "current_A" for c in columns)


class MissingColumnsError(InputError):
    """Columns that are needed, ``missing``, are not there.

    ``proposals`` are what may hold them, best first: tidy names to names in the file. Nobody has
    tried them. ``fitting`` is one that was tried and reads.
    """

    def __init__(
        self,
        found: str,
        expected: str,
        action: str,
        missing: Sequence[str] = (),
        proposals: Sequence[Mapping[str, str]] = (),
        fitting: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(found, expected, action)
        self.missing, self.proposals = tuple(missing), tuple(proposals)
        self.fitting = dict(fitting or {})

    def __reduce__(self) -> tuple[Any, ...]:
        said = self.found, self.expected, self.action
        return type(self), (*said, self.missing, self.proposals, self.fitting)


def choose_columns(
    header: Sequence[str],
    channels: Sequence[Channel],
    where: str,
    *,
    known: Sequence[str] | None = None,
    chosen: Mapping[str, str] | None = None,
    look: Look | None = None,
) -> tuple[list[Column], list[Notice]]:
    """Find the channels' columns in a header.

    Parameters
    ----------
    header : sequence of str        column names as they stand in the file
    channels : sequence             what the format knows
    where : str                     the file, for messages
    known : sequence of str         names that belong to the format and are of no use here; None:
                                    no program's form, whose columns are known by their words
    chosen : mapping                what the user stated: a tidy name, which gives the unit, to the
                                    name in the file
    look : callable                 place of a column to the texts of its first cells

    Returns
    -------
    columns : list of Column
    notices : list of Notice        units converted, columns not used

    Raises
    ------
    MissingColumnsError                  a required column is missing
    InputError                      one stands there twice
    """
    table = Evidence([name.strip() for name in header], look or (lambda _: ()))
    names = table.names
    columns = [_stated(tidy, name, names, where) for tidy, name in (chosen or {}).items()]
    notices = [
        Notice(Code.COLUMN_STATED, f"column '{c.name}' was taken for {c.field}, as stated")
        for c in columns
    ]
    usual = {folded(name) for name in (*TIDY_NAMES, *(n for c in channels for n in c.names))}
    columns = [replace(c, by_words=folded(c.name) not in usual) for c in columns]
    found = {column.field for column in columns}
    for channel in channels:
        if channel.field in found:
            continue
        column = _find(channel, names, where)
        if column is None and known is None:
            column, others = table.by_words(channel, {c.index for c in columns})
            if column is not None:
                said = f"column '{column.name}' was taken for {channel.field}, by its name"
                said += f" (not {listed(others)})" if others else ""
                notices.append(Notice(Code.COLUMN_BY_NAME, said))
        elif column is not None and known is None and _is_converted(column):
            tidy = TIDY_NAME.get(channel.field, channel.field)
            text = f"column '{column.name}' was converted to {tidy}"
            notices.append(Notice(Code.COLUMN_CONVERTED, text, column=column.name))
        if column is not None:
            columns.append(column)
    if known is None:
        columns, noted = table.completed(columns)
        notices += noted
    found = {column.field for column in columns} | (
        {"current_A"} if two_currents(columns) else set()
    )
    missing = [
        c for c in channels if c.required and c.field not in found and c.instead not in found
    ]
    if missing:
        raise _missing_columns(missing, table, channels, where, columns)
    used = {column.index for column in columns}
    unused = [name for k, name in enumerate(names) if k not in used and name]
    if unused and known is None:
        text = f"column(s) not used: {listed(unused)}"
        return columns, [*notices, Notice(Code.COLUMN_UNUSED, text)]
    return columns, notices + (_unknown(unused, channels, known or ()) if known != ANY else [])


def _is_converted(column: Column) -> bool:
    """A measured column in another unit; the number of a battery has none."""
    return column.unit != OWN and column.field != "instance"


def has_days(columns: Sequence[Column]) -> bool:
    """The time's clock has a day beside it."""
    return any(column.field == "day_s" for column in columns)


def two_currents(columns: Sequence[Column]) -> bool:
    """There is a current of charge and one of discharge."""
    return {"charging_A", "discharging_A"} <= {column.field for column in columns}


def _stated(tidy: str, name: str, names: Sequence[str], where: str) -> Column:
    """The column that the user named for a channel."""
    field, unit = tidy_name(tidy)
    places = [k for k, text in enumerate(names) if text == name.strip()]
    places = places or [k for k, text in enumerate(names) if folded(text) == folded(name)]
    if not places:
        raise no_such_name(name, names, where)
    if tidy == "time_s":
        unit = CLOCK  # a number of seconds, a clock or a date, whichever the cells hold
    return Column(field, places[0], names[places[0]], unit)


def _unknown(
    unused: Sequence[str], channels: Sequence[Channel], known: Sequence[str]
) -> list[Notice]:
    """A notice of columns that a format does not know; one of numbered ones is known by another."""
    expected = {folded(n): n for n in (*(n for c in channels for n in c.names), *known)}
    siblings = {_NUMBERS.sub("", name) for name in expected if _NUMBERS.search(name)}
    unknown = [
        name
        for name in unused
        if folded(name) not in expected and _NUMBERS.sub("", folded(name)) not in siblings
    ]
    if not unknown:
        return []
    listing = []
    for name in unknown[:MOST_LISTED]:
        near = get_close_matches(folded(name), expected, n=1)
        listing.append(f"'{name}'" + (f" (nearest: '{expected[near[0]]}')" if near else ""))
    more = len(unknown) - len(listing)
    text = f"column(s) that this format does not know: {', '.join(listing)}"
    return [Notice(Code.COLUMN_UNKNOWN, text + (f" and {more} more" if more else ""))]


def _find(channel: Channel, names: Sequence[str], where: str) -> Column | None:
    keys = [folded(name) for name in names]
    for name, unit in channel.names.items():
        places = [k for k, text in enumerate(keys) if text == folded(name)]
        if len(places) > 1:
            raise InputError(
                f"{len(places)} columns named '{name}' in {where} "
                f"(columns {', '.join(str(k + 1) for k in places)})",
                "one column for each channel",
                "Rename or remove the one that is not meant.",
            )
        if places:
            return Column(channel.field, places[0], names[places[0]], unit)
    return None


def _missing_columns(
    missing: Sequence[Channel],
    table: Evidence,
    channels: Sequence[Channel],
    where: str,
    columns: Sequence[Column],
) -> MissingColumnsError:
    names = table.names
    optional = ", ".join(c.usual_name for c in channels if not c.required)
    required = ", ".join(c.usual_name for c in channels if c.required)
    return MissingColumnsError(
        f"column(s) {listed(names) or 'without any name'} in {where}; missing: "
        f"{', '.join(c.usual_name for c in missing)}",
        f"the columns {required} (and, where measured, {optional})",
        "Give the columns these names; the name gives the unit (current_mA, voltage_mV, time_ms, "
        "time_min, time_h).",
        [c.usual_name for c in missing],
        table.proposals([c.field for c in missing], {c.index for c in columns}),
    )


def tidy_of(field: str, name: str) -> str:
    """The tidy name with the unit that a column's name states: 'Strom [mA]' is ``current_mA``.

    Empty where it states another quantity's unit, the usual name where it states none.
    """
    tidy, unit = TIDY_NAME.get(field, field), unit_for(field, name)
    wanted = f"{tidy.rpartition('_')[0]}_{unit}"
    return next((n for n in TIDY_NAMES if n.casefold() == wanted), "" if unit is None else tidy)

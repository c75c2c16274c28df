"""Which column of a file is which channel of a log, and in which unit; what a name says of both."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal

from cellwise.errors import InputError
from cellwise.typing import FloatArray

KELVIN_OFFSET = -273.15


CellKind = Literal["number", "clock", "date", "label"]


@dataclass(frozen=True)
class Unit:
    """Conversion to the channel's own unit: ``value * factor + offset``.

    ``kind`` says how the cells are written: as numbers, as a clock (``1d 02:03:04.5``) or a date
    (both in seconds), as dates alone, or as labels, of which ``labels`` gives the value (a label
    that is not among them: missing).
    """

    factor: float = 1.0
    offset: float = 0.0
    kind: CellKind = "number"
    labels: Mapping[str, float] = field(default_factory=dict, hash=False)

    def convert(self, values: FloatArray) -> FloatArray:
        """Values in the channel's own unit; the same array where nothing changes."""
        if self.factor == 1.0 and self.offset == 0.0:
            return values
        return values * self.factor + self.offset


OWN = Unit()
CLOCK = Unit(kind="clock")
DATE = Unit(kind="date")
# By how column maps write them; a minus: a counter that runs the other way.
UNITS = {
    "": OWN,
    **dict.fromkeys(("ms", "mA", "mV", "mAh"), Unit(1e-3)),
    **dict.fromkeys(("cA", "cV"), Unit(1e-2)),
    "us": Unit(1e-6),
    "min": Unit(60.0),
    "h": Unit(3600.0),
    "K": Unit(1.0, KELVIN_OFFSET),
    "F": Unit(5.0 / 9.0, -160.0 / 9.0),
    "As": Unit(1.0 / 3600.0),
    "clock": CLOCK,
    "nth": Unit(kind="label", labels={str(k): float(k) for k in range(32)}),
    "-Ah": Unit(-1.0),
    "-mAh": Unit(-1e-3),
}


def named_units(names: Iterable[str]) -> dict[str, Unit]:
    """Names with their units: ``time_h => h``; without one, the channel's own."""
    parts = (text.partition(" => ") for text in names)
    return {name: UNITS[unit] for name, _, unit in parts}


@dataclass(frozen=True)
class Channel:
    """One channel of a log and the column names a format gives it.

    Parameters
    ----------
    field : str             field of `CellLog`
    names : mapping         column name to unit, the usual one first; compared without regard to
                            case, blanks and underscores, the first one present is taken
    required : bool         a log without it is refused
    instead : str           field of another channel that will do in its place
    """

    field: str
    names: Mapping[str, Unit]
    required: bool = False
    instead: str = ""

    @property
    def usual_name(self) -> str:
        """The name to ask for."""
        return next(iter(self.names))


@dataclass(frozen=True)
class Column:
    """A column chosen for a channel: its place and name in the file, its unit.

    ``by_words``: no format's name, but a word for the quantity and the unit.
    """

    field: str
    index: int
    name: str
    unit: Unit
    by_words: bool = False


REQUIRED = ("time_s", "current_A", "voltage_V")
_TIDY = {
    "time_s": ("time_s", "time_ms => ms", "time_us => us", "time_min => min", "time_h => h"),
    "current_A": ("current_A", "current_mA => mA"),
    "voltage_V": ("voltage_V", "voltage_mV => mV"),
    "temperature_C": (
        *("temperature_C", "temperature_degC", "temperature_K => K", "temperature_F => F"),
    ),
    "charge_Ah": (
        *("ampere_hours", "charge_Ah", "milliampere_hours => mAh", "charge_mAh => mAh"),
        "ampere_seconds => As",
    ),
    "step": ("step",),
    "instance": ("instance => nth", "Inst => nth", "battery_id => nth", "battery_instance => nth"),
}
TIDY_CHANNELS = tuple(Channel(f, named_units(n), f in REQUIRED) for f, n in _TIDY.items())
# The tidy form's names, each with its field and unit, and the usual one of each field.
TIDY_NAMES = {n: (c.field, unit) for c in TIDY_CHANNELS for n, unit in c.names.items()}
TIDY_NAME = {c.field: c.usual_name for c in TIDY_CHANNELS}
_NUMBERS = re.compile(r"\d+")
MOST_LISTED = 12
LONGEST_LISTED = 60  # characters of a name


def tidy_name(name: str, fields: Collection[str] = ()) -> tuple[str, Unit]:
    """Field and unit of a name that the user stated a channel by.

    Raises
    ------
    InputError        no name of the tidy form, or of other fields than these
    """
    known = [n for n, (field, _) in TIDY_NAMES.items() if not fields or field in fields]
    if name in known:
        return TIDY_NAMES[name]
    near = get_close_matches(name, known, n=1)
    raise InputError(
        f"a channel '{name}'",
        f"one of {', '.join(known)}",
        f"Did you mean {near[0]}?" if near else "The name gives the unit.",
    )


def says_its_sign(columns: Sequence[Column]) -> bool:
    """The current's name is a format's, which says what its sign means."""
    return not any(c.by_words and c.field == "current_A" for c in columns)


def choose_columns(
    header: Sequence[str],
    channels: Sequence[Channel],
    where: str,
    *,
    known: Sequence[str] | None = None,
    chosen: Mapping[str, str] | None = None,
) -> tuple[list[Column], list[str]]:
    """Find the channels' columns in a header.

    Parameters
    ----------
    header : sequence of str        column names as they stand in the file
    channels : sequence             what the format knows
    where : str                     the file, for messages
    known : sequence of str         names that belong to the format and are of no use here
    chosen : mapping                what the user stated: a tidy name, which gives the unit, to the
                                    name in the file

    Returns
    -------
    columns : list of Column
    notices : list of str           units converted, columns not used

    Raises
    ------
    InputError                      a required column is missing, or stands there twice
    """
    names = [name.strip() for name in header]
    columns = [_stated(tidy, name, names, where) for tidy, name in (chosen or {}).items()]
    notices = [f"column '{c.name}' was taken for {c.field}, as stated" for c in columns]
    found = {column.field for column in columns}
    for channel in channels:
        if channel.field in found:
            continue
        column = _find(channel, names, where)
        if column is None and channels is TIDY_CHANNELS:
            column = _by_words(channel, names)
        if column is None:
            continue
        columns.append(column)
        if column.by_words:
            notices.append(f"column '{column.name}' was taken for {channel.field}, by its name")
        elif known is None and column.unit != OWN:
            tidy = TIDY_NAME.get(channel.field, channel.field)
            notices.append(f"column '{column.name}' was converted to {tidy}")
    found = {column.field for column in columns}
    missing = [
        c for c in channels if c.required and c.field not in found and c.instead not in found
    ]
    if missing:
        raise _missing_columns(missing, names, channels, where)
    used = {column.index for column in columns}
    unused = [name for k, name in enumerate(names) if k not in used and name]
    if unused and known is None:
        return columns, [*notices, f"column(s) not used: {listed(unused)}"]
    return columns, notices + _unknown(unused, channels, known or ())


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


def no_such_name(name: str, names: Sequence[str], where: str, what: str = "column") -> InputError:
    """The refusal of a name that the user gave and the file has not."""
    near = get_close_matches(name, names, n=3, cutoff=0.4)
    return InputError(
        f"no {what} '{name}' in {where}, which has {listed(names)}",
        f"the name of a {what} that is there",
        f"Nearest: {listed(near)}." if near else "Choose one of those.",
    )


def _unknown(unused: Sequence[str], channels: Sequence[Channel], known: Sequence[str]) -> list[str]:
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
    return [
        f"column(s) that this format does not know: {', '.join(listing)}"
        + (f" and {more} more" if more else "")
    ]


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


def _by_words(channel: Channel, names: Sequence[str]) -> Column | None:
    """The one column whose name is a word for the quantity with its unit: 'Strom [mA]'.

    Dates need no unit. A counter's name does not say its sign.
    """
    field = channel.field
    words = [k for k, name in enumerate(names) if is_word(field, name)]
    places = [k for k in words if unit_of(names[k])]
    dates = field == "time_s" and not places
    places = words if dates else places
    if len(places) != 1 or field == "charge_Ah":
        return None
    name = names[places[0]]
    unit = DATE if dates else channel.names.get(_tidy_of(channel, name))
    return None if unit is None else Column(field, places[0], name, unit, by_words=True)


def folded(name: str) -> str:
    """A column name as names are compared."""
    return name.casefold().replace(" ", "").replace("_", "").strip('"\t\ufeff')


def _missing_columns(
    missing: Sequence[Channel], names: Sequence[str], channels: Sequence[Channel], where: str
) -> InputError:
    near = [(c, name) for c in missing if (name := nearest(c.field, names))]
    said = ", ".join(f"{_tidy_of(c, name) or c.usual_name!r}: {name!r}" for c, name in near)
    optional = ", ".join(c.usual_name for c in channels if not c.required)
    required = ", ".join(c.usual_name for c in channels if c.required)
    return InputError(
        f"column(s) {listed(names) or 'without any name'} in {where}; missing: "
        f"{', '.join(c.usual_name for c in missing)}",
        f"the columns {required} (and, where measured, {optional})",
        f"Name the columns with `channels={{{said or '...'}}}`, if that is what they hold, or give "
        "the file these names; the name gives the unit (current_mA, voltage_mV, time_ms, time_min, "
        "time_h).",
    )


def _tidy_of(channel: Channel, name: str) -> str:
    """The tidy name with the unit that a column's name states: 'Strom [mA]' is ``current_mA``.

    Empty where it states another quantity's unit, the usual name where it states none.
    """
    tidy, unit = TIDY_NAME.get(channel.field, channel.field), unit_of(name)
    wanted = f"{tidy.rpartition('_')[0]}_{unit}"
    return next((n for n in TIDY_NAMES if n.casefold() == wanted), "" if unit else tidy)


def listed(names: Sequence[str], most: int = MOST_LISTED) -> str:
    """Names in quotes, the first dozen."""
    shown = ", ".join(f"'{name[:LONGEST_LISTED]}'" for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


# Words for a quantity, of several languages and programs.
WORDS = {
    "time_s": (
        *("time", "t", "timestamp", "seconds", "elapsed", "test time", "datum", "uhrzeit", "zeit"),
        *("testzeit", "laufzeit", "versuchszeit", "zeitstempel", "datetime"),
        *("elapsed time", "temps", "tiempo", "tempo", "date time", "date/time", "horodatage"),
    ),
    "current_A": (
        *("current", "curr", "i", "amps", "ampere", "strom", "ibat", "batteriestrom"),
        *("courant", "corriente", "corrente", "battery current", "cell current"),
    ),
    "voltage_V": (
        *("voltage", "volt", "volts", "v", "u", "spannung", "vbat", "ubat"),
        *("batteriespannung", "zellspannung", "klemmenspannung", "tension", "tensión", "tensione"),
        *("cell voltage", "battery voltage", "terminal voltage"),
    ),
    "temperature_C": (
        *("temperature", "temp", "tbat", "temperatur", "zelltemperatur", "cell temperature"),
    ),
    "charge_Ah": ("charge", "ah", "discharged", "consumed"),
}
# An electrode's potential may be the cell's voltage: asked for, never taken.
PERHAPS = {"voltage_V": ("ewe", "potential")}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+[a-z]*")
# A unit at the end of a column's name, in brackets or behind a stroke.
_UNIT = re.compile(r"(?:[(\[{<]|[/_])\s*([a-zµμ°]+)\s*[)\]}>]?$", re.IGNORECASE)
_UNITS = ("s", "ms", "us", "min", "h", "a", "ma", "v", "mv", "k", "c", "degc", "ah", "mah")
_UNIT_WORDS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek"), "s"),
    **dict.fromkeys(("µs", "μs"), "us"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours", "std"), "h"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("amps", "ampere"), "a"),
    **dict.fromkeys(("volt", "volts"), "v"),
    "°c": "degc",
}


def words_of(name: str) -> set[str]:
    """The words of a name: ``BMS_PackCurrent`` is bms, pack, current."""
    return {word.casefold() for word in _WORD.findall(name)}


def unit_of(name: str) -> str:
    """The unit that a name states, at its end, in small letters: 'Strom [mA]' states ma."""
    found = _UNIT.search(name.strip())
    if found is None:  # 'Volts' is its own unit, 'V' a symbol
        return _UNIT_WORDS.get(name.strip().casefold(), "")
    text = found[1].casefold()
    unit = _UNIT_WORDS.get(text, text)
    return unit if unit in _UNITS else ""


def _without_unit(name: str) -> str:
    plain = _UNIT.sub("", name.strip()) if unit_of(name) else name
    return plain.replace("_", " ").strip(" .\t")


def is_word(field: str, name: str) -> bool:
    """A name is, but for its unit, a word for a quantity."""
    return _without_unit(name).casefold() in WORDS.get(field, ())


def nearest(field: str, names: Sequence[str]) -> str:
    """The name that most likely holds a quantity, empty if none does."""
    known = (*WORDS.get(field, ()), *PERHAPS.get(field, ()))

    def likeness(name: str) -> int:
        words = {word for word in words_of(_without_unit(name)) if len(word) > 2}
        if is_word(field, name):
            return 3
        if words.intersection(known):
            return 2
        return any(get_close_matches(word, known, n=1, cutoff=0.75) for word in words)

    best = max(names, key=likeness, default="")
    return best if best and likeness(best) else ""

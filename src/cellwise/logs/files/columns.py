"""Which column of a file is which channel of a log, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal, Protocol

from cellwise.errors import InputError
from cellwise.logs.files.quantities import nearest, unit_of
from cellwise.typing import FloatArray

KELVIN_OFFSET = -273.15


class NamedColumns(Protocol):
    """Columns by their names: a pandas, polars or arrow frame, a mapping of arrays."""

    def __getitem__(self, name: str, /) -> object:
        """The column of that name."""
        ...


CellKind = Literal["number", "clock", "label"]


@dataclass(frozen=True)
class Unit:
    """Conversion to the channel's own unit: ``value * factor + offset``.

    ``kind`` says how the cells are written: as numbers, as a clock (``1d 02:03:04.5``) or a date
    (both in seconds), or as labels, of which ``labels`` gives the value (a label that is not among
    them: missing).
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
MILLI = Unit(1e-3)
CLOCK = Unit(kind="clock")


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
    """A column chosen for a channel: its place and name in the file, its unit."""

    field: str
    index: int
    name: str
    unit: Unit


TIDY_CHANNELS = (
    Channel(
        "time_s",
        {
            "time_s": OWN,
            "time_ms": Unit(1e-3),
            "time_us": Unit(1e-6),
            "time_min": Unit(60.0),
            "time_h": Unit(3600.0),
        },
        required=True,
    ),
    Channel("current_A", {"current_A": OWN, "current_mA": Unit(1e-3)}, required=True),
    Channel("voltage_V", {"voltage_V": OWN, "voltage_mV": Unit(1e-3)}, required=True),
    Channel(
        "temperature_C",
        {
            "temperature_C": OWN,
            "temperature_degC": OWN,
            "temperature_K": Unit(1.0, KELVIN_OFFSET),
            "temperature_F": Unit(5.0 / 9.0, -160.0 / 9.0),
        },
    ),
    Channel(
        "charge_Ah",
        {
            "ampere_hours": OWN,
            "charge_Ah": OWN,
            "milliampere_hours": Unit(1e-3),
            "charge_mAh": Unit(1e-3),
            "ampere_seconds": Unit(1.0 / 3600.0),
        },
    ),
    Channel("step", {"step": OWN}),
)

# The tidy form's names, each with its field and unit.
TIDY_NAMES = {n: (c.field, unit) for c in TIDY_CHANNELS for n, unit in c.names.items()}
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
    keys = [folded(name) for name in header]
    columns = [_stated(tidy, name, header, keys, where) for tidy, name in (chosen or {}).items()]
    notices = [f"column '{c.name}' was taken for {c.field}, as stated" for c in columns]
    stated = {column.field for column in columns}
    for channel in channels:
        if channel.field in stated:
            continue
        column = _find(channel, header, keys, where)
        if column is None:
            continue
        columns.append(column)
        if known is None and column.unit != OWN:
            notices.append(f"column '{column.name}' was converted to {_tidy_name(channel)}")
    found = {column.field for column in columns}
    missing = [
        c for c in channels if c.required and c.field not in found and c.instead not in found
    ]
    if missing:
        raise _missing_columns(missing, header, channels, where)
    used = {column.index for column in columns}
    unused = [header[k].strip() for k in range(len(header)) if k not in used and header[k].strip()]
    return columns, notices + _unused_columns(unused, channels, known)


def _stated(tidy: str, name: str, header: Sequence[str], keys: Sequence[str], where: str) -> Column:
    """The column that the user named for a channel."""
    field, unit = tidy_name(tidy)
    places = [k for k, text in enumerate(header) if text.strip() == name.strip()]
    places = places or [k for k, text in enumerate(keys) if text == folded(name)]
    if not places:
        raise no_such_name(name, [text.strip() for text in header], where)
    if tidy == "time_s":
        unit = CLOCK  # a number of seconds, a clock or a date, whichever the cells hold
    return Column(field, places[0], header[places[0]].strip(), unit)


def no_such_name(name: str, names: Sequence[str], where: str, what: str = "column") -> InputError:
    """The refusal of a name that the user gave and the file has not."""
    near = get_close_matches(name, names, n=3, cutoff=0.4)
    return InputError(
        f"no {what} '{name}' in {where}, which has {listed(names)}",
        f"the name of a {what} that is there",
        f"Nearest: {listed(near)}." if near else "Choose one of those.",
    )


def _unused_columns(
    unused: Sequence[str], channels: Sequence[Channel], known: Sequence[str] | None
) -> list[str]:
    """Notices of columns that are not used."""
    if not unused:
        return []
    if known is None:
        return [f"column(s) not used: {listed(unused)}"]
    expected = {folded(n): n for n in (*(n for c in channels for n in c.names), *known)}
    siblings = {_unnumbered(name) for name in expected if _unnumbered(name) != name}
    unknown = [
        name
        for name in unused
        if folded(name) not in expected and _unnumbered(folded(name)) not in siblings
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


def _unnumbered(name: str) -> str:
    """A name without its numbers: 'Aux #2' is a sibling of 'Aux #1'."""
    return _NUMBERS.sub("", name)


def _find(
    channel: Channel, header: Sequence[str], keys: Sequence[str], where: str
) -> Column | None:
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
            return Column(channel.field, places[0], header[places[0]].strip(), unit)
    return None


def folded(name: str) -> str:
    """A column name as names are compared."""
    return name.casefold().replace(" ", "").replace("_", "").strip('"\t\ufeff')


def _tidy_name(channel: Channel) -> str:
    """The name in the tidy form, or the field where the tidy form has none."""
    return next((c.usual_name for c in TIDY_CHANNELS if c.field == channel.field), channel.field)


def _missing_columns(
    missing: Sequence[Channel], header: Sequence[str], channels: Sequence[Channel], where: str
) -> InputError:
    names = [name.strip() for name in header]
    hints: list[str] = []
    lines: list[str] = []
    for channel in missing:
        if near := nearest(channel.field, names):
            tidy = _with_unit(_tidy_name(channel), near)
            name = tidy if tidy in channel.names else channel.usual_name
            hints.append(f"rename '{near}' to '{name}' if that is what it holds")
            lines.append(f"{tidy!r}: {near!r}")
    optional = ", ".join(c.usual_name for c in channels if not c.required)
    required = ", ".join(c.usual_name for c in channels if c.required)
    action = (
        "Give the file these column names, or a unit that the name gives (current_mA, voltage_mV, "
        "time_ms, time_min, time_h)"
    )
    if hints:
        action += f": {'; '.join(hints)}"
    said = ", ".join(lines) or "..."
    return InputError(
        f"column(s) {listed(names) or 'without any name'} in {where}; missing: "
        f"{', '.join(c.usual_name for c in missing)}",
        f"the columns {required} (and, where measured, {optional})",
        f"{action}, or name the columns with `channels={{{said}}}`.",
    )


def _with_unit(tidy: str, name: str) -> str:
    """The tidy name with the unit that a column's name states: 'Strom [mA]' is ``current_mA``."""
    quantity, unit = tidy.rpartition("_")[0], unit_of(name)
    return next((n for n in TIDY_NAMES if n.casefold() == f"{quantity}_{unit}"), tidy)


def listed(names: Sequence[str], most: int = MOST_LISTED) -> str:
    """Names in quotes, the first dozen."""
    shown = ", ".join(f"'{name[:LONGEST_LISTED]}'" for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")

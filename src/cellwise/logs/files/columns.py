"""Channels of a log, the names that files give them, and units."""

from __future__ import annotations

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
    **dict.fromkeys(("us", "uA", "uV"), Unit(1e-6)),
    "min": Unit(60.0),
    "h": Unit(3600.0),
    "K": Unit(1.0, KELVIN_OFFSET),
    "F": Unit(5.0 / 9.0, -160.0 / 9.0),
    "As": Unit(1.0 / 3600.0),
    "clock": CLOCK,
    "nth": Unit(
        kind="label", labels={n: float(k) for k in range(26) for n in (str(k), chr(97 + k))}
    ),
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
class ChosenColumn:
    """A column chosen for a channel: its place and name in the file, its unit.

    ``by_words``: no format's name, but a word for the quantity and the unit.
    """

    field: str
    index: int
    name: str
    unit: Unit
    by_words: bool = False


ANY = ("*",)  # in place of the names that a format knows: it has many, of no use here
REQUIRED = ("time_s", "current_A", "voltage_V")
_TIDY = {
    "time_s": ("time_s", "time_ms => ms", "time_us => us", "time_min => min", "time_h => h"),
    "current_A": ("current_A", "current_mA => mA", "current_uA => uA", "current_cA => cA"),
    "voltage_V": ("voltage_V", "voltage_mV => mV", "voltage_uV => uV", "voltage_cV => cV"),
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


def no_such_name(name: str, names: Sequence[str], where: str, what: str = "column") -> InputError:
    """The refusal of a name that the user gave and the file has not."""
    near = get_close_matches(name, names, n=3, cutoff=0.4)
    return InputError(
        f"no {what} '{name}' in {where}, which has {listed(names)}",
        f"the name of a {what} that is there",
        f"Nearest: {listed(near)}." if near else "Choose one of those.",
    )


def folded(name: str) -> str:
    """A column name as names are compared."""
    return name.casefold().replace(" ", "").replace("_", "").strip('"\t\ufeff')


def listed(names: Sequence[str]) -> str:
    """Names in quotes, the first dozen."""
    shown = ", ".join(f"'{name[:LONGEST_LISTED]}'" for name in names[:MOST_LISTED])
    return shown + (f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else "")

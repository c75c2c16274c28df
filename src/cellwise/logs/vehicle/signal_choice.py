"""Which signal of a vehicle's recording is the battery's current, which its voltage.

Names differ by maker, so they are only taken when units and names leave one choice.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cellwise.errors import InputError
from cellwise.logs.files.columns import (
    KELVIN_OFFSET,
    MILLI,
    OWN,
    TIDY_CHANNELS,
    Channel,
    Unit,
    folded,
    listed,
    no_such_name,
)

# What has been chosen has the tidy names and units.
CHOSEN = tuple(
    Channel(name, {name: OWN}, required=True) for name in ("time_s", "current_A", "voltage_V")
)
UNITS: Mapping[str, Mapping[str, Unit]] = {
    "current_A": {"a": OWN, "amp": OWN, "amps": OWN, "ampere": OWN, "ma": MILLI},
    "voltage_V": {"v": OWN, "volt": OWN, "volts": OWN, "mv": MILLI},
    "temperature_C": {
        **dict.fromkeys(("°c", "degc", "deg c", "c", "celsius", "grad c", "℃"), OWN),
        "k": Unit(1.0, KELVIN_OFFSET),
    },
    "charge_Ah": {"ah": OWN, "mah": MILLI, "as": Unit(1.0 / 3600.0)},
}
_REQUIRED = ("current_A", "voltage_V")
_OWN_WORDS = {
    "current_A": ("current", "curr", "amps", "strom", "ibat", "i"),
    "voltage_V": ("voltage", "volt", "spannung", "ubat", "vbat", "u", "v"),
    "temperature_C": ("temperature", "temp", "tbat"),
    "charge_Ah": ("charge", "ah", "discharged", "consumed"),
}
_OF_PACK = ("battery", "batt", "bat", "pack", "hv", "bms", "traction", "string", "total")
_OTHERWISE = (
    *("max", "min", "limit", "lim", "target", "setpoint", "set", "request", "req", "cmd", "avail"),
    *("motor", "phase", "aux", "lv", "12v", "dcdc", "charger", "inverter", "allowed", "nominal"),
    *("offset", "error", "fault", "status", "ref", "reference", "ambient", "coolant", "inlet"),
)
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+[a-z]*")


class Signal(NamedTuple):
    """A signal of a recording: its full name, its unit as written, what the reader finds it by."""

    name: str
    unit: str
    key: tuple[object, ...]

    @property
    def short(self) -> str:
        """The name without its message or group."""
        return self.name.rpartition(".")[2]


class Chosen(NamedTuple):
    """A signal for a channel, and its conversion."""

    field: str
    signal: Signal
    unit: Unit


def choose_signals(
    signals: Sequence[Signal], stated: Mapping[str, str], where: str
) -> tuple[list[Chosen], list[str]]:
    """Find current, voltage and, where they are clear, temperature and counter.

    Parameters
    ----------
    signals : sequence of Signal
    stated : mapping          tidy name, which gives the unit, to the signal's name
    where : str             for messages

    Returns
    -------
    chosen : list of Chosen
    notices : list of str

    Raises
    ------
    InputError              no such signal, none of that unit, or several that it could be
    """
    chosen = [_stated(tidy, name, signals, where) for tidy, name in stated.items()]
    notices: list[str] = []
    fields = {c.field for c in chosen}
    for field, units in UNITS.items():
        if field in fields:
            continue
        found = _best(field, signals)
        if len(found) == 1:
            signal = found[0]
            chosen.append(Chosen(field, signal, units[_unit(signal, field)]))
            unit = signal.unit or "no unit"
            notices.append(f"signal '{signal.name}' ({unit}) was taken for {field}")
        elif field in _REQUIRED:
            raise _unclear(field, found, signals, where)
    return chosen, notices


def _stated(tidy: str, name: str, signals: Sequence[Signal], where: str) -> Chosen:
    fields = [(c.field, u) for c in TIDY_CHANNELS for n, u in c.names.items() if n == tidy]
    if not fields or fields[0][0] not in UNITS:
        known = [n for c in TIDY_CHANNELS if c.field in UNITS for n in c.names]
        raise InputError(f"a channel '{tidy}'", f"one of {', '.join(known)}", "Correct the name.")
    found = [s for s in signals if s.name == name] or [
        s for s in signals if folded(name) in (folded(s.name), folded(s.short))
    ]
    if not found:
        raise no_such_name(name, [s.name for s in signals], where, "signal")
    if len(found) > 1:
        raise InputError(
            f"{len(found)} signals '{name}' in {where}: {listed([s.name for s in found])}",
            "one signal",
            "Name it with its message or group.",
        )
    return Chosen(fields[0][0], found[0], fields[0][1])


def _best(field: str, signals: Sequence[Signal]) -> list[Signal]:
    """The signals of a channel's unit whose names speak most for it."""
    scores = [(_score(field, s.name), s) for s in signals if _unit(s, field) in UNITS[field]]
    required = field in _REQUIRED
    scores = [(score, s) for score, s in scores if score > (-2 if required else 1)]
    best = max((score for score, _ in scores), default=0)
    return [s for score, s in scores if score == best]


def _score(field: str, name: str) -> int:
    words = {word.casefold() for word in _WORD.findall(name)}
    own = 1 if words.intersection(_OWN_WORDS[field]) else 0
    pack = 2 if words.intersection(_OF_PACK) else 0
    other = -3 if words.intersection(_OTHERWISE) else 0
    return own + pack + other


def _unit(signal: Signal, field: str) -> str:
    """The unit, folded; of a signal without one, what its name says (``current_mA``, ``PackVolt``).

    Without a unit the name must have the quantity's own name.
    """
    unit = signal.unit.strip().strip("[]()").casefold()
    if unit and unit != "-":
        return unit
    words = {word.casefold() for word in _WORD.findall(signal.short)}
    if not words.intersection(_OWN_WORDS[field]):
        return ""
    last = signal.short.rpartition("_")[2].casefold()
    return last if last in UNITS[field] else next(iter(UNITS[field]))


def _unclear(
    field: str, found: Sequence[Signal], signals: Sequence[Signal], where: str
) -> InputError:
    tidy = next(c.usual_name for c in TIDY_CHANNELS if c.field == field)
    if found:
        names = [f"{s.name}" for s in found]
        return InputError(
            f"{len(found)} signals that could be {field} in {where}: {listed(names)}",
            "one",
            f"Choose it: `channels={{{tidy!r}: {names[0]!r}}}`.",
        )
    names = [s.name + (f" [{s.unit}]" if s.unit else "") for s in signals]
    return InputError(
        f"no signal with a unit of {field} in {where}, which has {listed(names) or 'none at all'}",
        f"the battery's {field.partition('_')[0]}",
        f"Choose it: `channels={{{tidy!r}: 'NAME'}}`.",
    )

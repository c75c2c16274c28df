"""What a column's or a signal's name says: which quantity it is, in which unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches

# Words for a quantity, of several languages and programs.
WORDS = {
    "time_s": (
        *("time", "t", "timestamp", "seconds", "elapsed", "test time", "datum", "uhrzeit", "zeit"),
        *("testzeit", "laufzeit", "versuchszeit", "zeitstempel", "datetime"),
    ),
    "current_A": (*("current", "curr", "i", "amps", "ampere", "strom", "ibat", "batteriestrom"),),
    "voltage_V": (
        *("voltage", "volt", "volts", "v", "u", "ewe", "spannung", "potential", "vbat", "ubat"),
        *("batteriespannung", "zellspannung", "klemmenspannung"),
    ),
    "temperature_C": ("temperature", "temp", "tbat"),
    "charge_Ah": ("charge", "ah", "discharged", "consumed"),
}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+[a-z]*")
# A unit at the end of a column's name, in brackets or behind a stroke.
_UNIT = re.compile(r"(?:[(\[{<]|[/_])\s*([a-zµμ°]+)\s*[)\]}>]?$", re.IGNORECASE)
_UNITS = ("s", "ms", "us", "min", "h", "a", "ma", "v", "mv", "k", "c", "degc", "ah", "mah")
_UNIT_WORDS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek"), "s"),
    **dict.fromkeys(("µs", "μs"), "us"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours", "std"), "h"),
    **dict.fromkeys(("minute", "minutes"), "min"),
}


def words_of(name: str) -> set[str]:
    """The words of a name: ``BMS_PackCurrent`` is bms, pack, current."""
    return {word.casefold() for word in _WORD.findall(name)}


def unit_of(name: str) -> str:
    """The unit that a name states at its end, in small letters: 'Strom [mA]' states ma."""
    found = _UNIT.search(name.strip())
    text = "" if found is None else found[1].casefold()
    unit = _UNIT_WORDS.get(text, text)
    return unit if unit in _UNITS else ""


def without_unit(name: str) -> str:
    """The name without the unit at its end: 'Test_Time(s)' is 'Test Time'."""
    found = _UNIT.search(name.strip()) if unit_of(name) else None
    plain = name.strip() if found is None else name.strip()[: found.start()]
    return plain.replace("_", " ").strip(" .\t")


def nearest(field: str, names: Sequence[str]) -> str:
    """The name that most likely holds a quantity, empty if none does."""
    known = WORDS.get(field, ())

    def likeness(name: str) -> int:
        plain = without_unit(name)
        words = {word for word in words_of(plain) if len(word) > 2}
        if plain.casefold() in known:
            return 3
        if words.intersection(known):
            return 2
        return any(get_close_matches(word, known, n=1, cutoff=0.75) for word in words)

    best = max(names, key=likeness, default="")
    return best if best and likeness(best) else ""

"""What a column's name says of quantity and unit, what a label says of a state.

The words stand in `words.toml`.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

_ALL: dict[str, Any] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
WORDS: dict[str, list[str]] = _ALL["quantity"]
MONTHS = {name: k + 1 for k, names in enumerate(_ALL["month"]["names"]) for name in names}
_UNITS = {text: unit for unit, texts in _ALL["unit"].items() for text in texts}
_QUALIFIERS = {word: kind for kind, words in _ALL["qualifier"].items() for word in words}
_KNOWN = frozenset(word for words in WORDS.values() for word in words)
_ENDS = sorted((word for word in _KNOWN if len(word) > 4 and word.isalpha()), key=len, reverse=True)
_STATES = {"rest": 0.0, "discharge": 1.0, "charge": -1.0}
_OF = {
    "time_s": ("s", "ms", "us", "min", "h"),
    "current_A": ("a", "ma", "ua", "ca"),
    "voltage_V": ("v", "mv", "uv", "cv"),
    "temperature_C": ("c", "degc", "k", "f"),
    "charge_Ah": ("ah", "mah"),
}
_WORD = re.compile(r"[A-Z]+(?![a-zß-ÿ])|[A-Z]?[a-zß-ÿ]+|\d+[a-z]*|[^\W\d_]+")
# A unit at the end of a name: in brackets, behind a stroke, or as a word of its own.
_UNIT = re.compile(
    r"(?:[(\[{<]\s*(?:in\s+)?(?P<a>[^()\[\]{}<>]*?)\s*[)\]}>]|(?:\s*[/_,:#]|\s)\s*(?P<b>[^\s/_,:#()\[\]{}<>]+))\s*$"
)
_OTHER_SCRIPT = re.compile(r"[^\u0000-\u024f]")
# How much a name speaks for a quantity; from CLEAR on it is taken where its unit is clear.
WHOLE, CLEAR, PART, PERHAPS, LIKE, NEVER = 6, 5, 3, 2, 1, -1


class Name(NamedTuple):
    """A column's name: its unit in small letters (``other``: of something else), what it names."""

    unit: str
    phrase: str
    words: frozenset[str]


def plain(text: str) -> str:
    """A text as words are compared: Unicode's compatible form, small letters, single blanks."""
    return " ".join(unicodedata.normalize("NFKC", text).casefold().replace("_", " ").split())


@cache
def name_of(text: str) -> Name:
    """What stands in a column's name."""
    whole = unicodedata.normalize("NFKC", text).strip(' "\t\ufeff')
    found, unit, rest = _UNIT.search(whole), "", whole
    if found is not None:
        unit = _UNITS.get(" ".join((found["a"] or found["b"] or "").casefold().split()), "")
        if unit == "other" and found["a"] is None:
            unit = ""
        rest = whole[: found.start()] if unit else whole
    rest = rest or whole
    # 'Volts' is its own unit, 'V' a symbol
    own = whole.casefold()
    if not unit and len(own) > 2:
        unit = _UNITS.get(own, "")
    group, _, last = rest.rpartition(".")  # SYS_STATUS.voltage_battery
    words = words_of(last) | (words_of(group) - {"status", "state"})
    words = frozenset(part for word in words for part in _parts(word))
    return Name(unit, plain(rest).strip(" .:-"), words)


def _parts(word: str) -> tuple[str, ...]:
    """A word, or what it is joined of: Ladestrom, packvoltage."""
    end = next((w for w in _ENDS if word.endswith(w)), "") if word not in _KNOWN else ""
    return (word.removesuffix(end), end) if end and word != end else (word,)


def words_of(name: str) -> frozenset[str]:
    """The words of a name: ``BMS_PackCurrent`` is bms, pack, current."""
    return frozenset(word.casefold() for word in _WORD.findall(name))


def unit_for(field: str, name: str) -> str | None:
    """The unit of a quantity that a name states; empty: none; None: that of another quantity."""
    unit = name_of(name).unit
    return unit if not unit or unit in _OF.get(field, ()) else None


def is_unit(text: str) -> bool:
    """A text is a unit, of whatever quantity."""
    return plain(text) in _UNITS or text.casefold() in _UNITS


def likeness(field: str, text: str) -> int:
    """How much a name speaks for a quantity: from `CLEAR` on for nothing else, 0 not at all.

    `NEVER`: it is of something else.
    """
    name = name_of(text)
    if unit_for(field, text) is None:
        return NEVER
    if name.phrase in WORDS[field]:
        return WHOLE
    kinds = {_kind(word) for word in name.words}
    spoken = {
        f: bool(_spoken(f, name))
        for f in _OF
        if f in (field, "time_s", "current_A", "voltage_V", "temperature_C")
    }
    if "other" in kinds or (not spoken[field] and any(spoken.values())):
        return NEVER
    if spoken[field]:
        own = _spoken(field, name)
        last = name.phrase.rpartition(" ")[2]
        if not name.unit and any(last in WORDS[f] for f in spoken if f != field):
            return NEVER  # 'Current time'
        beside = {w for w in name.words - own if _kind(w) not in ("battery", "plain", "number")}
        if not beside:
            return CLEAR
        return PART if any(len(w) > 1 for w in own) else 0
    if (name.words | {name.phrase}).intersection(_ALL["perhaps"].get(field, ())):
        return PERHAPS
    long = [word for word in name.words if len(word) > 3]
    known = [word for word in WORDS[field] if len(word) > 3]
    return LIKE if any(get_close_matches(w, known, n=1, cutoff=0.8) for w in long) else 0


def of_battery(text: str) -> bool:
    """A name says that it is the battery's, or the cell's."""
    return any(_kind(word) == "battery" for word in words_of(text))


def _spoken(field: str, name: Name) -> set[str]:
    """The words of a name that are words for a quantity; of other scripts, that end in one."""
    found = name.words.intersection(WORDS[field])
    for word in name.words:
        if _OTHER_SCRIPT.search(word) and any(
            len(w) > 1 and word.endswith(w) for w in WORDS[field]
        ):
            found |= {word}
    return set(found)


def _kind(word: str) -> str:
    """What a word says of a quantity: battery, plain, other, number; empty: unknown."""
    if word in _QUALIFIERS or not _OTHER_SCRIPT.search(word):
        return "number" if word.isdigit() else _QUALIFIERS.get(word, "")
    others = (w for w, kind in _QUALIFIERS.items() if kind == "other" and _OTHER_SCRIPT.search(w))
    return "other" if any(w in word for w in others) else ""


@cache
def state_of(label: str) -> float:
    """What a label says of a current: 1 discharge, -1 charge, 0 rest, NaN nothing."""
    text = plain(label)
    for kind, value in _STATES.items():
        if text in _ALL["state"][kind]:
            return value
    for kind, parts in _ALL["state"]["part"].items():
        if any(part in text for part in parts):
            return _STATES[kind]
    return float("nan")


def names_states(name: str) -> bool:
    """A column of this name may hold states."""
    phrase = name_of(name).phrase
    return phrase in _ALL["state"]["names"] or phrase.partition(" ")[2] in _ALL["state"]["names"]


def long_table(header: Sequence[str]) -> tuple[list[int], int, int | None] | None:
    """Columns of entities, of their value and unit, of a table with a row for each and time."""
    phrases = [name_of(name).phrase.strip() for name in header]
    entities, values, units = (
        [k for word in _ALL["long"][kind] for k, p in enumerate(phrases) if p == word]
        for kind in ("entity", "value", "unit")
    )
    values = [k for k in values if k not in entities[:1]]
    if not entities or not values:
        return None
    quantities = ("current_A", "voltage_V")
    if any(likeness(field, name) >= CLEAR for name in header for field in quantities):
        return None
    return entities, values[0], units[0] if units else None


def words_in(text: str) -> int:
    """How many letters of other scripts in a text belong to known words."""
    lower = text.casefold()
    known = _KNOWN.union(_ALL["state"]["names"])
    return sum(
        len(word)
        for word in known
        if len(word) > 1 and _OTHER_SCRIPT.search(word) and word in lower
    )

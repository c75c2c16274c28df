"""Tables of TOML as records: every key known, every value of its kind and within its range."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from difflib import get_close_matches
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from cellwise.errors import InputError

R = TypeVar("R")
KINDS = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}
FINITE = (-1e9, 1e9)  # of every number whose field says nothing else


def need(holds: bool, found: str, expected: str, action: str = "Correct it.") -> None:
    """Refuse where something does not hold.

    Raises
    ------
    InputError
    """
    if not holds:
        raise InputError(found, expected, action)


def within(low: float, high: float, default: Any) -> Any:
    """A field whose value, or each of whose values, lies between two numbers."""
    return field(default=default, metadata={"range": (low, high)})


def keyed(key: str) -> Any:
    """A field of tables that a file calls by another name; no key: it is in no file."""
    return field(default=(), metadata={"key": key})


def check_ranges(record: Any, where: str, action: str = "Correct it.") -> None:
    """Refuse a record with a number that is not finite, or beyond the range of its field.

    Raises
    ------
    InputError
    """
    for one in fields(record):
        value = getattr(record, one.name)
        low, high = one.metadata.get("range", FINITE)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float):
                text = f"{one.name} = {number:g} in {where}"
                need(low <= number <= high, text, f"a number from {low:g} to {high:g}", action)


def record(kind: type[R], table: Any, where: str, **given: Any) -> R:
    """The record of a table, with tables in it as records too; ``given`` is not in the file.

    Raises
    ------
    InputError       no table; a key that the record lacks, one that is missing, a value of another
                     kind
    """
    need(isinstance(table, Mapping), f"{where} as {type(table).__name__}", f"tables {where}")
    hints = get_type_hints(kind)
    known = {_key(f): f for f in fields(kind) if _key(f) and f.name not in given}  # type: ignore[arg-type]
    unknown = next((key for key in table if key not in known), None)
    near = get_close_matches(unknown or "", known, n=1)
    need(
        unknown is None,
        f"key '{unknown}' in {where}",
        f"some of {', '.join(known)}",
        f"Did you mean '{near[0]}'?" if near else "Correct its name.",
    )
    for key, one in known.items():
        if key in table:
            given[one.name] = _value(hints[one.name], table[key], key, where)
        else:
            there = one.default is not MISSING or one.default_factory is not MISSING
            need(there, f"{where} without '{key}'", f"a value for '{key}'", "Add it.")
    return kind(**given)


def _key(one: Field[Any]) -> str:
    return str(one.metadata.get("key", one.name))


def _value(hint: Any, value: Any, key: str, where: str) -> Any:
    """A TOML value as a field's type wants it: lists as tuples, whole numbers as numbers."""
    if get_origin(hint) in (Union, types.UnionType):
        inner = next(a for a in get_args(hint) if a is not type(None))
        return _value(inner, value, key, where)
    if is_dataclass(hint):
        return record(hint, value, f"[{key}]")  # type: ignore[arg-type]
    if get_origin(hint) is tuple:
        kind = get_args(hint)[0]
        if is_dataclass(kind):
            need(isinstance(value, list), f"[{key}]", f"tables [[{key}]]")
            return tuple(record(kind, t, f"[[{key}]] {k + 1}") for k, t in enumerate(value))  # type: ignore[arg-type]
        need(isinstance(value, list), f"{key} = {value!r} in {where}", "a list", "In brackets.")
        return tuple(_value(kind, item, key, where) for item in value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    fits = isinstance(value, hint) and not (isinstance(value, bool) and hint is not bool)
    need(fits, f"{key} = {value!r} in {where}", KINDS.get(hint, str(hint)))
    return value

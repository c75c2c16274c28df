"""Tables of a suite's TOML as records: every key known, every value of its kind."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from cellwise.errors import InputError

R = TypeVar("R")
KINDS = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}


def need(holds: bool, found: str, expected: str, action: str = "Correct it.") -> None:
    """Refuse where something does not hold.

    Raises
    ------
    InputError
    """
    if not holds:
        raise InputError(found, expected, action)


def records(kind: type[R], tables: Any, where: str) -> tuple[R, ...]:
    """One record per table.

    Raises
    ------
    InputError       no list of tables; a key that the record lacks, one that is missing, a value of
                     another kind
    """
    if not isinstance(tables, list) or not all(isinstance(t, Mapping) for t in tables):
        raise InputError(f"{where} as {type(tables).__name__}", f"tables {where}", "Correct it.")
    return tuple(kind(**checked(kind, table, f"{where} {k + 1}")) for k, table in enumerate(tables))


def checked(kind: type[Any], table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The table's values as the record's fields want them, defaults filled in."""
    hints = get_type_hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    unknown = [key for key in table if key not in fields]
    if unknown:
        raise InputError(
            f"key '{unknown[0]}' in {where}", f"some of {', '.join(fields)}", "Correct its name."
        )
    found: dict[str, Any] = {}
    for name, one in fields.items():
        if name in table:
            found[name] = _value(hints[name], table[name], f"{name} in {where}")
        elif one.default is not dataclasses.MISSING:
            found[name] = one.default
        else:
            raise InputError(f"{where} without '{name}'", f"a value for '{name}'", "Add it.")
    return found


def _value(hint: Any, value: Any, where: str) -> Any:
    """A TOML value as a field's type wants it: lists as tuples, whole numbers as numbers."""
    if get_origin(hint) in (Union, types.UnionType):
        inner = next(a for a in get_args(hint) if a is not type(None))
        return _value(inner, value, where)
    if get_origin(hint) is tuple:
        if not isinstance(value, list):
            raise InputError(f"{where} = {value!r}", "a list", "Put it in brackets.")
        return tuple(_value(get_args(hint)[0], item, where) for item in value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise InputError(f"{where} = {value!r}", KINDS.get(hint, str(hint)), "Correct it.")
    return value

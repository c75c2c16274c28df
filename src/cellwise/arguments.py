"""Arguments of the public face, checked where they come in: a wrong type is put in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray

Kind = TypeVar("Kind")


def check_kind(name: str, value: object, kind: type[Kind], way_out: str) -> Kind:
    """The value; refused where it is of another type.

    Raises
    ------
    InputError        names the argument, what it is, what it should be
    """
    if not isinstance(value, kind):
        raise InputError(f"{name} = {shown(value)}", with_article(kind.__name__), way_out)
    return value


def several(name: str, values: object, kind: type[Kind], way_out: str) -> tuple[Kind, ...]:
    """Things of one type, or one of them alone.

    Raises
    ------
    InputError        names the argument, and what is of another type
    """
    if isinstance(values, kind):
        return (values,)
    if not isinstance(values, Sequence) or isinstance(values, (str, bytes)):
        raise InputError(f"{name} = {shown(values)}", f"{kind.__name__}, one or several", way_out)
    for one in values:
        check_kind(f"one of {name}", one, kind, way_out)
    return tuple(values)


def choice(name: str, value: object, names: Sequence[str]) -> str:
    """One of some names, in whatever case it was written, as it stands among them.

    Raises
    ------
    InputError        none of them
    """
    for one in names:
        if isinstance(value, str) and value.casefold() == one.casefold():
            return one
    raise InputError(f"{name} {shown(value)}", f"one of {', '.join(names)}", "Choose one of them.")


def file_path(name: str, value: object) -> Path:
    """Where a file is.

    Raises
    ------
    InputError        neither a text nor a Path
    """
    if isinstance(value, (str, Path)):
        return Path(value)
    raise InputError(f"{name} = {shown(value)}", "where the file is", "Write 'name.json', say.")


def number(name: str, value: object, expected: str, way_out: str = "Pass one number.") -> float:
    """A number as a float; numpy's scalars are numbers, texts and None are not.

    Raises
    ------
    InputError        it is none
    """
    if type(value) is float:
        return value
    if value is not None and not isinstance(value, (str, bytes)):
        try:
            return float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            pass
    raise InputError(f"{name} = {shown(value)}", expected, way_out)


def numbers(name: str, values: object) -> FloatArray:
    """Numbers as an array of floats, of whatever shape.

    Raises
    ------
    InputError        texts, None, or rows of unequal length
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf":
            return array.astype(np.float64, copy=False)
    except ValueError:
        pass
    raise InputError(f"{name} = {shown(values)}", "numbers, nan where one is missing", "Correct.")


SOC_BEYOND = 0.005  # a counter ends no further beyond empty or full


def held_soc(soc: float) -> float:
    """A SOC, 0..1: one that a counter puts up to 0.005 beyond empty or full is empty or full."""
    return min(max(soc, 0.0), 1.0) if -SOC_BEYOND <= soc <= 1.0 + SOC_BEYOND else soc


def beyond(soc: float) -> str:
    """Says that a SOC was held."""
    return (
        f"a SOC of {soc:g} was taken as {held_soc(soc):g}: up to {SOC_BEYOND:g} beyond 0 to 1 is a "
        "counter's error"
    )


def shown(value: object) -> str:
    """A value as a message shows it: None, a short text, a number, else its type."""
    if value is None or isinstance(value, (bool, int, float)):
        return str(value)
    if isinstance(value, str):
        return repr(value if len(value) <= 40 else f"{value[:40]}...")
    shape = getattr(value, "shape", None)
    of = f" of shape {shape}" if isinstance(shape, tuple) and shape else ""
    return with_article(type(value).__name__) + of


def with_article(name: str) -> str:
    """``a CellLog``, ``an EkfState``."""
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"

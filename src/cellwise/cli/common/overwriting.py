"""No command writes over what it reads."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cellwise.errors import InputError

OUTPUTS = ("output", "report")


def check_overwriting(arguments: argparse.Namespace) -> None:
    """Refuse an output that is one of the command's own inputs, under whatever name.

    Raises
    ------
    InputError        it is
    """
    said = vars(arguments)
    for output in OUTPUTS:
        text = said.get(output)
        if not isinstance(text, str) or not _is_file(text):
            continue
        for name, value in said.items():
            if name in OUTPUTS or name == "state":
                continue
            for given in _texts(value):
                if _is_file(given) and Path(given).samefile(text):
                    raise InputError(
                        f"'{text}' both to read and to write",
                        "an output that is none of the inputs",
                        "Name another one: nothing was overwritten.",
                    )


def _texts(value: Any) -> Iterator[str]:
    """The texts of an argument, and the paths of those that state something behind an @."""
    if isinstance(value, str):
        yield value
        yield value.rpartition("@")[0]
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _texts(one)


def _is_file(text: str) -> bool:
    try:
        return bool(text) and Path(text).is_file()
    except (OSError, ValueError):
        return False

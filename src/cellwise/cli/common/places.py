"""Where a command writes: there is room for it, and it is none of what the command reads."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cellwise.errors import InputError

OUTPUTS = ("output", "report")
LOGS = ("log", "logs", "holdout", "baseline", "hppc", "ocv", "capacity", "drive")


def check_places(*paths: str | None) -> None:
    """Refuse output files without a folder to stand in, before the work is done.

    Raises
    ------
    InputError        no such folder, or a folder where the file would be
    """
    for path in paths:
        if path is None:
            continue
        place = Path(path)
        try:
            is_folder, folder = place.is_dir(), place.resolve().parent
            place.exists()
            has_folder = folder.is_dir()
        except (OSError, ValueError) as error:
            raise InputError(
                f"'{str(place)[:60]}...', a name to write to that the system refuses "
                f"({getattr(error, 'strerror', None) or error})",
                "a name of a file",
                "Choose another one.",
            ) from None
        if is_folder:
            raise InputError(f"a folder at '{place}'", "a file to write", "Give a file name.")
        if not has_folder:
            raise InputError(
                f"no folder '{folder}' to write '{place.name}' into",
                "an existing folder",
                "Create it first.",
            )


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
            for path in _files(value) if name in LOGS else _texts(value):
                if _is_file(path) and Path(path).samefile(text):
                    raise InputError(
                        f"'{text}' both to read and to write",
                        "an output that is none of the inputs",
                        "Name another one: nothing was overwritten.",
                    )


def _files(value: Any) -> Iterator[str]:
    """The files that the logs of an argument are."""
    from cellwise.logs.places import logs_of

    for text in [value] if isinstance(value, str) else value:
        try:
            yield from (one.path for one in logs_of(text).logs)
        except InputError:
            continue  # refused where it is read


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

"""Output files that appear whole or not at all, and the folder of the embedded data."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from cellwise.errors import InputError, MachineError

EMBEDDED_MARK = "catalogue.toml"
LONGEST_SHOWN = 200  # characters of a path, in messages


def shipped_folder(packaged: str, source: str, mark: str) -> Path:
    """A folder that comes with cellwise: inside an installed package, else in the source tree.

    Parameters
    ----------
    packaged, source : str    its name in the package, and in the source tree
    mark : str                a file that it holds

    Raises
    ------
    InputError                neither is there
    """
    package = Path(__file__).resolve().parent
    for folder in (package / packaged, package.parents[1] / source):
        if (folder / mark).is_file():
            return folder
    raise InputError(
        f"no {source} beside this installation of cellwise",
        f"a folder with {mark}",
        "Install cellwise from its wheel or its source tree.",
    )


def embedded_folder() -> Path:
    """Folder of the embedded data; raises as `shipped_folder`."""
    return shipped_folder("_datasets", "datasets", EMBEDDED_MARK)


def made_folder(path: str | Path, content: str = "") -> Path:
    """Make a folder where there is none, parents too; ``content`` is what it is for.

    Raises
    ------
    InputError        it cannot be made
    """
    place = Path(path)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MachineError(
            f"'{path}', which cannot be made ({error.strerror})",
            f"a folder for {content}" if content else "a folder",
            "Choose another place.",
        ) from error
    return place


def file_place(path: str | Path) -> Path:
    """Where a file is to be written: a link keeps pointing to what it points to.

    Raises
    ------
    InputError        a folder is there, or none to stand in; a name that the system refuses
    """
    place = Path(path)
    try:
        target, is_folder = place.resolve(), place.is_dir()
        has_folder, _ = target.parent.is_dir(), place.exists()
    except (OSError, ValueError) as error:
        raise _not_written(place, error) from None
    if is_folder:
        raise InputError(f"a folder at '{place}'", "a file to write", "Give a file name.")
    if not has_folder:
        raise InputError(
            f"no folder '{target.parent}' to write '{target.name}' into",
            "an existing folder",
            "Create it first.",
        )
    return target


def write_atomically(path: str | Path, content: str | bytes | Callable[[Path], object]) -> Path:
    """Write a file so that it appears whole or not at all.

    The content goes to a temporary file in the same folder, which then takes the name. Whatever
    stands there is untouched until then, and stays when writing fails.

    Parameters
    ----------
    path : str or Path
    content : str, bytes or callable      text (written as UTF-8), bytes, or a function that writes
                                          to the path it is given, which has the same suffix

    Returns
    -------
    Path              where the file now is

    Raises
    ------
    InputError        the folder does not exist or cannot be written to, the path is a folder, the
                      disk is full
    """
    place = Path(path)
    try:
        if place.exists() and not (place.is_file() or place.is_dir()):
            _write(place, content)  # a device or a pipe has no whole
            return place
    except OSError as error:
        raise _not_written(place, error) from error
    target = file_place(place)
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(6)}{target.suffix}")
    try:
        _write(temporary, content)
        os.replace(temporary, target)
    except OSError as error:
        raise _not_written(target, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return target


def _not_written(place: Path, error: Exception) -> MachineError:
    name = str(place)
    return MachineError(
        f"'{name if len(name) < LONGEST_SHOWN else name[:LONGEST_SHOWN] + '...'}', which cannot be "
        f"written ({getattr(error, 'strerror', None) or error})",
        "a folder with write permission and space left",
        "Check permissions and disk space, or choose another place.",
    )


def _write(path: Path, content: str | bytes | Callable[[Path], object]) -> None:
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)

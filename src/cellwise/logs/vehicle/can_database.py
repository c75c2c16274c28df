"""The database of the signals in CAN frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cellwise.errors import InputError
from cellwise.logs.files.extras import need


def can_database(path: Path | None, of: str) -> Any:
    """A database of cantools.

    Parameters
    ----------
    path : Path or None     what the user gave
    of : str                whose frames it describes, for the message

    Raises
    ------
    InputError              none was given, or the file is no such database
    """
    cantools = need("cantools", "a CAN log")
    if path is None:
        raise InputError(of, "the database that describes them", "Give it with `dbc=FILE.dbc`.")
    try:
        return cantools.database.load_file(str(path), strict=False)
    except Exception as error:  # parsers of four formats raise what they like
        text = " ".join(str(error).split())[:160]
        raise InputError(
            f"a file that is no CAN database, '{path}' ({text})",
            "a DBC, ARXML, KCD or SYM file",
            "Choose the database of this log.",
        ) from error

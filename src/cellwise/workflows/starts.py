"""Which start holds: what is stated of a log, or what is asked for."""

from __future__ import annotations

from cellwise.errors import InputError
from cellwise.wording import arg


def start_of(stated: float | None, asked: float | None, argument: str = "soc0") -> float | None:
    """The start that is asked for; None where the log's own stated one holds, or none is known.

    Parameters
    ----------
    stated : float or None    ``soc0`` of the log
    asked : float or None     of the call, in its ``argument``

    Raises
    ------
    InputError        an argument that contradicts what is stated of the log
    """
    if stated is not None and asked is not None and asked != stated:
        raise InputError(
            arg(argument, letter=f"{asked:g}")
            + f" for a log whose initial SOC is stated as {stated:g}",
            "one initial SOC",
            "Leave out " + arg(argument, letter="...") + ", or what is stated behind the @.",
        )
    return asked if stated is None else None

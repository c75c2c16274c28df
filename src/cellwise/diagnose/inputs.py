"""What `diagnose` is given, checked where it comes in: logs, causes, where the logs start."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cellwise.arguments import number, shown
from cellwise.diagnose.causes.catalogue import CAUSES, ON_REQUEST, Cause
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog, check_is_log

Logs = CellLog | Sequence[CellLog]
Start = float | str
START = "a fraction from 0 to 1 or 'auto', or one of them for every log"
CORRECT_START = "Give `soc0=0.9`, say; left out it is found from the log."


def logs_of(logs: Logs) -> tuple[CellLog, ...]:
    """One log or several as several.

    Raises
    ------
    InputError        what is no log
    """
    if isinstance(logs, str) or not isinstance(logs, Iterable):
        check_is_log(logs)
        return (logs,)
    found = tuple(logs)
    for log in found:
        check_is_log(log)
    return found


def causes_of(names: str | Sequence[str] | None) -> list[Cause]:
    """Causes by their names; without any, all that need no request.

    Raises
    ------
    InputError        an unknown cause
    """
    if names is None:
        return [c for c in CAUSES.values() if c.name not in ON_REQUEST]
    several = names if isinstance(names, Iterable) and not isinstance(names, str) else [names]
    found = []
    for name in several:
        if name not in CAUSES:
            raise InputError(
                f"cause {shown(name)}", f"one of {', '.join(CAUSES)}", "Correct its name."
            )
        found.append(CAUSES[name])
    return found


def stated_starts(
    groups: Sequence[Sequence[CellLog]], soc0: Start | Sequence[Start]
) -> list[Start]:
    """What is said of every log's start; a log's own goes before one for all.

    Raises
    ------
    InputError        what is neither a number nor "auto", or more of them than logs
    """
    logs = [g for group in groups for g in group]
    if isinstance(soc0, str) or not isinstance(soc0, Iterable):
        one = _start(soc0)
        return [one if g.soc0 is None else g.soc0 for g in logs]
    stated = [_start(s) for s in soc0]
    if len(stated) > len(logs):
        raise InputError(
            f"soc0 for {len(stated)} logs", f"at most one for each of {len(logs)}", CORRECT_START
        )
    return stated + ["auto"] * (len(logs) - len(stated))


def _start(value: object) -> Start:
    return "auto" if value == "auto" else number("soc0", value, START, CORRECT_START)

"""What commands print: a progress bar, tables and lines for people, one JSON object.

The library's messages are put in the words of the command line: `series=4` is ``--series 4``.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

from cellwise.notices import Notice
from cellwise.progress import progress_bar
from cellwise.report.page.numerals import NONE
from cellwise.wording import Option, Text, pairs_of

T = TypeVar("T")
# Where the option is not the argument's own name.
NAMES = {"channels": "channel", "dt_s": "dt", "limits": "voltage-limits"}
OPEN = ("...", "{...}")  # the argument, whatever its value


def worded(text: str) -> str:
    """A text of the library, with every argument that it names as the option of a command."""
    return text.rendered(in_command) if isinstance(text, Text) else text


def in_command(option: Option) -> str:
    """An argument and its value as the option of a command.

    ``series=4`` is ``--series 4``, ``partial=True`` is ``--partial``, ``refine=False`` is
    ``--no-refine``, ``channels={'time_s': 'COLUMN'}`` is ``--channel time_s=COLUMN``.
    """
    value = option.letter or option.value
    name = NAMES.get(option.argument, option.argument).replace("_", "-").lower()
    if isinstance(value, bool):
        return f"--{name}" if value else f"--no-{name}"
    if value in OPEN:
        return f"--{name}"
    pairs = pairs_of(value)
    said = [f"{key}={shlex.quote(of)}" for key, of in pairs] or [shlex.quote(str(value))]
    return " ".join(f"--{name} {one}" for one in said)


def rendered(notices: Iterable[Notice]) -> list[str]:
    """Notices in a command's words, for JSON."""
    return [notice.rendered(in_command) for notice in notices]


@contextmanager
def working(what: str) -> Iterator[Callable[..., None]]:
    """A line on standard error while it works, and what moves it; none without a terminal."""
    with progress_bar() as follow:
        follow(what)
        yield follow


def print_json(data: Mapping[str, Any]) -> None:
    """One JSON object on standard output; what is not a number becomes null."""
    print(json.dumps(clean(data), allow_nan=False))


def clean(value: Any) -> Any:
    """JSON values only: numpy scalars to Python's, NaN to null; texts in a command's words."""
    if isinstance(value, Mapping):
        return {str(k): clean(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [clean(v) for v in value]
    if hasattr(value, "tolist"):
        return clean(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return worded(value) if isinstance(value, str) else value


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table for people; numbers to the right."""
    shown = Table(title=title, title_justify="left", header_style="bold")
    for k, column in enumerate(columns):
        shown.add_column(column, justify="left" if k == 0 else "right")
    for row in rows:
        shown.add_row(*map(worded, row))
    console = Console()
    if console.width < 100 and not console.is_terminal:
        console = Console(width=140)
    console.print(shown)


def record_table(title: str, items: Iterable[T], *columns: tuple[str, Callable[[T], str]]) -> None:
    """A table of a row per item; a column is its head and how an item reads in it.

    Columns of which no row says anything are left out.
    """
    found = list(items)
    texts = {head: [read(item) for item in found] for head, read in columns}
    said = {head: rows for head, rows in texts.items() if not {"", "-", NONE}.issuperset(rows)}
    table(title, list(said), list(zip(*said.values(), strict=True)))


def say_notices(notices: Iterable[Notice]) -> None:
    """What a person should know, each once; what holds for several logs once for all of them."""
    logs_of: dict[str, list[str]] = {}
    for notice in dict.fromkeys(notices):
        logs = logs_of.setdefault(notice.behind_name(in_command), [])
        logs += [notice.before] if notice.log else []
    for said, logs in logs_of.items():
        more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        say(f"  ! {logs[0] if logs else ''}{more}{said}")


def warn(text: str) -> None:
    """A line on standard error, whatever standard output is for."""
    Console(stderr=True, soft_wrap=True, highlight=False, markup=False).print(worded(text))


def say(text: str) -> None:
    """A line for people."""
    Console(soft_wrap=True, highlight=False, markup=False).print(worded(text))


def millivolt(value: float | None) -> str:
    """A voltage in millivolts, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{1e3 * value:.1f}"


def band(value: float, std: float, digits: int = 3) -> str:
    """A value and two deviations, for a table."""
    return "-" if value != value else f"{value:.{digits}f} +- {2 * std:.{digits}f}"


def percent(value: float | None, digits: int = 2) -> str:
    """A fraction in per cent, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{100 * value:.{digits}f}"

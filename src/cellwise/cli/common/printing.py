"""What commands share: reading logs with a progress bar, tables for people, one JSON object."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from cellwise.cli.common.wording import in_options
from cellwise.errors import InputError
from cellwise.logs import CellLog, Stated, read_log

SIGNS = ("auto", "charge-positive", "discharge-positive")
BIG_FILE = 20_000_000


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    parser.add_argument("--json", action="store_true", help="print one JSON object and no more")


def add_sign(parser: argparse.ArgumentParser) -> None:
    """Add ``--sign``."""
    parser.add_argument(
        "--sign", choices=SIGNS, default="auto", help="sign of the current in the file [auto]"
    )


def read(path: str, sign: str = "auto", **options: Any) -> CellLog:
    """Read a log and what is stated of it, with a bar for a big file; options as of `read_log`."""
    stated = Stated.parse(path)
    place = Path(stated.path)
    if not place.is_file() or place.stat().st_size < BIG_FILE:
        return read_log(stated, sign=sign, **options)
    with bar() as progress:
        task = progress.add_task(f"reading {place.name}", total=None)
        return read_log(
            stated,
            sign=sign,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
            **options,
        )


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


@contextmanager
def bar() -> Iterator[Progress]:
    """A progress bar on standard error that leaves nothing behind; none without a terminal."""
    console = Console(stderr=True)
    with Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as progress:
        yield progress


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
    return in_options(value) if isinstance(value, str) else value


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table for people; numbers to the right."""
    shown = Table(title=title, title_justify="left", header_style="bold")
    for k, column in enumerate(columns):
        shown.add_column(column, justify="left" if k == 0 else "right")
    for row in rows:
        shown.add_row(*map(in_options, row))
    console = Console()
    if console.width < 100 and not console.is_terminal:
        console = Console(width=140)
    console.print(shown)


def say(text: str) -> None:
    """A line for people."""
    Console(soft_wrap=True, highlight=False, markup=False).print(in_options(text))


def millivolt(value: float | None) -> str:
    """A voltage in millivolts, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{1e3 * value:.1f}"


def percent(value: float | None, digits: int = 2) -> str:
    """A fraction in per cent, for a table."""
    return "-" if value is None or not math.isfinite(value) else f"{100 * value:.{digits}f}"

"""Options of every command that has a page: the page, and its pictures as files."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cellwise.cli.common import printing
from cellwise.cli.common.options import check_places
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.report.page.picture import FigureFiles

PAGES = (".html", ".htm")


class PagePlaces(NamedTuple):
    """Where a page goes, and its pictures if they were asked for."""

    page: Path
    figures: FigureFiles | None


def check_page_options(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        no place for page or pictures; nothing to draw with; a format without folder
    """
    report = getattr(arguments, "report", None)
    check_places(report)
    if report and Path(report).suffix.lower() not in ("", *PAGES):
        raise InputError(
            f"--report {report}",
            "a page, which is HTML: F.html",
            "Name it so; its pictures as files: --figures DIR --figure-format pdf.",
        )
    if arguments.figure_format and not arguments.figures:
        raise InputError(
            "--figure-format without --figures", "a folder for the pictures", "Add --figures DIR."
        )
    if arguments.figures and Path(arguments.figures).is_file():
        raise InputError(f"a file at '{arguments.figures}'", "a folder for pictures", "Rename it.")
    if report or arguments.figures:
        from cellwise.report.page import style

        with style.drawing():  # says so now if pictures cannot be drawn
            pass


def figure_files(arguments: argparse.Namespace) -> FigureFiles | None:
    """Folder and formats of the pictures, None where they were not asked for."""
    if not arguments.figures:
        return None
    from cellwise.report.page.picture import FigureFiles

    kinds = dict.fromkeys(arguments.figure_format or ("png",))
    return FigureFiles(Path(arguments.figures), tuple(f".{kind}" for kind in kinds))


@contextmanager
def page_places(arguments: argparse.Namespace) -> Iterator[PagePlaces | None]:
    """Where the page and its pictures go; None where neither is wanted.

    Pictures without a page: the page goes to a folder that is dropped.
    """
    figures = figure_files(arguments)
    if arguments.report:
        yield PagePlaces(Path(arguments.report), figures)
    elif figures is not None:
        with tempfile.TemporaryDirectory() as folder:
            yield PagePlaces(Path(folder) / "page.html", figures)
    else:
        yield None


def say_pages(arguments: argparse.Namespace) -> None:
    """Name for people what was written."""
    if getattr(arguments, "report", None):
        printing.say(f"page to open: {arguments.report}")
    if arguments.figures:
        printing.say(f"pictures in {arguments.figures}")


def hand_over(
    arguments: argparse.Namespace,
    found: Any,
    write_page: Callable[..., Path],
    say: Callable[[Any], None],
    data: Mapping[str, Any],
) -> None:
    """Write the page of a result if one is wanted, and print the result as was asked.

    ``data`` is its JSON, with notices in a command's words.
    """
    with page_places(arguments) as pages:
        if pages is not None:
            write_page(found, pages.page, figures=pages.figures)
    if arguments.json:
        printing.print_json(data)
        return
    say(found)
    say_pages(arguments)

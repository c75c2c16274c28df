"""A headed part of a page: markup and pictures in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.files import write_atomically
from cellwise.report.page.markup import EMPTY, Markup, page, page_file
from cellwise.report.page.picture import FigureFiles, Picture, inline, save_figures

Blocks = tuple[Markup | Picture, ...]


class Section(NamedTuple):
    """Key and short name for links, heading, and blocks of markup or pictures."""

    key: str
    title: str
    blocks: Blocks
    short: str = ""


def pictures_of(sections: Iterable[Section]) -> tuple[Picture, ...]:
    """All pictures of the sections, in order."""
    return tuple(b for s in sections for b in s.blocks if isinstance(b, Picture))


def rendered(section: Section) -> Markup:
    """The blocks of a section as one piece of HTML."""
    parts = [inline(b) if isinstance(b, Picture) else b for b in section.blocks]
    return Markup("\n".join(p for p in parts if p))


def write_page(
    path: str | Path,
    finding: str,
    about: str,
    sections: Sequence[Section],
    data: Mapping[str, Any],
    *,
    lead: Markup = EMPTY,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Render a page and write it whole; its pictures too, where a folder for them is given."""
    parts = [(s.key, s.title, s.short or s.title, rendered(s)) for s in sections]
    text = page(
        finding,
        about,
        parts,
        data,
        lead=lead,
        scripts=scripts_for(inside for *_, inside in parts),
    )
    if figures is not None:
        files = figures if isinstance(figures, FigureFiles) else FigureFiles(Path(figures))
        save_figures(pictures_of(sections), *files)
    return write_atomically(path, text)


# What a page holds that needs the program.
NEEDED_BY = {"zoom.js": "<figure ", "interactive.js": '<div class="trace"',
             "sort.js": 'sort"><thead'}  # fmt: skip


def scripts_for(parts: Iterable[str]) -> list[Markup]:
    """The programs that the parts of a page need."""
    inside = list(parts)
    return [
        script(name) for name, mark in NEEDED_BY.items() if any(mark in part for part in inside)
    ]


def script(name: str) -> Markup:
    """A program as it stands in a page."""
    return Markup(page_file(name).replace("</", "<\\/"))

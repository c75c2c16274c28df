"""A page: headed parts in reading order, each of markup, pictures and plots that zoom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from cellwise.files import write_atomically
from cellwise.report.page.markup import (
    EMPTY,
    MOST,
    Markup,
    data_block,
    escape,
    page_file,
    paragraph,
)
from cellwise.report.page.numerals import listed
from cellwise.report.page.picture import FigureFiles, Figures, Picture, inline, save_figures
from cellwise.report.page.plot import Plot, trace

Block = Markup | Picture | Plot
Blocks = tuple[Block, ...]
USE = (
    "Plots zoom: drag over the part to see, or click a plot and turn the wheel; arrow keys, + and "
    "− move; a double click shows all. Plots of one log share a cursor."
)
TWO_SIGMA = "± and bands are two standard deviations."


class Section(NamedTuple):
    """Key and short name for links, heading, and blocks of markup, pictures or plots."""

    key: str
    title: str
    blocks: Blocks
    short: str = ""


def pictures_of(sections: Iterable[Section]) -> tuple[Picture | Plot, ...]:
    """All pictures and plots of the sections, in order."""
    return tuple(b for s in sections for b in s.blocks if not isinstance(b, Markup))


def plots_within(plots: Iterable[Plot]) -> list[Block]:
    """Plots up to the size of a page; those beyond are left out, with a note."""
    shown: list[Block] = []
    left_out, samples = [], 0
    for plot in plots:
        samples += plot.samples
        if samples > MOST.samples and shown:
            left_out.append(plot.title)
        else:
            shown.append(plot)
    note = paragraph(f"Left out, for the page's size: {listed(left_out)}.")
    return [*shown, note] if left_out else shown


def rendered(section: Section) -> Markup:
    """The blocks of a section as one piece of HTML; pictures in a row stand beside one another."""
    parts: list[str] = []
    for kind, blocks in groupby(section.blocks, type):
        if kind is Picture:
            inside = "\n".join(inline(b) for b in blocks if isinstance(b, Picture))
            parts.append(f'<div class="pictures">{inside}</div>')
        else:
            parts += [trace(b) if isinstance(b, Plot) else str(b) for b in blocks]
    return Markup("\n".join(p for p in parts if p))


def write_page(
    path: str | Path,
    finding: str,
    about: str,
    sections: Sequence[Section],
    data: Mapping[str, Any],
    *,
    lead: Markup = EMPTY,
    figures: Figures = None,
) -> Path:
    """Render a page and write it.

    Parameters
    ----------
    path : str or Path            of the HTML file; it appears whole or not at all
    finding, about : str          the first line, and what the page is
    sections : of Section         in reading order; those without content are left out
    data : mapping                the figures for machines
    lead : Markup                 between the first line and the sections
    figures : folder or FigureFiles   for pictures and plots as PNG and SVG files

    Raises
    ------
    InputError        matplotlib is missing; nothing to show; the path cannot be written
    """
    text = page_text(finding, about, sections, data, lead)
    if figures is not None:
        files = figures if isinstance(figures, FigureFiles) else FigureFiles(Path(figures))
        save_figures(pictures_of(sections), *files)
    return write_atomically(path, text)


def page_text(
    finding: str, about: str, sections: Sequence[Section], data: Mapping[str, Any], lead: Markup
) -> str:
    """The whole page; nothing outside it is needed."""
    parts = [(s, inside) for s in sections if (inside := rendered(s))]
    links = "".join(
        f'<a href="#{escape(s.key)}">{escape(s.short or s.title)}</a>' for s, _ in parts
    )
    body = "\n".join(
        f'<section id="{escape(s.key)}">\n<h2>{escape(s.title)}</h2>\n{inside}\n</section>'
        for s, inside in parts
    )
    said = [USE] if 'class="trace"' in body else []
    said += [TWO_SIGMA] if "±" in finding + lead + body else []
    use = paragraph(" ".join(said), "about") if said else EMPTY
    runs = any(mark in body for mark in ('class="trace"', 'sort"><thead'))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="cellwise">
<title>{escape(about)}</title>
<style>
{page_file("page.css")}</style>
</head>
<body>
<main>
<header>
<h1>{escape(finding)}</h1>
<p class="about">{escape(about)}</p>
{lead}
<nav aria-label="Contents">{links}</nav>
{use}
</header>
{body}
<footer>Written by cellwise. Nothing on this page is loaded from elsewhere; the figures for
machines are in the block <code>cellwise-data</code> of its source.</footer>
</main>
{data_block(data)}
{f"<script>{program()}</script>" if runs else ""}
</body>
</html>
"""


def program() -> Markup:
    """What zooms and sorts, as it stands in a page."""
    return Markup(page_file("plots.js").replace("</", "<\\/"))

"""A picture with its explanation, and how it leaves: inline SVG, PNG, SVG and PDF files."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, Protocol, TypeAlias

from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, escape

P = ParamSpec("P")

SUFFIXES = (".png", ".svg", ".pdf")
VARIABLES = {
    style.INK: "--ink",
    style.MUTED: "--muted",
    style.GRID: "--grid",
    style.PAPER: "--paper",
}
DRAWN, DIGITS = re.compile(r'(?<= d=")[^"]*'), re.compile(r"-?\d+\.\d+")


class Drawable(Protocol):
    """What can be written as a file: a picture, or a plot over time."""

    @property
    def key(self) -> str:
        """The file's name without suffix."""

    @property
    def figure(self) -> style.Figure:
        """What is drawn."""


class Picture(NamedTuple):
    """A figure, its file name without suffix, and what a newcomer should see in it."""

    key: str
    figure: style.Figure
    caption: str = ""


def pictured(
    key: str, caption: str | Callable[..., str] = ""
) -> Callable[[Callable[P, style.Figure]], Callable[P, Picture]]:
    """Decorator: what draws a figure gives a picture of this key and caption, drawn in style.

    A caption that depends on what is drawn is a function of the same arguments.
    """

    def decorate(draw: Callable[P, style.Figure]) -> Callable[P, Picture]:
        @wraps(draw)
        def inside(*args: P.args, **kwargs: P.kwargs) -> Picture:
            text = caption if isinstance(caption, str) else caption(*args, **kwargs)
            with style.drawing():
                return Picture(key, draw(*args, **kwargs), text)

        return inside

    return decorate


class FigureFiles(NamedTuple):
    """A folder for pictures, and the suffixes of the files that each is written to."""

    folder: Path
    suffixes: tuple[str, ...] = (".png", ".svg")


Figures: TypeAlias = str | Path | FigureFiles | None  # where a page's pictures go as files, too


def save_figure(figure: style.Figure, path: str | Path) -> Path:
    """Write a figure as PNG, SVG or PDF, whichever the file name says.

    Raises
    ------
    InputError        another suffix, a path that cannot be written
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"the picture file '{path}'", f"a name that ends in {', '.join(SUFFIXES)}", "Rename it."
        )
    target = io.BytesIO()
    # Without dates, so that equal data give equal files.
    known = {".svg": ("Creator", "Date", "Format", "Type"), ".pdf": ("Creator", "CreationDate")}
    with style.drawing():
        metadata: Any = dict.fromkeys(known.get(suffix, ()))
        figure.savefig(target, format=suffix[1:], metadata=metadata)
    return write_atomically(path, target.getvalue())


def save_figures(
    drawn: Iterable[Drawable], folder: str | Path, suffixes: Iterable[str] = (".png", ".svg")
) -> tuple[Path, ...]:
    """Write pictures into a folder, which is made if need be, each under its key.

    Raises
    ------
    InputError        the folder cannot be made or written to
    """
    place, kinds = made_folder(folder, "the pictures"), tuple(suffixes)
    figures = ((one.key, one.figure) for one in drawn)
    return tuple(save_figure(f, place / f"{key}{kind}") for key, f in figures for kind in kinds)


def inline(picture: Picture) -> Markup:
    """The picture as an HTML figure: SVG in the page's own colours, caption below."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    key = f"figure-{safe_key(picture.key)}"
    target = io.StringIO()
    with style.drawing():
        # Straight to the canvas: saving would draw everything twice.
        canvas: Any = FigureCanvasSVG(picture.figure)
        none = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        canvas.print_svg(target, metadata=none)
    wide = bool(picture.figure.get_size_inches()[0] > style.SMALL_IN)
    svg = _for_page(target.getvalue(), key, _main_title(picture.figure))
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>" if picture.caption else ""
    shown = f'<div class="scroll">{svg}</div>' if wide else svg
    return Markup(f'<figure id="{key}"{" class=wide" * wide}>{shown}{caption}</figure>')


def safe_key(text: str) -> str:
    """A name that can be a file's and an element's: letters, digits, dashes."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-").lower() or "figure"


def _main_title(figure: style.Figure) -> str:
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    return " ".join(next((t for t in titles if t), "figure").split())


def _for_page(svg: str, key: str, title: str) -> str:
    """An SVG document as part of a page: own ids, the page's colours, a name for those who listen.

    Ids are the document's in HTML, so two figures must not share them. Places in paths are rounded
    to a hundredth of a point, which is not visible.
    """
    body = svg[svg.index("<svg") :].rstrip()
    # Its style would hold for the whole page, which has the same in its own.
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    body = DRAWN.sub(lambda d: DIGITS.sub(lambda n: f"{float(n[0]):.2f}", d[0]), body)
    # Unused ids go, the others take the figure's name and a number: matplotlib's are made of
    # unrounded positions, whose last bits differ from one drawing to the next.
    used = dict.fromkeys(re.findall(r'(?:url\(#|href="#)([^")]+)', body))
    names = {old: f"{key}-{k}" for k, old in enumerate(used)}
    body = re.sub(r' id="([^"]+)"', lambda m: f' id="{names[m[1]]}"' if m[1] in names else "", body)
    body = re.sub(r'(url\(#|href="#)([^")]+)', lambda m: m[1] + names[m[2]], body)
    for colour, variable in VARIABLES.items():
        body = body.replace(colour, f"var({variable})")
    opening, rest = body.split(">", 1)
    opening = re.sub(r' (?:width|height|version|xmlns(?::\w+)?)="[^"]*"', "", opening)
    return f'{opening} role="img" aria-label="{escape(title)}">{rest}'

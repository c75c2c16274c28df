"""A picture with its explanation, and how it leaves: inline SVG, PNG and SVG files."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.report.page.markup import Markup, escape
from cellwise.report.page.style import GRID, INK, MUTED, PAPER, RASTER_DPI, TINTS, drawing
from cellwise.report.page.zooming import axes_attribute, marked, marked_axes, rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A figure with more points than this is drawn as pixels: its paths would outweigh them.
VECTOR_POINTS = 6000
# In a page, where pictures zoom, so many are drawn as paths.
PAGE_POINTS = 60_000
SUFFIXES = (".png", ".svg", ".pdf")
VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    GRID: "--grid",
    PAPER: "--paper",
    **{tint: f"--tint-{k}" for k, tint in enumerate(TINTS, start=1)},
}


class Picture(NamedTuple):
    """A figure, its file name without suffix, and what a newcomer should see in it.

    ``clock`` names the log whose time since its first row the first axes show, if they do: plots of
    one clock have one cursor.
    """

    key: str
    figure: Figure
    caption: str
    clock: str = ""


class FigureFiles(NamedTuple):
    """A folder for pictures, and the suffixes of the files that each is written to."""

    folder: Path
    suffixes: tuple[str, ...] = (".png", ".svg")


def figure_png(figure: Figure, dpi: int = RASTER_DPI) -> bytes:
    """A figure as the bytes of a PNG."""
    return _rendered(figure, "png", dpi)


def figure_svg(figure: Figure) -> str:
    """A figure as an SVG document, traces of very many points as pixels within it."""
    with drawing():
        _prepare(figure)
        return _svg(figure)


def _svg(figure: Figure) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    target = io.StringIO()
    figure.set_dpi(RASTER_DPI)
    # Straight to the canvas: saving would draw everything twice.
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(target, metadata=_no_metadata("svg"))
    return target.getvalue()


def save_figure(figure: Figure, path: str | Path) -> Path:
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
    content = figure_svg(figure) if suffix == ".svg" else _rendered(figure, suffix[1:])
    return write_atomically(path, content)


def save_figures(
    pictures: Iterable[Picture], folder: str | Path, suffixes: Iterable[str] = (".png", ".svg")
) -> tuple[Path, ...]:
    """Write pictures into a folder, which is made if need be, each under its key.

    Raises
    ------
    InputError        the folder cannot be made or written to
    """
    place = made_folder(folder, "the pictures")
    kinds = tuple(suffixes)
    return tuple(
        save_figure(p.figure, place / f"{p.key}{kind}") for p in pictures for kind in kinds
    )


def inline(picture: Picture) -> Markup:
    """The picture as an HTML figure: SVG in the page's own colours that zooms, caption below."""
    key = f"figure-{safe_key(picture.key)}"
    title = _main_title(picture.figure)
    with drawing(closely=True):
        _prepare(picture.figure, PAGE_POINTS)
        with marked_axes(picture.figure) as axes:
            text = _svg(picture.figure)
    svg = _for_page(rounded(marked(text)), key, title)
    clock = f' data-clock="{escape(picture.clock)}"' if picture.clock else ""
    return Markup(
        f'<figure id="{key}"{clock} data-axes="{escape(axes_attribute(axes))}">\n<div>{svg}'
        f'<p class="readout"></p></div>\n'
        f"<figcaption>{escape(picture.caption)}</figcaption>\n</figure>"
    )


def safe_key(text: str) -> str:
    """A name that can be a file's and an element's: letters, digits, dashes."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-").lower() or "figure"


def _rendered(figure: Figure, kind: str, dpi: int = RASTER_DPI) -> bytes:
    target = io.BytesIO()
    with drawing():
        _prepare(figure)
        figure.savefig(target, format=kind, dpi=dpi, metadata=_no_metadata(kind))
    return target.getvalue()


def _no_metadata(kind: str) -> dict[str, None]:
    """Leaves out dates and the namespaces' addresses, so that equal data give equal files."""
    names = {"svg": ("Creator", "Date", "Format", "Type"), "pdf": ("Creator", "CreationDate")}
    return dict.fromkeys(names.get(kind, ()))


def rasterise(figure: Figure, most: int = VECTOR_POINTS) -> None:
    """Turn the traces of a figure into pixels when there are too many points for paths."""
    lines = [(line, np.size(line.get_xdata())) for axes in figure.axes for line in axes.lines]
    many = sum(size for _, size in lines) > most
    for line, size in lines:
        line.set_rasterized(many and size > VECTOR_POINTS // 10)
        line.recache(always=True)  # how closely it is drawn is a part of its path


def _prepare(figure: Figure, most: int = VECTOR_POINTS) -> None:
    rasterise(figure, most)
    settle(figure)


def settle(figure: Figure) -> None:
    """Find the places of all parts once; every later writing of the figure keeps them."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def _main_title(figure: Figure) -> str:
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    return " ".join(next((t for t in titles if t), "figure").split())


def _for_page(svg: str, key: str, title: str) -> str:
    """An SVG document as part of a page: own ids, the page's colours, a name for those who listen.

    Ids are the document's in HTML, so two figures must not share them.
    """
    body = svg[svg.index("<svg") :].rstrip()
    # Its style would hold for the whole page, which has the same in its own.
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    # Unused ids go, the others take the figure's name.
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', body))
    body = re.sub(r' id="([^"]+)"', lambda m: f' id="{key}-{m[1]}"' if m[1] in used else "", body)
    body = re.sub(r'(url\(#|href="#)', rf"\g<1>{key}-", body)
    for colour, variable in VARIABLES.items():
        body = body.replace(colour, f"var({variable})")
    opening, rest = body.split(">", 1)
    opening = re.sub(r' (?:width|height|version|xmlns(?::\w+)?)="[^"]*"', "", opening)
    return f'{opening} role="img" aria-label="{escape(title)}">{rest}'

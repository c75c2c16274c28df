"""A picture with its explanation, and how it leaves: inline SVG, PNG and SVG files."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np

from cellwise.errors import InputError
from cellwise.files import made_folder, write_atomically
from cellwise.logs.cell_log import CellLog
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, clock_of, details, escape

P = ParamSpec("P")

# A figure with more points than this is drawn as pixels: its paths would outweigh them. In a page,
# where pictures zoom, more are drawn as paths.
VECTOR_POINTS, PAGE_POINTS = 6000, 60_000
SUFFIXES = (".png", ".svg", ".pdf")
VARIABLES = {
    style.INK: "--ink",
    style.MUTED: "--muted",
    style.GRID: "--grid",
    style.PAPER: "--paper",
    **{tint: f"--tint-{k}" for k, tint in enumerate(style.TINTS, start=1)},
}


class Picture(NamedTuple):
    """A figure, its file name without suffix, and what a newcomer should see in it.

    ``clock`` names the log whose time since its first row the
    first axes show, if they do: plots of one clock have one cursor. ``fold``: what a page shows of
    it until it is opened; nothing: it is open.
    """

    key: str
    figure: style.Figure
    caption: str
    clock: str = ""
    fold: str = ""

    def of(self, log: CellLog, key: str = "") -> Picture:
        """The same picture as one of a log, over its time, with a key that carries its name."""
        key = f"{key or self.key}-{safe_key(clock_of(log))}"
        return self._replace(key=key, clock=clock_of(log))


def pictured(
    key: str, caption: str | Callable[..., str]
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


def figure_png(figure: style.Figure, dpi: int = style.RASTER_DPI) -> bytes:
    """A figure as the bytes of a PNG."""
    return _rendered(figure, "png", dpi)


def figure_svg(figure: style.Figure) -> str:
    """A figure as an SVG document, traces of very many points as pixels within it."""
    with style.drawing():
        _prepare(figure)
        return _svg(figure)


def _svg(figure: style.Figure) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    target = io.StringIO()
    figure.set_dpi(style.RASTER_DPI)
    # Straight to the canvas: saving would draw everything twice.
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(target, metadata=_no_metadata("svg"))
    return target.getvalue()


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
    """The picture as an HTML figure: SVG in the page's own colours that zooms, caption below.

    In a narrow window the page's program lays it out for that width.
    """
    key = f"figure-{safe_key(picture.key)}"
    with style.drawing(closely=True):
        axes, svg = _zooming(picture.figure, key)
    clock = f' data-clock="{escape(picture.clock)}"' if picture.clock else ""
    shown = Markup(
        f'<figure id="{key}"{clock} data-axes="{axes}">\n<div>{svg}</div><p class="readout"></p>\n'
        f"<figcaption>{escape(picture.caption)}</figcaption>\n</figure>"
    )
    return details(picture.fold, shown) if picture.fold else shown


def _zooming(figure: style.Figure, key: str) -> tuple[str, str]:
    """What the script must know of a figure's axes, as an attribute, and the figure as SVG."""
    _prepare(figure, PAGE_POINTS)
    with marked_axes(figure) as axes:
        text = _svg(figure)
    return escape(axes_attribute(axes)), _for_page(rounded(marked(text)), key, _main_title(figure))


def safe_key(text: str) -> str:
    """A name that can be a file's and an element's: letters, digits, dashes."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-").lower() or "figure"


def _rendered(figure: style.Figure, kind: str, dpi: int = style.RASTER_DPI) -> bytes:
    target = io.BytesIO()
    with style.drawing():
        _prepare(figure)
        figure.savefig(target, format=kind, dpi=dpi, metadata=_no_metadata(kind))
    return target.getvalue()


def _no_metadata(kind: str) -> dict[str, None]:
    """Leaves out dates and the namespaces' addresses, so that equal data give equal files."""
    names = {"svg": ("Creator", "Date", "Format", "Type"), "pdf": ("Creator", "CreationDate")}
    return dict.fromkeys(names.get(kind, ()))


def rasterise(figure: style.Figure, most: int = VECTOR_POINTS) -> None:
    """Turn the traces of a figure into pixels when there are too many points for paths."""
    lines = [(line, np.size(line.get_xdata())) for axes in figure.axes for line in axes.lines]
    many = sum(size for _, size in lines) > most
    for line, size in lines:
        line.set_rasterized(many and size > VECTOR_POINTS // 10)
        line.recache(always=True)  # how closely it is drawn is a part of its path


def _prepare(figure: style.Figure, most: int = VECTOR_POINTS) -> None:
    rasterise(figure, most)
    settle(figure)


def settle(figure: style.Figure) -> None:
    """Find the places of all parts once; every later writing of the figure keeps them."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def _main_title(figure: style.Figure) -> str:
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    return " ".join(next((t for t in titles if t), "figure").split())


def _for_page(svg: str, key: str, title: str) -> str:
    """An SVG document as part of a page: own ids, the page's colours, a name for those who listen.

    Ids are the document's in HTML, so two figures must not share them.
    """
    body = svg[svg.index("<svg") :].rstrip()
    # Its style would hold for the whole page, which has the same in its own.
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
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


POINTS_PER_INCH = 72.0
# Names that matplotlib is asked to write beside its groups, to be found again in the text.
MARKS = (
    (re.compile(r' id="cw-(plot|text)-(\d+)"'), r' data-\1="\2"'),
    (re.compile(r' id="cw-part-(\w+)"'), r' data-part="\1"'),
    (re.compile(r' id="cw-axis-([xy])"'), r' data-axis="\1"'),
    (re.compile(r' id="[xy]tick_\d+"'), ' data-tick=""'),
)
DRAWN = re.compile(r'(?<= d=")[^"]*')
DIGITS = re.compile(r"-?\d+\.\d+")


@contextmanager
def marked_axes(figure: style.Figure) -> Iterator[list[dict[str, Any]]]:
    """Name the parts of a figure that move, and say of every axes what the script must know.

    The figure's places must be settled. Boxes and places are in points from the upper left, as they
    stand in the SVG; ``share`` is the same for axes of one column and one range of x.
    """
    named = _parts(figure)
    for part, name in named:
        part.set_gid(f"cw-part-{name}")
    yield _mark(figure)
    for axes in figure.axes:
        for part in (axes, axes.xaxis, axes.yaxis, *axes.texts):
            part.set_gid(None)
    for part, _ in named:
        part.set_gid(None)


def _parts(figure: style.Figure) -> list[tuple[style.Artist, str]]:
    """What a narrow window sets itself: titles, names, keys, frames; and arrows, left out."""
    from matplotlib.text import Text

    found: list[tuple[style.Artist, str]] = [(text, "heading") for text in figure.texts]
    found += [(legend, "legend") for legend in figure.legends]
    for axes in figure.axes:
        texts = [c for c in axes.get_children() if isinstance(c, Text) and c not in axes.texts]
        found += [(text, "title") for text in texts]
        found += [(axis.label, "label") for axis in (axes.xaxis, axes.yaxis)]
        found += [(part, "frame") for part in (axes.patch, *axes.spines.values())]
        arrows = (getattr(text, "arrow_patch", None) for text in axes.texts)
        found += [(arrow, "arrow") for arrow in arrows if arrow is not None]
        legend = axes.get_legend()
        if legend is not None:
            found.append((legend, "legend"))
    return found


def _mark(figure: style.Figure) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    shared: dict[tuple[float, ...], int] = {}
    for axes in figure.axes:
        if not axes.axison:
            continue
        axes.set_gid(f"cw-plot-{len(found)}")
        axes.xaxis.set_gid("cw-axis-x")
        axes.yaxis.set_gid("cw-axis-y")
        box, x = _box(figure, axes), _axis(axes.xaxis, "bottom")
        column = (round(box[0]), round(box[2]), *x["limits"])
        found.append(
            {
                "box": box,
                "x": x,
                "y": _axis(axes.yaxis, "left"),
                "share": shared.setdefault(column, len(shared)),
                "title": " ".join(axes.get_title(loc="left").split()),
                "colours": axes.get_label() == "<colorbar>",
                "texts": _texts(figure, axes),
            }
        )
    return found


def marked(svg: str) -> str:
    """The names of `marked_axes` as attributes of their own, beside the ids that are used."""
    for pattern, attribute in MARKS:
        svg = pattern.sub(attribute, svg)
    return svg


def rounded(svg: str) -> str:
    """Places in paths to a hundredth of a point, which is not visible."""
    return DRAWN.sub(lambda d: DIGITS.sub(lambda n: f"{float(n[0]):.2f}", d[0]), svg)


def axes_attribute(axes: list[dict[str, Any]]) -> str:
    """What `marked_axes` found, as JSON."""
    return json.dumps(axes, allow_nan=False, separators=(",", ":"))


def _place(figure: style.Figure, xy: Any) -> list[float]:
    """A place on the canvas [pixels] in points from the upper left."""
    x, y = figure.dpi_scale_trans.inverted().transform(xy)
    height = figure.get_figheight()
    return [round(POINTS_PER_INCH * float(v), 3) for v in (x, height - y)]


def _box(figure: style.Figure, axes: style.Axes) -> list[float]:
    left, top = _place(figure, (axes.bbox.x0, axes.bbox.y1))
    right, bottom = _place(figure, (axes.bbox.x1, axes.bbox.y0))
    return [left, top, right - left, bottom - top]


def _axis(axis: style.Axis, side: str) -> dict[str, Any]:
    from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter

    low, high = axis.get_view_interval()
    ticks = axis.get_tick_params()
    written = axis.get_major_formatter()
    placed = isinstance(axis.get_major_locator(), FixedLocator)
    words = isinstance(written, FixedFormatter) or (placed and isinstance(written, FuncFormatter))
    return {
        "limits": [float(low), float(high)],
        "log": axis.get_scale() == "log",
        "words": words,
        "label": axis.get_label_text(),
        "shown": bool(ticks.get(f"label{side}", True)),
        "grid": bool(ticks.get("gridOn", False)),
    }


def _texts(figure: style.Figure, axes: style.Axes) -> list[list[float]]:
    """Places of the texts in an axes, and of x and of y whether it moves with the data (1, 0)."""
    from matplotlib.text import Annotation

    known: dict[Any, Any] = {"data": axes.transData, "axes fraction": axes.transAxes}
    places: list[list[float]] = []
    for text in axes.texts:
        if isinstance(text, Annotation):
            named: Any = text.xycoords
            pair, at = (named if isinstance(named, tuple) else (named, named)), text.xy
        else:
            by = text.get_transform()
            pair = (next((name for name, one in known.items() if one is by), ""),) * 2
            at = text.get_position()
        if not set(pair) <= set(known):
            continue
        text.set_gid(f"cw-text-{len(places)}")
        x, y = (known[by].transform(at)[k] for k, by in enumerate(pair))
        places.append([*_place(figure, (x, y)), *(float(by == "data") for by in pair)])
    return places

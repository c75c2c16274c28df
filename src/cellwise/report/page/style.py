"""How every picture looks: one palette, one font size, light grid, and the lazy matplotlib."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from typing import TYPE_CHECKING, Any, cast

from cellwise.errors import not_installed
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    # Named so that pages outside this folder can say what they draw on.
    from matplotlib.artist import Artist as Artist
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis as Axis
    from matplotlib.figure import Figure as Figure

# Okabe and Ito's colours, which people with any colour vision can distinguish; the blue is
# lightened so that it reads on a dark page too.
# Truth is grey, the model vermillion, the filter blue.
BLUE, SKY, GREEN = "#1f83c4", "#56b4e9", "#009e73"
AMBER, VERMILLION, PURPLE = "#e69f00", "#d55e00", "#cc79a7"
MEASURED, MODEL, FILTER = "#808a96", VERMILLION, BLUE
# Verdicts on pulses: colour and marker, so that neither has to be relied on alone.
VERDICTS = {
    "healthy": (GREEN, "o"),
    "trimmed": (AMBER, "s"),
    "distorted": (PURPLE, "^"),
    "spurious": (MEASURED, "x"),
}
# Ink, quiet ink, grid and paper: the page replaces these by its own colours of day and night.
INK, MUTED, GRID, PAPER = "#1f2329", "#57606b", "#dfe3e8", "#fefefe"

# Three of the small width stand beside one another on a page, and one fills a phone: the text has
# one size on both. The wide one scrolls there.
SMALL_IN, WIDE_IN = 3.6, 7.4
SMALL_PT = 8.5  # of notes in a picture, the smallest text
COVERED = 0.02  # of SOC: less is missing at either end of a test from full to empty


@contextmanager
def drawing() -> Iterator[None]:
    """The style while a picture is made or written; other settings do not change.

    Raises
    ------
    InputError        matplotlib is not installed
    """
    try:
        import matplotlib
    except ImportError as error:
        raise not_installed("matplotlib", "a picture") from error
    with matplotlib.rc_context(_rc()):
        yield


@functools.cache
def _rc() -> Any:
    """The settings of ``page.mplstyle``."""
    from matplotlib import rc_params_from_file

    with as_file(files("cellwise.report.page") / "page.mplstyle") as place:
        return dict(rc_params_from_file(place, use_default_template=False))


def new_figure(height_in: float, width_in: float = SMALL_IN) -> Figure:
    """An empty figure whose parts find their own places."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    engine = ConstrainedLayoutEngine(w_pad=0.04, h_pad=0.04, wspace=0.03, hspace=0.02)
    return Figure(figsize=(width_in, height_in), layout=engine)


def new_axes(height_in: float = 2.6, width_in: float = SMALL_IN) -> tuple[Figure, Axes]:
    """A figure of one axes."""
    figure = new_figure(height_in, width_in)
    return figure, figure.subplots()


def finding(axes: Axes, text: str) -> None:
    """Title of an axes as wide as its figure: what was found, wrapped."""
    width_in = cast("Figure", axes.figure).get_size_inches()[0]
    axes.set_title("\n".join(wrapped(text, 72.0 * 0.83 * width_in)))


def wrapped(text: str, width_pt: float) -> list[str]:
    """Text broken at its spaces into lines no wider than so many points in the titles' font."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    size = _rc()["axes.titlesize"]
    font = FontProperties(family=_rc()["font.sans-serif"][0], weight="bold", size=size)
    measure = TextToPath().get_text_width_height_descent

    def width(word: str) -> float:
        return float(measure(f"{word} ", font, False)[0])

    lines, room = [""], 0.0
    for word in text.split(" "):
        needs = width(word)
        if lines[-1] and needs > room:
            lines.append("")
        if not lines[-1]:
            room = width_pt
        lines[-1] += f" {word}" if lines[-1] else word
        room -= needs
    return lines


def labels(axes: Axes, x: str = "", y: str = "") -> None:
    """Axis labels."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def legend(axes: Axes, *, place: str = "best") -> None:
    """A legend, if there is anything to name."""
    handles, names = axes.get_legend_handles_labels()
    if handles:
        axes.legend(handles, names, loc=cast(Any, place)).set_zorder(6)


def key_below(axes: Axes, keys: Sequence[Artist] = ()) -> None:
    """A legend below the axes, of ``keys`` or else of what is drawn."""
    handles = list(keys) or axes.get_legend_handles_labels()[0]
    names = [str(one.get_label()) for one in handles]
    if handles:
        place = cast(Any, "outside lower left")
        cast("Figure", axes.figure).legend(handles, names, loc=place, ncols=2, columnspacing=1.0)


def zero_line(axes: Axes) -> None:
    """A quiet line at zero."""
    axes.axhline(0.0, color=MUTED, linewidth=0.7, zorder=1.5)


def note(
    axes: Axes, text: str, at: Any, offset: tuple[float, float] = (0, 5), **looks: Any
) -> None:
    """A small text beside a point of the data, so many points away from it."""
    drawn: dict[str, Any] = {"fontsize": SMALL_PT, "color": MUTED} | looks
    axes.annotate(text, at, offset, textcoords="offset points", **drawn)


def error_dots(axes: Axes, x: FloatArray, y: FloatArray, std: FloatArray, **looks: Any) -> None:
    """Dots with bars of two standard deviations; many bars are pale, or they hide the dots."""
    drawn: dict[str, Any] = {"fmt": "o", "color": BLUE, "markersize": 3.5, "linewidth": 0.8} | looks
    _, _, bars = axes.errorbar(x, y, 2.0 * std, **drawn)
    for bar in bars:
        bar.set_alpha(min(1.0, 30.0 / x.size))


def dots_on_bars(
    names: Sequence[str], dots: Sequence[float], bars: Sequence[float], text: str, label: str
) -> Figure:
    """A row for each name from the top: a bar, and a dot on it."""
    figure, axes = new_axes(0.9 + 0.24 * len(names))
    axes.barh(names[::-1], bars[::-1], color=BLUE, alpha=0.35)
    axes.plot(dots[::-1], names[::-1], "o", color=INK, markersize=4)
    # Long names leave the axes half of the picture's width.
    axes.set_title("\n".join(wrapped(text, 72.0 * 0.42 * SMALL_IN)))
    labels(axes, label)
    return figure


def soc_axis(axes: Axes, y: str = "") -> None:
    """SOC from 0 to 100 % on the x axis."""
    axes.set_xlim(-2.0, 102.0)
    axes.set_xticks([0, 20, 40, 60, 80, 100])
    labels(axes, "SOC [%]", y)


def no_data(axes: Axes, soc: tuple[float, float] | None) -> None:
    """Shades the SOC that no log covered; ``soc`` is where the data begin and end."""
    for low, high in _without_data(soc):
        axes.axvspan(100.0 * low, 100.0 * high, color=MUTED, alpha=0.12, linewidth=0, zorder=0.4)


def no_data_text(soc: tuple[float, float] | None) -> str:
    """The same in a caption; empty where all SOC is covered."""
    return " Shaded: no log was there." if _without_data(soc) else ""


def _without_data(soc: tuple[float, float] | None) -> list[tuple[float, float]]:
    low, high = soc or (0.0, 1.0)
    return [part for part in ((0.0, low), (high, 1.0)) if part[1] - part[0] > COVERED]

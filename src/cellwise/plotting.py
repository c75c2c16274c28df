"""What results have in common for people: a plot, and their columns as a data frame.

A result says what is to be seen, as data; the drawing and the data frame libraries are imported
when somebody asks for them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib import import_module
from io import BytesIO
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.arguments import shown
from cellwise.errors import InputError, not_installed
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LineStyle = str | float | tuple[float, ...] | None  # what matplotlib takes for a line's property
MOST_POINTS = 20_000  # of a line: more than any screen has columns
PANEL_IN, AXIS_IN = 2.0, 1.2  # a panel that can be read, and what the x axis adds


class Line(NamedTuple):
    """One curve; ``band`` is half the height of the shade around it (n,), or its ends (n, 2)."""

    label: str
    x: FloatArray
    y: FloatArray
    band: FloatArray | None = None

    @property
    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper end of the shade."""
        band = np.zeros_like(self.y) if self.band is None else self.band
        return (self.y - band, self.y + band) if band.ndim == 1 else (band[:, 0], band[:, 1])


class Panel(NamedTuple):
    """Curves over one pair of axes; the name of the y axis carries its unit.

    ``limits`` of the axis leave out what is said to be off scale.
    """

    y_label: str
    lines: tuple[Line, ...]
    limits: tuple[float, float] | None = None


class Plottable:
    """Adds ``plot()`` to what can say its panels."""

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Name of the common x axis with its unit, and the panels from top to bottom."""
        raise NotImplementedError

    def plot(
        self,
        ax: Axes | Sequence[Axes] | None = None,
        *,
        panel: str | None = None,
        figure: Figure | None = None,
        **style: LineStyle,
    ) -> Figure:
        """Draw it with matplotlib, as its rcParams say.

        Parameters
        ----------
        ax : matplotlib axes, several, or None      to draw into: the first panels, one in each;
                                              None: all of them, one below the other
        panel : str or None                   how the y label of the one panel to draw begins: "SOC"
        figure : matplotlib figure or None    to draw all into, if no axes are given; None: a new
                                              one
        **style                               of every line, as ``Axes.plot`` takes it: color, lw

        Returns
        -------
        matplotlib figure                     shown by a notebook, saved with ``savefig``

        Raises
        ------
        InputError                            matplotlib is not installed; more axes than panels; no
                                              panel of that name; axes that are none
        """
        x_label, panels = self.panels()
        chosen = panels if panel is None else (panel_of(panels, panel),)
        if ax is None:
            drawn = _new_figure(len(chosen)) if figure is None else figure
            draw_panels(drawn, x_label, chosen, **style)
            return drawn
        axes = axes_of(ax, len(chosen))
        draw_on(axes, chosen, **style)
        for place in filter(_shows_x, axes):
            place.set_xlabel(x_label)
        whole: Figure = axes[0].figure
        return whole


def _shows_x(ax: Any) -> bool:
    """Whether axes that somebody made show an x label: those above others leave it to them."""
    spec = ax.get_subplotspec()
    return spec is None or bool(spec.is_last_row())


def panel_of(panels: Sequence[Panel], name: str) -> Panel:
    """The panel whose y label begins with a name, in any case.

    Raises
    ------
    InputError        none does
    """
    for panel in panels:
        if panel.y_label.casefold().startswith(name.casefold()):
            return panel
    labels = ", ".join(f"'{panel.y_label}'" for panel in panels)
    raise InputError(f"panel '{name}'", f"the beginning of one of {labels}", "Choose one of them.")


def axes_of(ax: Axes | Sequence[Axes], panels: int) -> list[Any]:
    """Axes that were given, one or several, as a list.

    Raises
    ------
    InputError        something else; more than there are panels
    """
    several = list(np.ravel(np.asarray(ax, dtype=object)))
    wrong = next((one for one in several if not hasattr(one, "fill_between")), None)
    if wrong is not None or not several:
        raise InputError(
            f"ax = {shown(ax if wrong is None else wrong)}",
            "matplotlib's axes",
            "Make them: figure, ax = plt.subplots().",
        )
    if len(several) > panels:
        raise InputError(
            f"{len(several)} axes for {panels} panel(s)", "no more axes than panels", "Give fewer."
        )
    return several


def draw_panels(
    figure: Figure, x_label: str, panels: Sequence[Panel], **style: LineStyle
) -> NDArray[Any]:
    """Draw panels one below the other into a figure; their axes from top to bottom."""
    axes = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
    draw_on(axes, panels, **style)
    axes[-1].set_xlabel(x_label)
    return axes


def draw_on(axes: Iterable[Any], panels: Sequence[Panel], **style: LineStyle) -> None:
    """Draw the first panels into axes, one in each."""
    for place, panel in zip(axes, panels, strict=False):
        for line in panel.lines:
            _draw(place, line, style)
        place.set_ylabel(panel.y_label)
        if panel.limits is not None:
            place.set_ylim(*panel.limits)
        if len(place.get_legend_handles_labels()[0]) > 1:
            place.legend(loc="best")


class Summarised:
    """Adds what a notebook shows of a result that is more than a table: its facts."""

    def facts(self) -> Mapping[str, str]:
        """What it is to what it was found to be, in words."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """For notebooks: what `repr` says, and the facts."""
        rows = (f"<th style='text-align:left'>{escape(k)}</th>" f"<td style='text-align:left'>"
                f"{escape(v)}</td>" for k, v in self.facts().items())  # fmt: skip
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<div><p><code>{escape(repr(self))}</code></p><table>{body}</table></div>"


class Tabular:
    """Adds ``table()``, ``to_pandas()`` and ``to_polars()`` to what can say its columns."""

    def columns(self) -> Mapping[str, Any]:
        """Name, which carries the unit, to array; all of one length."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """For notebooks: what `repr` says, and the first and last rows as a table."""
        columns = {name: np.asarray(values) for name, values in self.columns().items()}
        size = min((values.size for values in columns.values()), default=0)
        rows = sorted({*range(min(size, 3)), *range(max(size - 2, 0), size)})
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            "<tr>"
            + "".join(f"<td>{_cell(values[k])}</td>" for values in columns.values())
            + "</tr>"
            for k in rows
        )
        return (
            f"<div><p><code>{escape(repr(self))}</code></p><div style='overflow-x:auto'><table>"
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></div>"
        )

    def table(self) -> dict[str, NDArray[Any]]:
        """Name, which carries the unit, to a column of shape (rows,): what data frames are made of.

        A copy; a value that is not known is NaN.
        """
        return {name: np.array(values) for name, values in self.columns().items()}

    def to_pandas(self) -> pandas.DataFrame:
        """The columns as a pandas data frame.

        Raises
        ------
        InputError      pandas is not installed
        """
        frames = _need("pandas")
        frame: pandas.DataFrame = frames.DataFrame(self.table())
        return frame

    def to_polars(self) -> polars.DataFrame:
        """The columns as a polars data frame; a missing value is NaN.

        Raises
        ------
        InputError      polars is not installed
        """
        frames = _need("polars")
        frame: polars.DataFrame = frames.DataFrame(self.table())
        return frame


def _cell(value: Any) -> str:
    """A value in a table of a notebook."""
    return f"{value:.6g}" if isinstance(value, (float, np.floating)) else escape(str(value))


def _new_figure(panels: int) -> Figure:
    """As wide as rcParams say, as high as the panels need."""
    rc = _need("matplotlib").rcParams
    wide, high = rc["figure.figsize"]
    return _figure((wide, max(high, PANEL_IN * panels + AXIS_IN)))


def _figure(size: tuple[float, float]) -> Figure:
    """A figure: in a notebook one that only its cell's value shows, else pyplot's, for a window.

    A notebook shows what pyplot holds at the end of a cell, and the cell's value besides: the same
    picture twice.
    """
    if "ipykernel" in sys.modules:
        figures = _need("matplotlib.figure")
        _need("matplotlib.backends.backend_agg")
        alone: Figure = _notebook_figure(figures.Figure)(figsize=size, layout="constrained")
        return alone
    pyplot = _need("matplotlib.pyplot")
    shown: Figure = pyplot.figure(figsize=size, layout="constrained")
    return shown


@cache
def _notebook_figure(figure: type[Any]) -> Any:
    """Figures that a notebook shows by themselves: it knows matplotlib's own with pyplot only."""

    def as_png(self: Any) -> bytes:
        into = BytesIO()
        self.savefig(into, format="png")
        return into.getvalue()

    return type("Figure", (figure,), {"_repr_png_": as_png})


def _draw(axes: Any, line: Line, style: Mapping[str, LineStyle]) -> None:
    rows = _extreme_rows(line.y)
    x, y = line.x[rows], line.y[rows]
    (drawn,) = axes.plot(x, y, **{"label": line.label, **style})
    if line.band is not None:
        low, high = (edge[rows] for edge in line.edges)
        axes.fill_between(x, low, high, color=drawn.get_color(), alpha=0.2, linewidth=0)


def _extreme_rows(y: FloatArray) -> Any:
    """Rows to draw: all of a short line; of a long one the lowest and highest of each stretch."""
    if y.size <= MOST_POINTS:
        return slice(None)
    edges = np.linspace(0, y.size, MOST_POINTS // 2 + 1).astype(np.int64)
    low = np.where(np.isnan(y), np.inf, y)
    high = np.where(np.isnan(y), -np.inf, y)
    rows = [f(part[a:b]) + a for a, b in pairwise(edges)
            for part, f in ((low, np.argmin), (high, np.argmax))]  # fmt: skip
    return np.unique(rows)


def _need(module: str) -> Any:
    try:
        return import_module(module)
    except ModuleNotFoundError:
        raise not_installed(module.partition(".")[0], "a plot or table") from None

"""Pictures that zoom in a page: where their axes are, for the script that moves their parts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

POINTS_PER_INCH = 72.0
# Names that matplotlib is asked to write beside its groups, to be found again in the text.
MARKS = (
    (re.compile(r' id="cw-(plot|text)-(\d+)"'), r' data-\1="\2"'),
    (re.compile(r' id="cw-axis-([xy])"'), r' data-axis="\1"'),
    (re.compile(r' id="[xy]tick_\d+"'), ' data-tick=""'),
)
DRAWN = re.compile(r'(?<= d=")[^"]*')
DIGITS = re.compile(r"-?\d+\.\d+")


@contextmanager
def marked_axes(figure: Figure) -> Iterator[list[dict[str, Any]]]:
    """Name the parts of a figure that move, and say of every axes what the script must know.

    The figure's places must be settled. Boxes and places are in points from the upper left, as they
    stand in the SVG; ``share`` is the same for axes of one column and one range of x.
    """
    yield _mark(figure)
    for axes in figure.axes:
        for part in (axes, axes.xaxis, axes.yaxis, *axes.texts):
            part.set_gid(None)


def _mark(figure: Figure) -> list[dict[str, Any]]:
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


def _place(figure: Figure, xy: Any) -> list[float]:
    """A place on the canvas [pixels] in points from the upper left."""
    x, y = figure.dpi_scale_trans.inverted().transform(xy)
    height = figure.get_figheight()
    return [round(POINTS_PER_INCH * float(v), 3) for v in (x, height - y)]


def _box(figure: Figure, axes: Axes) -> list[float]:
    left, top = _place(figure, (axes.bbox.x0, axes.bbox.y1))
    right, bottom = _place(figure, (axes.bbox.x1, axes.bbox.y0))
    return [left, top, right - left, bottom - top]


def _axis(axis: Axis, side: str) -> dict[str, Any]:
    from matplotlib.ticker import FixedFormatter

    low, high = axis.get_view_interval()
    ticks = axis.get_tick_params()
    words = isinstance(axis.get_major_formatter(), FixedFormatter)
    return {
        "limits": [float(low), float(high)],
        "log": axis.get_scale() == "log",
        "words": words,
        "label": axis.get_label_text(),
        "shown": bool(ticks.get(f"label{side}", True)),
        "grid": bool(ticks.get("gridOn", False)),
    }


def _texts(figure: Figure, axes: Axes) -> list[list[float]]:
    """Places of the texts that stand at data, which move with them."""
    from matplotlib.text import Annotation

    places: list[list[float]] = []
    for text in axes.texts:
        if isinstance(text, Annotation):
            if text.xycoords != "data":
                continue
            at = text.xy
        elif text.get_transform() is axes.transData:
            at = text.get_position()
        else:
            continue
        text.set_gid(f"cw-text-{len(places)}")
        places.append(_place(figure, axes.transData.transform(at)))
    return places

"""The page of a pack: what it can give, which cell limits it, which sensor is odd."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.arguments import check_kind
from cellwise.pack.pack_estimate import PackEstimate
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, details, lead_of, paragraph, record_table, tiles
from cellwise.report.page.numerals import banded, millivolt, percent, plural, significant
from cellwise.report.page.picture import Figures, Picture, pictured
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.typing import FloatArray

# How the picture of the cells over time is divided.
IMAGE_COLUMNS = 240
IMAGE_ROWS = 5  # of a log in a column, at least
IMAGE_LABELS = 12  # of days below the cells, at most
IMAGE_MV = 3.0  # to either side of the mean, at least


def pack_page(found: PackEstimate, path: str | Path, *, figures: Figures = None) -> Path:
    """Write the page of a pack.

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    check_kind("found", found, PackEstimate, "Pass what estimate_pack(model, logs) gives.")
    data = found.to_dict()
    causes = [
        f"{cause['name']}: {'; '.join(cause['evidence'])}"
        + (f" (or {', '.join(cause['confusable_with'])})" if cause["confusable_with"] else "")
        for cause in data["causes"]
    ]
    numbers = details("the numbers", record_table(data["per_cell"], *CELL_COLUMNS))
    every: Blocks = (numbers,)
    if found.withheld is None:
        shown = [cells_figure(found, one) for one in figures_of(found)]
        every = (paragraph(EXPLAINED, "note"), *shown, numbers)
    sections = [
        Section("cells", "Cells over time", (cells_picture(found),), "Over time"),
        Section("every", "Every cell", every),
    ]
    return write_page(
        path,
        _first_line(found),
        f"{len(found.names)} cells, {plural(len(found.days), 'log')}, by cellwise",
        sections,
        data,
        lead=lead_of([*causes, *data["notices"]], _figures(found)),
        figures=figures,
    )


def _first_line(found: PackEstimate) -> str:
    if found.withheld is not None:
        return "Far off this model: no health of these cells is said"
    cells = list(dict.fromkeys(c["cell"] for c in found.causes))
    if not cells:
        return f"None of {len(found.names)} cells is odd"
    named = ", ".join(cells[:4]) + (f" and {len(cells) - 4} more" if len(cells) > 4 else "")
    return f"{named} of {len(found.names)} cells: {found.causes[0]['name'].replace('_', ' ')}"


def pack_facts(found: PackEstimate) -> list[tuple[str, str]]:
    """The whole of a pack and the cells at its ends, for a page and a command."""
    data = found.to_dict()
    soc, weakest, cells = data["soc"], data["weakest"], data["per_cell"]
    soc_std = float(np.median([c["soc_std"] for c in cells]))
    std_of = {c["name"]: c["capacity_std_Ah"] for c in cells}
    std = std_of.get(weakest["by_capacity"])
    band = "" if std is None else f" ± {significant(2.0 * std, 2)}"
    return [
        ("SOC, lowest to highest", f"{percent(soc['min'], 1)} to {percent(soc['max'], 1)}"),
        ("how well it is known", f"± {percent(2.0 * soc_std, 1)}"),
        (
            "usable as the cells are",
            _with_energy(f"{significant(data['usable_Ah'])}{band} Ah", data),
        ),
        ("left until the first cell is empty", f"{significant(data['left_Ah'])} Ah"),
        ("balancing would bring", f"{significant(data['balancing_gain_Ah'], 2)} Ah"),
        ("least SOC", weakest["by_soc"]),
        ("least capacity", weakest["by_capacity"]),
        ("most resistance", weakest["by_resistance"]),
        ("weak beyond what cells differ by", ", ".join(data["weak"]) or "none"),
    ]


def _with_energy(charge: str, data: Mapping[str, Any]) -> str:
    """A charge and, where it is known, the pack's energy in it."""
    energy_Wh = data["usable_Wh"]
    return f"{charge}, {significant(energy_Wh)} Wh" if math.isfinite(energy_Wh) else charge


def _figures(found: PackEstimate) -> Markup:
    text = paragraph(
        "The least and most are those of any pack: weak is only who is named as such above. Cells "
        "are compared with each other, which is far surer than the level of all."
    )
    return Markup(f"{tiles(pack_facts(found))}\n{text}")


# Of one cell among ``per_cell``: how it reads on a page and in a command.
CELL_COLUMNS: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("cell", lambda row: row["name"]),
    ("SOC", lambda row: f"{percent(row['soc'])} ± {percent(2.0 * row['soc_std'])}"),
    ("capacity Ah", lambda row: banded(row["capacity_Ah"], row["capacity_std_Ah"])),
    ("resistance", lambda row: banded(row["resistance_scale"], row["resistance_std"])),
    ("offset mV", lambda row: millivolt(row["offset_V"])),
    ("polled s", lambda row: significant(row["skew_s"], 2)),
    ("left mV", lambda row: millivolt(row["voltage_rmse_V"])),
)


def named_cells(found: PackEstimate) -> list[int]:
    """Numbers of the cells that the page points at."""
    names = {cause["cell"] for cause in found.causes}
    return [k for k, name in enumerate(found.names) if name in names]


def _far_enough(edges: Sequence[float], least: float) -> list[int]:
    """Numbers of edges that lie far enough from each other to be labelled."""
    shown: list[int] = []
    for k, edge in enumerate(edges):
        if not shown or edge - edges[shown[-1]] >= least:
            shown.append(k)
    return shown


@pictured(
    "pack_cells_over_time",
    "Each line is a cell, each column a stretch of the logs without its pauses; colour is "
    "the cell's voltage minus the mean cell's. A weak cell changes colour with load or "
    "with SOC, a sensor's offset keeps it, balancing changes it from one day to the next.",
)
def cells_picture(found: PackEstimate) -> style.Figure:
    """Cells over time as colours."""
    image, edges, labels_of = cells_over_time(found)
    cells = len(found.names)
    figure, axes = style.new_axes(min(2.0 + 0.035 * cells, 5.5), style.WIDE_IN)
    usual = np.nanpercentile(np.abs(image), 97) if np.isfinite(image).any() else 0.0
    scale = max(IMAGE_MV, float(usual))
    drawn = axes.imshow(
        image, aspect="auto", cmap="RdBu", vmin=-scale, vmax=scale, interpolation="nearest",
        extent=(0.0, float(image.shape[1]), cells + 0.5, 0.5),
    )  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="cell minus mean [mV]", shrink=0.8, pad=0.07)
    axes.grid(visible=False)
    shown = _far_enough(edges, image.shape[1] / IMAGE_LABELS)
    axes.set_xticks([edges[k] for k in shown], [labels_of[k] for k in shown], rotation=0)
    for cell in named_cells(found):
        style.note(
            axes, found.names[cell], (1.0, cell + 1.0), (4, 0), xycoords=("axes fraction", "data"),
            color=style.VERMILLION, va="center", fontsize=style.SMALL_PT, annotation_clip=False,
        )  # fmt: skip
    spread = np.nanmax(image, axis=0) - np.nanmin(image, axis=0)
    size = f"{np.nanmedian(spread):.1f} mV from lowest to highest"
    style.finding(axes, f"Cells differ by {size}, averaged over minutes")
    style.labels(axes, "logs in order", "cell")
    return figure


def cells_over_time(found: PackEstimate) -> tuple[FloatArray, list[int], list[str]]:
    """Mean differences [mV], shape (cells, columns), and where which log begins."""
    rows = sum(len(day.log) for day in found.days)
    parts, edges, names, at = [], [], [], 0
    for day in found.days:
        count = max(1, min(len(day.log) // IMAGE_ROWS, round(IMAGE_COLUMNS * len(day.log) / rows)))
        starts = np.linspace(0, len(day.log), count + 1).astype(np.int64)[:-1]
        values = day.log.difference_V
        known = np.isfinite(values)
        total = np.add.reduceat(np.where(known, values, 0.0), starts, axis=0)
        number = np.add.reduceat(known.astype(np.float64), starts, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            parts.append(1e3 * total / number)
        edges.append(at)
        names.append(f"{day.day:%d %b}" if day.day is not None else day.log.name)
        at += count
    return np.concatenate(parts).T, edges, names


EXPLAINED = (
    "Dots with two standard deviations of a cell's difference from the mean; named cells are "
    "beyond what cells differ by. Offset and polling are the sensors' and not the cells': what "
    "each voltage reads too much, and by how much later than the others it is polled."
)


class CellFigure(NamedTuple):
    """A figure of every cell with its standard deviation, its axis, and what its spread is."""

    key: str
    axis: str
    values: FloatArray
    std: FloatArray
    title: str


def figures_of(found: PackEstimate) -> list[CellFigure]:
    """Capacity and resistance of every cell, offset and polling of its sensor."""

    def spread(name: str, v: FloatArray) -> str:
        share = 100.0 * float(np.nanstd(v) / np.nanmean(v))
        return f"{name}: cells differ by {share:.1f} % (standard deviation)"

    def ends(name: str, v: FloatArray, unit: str) -> str:
        return f"Sensors' {name}: {np.nanmin(v):+.2g} to {np.nanmax(v):+.2g} {unit}"

    c = found.cells
    scale, offset_mV = c.resistance_scale, 1e3 * c.offset_V
    return [
        CellFigure("capacity", "capacity [Ah]", c.capacity_Ah, found.own_capacity_std_Ah,
                   spread("Capacity", c.capacity_Ah)),
        CellFigure("resistance", "resistance / mean", scale, c.resistance_std,
                   spread("Resistance", scale)),
        CellFigure("offsets", "offset [mV]", offset_mV, 1e3 * c.offset_std_V,
                   ends("offsets", offset_mV, "mV")),
        CellFigure("polling", "polled later by [s]", c.skew_s, c.skew_std_s,
                   ends("polling", c.skew_s, "s")),
    ]  # fmt: skip


def cells_figure(found: PackEstimate, one: CellFigure) -> Picture:
    """A dot with its band for every cell, and the names of those that the page points at."""
    return _cells_figure(found, one)._replace(key=f"pack_{one.key}")


@pictured("pack_cells")
def _cells_figure(found: PackEstimate, one: CellFigure) -> style.Figure:
    figure, axes = style.new_axes()
    number = np.arange(1.0, one.values.size + 1.0)
    style.error_dots(axes, number, one.values, one.std, markersize=3.0, ecolor=style.MUTED)
    _point_at(axes, found, one.values)
    style.finding(axes, one.title)
    style.labels(axes, "cell", one.axis)
    return figure


def _point_at(axes: style.Axes, found: PackEstimate, heights: FloatArray) -> None:
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}
    line = {"arrowstyle": "-", "color": style.VERMILLION, "linewidth": 0.7}
    looks = {"va": "center", "fontsize": style.SMALL_PT, "bbox": box, "arrowprops": line}
    for cell in named_cells(found):
        if np.isfinite(heights[cell]):
            # Beside the dot: above it would lie on its band or in the plot's title.
            left = cell > 0.8 * len(found.names)
            at, side = (cell + 1.0, heights[cell]), {"ha": "right" if left else "left"}
            offset = (-14 if left else 14, 0)
            look = {"color": style.VERMILLION, **side, **looks}
            style.note(axes, found.names[cell], at, offset, **look)

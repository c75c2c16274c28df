"""Pictures of a pack: cells over time, at rest and under load, capacity, resistance, sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cellwise.pack.pack_estimate import PackEstimate
from cellwise.report.page.numerals import millivolt
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    BLUE,
    MUTED,
    VERMILLION,
    finding,
    labels,
    legend,
    new_figure,
    styled,
    two_columns,
    zero_line,
)
from cellwise.typing import BoolArray, FloatArray

if TYPE_CHECKING:
    from cellwise.report.page.style import Axes, Figure

BINS = 240
LEAST_SCALE_MV = 3.0
REST_RATE, LOAD_RATE = 0.05, 0.3  # 1/h
BIN_ROWS = 5
MOST_LABELS = 12  # of days below the cells
BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}  # of a cell's name


def pack_pictures(found: PackEstimate) -> tuple[Picture, ...]:
    """All pictures of a pack, in the order of the page."""
    return (
        Picture(
            "pack_cells_over_time",
            draw_cells(found),
            "Each line is a cell, each column a stretch of the logs without its pauses; colour is "
            "the cell's voltage minus the mean cell's. A weak cell changes colour with load or "
            "with SOC, a sensor's offset keeps it, balancing changes it from one day to the next.",
        ),
        Picture(
            "pack_rest_and_load",
            draw_rest_and_load(found),
            "The same difference, averaged where the pack rests and where it is under load. "
            "Resting differences are SOC and sensors; what a load adds is resistance and polling.",
        ),
        Picture(
            "pack_capacity_and_resistance",
            draw_estimates(found),
            "Estimates with two standard deviations of a cell's difference from the mean; the "
            "histograms are of the estimates. Named cells are beyond what cells differ by.",
        ),
        Picture(
            "pack_sensors",
            draw_sensors(found),
            "What is the sensors' and not the cells': what each voltage reads too much, and by how "
            "much later than the others it is polled.",
        ),
    )


def named_cells(found: PackEstimate) -> list[int]:
    """Numbers of the cells that the page points at."""
    names = {cause["cell"] for cause in found.causes}
    return [k for k, name in enumerate(found.names) if name in names]


def _apart(edges: Sequence[float], least: float) -> list[int]:
    """Numbers of edges that lie far enough from each other to be labelled."""
    shown: list[int] = []
    for k, edge in enumerate(edges):
        if not shown or edge - edges[shown[-1]] >= least:
            shown.append(k)
    return shown


@styled
def draw_cells(found: PackEstimate) -> Figure:
    """Cells over time as colours."""
    image, edges, labels_of = cells_over_time(found)
    cells = len(found.names)
    figure = new_figure(min(2.2 + 0.045 * cells, 6.0))
    axes = figure.subplots()
    usual = np.nanpercentile(np.abs(image), 97) if np.isfinite(image).any() else 0.0
    scale = max(LEAST_SCALE_MV, float(usual))
    drawn = axes.imshow(
        image, aspect="auto", cmap="RdBu", vmin=-scale, vmax=scale, interpolation="nearest",
        extent=(0.0, float(image.shape[1]), cells + 0.5, 0.5),
    )  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="cell minus mean [mV]", shrink=0.8, pad=0.07)
    axes.grid(visible=False)
    shown = _apart(edges, image.shape[1] / MOST_LABELS)
    axes.set_xticks([edges[k] for k in shown], [labels_of[k] for k in shown], rotation=0)
    for cell in named_cells(found):
        axes.annotate(
            found.names[cell], (1.0, cell + 1.0), (4, 0), xycoords=("axes fraction", "data"),
            textcoords="offset points", color=VERMILLION, va="center", fontsize=7.5,
            annotation_clip=False,
        )  # fmt: skip
    spread = np.nanmax(image, axis=0) - np.nanmin(image, axis=0)
    finding(
        axes,
        f"Cells differ by {np.nanmedian(spread):.1f} mV from lowest to highest, averaged over "
        "minutes",
        0.8,
    )
    labels(axes, "logs in order", "cell")
    return figure


def cells_over_time(found: PackEstimate) -> tuple[FloatArray, list[int], list[str]]:
    """Mean differences [mV], shape (cells, columns), and where which log begins."""
    rows = sum(len(day.log) for day in found.days)
    parts, edges, names, at = [], [], [], 0
    for day in found.days:
        count = max(1, min(len(day.log) // BIN_ROWS, round(BINS * len(day.log) / rows)))
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


@styled
def draw_rest_and_load(found: PackEstimate) -> Figure:
    """Mean difference of every cell at rest and under load."""
    figure = new_figure(2.9)
    axes = figure.subplots()
    number = np.arange(1, len(found.names) + 1)
    capacity = found.model.capacity_Ah
    shown = {}
    heights = np.zeros(len(found.names))
    rates = [day.log.mean.current_A / capacity for day in found.days]
    for label, colour, marker, inside in (
        ("at rest", BLUE, "o", [np.abs(rate) < REST_RATE for rate in rates]),
        ("under load", VERMILLION, "s", [rate > LOAD_RATE for rate in rates]),
    ):
        mean = _mean_where(found, inside)
        if np.isfinite(mean).any():
            shown[label] = float(np.nanstd(mean))
            heights = 1e3 * mean
            axes.plot(number, 1e3 * mean, marker, color=colour, markersize=3.5, label=label)
    zero_line(axes)
    _point_at(axes, found, lambda cell: float(heights[cell]))
    said = ", ".join(f"{millivolt(v)} {k}" for k, v in shown.items())
    finding(axes, f"Standard deviation between cells: {said or 'no row at rest or under load'}")
    labels(axes, "cell", "cell minus mean [mV]")
    if shown:
        legend(axes, columns=2)
    return figure


def _mean_where(found: PackEstimate, inside: list[BoolArray]) -> FloatArray:
    total = np.zeros(len(found.names))
    count = np.zeros(len(found.names))
    for day, rows in zip(found.days, inside, strict=True):
        part = day.log.difference_V[rows]
        known = np.isfinite(part)
        total += np.where(known, part, 0.0).sum(axis=0)
        count += known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / count)


@styled
def draw_estimates(found: PackEstimate) -> Figure:
    """Capacity and resistance of every cell with bands, and their histograms."""
    figure = new_figure(4.6)
    wide, narrow = two_columns(figure, (1.0, 1.0), (1.0, 1.0), share=0.74)
    cells = found.cells
    own = found.own_capacity_std_Ah
    for axes, beside, values, std, unit, what in (
        (wide[0], narrow[0], cells.capacity_Ah, own, "[Ah]", "capacity"),
        (wide[1], narrow[1], cells.resistance_scale, cells.resistance_std, "/ mean", "resistance"),
    ):
        number = np.arange(1, values.size + 1)
        axes.errorbar(
            number, values, 2.0 * std, fmt="o", color=BLUE, markersize=3.0, linewidth=0.8,
            ecolor=MUTED,
        )  # fmt: skip
        _point_at(axes, found, lambda cell, v=values: float(v[cell]))
        share = 100.0 * np.nanstd(values) / np.nanmean(values)
        finding(
            axes, f"{what.capitalize()}: cells differ by {share:.1f} % (standard deviation)", 0.6
        )
        labels(axes, "cell", f"{what} {unit}")
        beside.hist(values[np.isfinite(values)], bins=min(24, max(values.size // 2, 3)), color=BLUE)
        labels(beside, f"{what} {unit}", "cells")
    return figure


@styled
def draw_sensors(found: PackEstimate) -> Figure:
    """Offset and polling of every cell's sensor."""
    figure = new_figure(2.8)
    left, right = figure.subplots(1, 2)
    cells = found.cells
    for axes, values, std, unit, what in (
        (left, 1e3 * cells.offset_V, 1e3 * cells.offset_std_V, "offset [mV]", "offsets"),
        (right, cells.skew_s, cells.skew_std_s, "polled later by [s]", "polling"),
    ):
        number = np.arange(1, values.size + 1)
        axes.errorbar(
            number, values, 2.0 * std, fmt="o", color=BLUE, markersize=3.0, linewidth=0.8,
            ecolor=MUTED,
        )  # fmt: skip
        zero_line(axes)
        _point_at(axes, found, lambda cell, v=values: float(v[cell]))
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        in_unit = unit.partition("[")[2].rstrip("]")
        finding(axes, f"Sensors' {what}: {low:+.2g} to {high:+.2g} {in_unit}", 0.42)
        labels(axes, "cell", unit)
    return figure


def _point_at(axes: Axes, found: PackEstimate, height: Any) -> None:
    for cell in named_cells(found):
        value = height(cell)
        if np.isfinite(value):
            # Beside the dot: above it would lie on its band or in the plot's title.
            left = cell > 0.8 * len(found.names)
            axes.annotate(
                found.names[cell], (cell + 1.0, value), (-14 if left else 14, 0),
                textcoords="offset points", color=VERMILLION, ha="right" if left else "left",
                va="center", fontsize=7.5, bbox=BEHIND,
                arrowprops={"arrowstyle": "-", "color": VERMILLION, "linewidth": 0.7},
            )  # fmt: skip

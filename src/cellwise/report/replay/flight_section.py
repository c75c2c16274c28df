"""Remaining time and energy along a flight, with their bands, as a picture and a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwise.forecast.remaining import Flight, Forecast
from cellwise.report.page.markup import Markup, paragraph, table
from cellwise.report.page.numerals import (
    duration,
    duration_range,
    percent,
    points,
    significant,
    time_unit,
)
from cellwise.report.page.picture import Picture, safe_key
from cellwise.report.page.section import Section
from cellwise.report.page.style import FILTER, finding, labels, legend, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STANDING = 0.2  # of the usual load: whoever stands does not ask how long it could stand
IDLE = 4.0  # times the median; longer times are left out of the picture
CAPTION = (
    "At every moment: how long each cell would last, and what energy it would still give, if the "
    "mean load of the last minute went on, with the band that two standard deviations of the state "
    "of charge, the capacity, the model's voltage and the cell's warming leave. A load that "
    "changes moves the curves; a converging filter narrows the band. What is more than four times "
    "the median is cut off."
)
EXPLAINED = (
    "From the filter's state of charge and the relaxation that the log's own current left, the "
    "model goes on until the terminal voltage reaches its cutoff or the charge ends. Energies and "
    "powers are those of one cell; a pack has as many times of them as it has cells."
)


def flight_finding(flight: Flight) -> str:
    """The first line of a flight's page."""
    now, load = flight.last, "the present load"
    usual = flight.typical
    if usual is not None and now.load_A < STANDING * usual.last.load_A:
        now, load = usual.last, f"the usual load of {significant(usual.last.load_A)} A"
    return (
        f"At {duration(now.time_s)} the cells are at {percent(now.soc, 0)}: "
        f"{duration(now.remaining_s)} remaining at {load} "
        f"({duration_range(*now.remaining_s_band)})."
    )


def flight_section(flights: Sequence[Flight]) -> Section:
    """Pictures of all flights, then their figures."""
    pictures = [
        Picture(f"flight-{k + 1}-{safe_key(f.name or 'log')}", draw_flight(f), CAPTION)
        for k, f in enumerate(flights)
    ]
    return Section("left", "Remaining time and energy", (*pictures, flight_content(flights)))


def flight_content(flights: Sequence[Flight]) -> Markup:
    """The last moment of every flight, at its present and at its usual load."""
    rows = []
    for flight in flights:
        name = f"{flight.name or 'log'}, " if len(flights) > 1 else ""
        rows.append((f"{name}present load", *_figures(flight.last)))
        if flight.typical is not None:
            rows.append((f"{name}median load", *_figures(flight.typical.last)))
        if flight.given is not None:
            after = duration(flight.given.time_s)
            rows.append((f"{name}given load, after {after}", *_figures(flight.given)))
    head = (
        "",
        "load",
        "SOC",
        "remaining time",
        "remaining energy",
        "end voltage",
        "SOC then",
        "ends by",
    )
    return Markup(paragraph(EXPLAINED, "note") + table(head, rows, text_columns=(0, 7)))


def _figures(now: Forecast) -> tuple[str, ...]:
    least, most = (significant(x) for x in now.remaining_Wh_band)
    return (
        f"{significant(now.load_A)} A, {significant(now.load_W)} W",
        f"{points(now.soc)} ± {percent(2.0 * now.soc_std, 1)}",
        f"{duration(now.remaining_s)} ({duration_range(*now.remaining_s_band)})",
        f"{significant(now.remaining_Wh)} Wh ({least} to {most})",
        f"{now.end_voltage_V:.3f} V",
        percent(now.end_soc, 1),
        now.by,
    )


@styled
def draw_flight(flight: Flight) -> Figure:
    """Time and energy left over the log, with bands."""
    figure = new_figure(4.2)
    above, below = figure.subplots(2, 1, sharex=True)
    scale, unit = time_unit(float(flight.time_s[-1]) or 1.0)
    t = flight.time_s / scale  # the log's own, as the headline says it
    drawn = (
        (above, flight.remaining_s / 60.0, flight.remaining_s_band / 60.0, "time left [min]"),
        (below, flight.remaining_Wh, flight.remaining_Wh_band, "energy left [Wh per cell]"),
    )
    for axes, values, band, name in drawn:
        known = np.isfinite(band).all(axis=1)
        axes.fill_between(
            t[known], band[known, 0], band[known, 1], color=FILTER, alpha=0.25, linewidth=0,
            label="2 standard deviations",
        )  # fmt: skip
        axes.plot(t[known], values[known], color=FILTER, label="at the load of the last minute")
        labels(axes, f"time [{unit}]" if axes is below else "", name)
        # A vehicle that stands would last for hours: the picture is for when it moves.
        tallest = max(float(np.max(band[known, 1], initial=0.0)), 1e-9)
        usual = IDLE * float(np.median(values[known])) if known.any() else tallest
        axes.set_ylim(0.0, 1.05 * (min(tallest, usual) or tallest))
    finding(above, flight_finding(flight))
    legend(below)
    return figure

"""What a replay foresees: remaining time and energy, the power it can give and take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cellwise.estimate.power.along import PowerTrace
from cellwise.estimate.power.state_of_power import PowerLimit
from cellwise.estimate.replay import Replay
from cellwise.forecast.remaining import Flight, Forecast
from cellwise.report.page import style
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.log_figures import time_axis
from cellwise.report.page.markup import Markup, paragraph, table
from cellwise.report.page.numerals import (
    duration,
    duration_range,
    percent,
    points,
    significant,
    time_unit,
)
from cellwise.report.page.picture import pictured, safe_key
from cellwise.report.page.section import Section
from cellwise.report.page.traces import thin, thin_band

# Of the usual load below which one stands, and does not ask for how long; times the median time
# beyond which the picture leaves out.
STANDING, IDLE = 0.2, 4.0
FORECAST_EXPLAINED = (
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
        flight_picture(f)._replace(key=f"flight-{k + 1}-{safe_key(f.name or 'log')}")
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
        "", "load", "SOC", "remaining time", "remaining energy", "end voltage", "SOC then",
        "ends by",
    )  # fmt: skip
    return Markup(paragraph(FORECAST_EXPLAINED, "note") + table(head, rows, text_columns=(0, 7)))


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


@pictured(
    "flight",
    "At every moment: how long each cell would last, and what energy it would still give, if the "
    "mean load of the last minute went on, with the band that two standard deviations of the state "
    "of charge, the capacity, the model's voltage and the cell's warming leave. A load that "
    "changes moves the curves; a converging filter narrows the band. What is more than four times "
    "the median is cut off.",
)
def flight_picture(flight: Flight) -> style.Figure:
    """Time and energy left over the log, with bands."""
    figure = style.new_figure(4.2)
    above, below = figure.subplots(2, 1, sharex=True)
    scale, unit = time_unit(float(flight.time_s[-1]) or 1.0)
    t = flight.time_s / scale  # the log's own, as the headline says it
    drawn = (
        (above, flight.remaining_s / 60.0, flight.remaining_s_band / 60.0, "time left [min]"),
        (below, flight.remaining_Wh, flight.remaining_Wh_band, "energy left [Wh per cell]"),
    )
    for axes, values, band, name in drawn:
        known = np.isfinite(band).all(axis=1)
        looks: dict[str, Any] = {"color": style.FILTER, "alpha": 0.25, "linewidth": 0}
        low, high = band[known].T
        axes.fill_between(t[known], low, high, label="2 standard deviations", **looks)
        axes.plot(
            t[known], values[known], color=style.FILTER, label="at the load of the last minute"
        )
        style.labels(axes, f"time [{unit}]" if axes is below else "", name)
        # A vehicle that stands would last for hours: the picture is for when it moves.
        tallest = max(float(np.max(band[known, 1], initial=0.0)), 1e-9)
        usual = IDLE * float(np.median(values[known])) if known.any() else tallest
        axes.set_ylim(0.0, 1.05 * (min(tallest, usual) or tallest))
    style.finding(above, flight_finding(flight))
    style.legend(below)
    return figure


USUAL_S = 10.0
POWER_EXPLAINED = (
    "The largest constant {hold} which keeps terminal voltage, current and SOC within their limits "
    "to the end of the horizon, from the state that the filter has at that moment; the power is "
    "that at the horizon's end. The lower bound keeps 1.645 standard deviations of the predicted "
    "voltage and of the SOC from the limits. Powers are those of one cell, at the end of the log."
)


def power_section(replays: Sequence[Replay]) -> Section:
    """A picture of every replay that has a power, then their figures."""
    known = [(r, r.power) for r in replays if r.power is not None]
    pictures = []
    for k, (r, power) in enumerate(known):
        picture = power_picture(r, power).of(r.log, f"power-{k + 1}-{safe_key(r.estimator)}")
        horizon = power.horizons_s[usual(power)]
        pictures.append(picture._replace(caption=picture.caption.format(horizon=horizon)))
    tables = [power_content(r, power, several=len(known) > 1) for r, power in known]
    return Section("power", "State of power", (*pictures, *tables))


def power_content(replay: Replay, power: PowerTrace, *, several: bool) -> Markup:
    """The power at the log's end, at every horizon."""

    def limit(way: PowerLimit) -> tuple[str, ...]:
        return (
            f"{significant(way.power_W)} W",
            f"{significant(way.power_low_W)} W",
            f"{significant(way.current_A)} A",
            way.by,
        )

    rows = [(f"{s.horizon_s:g} s", *limit(s.discharge), *limit(s.charge)) for s in power.last]
    name = f"{replay.estimator} on {clock_of(replay.log)}. " if several else ""
    one_way = ("at least (95 %)", "current", "limited by")
    head = ("for", "discharge", *one_way, "charge", *one_way)
    text = name + POWER_EXPLAINED.format(hold=power.hold)
    return Markup(paragraph(text, "note") + table(head, rows, text_columns=(0, 4, 8)))


def usual(power: PowerTrace) -> int:
    """Number of the horizon that is drawn: the one nearest to ten seconds."""
    return int(np.argmin([abs(h - USUAL_S) for h in power.horizons_s]))


@pictured(
    "power",
    "At every moment: the power that the cell can give (above zero) and take (below) for "
    "{horizon:g} s within its limits, each with the band down to what it sustains with 95 %; grey "
    "is the power that was measured.",
)
def power_picture(replay: Replay, power: PowerTrace) -> style.Figure:
    """Power limits over the log, charge below zero, and the measured power."""
    j = usual(power)
    log = replay.log
    figure = style.new_figure(2.9)
    axes = figure.subplots()
    t, time_label, _ = time_axis(log.time_s)
    ways = (
        (power.discharge_W[j], power.discharge_low_W[j], 1.0, "limits, down to 95 %"),
        (power.charge_W[j], power.charge_low_W[j], -1.0, None),
    )
    for value, low, sign, name in ways:
        x, least, most = thin_band(t, np.minimum(sign * low, sign * value),
                                   np.maximum(sign * low, sign * value))  # fmt: skip
        axes.fill_between(x, least, most, color=style.FILTER, alpha=0.25, linewidth=0, label=name)
        axes.plot(*thin(t, sign * value), color=style.FILTER)
    measured = log.interval_current_A * log.voltage_V
    axes.plot(*thin(t, measured), color=style.MEASURED, label="measured")
    style.labels(axes, time_label, f"power for {power.horizons_s[j]:g} s [W per cell]")
    style.finding(axes, power_finding(power))
    style.legend(axes)
    return figure


def power_finding(power: PowerTrace) -> str:
    """One line of the state of power at the log's end."""
    now = power.last[usual(power)]
    return (
        f"At the end each cell can give {significant(now.discharge.power_W)} W for "
        f"{now.horizon_s:g} s (at least {significant(now.discharge.power_low_W)} W) and take "
        f"{significant(now.charge.power_W)} W."
    )

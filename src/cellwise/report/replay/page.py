"""The page of replays: SOC against its reference, figures, remaining time and energy, power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.plausibility.notice import OTHER
from cellwise.cell.simulate import Simulation
from cellwise.errors import InputError
from cellwise.estimate.power.along import PowerTrace
from cellwise.estimate.power.state_of_power import PowerLimit
from cellwise.estimate.replay import Replay
from cellwise.forecast.remaining import Flight, Forecast
from cellwise.logs.checks.grave import is_grave
from cellwise.report.findings import replay_finding, simulation_finding
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page import style
from cellwise.report.page.markup import (
    MOST,
    Markup,
    clock_of,
    escape,
    lead_of,
    linked,
    paragraph,
    table,
    tiles,
)
from cellwise.report.page.numerals import (
    capitalised,
    duration,
    duration_range,
    listed,
    millivolt,
    percent,
    points,
    significant,
    spanned,
    time_unit,
)
from cellwise.report.page.picture import FigureFiles, pictured, safe_key
from cellwise.report.page.section import Blocks, HasPanels, Section, trace_section, write_page
from cellwise.report.page.traces import thin, thin_band, time_axis
from cellwise.report.replay.replay_section import (
    reached,
    replay_content,
    replay_pictures,
    soc_at_end,
)

# Times the median time beyond which the picture at the load of the last minute leaves out: a
# vehicle that stands would last for hours.
IDLE = 4.0
FORECAST_EXPLAINED = (
    "From the filter's state of charge and the relaxation that the log's own current left, the "
    "model goes on until the terminal voltage reaches its cutoff or the charge ends. Energies and "
    "powers are those of one cell; a pack has as many times of them as it has cells."
)


def flight_finding(flight: Flight) -> str:
    """The first line of a flight's page."""
    now = (flight.typical or flight).last
    return (
        f"At {duration(now.time_s)} the cells are at {percent(now.soc, 0)}: "
        f"{duration(now.remaining_s)} ({duration_range(*now.remaining_s_band)}) remaining at the "
        f"usual load of {significant(now.load_A)} A."
    )


def flight_section(flights: Sequence[Flight]) -> Section:
    """Pictures of all flights, then their figures."""
    named = [(f, f"{k + 1}-{safe_key(f.name or 'log')}") for k, f in enumerate(flights)]
    pictures = [flight_picture(f)._replace(key=f"flight-{key}") for f, key in named]
    folded = [
        present_picture(f)._replace(
            key=f"present-{key}",
            fold="The same at the load of the last minute"
            + (f", {f.name}" if len(flights) > 1 else ""),
        )
        for f, key in named
    ]
    blocks: Blocks = (*pictures, flight_content(flights), *folded)
    return Section("left", "Remaining time and energy", blocks)


def flight_content(flights: Sequence[Flight]) -> Markup:
    """The last moment of every flight, at its present and at its usual load."""
    rows = []
    for flight in flights:
        name = f"{flight.name or 'log'}, " if len(flights) > 1 else ""
        if flight.typical is not None:
            rows.append((f"{name}usual load", *_figures(flight.typical.last)))
        rows.append((f"{name}last minute", *_figures(flight.last)))
        if flight.given is not None:
            after = duration(flight.given.time_s)
            rows.append((f"{name}given load, after {after}", *_figures(flight.given)))
    head = (
        "", "load", "SOC", "remaining time", "remaining energy", "end voltage", "SOC then",
        "ends by",
    )  # fmt: skip
    return Markup(paragraph(FORECAST_EXPLAINED, "note") + table(head, rows, text_columns=(0, 7)))


def _figures(now: Forecast) -> tuple[str, ...]:
    return (
        f"{significant(now.load_A)} A, {significant(now.load_W)} W",
        f"{points(now.soc)} ± {percent(2.0 * now.soc_std, 1)}",
        f"{duration(now.remaining_s)} ({duration_range(*now.remaining_s_band)})",
        f"{significant(now.remaining_Wh)} Wh ({spanned(*now.remaining_Wh_band)})",
        f"{now.end_voltage_V:.3f} V",
        percent(now.end_soc, 1),
        now.by,
    )


@pictured(
    "flight",
    "At every moment: how long each cell would last, and what energy it would still give, at the "
    "log's usual load, the mean while it is under way. The band is what two standard deviations of "
    "the state of charge, the capacity, the model's voltage and the cell's warming leave; its "
    "lower edge is where the load's usual peaks first press the voltage to the cutoff. It takes "
    "the load to stay: one twice as large leaves about half.",
)
def flight_picture(flight: Flight) -> style.Figure:
    """Time and energy left over the log at the usual load, with bands."""
    shown = flight.typical or flight
    return _drawn(shown, f"at the usual {significant(shown.last.load_A)} A", math.inf)


@pictured(
    "present",
    "At every moment, if the mean load of the last minute went on: a load that changes moves the "
    "curves. What is more than four times the median is cut off.",
)
def present_picture(flight: Flight) -> style.Figure:
    """Time and energy left over the log at the load of each moment, with bands."""
    return _drawn(flight, "at the load of the last minute", IDLE)


def _drawn(flight: Flight, load: str, most: float) -> style.Figure:
    """Both over the log; what is more than ``most`` times the median is cut off."""
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
        axes.plot(t[known], values[known], color=style.FILTER, label=load)
        style.labels(axes, f"time [{unit}]" if axes is below else "", name)
        tallest = max(float(np.max(band[known, 1], initial=0.0)), 1e-9)
        usual = float(np.median(values[known])) if known.any() else 0.0
        axes.set_ylim(0.0, 1.05 * (min(tallest, most * usual) if usual else tallest))
    now = flight.last
    left = f"{duration(now.remaining_s)} ({duration_range(*now.remaining_s_band)})"
    style.finding(above, f"{left} left at the end, {load}")
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
        key = f"power-{k + 1}-{safe_key(r.estimator)}"
        pictures.append(power_picture(r, power).of(r.log, key))
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


def _power_caption(_: Replay, power: PowerTrace) -> str:
    return (
        "At every moment: the power that the cell can give (above zero) and take (below) for "
        f"{power.horizons_s[usual(power)]:g} s within its limits, each with the band down to what "
        "it sustains with 95 %; grey is the power that was measured."
    )


@pictured("power", _power_caption)
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


def replay_page(
    replays: Sequence[Replay],
    path: str | Path,
    simulations: Sequence[Simulation] = (),
    *,
    flights: Sequence[Flight] = (),
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of one or more replays, and of simulations beside them.

    Parameters
    ----------
    replays : of Replay           the first one gives the page's first line
    path : str or Path            of the HTML file; it appears whole or not at all
    simulations : of Simulation   of the same or other logs
    flights : of Flight           forecasts along them (`cellwise.forecast.remaining.forecast`)
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        no replay; matplotlib is missing; the path cannot be written
    """
    if not replays:
        raise InputError("no replay for the page", "at least one", "Replay a log first.")
    names = list(dict.fromkeys(clock_of(r.log) for r in replays))
    lines = [replay_finding(r) for r in replays]
    if simulations:
        lines.append(simulation_finding(simulations))
    if flights:  # remaining time and energy come first where the estimate cannot be judged
        place = 0 if replays[0].reference_soc is None else len(lines)
        lines.insert(place, flight_finding(flights[0]))
    lines = [*filter(None, (warning(r) for r in replays)), *lines]
    sections = list(replay_sections(replays, simulations))
    if flights:
        sections.insert(0, flight_section(flights))
    if any(r.power is not None for r in replays):
        sections.insert(0, power_section(replays))
    few: list[tuple[str, HasPanels]] = [
        (f"{r.estimator} on {clock_of(r.log)}", r) for r in replays[: MOST.replays]
    ]
    logs = {r.log.name: (f"{clock_of(r.log)} as it was measured", r.log) for r in replays}
    sections.append(trace_section([*few, *logs.values()]))
    data: dict[str, object] = {**replay_data(replays, simulations)}
    if flights:
        data["flights"] = [{"log": f.name, **f.to_dict()} for f in flights]
    return write_page(
        path,
        lines[0],
        f"State of charge on {listed(names)}, by cellwise",
        sections,
        data,
        lead=lead_of(noticed(replays, simulations, flights), replay_tiles(replays[0]), lines[1:]),
        figures=figures,
    )


def warning(replay: Replay) -> str | None:
    """What makes all else on the page useless, as its first line; None: nothing does."""
    grave = next((n for n in replay.log.notices if is_grave(n)), None)
    if grave is not None:
        return f"{capitalised(grave)}."
    far_off = replay.far_off
    return far_off and f"{far_off.partition(f': {OTHER}')[0]}: neither SOC nor time can be used."


def noticed(
    replays: Sequence[Replay], simulations: Sequence[Simulation], flights: Sequence[Flight] = ()
) -> list[Markup]:
    """What a reader should know of the logs and of how far the model is off, rows as links."""
    found = [escape(n) for f in flights for n in f.notices]
    found += [linked(n, r.log) for r in replays for n in r.notices]
    found += [linked(n, s.log) for s in simulations for n in s.notices]
    return list(dict.fromkeys(found))


def replay_sections(
    replays: Sequence[Replay], simulations: Sequence[Simulation] = ()
) -> tuple[Section, ...]:
    """The parts of a replay page."""
    text = f"The first {MOST.replays} replays have pictures of their own; the table has all."
    few = (paragraph(text),) if len(replays) > MOST.replays else ()
    sections = [
        Section("soc", "State of charge", (*few, *replay_pictures(replays))),
        Section("figures", "All figures", (replay_content(replays),)),
    ]
    if simulations:
        blocks: Blocks = (simulation_content(simulations), *simulation_pictures(simulations))
        sections.append(Section("simulation", "Measured and simulated voltage", blocks))
    return tuple(sections)


def replay_data(
    replays: Sequence[Replay], simulations: Sequence[Simulation]
) -> dict[str, list[dict[str, object]]]:
    """Figures of replays and simulations as JSON values, each with the name of its log."""
    return {
        "replays": [{"log": r.log.name, **r.to_dict()} for r in replays],
        "simulations": [{"log": s.log.name, **s.to_dict()} for s in simulations],
    }


def replay_tiles(replay: Replay) -> Markup:
    """Key figures of a replay."""
    facts: list[tuple[object, object]] = [
        ("initial SOC", points(replay.start.soc)),
        ("final SOC", soc_at_end(replay)),
    ]
    settled = replay.settled
    if settled is not None:
        facts += [
            ("within 2 points after", reached(replay)),
            ("settled SOC RMSE", percent(settled.rmse)),
            ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ]
    return tiles([*facts, ("voltage prediction RMSE", millivolt(replay.voltage_rmse_V))])

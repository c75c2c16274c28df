"""The page of replays: SOC against its reference, figures, remaining time and energy, power."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cellwise.arguments import several
from cellwise.cell.simulate import Simulation
from cellwise.errors import InputError
from cellwise.estimate.power.power_along_log import PowerTrace
from cellwise.estimate.power.state_of_power import PowerLimit
from cellwise.estimate.replay import Replay
from cellwise.forecast.remaining import Forecast, ForecastTrace
from cellwise.plotting import Line, Panel
from cellwise.report.identification.simulation_section import simulation_blocks, simulation_finding
from cellwise.report.page.markup import (
    MOST,
    Markup,
    clock_of,
    escape,
    lead_of,
    linked,
    paragraph,
    record_table,
    table,
    tiles,
)
from cellwise.report.page.numerals import (
    SPACE,
    capitalised,
    duration,
    duration_between,
    listed,
    millivolt,
    percent,
    plural,
    points,
    significant,
    spanned,
)
from cellwise.report.page.picture import Figures, safe_key
from cellwise.report.page.plot import Plot, time_axis
from cellwise.report.page.section import Blocks, Section, plots_within, write_page
from cellwise.report.replay.replay_section import (
    estimated_content,
    reached,
    replay_content,
    replay_finding,
    replay_name,
    replay_plots,
    soc_at_end,
    soc_at_start,
)

FORECAST_EXPLAINED = (
    "From the state at {time} the model goes on until the voltage reaches its cutoff or the charge "
    "ends. Where no pack is named, energies and powers are those of one cell."
)


def flight_finding(flight: ForecastTrace) -> str:
    """The first line of a flight's page: remaining time at the usual load, with its band."""
    now = (flight.typical or flight).last
    energy = f", {_pack_energy(now, flight.cells)} in the pack" if flight.cells > 1 else ""
    left = f"{_left(now)} left at {_load(flight)}{energy}"
    return f"{points(now.soc)} SOC at {duration(now.time_s)}: {left}."


def _left(now: Forecast) -> str:
    return duration_between(now.remaining_s, *now.remaining_s_band)


def _load(flight: ForecastTrace) -> str:
    """The load that is forecast; before the log has a usual one, that of its last minute."""
    what = "the usual" if flight.typical else "the last minute's"
    return f"{what} {significant((flight.typical or flight).last.load_A)}{SPACE}A"


def flight_section(flights: Sequence[ForecastTrace]) -> Section:
    """Plot and figures of the last flight; of several a row for each."""
    now = flights[-1]
    several = len(flights) > 1
    plot = flight_plot(now, now.name if several else "")
    blocks: Blocks = (plot, flight_content(now, several=several))
    if several:
        every = record_table(
            flights,
            ("log", lambda f: f.name),
            ("SOC", lambda f: points((f.typical or f).last.soc)),
            ("load", lambda f: f"{significant((f.typical or f).last.load_A)} A"),
            ("remaining time", lambda f: _left((f.typical or f).last)),
            ("remaining energy", lambda f: _energy((f.typical or f).last)),
            ("of the pack", lambda f: _pack_energy((f.typical or f).last, f.cells)),
            caption="What was left at the end of every log, at its own usual load.",
        )
        blocks = (*blocks, every)
    return Section("left", "Remaining time and energy", blocks)


def flight_content(flight: ForecastTrace, *, several: bool) -> Markup:
    """The last moment of a flight at its usual load, that of its last minute and a given one."""
    text = FORECAST_EXPLAINED.format(time=duration(flight.last.time_s))
    rows = forecast_table(forecasts_of(flight, flight.given), flight.cells)
    return table(*rows, caption=f"{flight.name}. {text}" if several else text)


def forecasts_of(flight: ForecastTrace | None, given: Forecast | None) -> dict[str, Forecast]:
    """The forecasts from a log's end by the load that goes on, the usual load first."""
    ways: dict[str, Forecast | None] = {}
    if flight is not None:
        ways["usual load"] = flight.typical.last if flight.typical else None
        ways["load of the last minute"] = None if flight.stands and flight.typical else flight.last
    ways["given load"] = given
    return {name: now for name, now in ways.items() if now is not None}


def forecast_table(
    forecasts: Mapping[str, Forecast], cells: int
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: remaining time and energy, a column for each load."""
    columns = [_figures(now, cells) for now in forecasts.values()]
    head = (
        "load of a cell", "remaining time", "remaining energy of a cell",
        f"of the pack of {plural(cells, 'cell')}", "voltage then", "SOC then", "ends by",
    )  # fmt: skip
    rows = [
        row
        for row in zip(head, *columns, strict=True)
        if cells > 1 or not row[0].startswith("of the pack")
    ]
    return ("", *forecasts), rows


def _energy(now: Forecast) -> str:
    return f"{significant(now.remaining_Wh)} Wh ({spanned(*now.remaining_Wh_band)})"


def _pack_energy(now: Forecast, cells: int) -> str:
    """Energy of all cells, which are alike and err together."""
    low, high = now.remaining_Wh_band
    return f"{significant(cells * now.remaining_Wh)} Wh ({spanned(cells * low, cells * high)})"


def _figures(now: Forecast, cells: int) -> tuple[str, ...]:
    return (
        f"{significant(now.load_A)} A, {significant(now.load_W)} W",
        _left(now),
        _energy(now),
        _pack_energy(now, cells),
        f"{now.end_voltage_V:.3f} V",
        percent(now.end_soc, 1),
        now.by,
    )


FLIGHT_CAPTION = (
    "At every moment: how long each cell would last at the log's usual load, the mean while it is "
    "under way, and what energy it would give. The band holds two standard deviations of SOC, "
    "capacity, voltage and warming; its lower edge is where the load's usual peaks first press the "
    "voltage to the cutoff."
)


def flight_plot(flight: ForecastTrace, of_log: str = "") -> Plot:
    """Time and energy left over the log at the usual load, with bands."""
    shown = flight.typical or flight
    title = f"{_left(shown.last)} left at the end, at {_load(flight)}"
    title = f"{of_log}: {title}" if of_log else title
    key = f"flight-{safe_key(flight.name or 'log')}"
    return Plot(key, title, *shown.panels(), FLIGHT_CAPTION)


USUAL_S = 10.0
WIDE_SOC = 0.1  # two standard deviations of a SOC: beyond, it answers little
NARROW = 0.8  # share of errors inside two standard deviations: below, the band misleads
POWER_EXPLAINED = (
    "The largest constant {hold} which keeps terminal voltage, current and SOC within their limits "
    "to the end of the horizon, from the state that the filter has at that moment; the power is "
    "that at the horizon's end. The lower bound keeps 1.645 standard deviations of the predicted "
    "voltage and of the SOC from the limits. Powers are those of one cell, at the end of the log."
)


def power_section(replays: Sequence[Replay]) -> Section:
    """A plot of every replay that has a power, then their figures."""
    known = [(r, r.power) for r in replays if r.power is not None]
    keys = (f"power-{k}-{safe_key(r.estimator)}" for k, (r, _) in enumerate(known, start=1))
    plots = [power_plot(r, power, key) for key, (r, power) in zip(keys, known, strict=True)]
    tables = [power_content(r, power, several=len(known) > 1) for r, power in known]
    return Section("power", "State of power", (*plots, *tables))


def power_content(replay: Replay, power: PowerTrace, *, several: bool) -> Markup:
    """The power at the log's end, at every horizon."""
    name = f"{replay.estimator} on {clock_of(replay.log)}. " if several else ""
    shown = power_table(power, replay.log.series * replay.log.parallel)
    return table(*shown, caption=name + POWER_EXPLAINED.format(hold=power.hold))


def power_table(power: PowerTrace, cells: int) -> tuple[list[str], list[tuple[str, ...]]]:
    """Head and rows: a cell's limits, and the power of all, a column for each horizon."""
    names = ["{} [W]", "at least (95 %) [W]", "current", "limited by"]
    names += ["{} of all " + f"{cells} cells [W]"] * (cells > 1)

    def limits(way: PowerLimit) -> list[str]:
        current, of_all = f"{significant(way.current_A)} A", significant(cells * way.power_W)
        shown = [significant(way.power_W), significant(way.power_low_W), current, way.by]
        return shown + [of_all] * (cells > 1)

    columns = [(*limits(s.discharge), *limits(s.charge)) for s in power.last]
    head = [name.format(way) for way in ("discharge", "charge") for name in names]
    horizons = (f"{s.horizon_s:g} s" for s in power.last)
    return ["for", *horizons], list(zip(head, *columns, strict=True))


def usual(power: PowerTrace) -> int:
    """Number of the horizon that is drawn: the one nearest to ten seconds."""
    return int(np.argmin([abs(h - USUAL_S) for h in power.horizons_s]))


def power_plot(replay: Replay, power: PowerTrace, key: str) -> Plot:
    """Power limits over the log, charge below zero, and the measured power."""
    j, log = usual(power), replay.log
    t, label = time_axis(log)
    give, take = power.discharge_W[j], -power.charge_W[j]
    lines = (
        Line("measured", t, log.interval_current_A * log.voltage_V),
        Line("can give", t, give, np.column_stack((power.discharge_low_W[j], give))),
        Line("can take", t, take, np.column_stack((take, -power.charge_low_W[j]))),
    )
    horizon = f"{power.horizons_s[j]:g} s"
    caption = (
        f"At every moment: the power that the cell can give and take for {horizon} within its "
        "limits, each with the band down to what it sustains with 95 %; grey is what was measured."
    )
    panel = Panel(f"power for {horizon} [W per cell]", lines)
    return Plot(key, power_finding(power), label, (panel,), caption, clock_of(log))


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
    flights: Sequence[ForecastTrace] = (),
    figures: Figures = None,
) -> Path:
    """Write the page of one or more replays, and of simulations beside them.

    Parameters
    ----------
    replays : of Replay           the last log's first one gives the page's first line: where the
                                  battery is now
    simulations : of Simulation   of the same or other logs
    flights : of ForecastTrace    forecasts along them (`cellwise.forecast.remaining.forecast`)
    path, figures : as of `write_page`, whose errors it raises
    """
    replays = several("replays", replays, Replay, "Write replay_page([replay(model, log)], path).")
    if not replays:
        raise InputError("no replay for the page", "at least one", "Replay a log first.")
    names = list(dict.fromkeys(clock_of(r.log) for r in replays))
    about = listed(names) if len(names) <= MOST.bullets else f"{len(names)} logs, {names[-1]} last"
    last = [r for r in replays if r.log is replays[-1].log]  # by one estimator or several
    now, before = last[0], [r for r in replays if r.log is not replays[-1].log]
    lines = [replay_finding(r) for r in last]
    if simulations:
        lines.append(simulation_finding(simulations))
    if flights:  # remaining time and energy come first where the estimate cannot be judged
        place = 0 if now.reference_soc is None else len(lines)
        lines.insert(place, flight_finding(flights[-1]))
    lines += [power_finding(now.power)] if now.power is not None else []
    unsure = [say(r) for r in last for say in (narrow_band, unknown_start)]
    lines[1:1] = filter(None, unsure)
    lines = [*filter(None, dict.fromkeys(warning(r) for r in replays)), *lines]
    of_model, of_reading = noticed(replays, simulations, flights)
    sections = list(replay_sections([*last, *before], simulations))
    if any(r.power is not None for r in replays):
        sections.insert(0, power_section([*last, *before]))
    if flights:
        sections.insert(0, flight_section(flights))
    data: dict[str, object] = {**replay_data(replays, simulations)}
    if flights:
        data["flights"] = [{"log": f.name, **f.to_dict()} for f in flights]
    return write_page(
        path,
        lines[0],
        f"State of charge on {about}, by cellwise",
        sections,
        data,
        lead=lead_of(of_model, replay_tiles(now), [*lines[1:], *of_reading]),
        figures=figures,
    )


def warning(replay: Replay) -> str | None:
    """What makes all else on the page useless, as its first line; None: nothing does."""
    critical = next((n for n in replay.log.notices if n.is_critical), None)
    if critical is not None:
        return f"{capitalised(critical.text)}."
    far = replay.model_mismatch
    return None if far is None else f"{far.head}: neither SOC nor time can be used."


def narrow_band(replay: Replay) -> str | None:
    """That the filter's own band does not hold its errors; None where it does."""
    share = replay.coverage_2sigma
    if share is None or not share < NARROW:
        return None
    return (
        f"Do not rely on the band of {replay_name(replay)}: it holds {percent(share, 0)} of the "
        "errors, 95 % if it were right. The model is further off here than it states."
    )


def unknown_start(replay: Replay) -> str | None:
    """What would narrow a wide SOC whose start nobody knows; None where it is known."""
    last = 2.0 * float(replay.trace.soc_std[-1])
    if last < WIDE_SOC or replay.start.std < 0.5 * WIDE_SOC:
        return None
    return (
        f"SOC ends no better than ± {percent(last, 0)}, since this log does not show where it "
        f"began ({soc_at_start(replay)}): state it where it is known (LOG@soc0=1 after a charge)."
    )


def noticed(
    replays: Sequence[Replay],
    simulations: Sequence[Simulation],
    flights: Sequence[ForecastTrace] = (),
) -> tuple[list[Markup], list[Markup]]:
    """What a reader should know of how far the model is off, and of how the logs were read.

    Rows are links to where they are drawn.
    """
    runs: list[Replay | Simulation] = [*replays, *simulations]
    read = {n for one in runs for n in one.log.notices if not n.is_critical}
    every = [(n, escape(n.text)) for f in flights for n in f.notices]
    every += [(n, linked(n, one.log)) for one in runs for n in one.notices]
    of_model, of_reading = ([m for n, m in every if (n in read) == side] for side in (False, True))
    return list(dict.fromkeys(of_model)), list(dict.fromkeys(of_reading))


def replay_sections(
    replays: Sequence[Replay], simulations: Sequence[Simulation] = ()
) -> tuple[Section, ...]:
    """The parts of a replay page."""
    text = f"The first {MOST.plots} replays have plots of their own; the table has all."
    few = (paragraph(text),) if len(replays) > MOST.plots else ()
    found = map(estimated_content, replays[: MOST.plots])
    sections = [
        Section("soc", "State of charge", (*few, *plots_within(replay_plots(replays)))),
        Section("figures", "All figures", (*found, replay_content(replays))),
    ]
    if simulations:
        blocks = simulation_blocks(simulations)
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
        ("initial SOC", soc_at_start(replay)),
        ("final SOC", soc_at_end(replay)),
    ]
    settled = replay.settled
    if settled is not None:
        facts += [
            ("within 2 points, and stated so, after", reached(replay)),
            ("settled SOC RMSE", percent(settled.rmse)),
            ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ]
    return tiles([*facts, ("voltage prediction RMSE", millivolt(replay.voltage_rmse_V))])

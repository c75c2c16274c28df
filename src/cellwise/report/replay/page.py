"""The page of replays: SOC against its reference, all figures, remaining time and energy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwise.cell.plausibility.far_off import OTHER
from cellwise.cell.simulate import Simulation
from cellwise.errors import InputError
from cellwise.estimate.replay import Replay
from cellwise.forecast.remaining import Flight
from cellwise.logs.checks.grave import is_grave
from cellwise.report.findings import replay_finding, simulation_finding
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page.interactive import HasPanels, trace_section
from cellwise.report.page.jumps import clock_of, linked
from cellwise.report.page.markup import MOST, Markup, escape, lead_of, paragraph, tiles
from cellwise.report.page.numerals import (
    capitalised,
    listed,
    millivolt,
    percent,
    points,
)
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.report.replay.forecast_section import flight_finding, flight_section, power_section
from cellwise.report.replay.replay_section import (
    reached,
    replay_content,
    replay_pictures,
    soc_at_end,
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

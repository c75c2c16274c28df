"""The page that ``make demo`` ends with: from laboratory logs to SOC on the road, explained."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import Replay
from cellwise.identify.identification import Identification
from cellwise.logs.cell_log import CellLog
from cellwise.report.findings import demo_finding, replay_finding, simulation_finding
from cellwise.report.hero import hero_picture
from cellwise.report.identification.capacity_section import capacity_content, capacity_picture
from cellwise.report.identification.ocv_section import ocv_content, ocv_evidence, ocv_picture
from cellwise.report.identification.page import cell_name, identify_tiles, notices
from cellwise.report.identification.parameter_section import parameter_content, parameter_picture
from cellwise.report.identification.provenance_section import provenance_content
from cellwise.report.identification.pulse_example import pulse_example_picture
from cellwise.report.identification.pulse_section import pulse_content, pulse_picture, pulse_sets
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page.markup import Markup, bullets, details, paragraph, table
from cellwise.report.page.numerals import counted, duration, listed, plural, significant
from cellwise.report.page.picture import FigureFiles, Picture
from cellwise.report.page.section import Section, write_page
from cellwise.report.replay.page import replay_data
from cellwise.report.replay.replay_figures import replay_content
from cellwise.report.replay.replay_section import comparison_pictures, replay_pictures


def demo_page(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write one page from tests to SOC, every picture explained for a newcomer.

    Parameters
    ----------
    identification : Identification
    simulations : of Simulation   drives that were not fitted
    replays : of Replay           the first one from a wrong start, of a simulated log
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    return write_page(
        path,
        demo_finding(identification, simulations, replays),
        f"cellwise demo on {cell_name(identification)}",
        demo_sections(identification, simulations, replays),
        {"identification": identification.to_dict(), **replay_data(replays, simulations)},
        lead=identify_tiles(identification),
        figures=figures,
    )


def demo_sections(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
) -> tuple[Section, ...]:
    """The steps, in the order in which a laboratory takes them."""
    sections = [
        _result(identification, simulations, replays),
        _logs(identification, simulations),
        _laboratory(identification),
        _pulses(identification),
        _parameters(identification),
        _own_fit(identification),
        _held_out(simulations),
        _soc(replays),
        Section(
            "provenance",
            "Where every number came from",
            (notices(identification), provenance_content(identification)),
            "Provenance",
        ),
    ]
    return tuple(s for s in sections if s.blocks)


def _result(
    identification: Identification, simulations: Sequence[Simulation], replays: Sequence[Replay]
) -> Section:
    """The main picture: the first drive that was simulated and replayed."""
    blocks: list[Markup | Picture] = [
        paragraph(
            "A battery's state of charge cannot be measured, only inferred from current, voltage "
            "and temperature. cellwise does it in two steps: in the laboratory it identifies a "
            "model of the cell, a small electric circuit whose parts change with the state of "
            "charge; on the road a Kalman filter runs this model beside the cell and corrects "
            "itself by what it sees."
        )
    ]
    pair = next(
        (
            (s, r)
            for r in replays
            for s in simulations
            if s.log is r.log or s.log.name == r.log.name
        ),
        None,
    )
    if pair is not None:
        blocks.append(hero_picture(identification, *pair))
    return Section("result", "The result", tuple(blocks))


def _logs(identification: Identification, simulations: Sequence[Simulation]) -> Section:
    seen: dict[int, tuple[str, CellLog]] = {}
    for found in identification.temperatures:
        for one in found.pulse_sets:
            seen[id(one.log)] = ("identification: pulses", one.log)
    for s in identification.simulations:
        seen.setdefault(id(s.log), ("identification: drive", s.log))
    for s in simulations:
        seen.setdefault(id(s.log), ("held out: validation", s.log))
    rows = [
        (
            log.name or "log",
            use,
            counted(len(log)),
            duration(log.duration_s),
            f"{significant(float(np.nanmin(log.current_A)))} to "
            f"{significant(float(np.nanmax(log.current_A)))} A",
            f"{np.nanmin(log.voltage_V):.2f} to {np.nanmax(log.voltage_V):.2f} V",
        )
        for use, log in seen.values()
    ]
    tests = list(dict.fromkeys(t.name for t in identification.capacity_tests))
    more = f" Capacity and OCV come from {listed(tests)}." if tests else ""
    return Section(
        "logs",
        "The logs",
        (
            paragraph(
                "Everything below is computed from these logs; positive current discharges." + more
            ),
            table(
                ("log", "used for", "rows", "length", "current", "voltage"),
                rows,
                text_columns=(0, 1),
            ),
        ),
    )


def _laboratory(identification: Identification) -> Section:
    evidence = ocv_evidence(identification)
    return Section(
        "laboratory",
        "How much charge, at what voltage",
        (
            capacity_picture(identification),
            details("Capacity in numbers", capacity_content(identification)),
            ocv_picture(identification, evidence),
            details("The OCV in numbers", ocv_content(identification, evidence)),
        ),
        "Capacity and OCV",
    )


def _pulses(identification: Identification) -> Section:
    if not any(s.pulses for _, s in pulse_sets(identification)):
        return Section("pulses", "Pulses", ())
    example = pulse_example_picture(identification)
    return Section(
        "pulses",
        "How the cell answers a pulse",
        (
            *(() if example is None else (example,)),
            pulse_picture(identification),
            details("Pulses in numbers", pulse_content(identification)),
        ),
        "Pulses",
    )


def _parameters(identification: Identification) -> Section:
    return Section(
        "parameters",
        "The model: a circuit whose parts change with SOC",
        (parameter_picture(identification), parameter_content(identification)),
        "Parameters",
    )


def _own_fit(identification: Identification) -> Section:
    sims = identification.simulations
    shown = sims[:1]
    return Section(
        "fit",
        "Does the model explain its own tests?",
        (simulation_content(sims), *simulation_pictures(shown, "fit")),
        "Own tests",
    )


def _held_out(simulations: Sequence[Simulation]) -> Section:
    if not simulations:
        return Section("held-out", "Held-out drives", ())
    return Section(
        "held-out",
        "Does it predict drives it was not fitted on?",
        (
            paragraph(simulation_finding(simulations)),
            simulation_content(simulations),
            *simulation_pictures(simulations, "held-out"),
        ),
        "Held-out drives",
    )


def _soc(replays: Sequence[Replay]) -> Section:
    if not replays:
        return Section("soc", "State of charge", ())
    pictures = (*comparison_pictures(replays), *replay_pictures(replays[:1]))
    return Section(
        "soc",
        "State of charge on the road",
        (
            paragraph(f"{plural(len(replays), 'replay')} of the held-out logs, row by row:"),
            bullets(replay_finding(r) for r in replays),
            *pictures,
            details("All figures of the replays", replay_content(replays)),
        ),
        "State of charge",
    )

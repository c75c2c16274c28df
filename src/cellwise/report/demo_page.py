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
from cellwise.report.identification.pulse_section import (
    pulse_content,
    pulse_example_picture,
    pulse_picture,
    pulse_sets,
)
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.markup import bullets, details, lead_of, paragraph, record_table
from cellwise.report.page.numerals import counted, duration, listed, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.report.replay.page import replay_data
from cellwise.report.replay.replay_section import (
    comparison_pictures,
    replay_content,
    replay_pictures,
)
from cellwise.typing import FloatArray


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
    judged = [replay_finding(r) for r in replays if r.settled is not None]
    return write_page(
        path,
        demo_finding(identification, simulations),
        f"cellwise demo on {cell_name(identification)}",
        demo_sections(identification, simulations, replays),
        {"identification": identification.to_dict(), **replay_data(replays, simulations)},
        lead=lead_of((), identify_tiles(identification), judged[:1]),
        figures=figures,
    )


def demo_sections(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
) -> tuple[Section, ...]:
    """The steps, in the order in which a laboratory takes them."""
    evidence = ocv_evidence(identification)
    own = identification.simulations
    provenance = (notices(identification), provenance_content(identification))
    laboratory = (
        capacity_picture(identification),
        details("Capacity in numbers", capacity_content(identification)),
        ocv_picture(identification, evidence),
        details("The OCV in numbers", ocv_content(identification, evidence)),
    )
    parameters = (parameter_picture(identification), parameter_content(identification))
    fit: Blocks = (simulation_content(own), *simulation_pictures(own[:1], "fit"))
    model = "The model: a circuit whose parts change with SOC"
    drives = "Does it predict drives it was not fitted on?"
    titled: tuple[tuple[str, str, Blocks, str], ...] = (
        ("result", "The result", _result(identification, simulations, replays), ""),
        ("logs", "The logs", _logs(identification, simulations), ""),
        ("laboratory", "How much charge, at what voltage", laboratory, "Capacity and OCV"),
        ("pulses", "How the cell answers a pulse", _pulses(identification), "Pulses"),
        ("parameters", model, parameters, "Parameters"),
        ("fit", "Does the model explain its own tests?", fit, "Own tests"),
        ("held-out", drives, _held_out(simulations), "Held-out drives"),
        ("soc", "State of charge on the road", _soc(replays), "State of charge"),
        ("provenance", "Where every number came from", provenance, "Provenance"),
    )
    return tuple(Section(*one) for one in titled if one[2])


def _result(
    identification: Identification, simulations: Sequence[Simulation], replays: Sequence[Replay]
) -> Blocks:
    """The main picture: the first drive that was simulated and replayed."""
    text = paragraph(
        "A battery's state of charge cannot be measured, only inferred from current, voltage "
        "and temperature. cellwise does it in two steps: in the laboratory it identifies a "
        "model of the cell, a small electric circuit whose parts change with the state of "
        "charge; on the road a Kalman filter runs this model beside the cell and corrects "
        "itself by what it sees."
    )
    pairs = ((s, r) for r in replays for s in simulations)
    pair = next(((s, r) for s, r in pairs if s.log is r.log or s.log.name == r.log.name), None)
    if pair is None:
        return (text,)
    return text, hero_picture(identification, *pair)._replace(clock=clock_of(pair[0].log))


def _logs(identification: Identification, simulations: Sequence[Simulation]) -> Blocks:
    seen: dict[int, tuple[str, CellLog]] = {}
    for found in identification.temperatures:
        for one in found.pulse_sets:
            seen[id(one.log)] = ("identification: pulses", one.log)
    for s in identification.simulations:
        seen.setdefault(id(s.log), ("identification: drive", s.log))
    for s in simulations:
        seen.setdefault(id(s.log), ("held out: validation", s.log))
    tests = list(dict.fromkeys(t.name for t in identification.capacity_tests))
    more = f" Capacity and OCV come from {listed(tests)}." if tests else ""
    text = "Everything below is computed from these logs; positive current discharges."
    logs = record_table(
        seen.values(),
        ("log", lambda one: clock_of(one[1])),
        ("used for", lambda one: one[0]),
        ("rows", lambda one: counted(len(one[1]))),
        ("length", lambda one: duration(one[1].duration_s)),
        ("current", lambda one: f"{' to '.join(map(significant, _ends(one[1].current_A)))} A"),
        ("voltage", lambda one: "{:.2f} to {:.2f} V".format(*_ends(one[1].voltage_V))),
        text_columns=(0, 1),
    )
    return paragraph(text + more), logs


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def _pulses(identification: Identification) -> Blocks:
    if not any(s.pulses for _, s in pulse_sets(identification)):
        return ()
    example = pulse_example_picture(identification)
    return (
        *(() if example is None else (example,)),
        pulse_picture(identification),
        details("Pulses in numbers", pulse_content(identification)),
    )


def _held_out(simulations: Sequence[Simulation]) -> Blocks:
    if not simulations:
        return ()
    return (
        paragraph(simulation_finding(simulations)),
        simulation_content(simulations),
        *simulation_pictures(simulations, "held-out"),
    )


def _soc(replays: Sequence[Replay]) -> Blocks:
    if not replays:
        return ()
    return (
        paragraph(f"{plural(len(replays), 'replay')} of the held-out logs, row by row:"),
        bullets(replay_finding(r) for r in replays),
        *comparison_pictures(replays),
        *replay_pictures(replays[:1]),
        details("All figures of the replays", replay_content(replays)),
    )

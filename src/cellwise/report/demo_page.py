"""The page that ``make demo`` ends with: from laboratory logs to SOC on the road."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import Replay
from cellwise.identify.identification import Identification
from cellwise.notices import Code, coded
from cellwise.report.identification.page import (
    cell_name,
    fitted_logs,
    identify_sections,
    identify_tiles,
)
from cellwise.report.identification.simulation_section import simulation_blocks, simulation_finding
from cellwise.report.page.markup import bullets, details, lead_of, paragraph
from cellwise.report.page.numerals import ampere_hours, capitalised, millivolt, plural
from cellwise.report.page.picture import Figures
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.report.replay.page import replay_data
from cellwise.report.replay.replay_section import replay_content, replay_finding, replay_plots

INTRODUCTION = (
    "A battery's state of charge cannot be measured, only inferred from current, voltage and "
    "temperature. cellwise does it in two steps: in the laboratory it identifies a model of the "
    "cell, a small electric circuit whose parts change with the state of charge; on the road a "
    "Kalman filter runs this model beside the cell and corrects itself by what it sees."
)


def demo_page(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
    path: str | Path,
    *,
    figures: Figures = None,
) -> Path:
    """Write one page from tests to SOC, every plot explained for a newcomer.

    Parameters
    ----------
    identification : Identification
    simulations : of Simulation   drives that were not fitted
    replays : of Replay           the first one from a wrong start, of a simulated log
    path, figures : as of `write_page`, whose errors it raises
    """
    judged = [replay_finding(r) for r in replays if r.settled is not None][:1]
    off = (n for r in replays for n in coded(r.notices, Code.MODEL_OFF) if n not in r.log.notices)
    judged += [f"{capitalised(n.text)}." for n in off][:1]
    return write_page(
        path,
        demo_finding(identification, simulations),
        f"cellwise demo on {cell_name(identification)}",
        demo_sections(identification, simulations, replays),
        {"identification": identification.to_dict(), **replay_data(replays, simulations)},
        lead=lead_of((), identify_tiles(identification), judged),
        figures=figures,
    )


def demo_finding(identification: Identification, simulations: Sequence[Simulation]) -> str:
    """The main result in short."""
    model = identification.model
    own = f"{millivolt(identification.fit.rmse_V)} RMSE on its own {fitted_logs(identification)}"
    text = f"{model.name or 'The cell'}, {ampere_hours(model.capacity_Ah)}: {own}"
    known = [s.rmse_above_10pct_V for s in simulations if np.isfinite(s.rmse_above_10pct_V)]
    if known:
        text += f", {millivolt(float(np.mean(known)))} on {plural(len(known), 'drive')} not seen"
    return f"{text}."


def demo_sections(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
) -> tuple[Section, ...]:
    """SOC on the road, the drives that the model has not seen, then how it was identified."""
    parts = []
    if replays:
        soc: Blocks = (
            paragraph(INTRODUCTION),
            bullets(replay_finding(r) for r in replays),
            *replay_plots(replays),
            details("All figures of the replays", replay_content(replays)),
        )
        parts.append(Section("soc", "State of charge on the road", soc, "State of charge"))
    if simulations:
        drives = (
            paragraph(simulation_finding(simulations)),
            *simulation_blocks(simulations, "held-out"),
        )
        title = "Does it predict drives it was not fitted on?"
        parts.append(Section("held-out", title, drives, "Held-out drives"))
    return (*parts, *identify_sections(identification))

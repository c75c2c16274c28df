"""The page of an identification: OCV, capacity, pulses, parameters, fit, provenance."""

from __future__ import annotations

from pathlib import Path

from cellwise.identify.identification import Identification
from cellwise.report.findings import identify_finding
from cellwise.report.identification.capacity_section import capacity_content, capacity_picture
from cellwise.report.identification.ocv_section import ocv_content, ocv_evidence, ocv_picture
from cellwise.report.identification.parameter_section import parameter_content, parameter_picture
from cellwise.report.identification.provenance_section import provenance_content, scope_content
from cellwise.report.identification.pulse_section import pulse_content, pulse_picture, pulse_sets
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page.interactive import simulation_traces, trace_section
from cellwise.report.page.jumps import clock_of, linked_among
from cellwise.report.page.markup import Markup, bullets, lead_of, paragraph, tiles
from cellwise.report.page.numerals import (
    ampere_hours,
    millivolt,
    plural,
    significant,
)
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Blocks, Section, write_page


def identify_page(
    identification: Identification,
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write the page of an identification: OCV, capacity, pulses, tables, fit, provenance.

    Parameters
    ----------
    identification : Identification
    path : str or Path            of the HTML file; it appears whole or not at all
    figures : folder or FigureFiles   for the same pictures as PNG and SVG files

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    return write_page(
        path,
        identify_finding(identification),
        f"Identification of {cell_name(identification)}, by cellwise",
        identify_sections(identification),
        identification.to_dict(),
        lead=lead_of(_alerts(identification), identify_tiles(identification)),
        figures=figures,
    )


def identify_sections(identification: Identification) -> tuple[Section, ...]:
    """The parts of an identification's page."""
    evidence = ocv_evidence(identification)
    simulations = identification.simulations
    ocv = (ocv_picture(identification, evidence), ocv_content(identification, evidence))
    capacity = (capacity_picture(identification), capacity_content(identification))
    parameters = (parameter_picture(identification), parameter_content(identification))
    fit: Blocks = (simulation_content(simulations), *simulation_pictures(simulations, "fit"))
    scope = (scope_content(identification),)
    provenance = (provenance_content(identification),)
    traces = [
        (f"{clock_of(s.log)}, measured and simulated", simulation_traces(s)) for s in simulations
    ]
    sections = [
        Section("ocv", "Open-circuit voltage", ocv),
        Section("capacity", "Capacity", capacity),
        Section("parameters", "Parameters", parameters),
        Section("fit", "Measured and simulated", fit),
        trace_section(traces),
        Section("scope", "What the model explains, and where it ends", scope, "Scope"),
        Section("provenance", "Where every number came from", provenance, "Provenance"),
    ]
    if any(s.pulses for _, s in pulse_sets(identification)):
        pulses = (pulse_picture(identification), pulse_content(identification))
        sections.insert(2, Section("pulses", "Pulses", pulses))
    return tuple(sections)


def cell_name(identification: Identification) -> str:
    """Name and chemistry of the identified cell."""
    model = identification.model
    name = model.name or "the cell"
    return f"{name} ({model.chemistry})" if model.chemistry else name


def identify_tiles(identification: Identification) -> Markup:
    """Key figures of an identification."""
    counts, fit = identification.pulse_counts, identification.fit
    capacity = ampere_hours(identification.model.capacity_Ah)
    facts = [
        (f"capacity ({identification.capacity_choice})", capacity),
        ("RMSE on its own logs", millivolt(fit.rmse_V)),
        ("MAE on its own logs", millivolt(fit.mae_V)),
        ("largest error", millivolt(fit.max_error_V)),
    ]
    if sum(counts.values()):
        facts.append(("healthy pulses", f"{counts['healthy']} of {sum(counts.values())}"))
    facts.append(("time taken", f"{significant(identification.seconds, 2)} s"))
    return tiles(facts)


def notices(identification: Identification) -> Markup:
    """What a person should know before believing the numbers."""
    if not identification.notices:
        return Markup("")
    text = paragraph(f"{plural(len(identification.notices), 'notice')} on the way:")
    return Markup(text + bullets(identification.notices, "notices"))


def _alerts(identification: Identification) -> list[Markup]:
    logs = [s.log for s in identification.simulations]
    # What the OCV was made of stands beside it and is no alert.
    said = [n for n in identification.notices if n not in identification.ocv.notes]
    return [linked_among(notice, logs) for notice in said]

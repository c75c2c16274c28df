"""The page of an identification: its parts, where every number came from, where the model ends."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cell.effects import (
    ChargeTransfer,
    Hysteresis,
    SelfHeating,
    SlowDiffusion,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.identify.identification import Identification, OwnLog
from cellwise.report.findings import identify_finding
from cellwise.report.identification.capacity_and_ocv import (
    capacity_content,
    capacity_picture,
    ocv_content,
    ocv_evidence,
    ocv_picture,
)
from cellwise.report.identification.parameter_section import parameter_content, parameter_picture
from cellwise.report.identification.pulse_section import pulse_content, pulse_picture, pulse_sets
from cellwise.report.identification.simulation_section import (
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page.markup import (
    Markup,
    bullets,
    clock_of,
    details,
    escape,
    finite,
    lead_of,
    linked_among,
    paragraph,
    record_table,
    table,
    tiles,
)
from cellwise.report.page.numerals import (
    ampere_hours,
    celsius,
    listed,
    millivolt,
    percent,
    plural,
    significant,
)
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import (
    Blocks,
    Section,
    simulation_traces,
    trace_section,
    write_page,
)

WORDS = {
    "r0_ohm": "R₀",
    "r1_ohm": "R₁",
    "tau1_s": "τ₁",
    "r2_ohm": "R₂",
    "tau2_s": "τ₂",
    "r3_ohm": "R₃",
    "tau3_s": "τ₃",
}


def provenance_content(identification: Identification) -> Markup:
    """One row per quantity of the model: value, where from, how, how sure."""
    rows = [
        *_capacity_rows(identification),
        *_ocv_rows(identification),
        *_table_rows(identification),
        *_effect_rows(identification),
        *_error_rows(identification),
    ]
    found = table(
        ("quantity", "value", "from", "how", "standard error (median)"), rows, text_columns=range(5)
    )
    record = json.dumps(
        finite(identification.model.provenance), indent=2, ensure_ascii=False, allow_nan=False
    )
    full = Markup(f"<pre>{escape(record)}</pre>")
    return Markup(found + details("The model's own record", full))


def _capacity_rows(identification: Identification) -> list[tuple[object, ...]]:
    choice = identification.capacity_choice
    tests = [t.name for t in identification.capacity_tests if t.complete]
    source = {"nominal": "the user", "hppc-total": "the HPPC log"}.get(
        choice, listed(list(dict.fromkeys(tests))) or "the capacity tests"
    )
    value = ampere_hours(identification.model.capacity_Ah)
    return [("capacity", value, source, f"choice {choice}", "")]


def _ocv_rows(identification: Identification) -> list[tuple[object, ...]]:
    curve, model = identification.ocv, identification.model
    value = f"{model.ocv_V.min():.3f} to {model.ocv_V.max():.3f} V"
    how = f"{curve.function.kind}, {plural(curve.points_soc.size, 'point')}"
    errors = _errors(identification, "ocv_V")
    text = listed([millivolt(e) for e in errors])
    refined = ", corrected by refinement" if errors else ""
    return [("OCV", value, curve.source, how + refined, text)]


def _table_rows(identification: Identification) -> list[tuple[object, ...]]:
    model = identification.model
    provenance = _mapping(model.provenance.get("pulses"))
    fitted = sum(len(s.fits) for t in identification.temperatures for s in t.pulse_sets)
    pulses = f"{plural(fitted, 'pulse')} by {provenance.get('method', 'fit')}" if fitted else ""
    logs = listed(
        [p.name for t in identification.temperatures if t.refinement for p in t.refinement.logs]
    )
    refined = "then least squares over whole logs" if pulses else "least squares over whole logs"
    how = "; ".join(part for part in (pulses, refined if logs else "") if part)
    source = logs or listed([s.log.name for t in identification.temperatures for s in t.pulse_sets])
    tables: dict[str, Any] = {name: getattr(model, name, None) for name in WORDS}
    slow = model.effect(SlowDiffusion)
    if np.any(np.asarray(slow.r3_ohm) > 0.0):
        tables |= {"r3_ohm": slow.r3_ohm, "tau3_s": slow.tau3_s}
    rows: list[tuple[object, ...]] = []
    for name, value in tables.items():
        if value is None:
            continue
        v = np.asarray(value)
        factor, unit = (1e3, "mΩ") if name.endswith("ohm") else (1.0, "s")
        text = f"{significant(factor * v.min())} to {significant(factor * v.max())} {unit}"
        note = listed([percent(e, 1) for e in _errors(identification, name)])
        rows.append((WORDS[name], text, source, how, note))
    return rows


def _effect_rows(identification: Identification) -> list[tuple[object, ...]]:
    model = identification.model
    rows: list[tuple[object, ...]] = []
    names = {e.name for e in model.effects}
    how = "fitted in the refinement"
    if Hysteresis.name in names:
        h = model.effect(Hysteresis)
        text = f"M up to {millivolt(float(np.max(h.m_V)))}, γ {significant(float(h.gamma))}"
        note = listed([millivolt(e) for e in _errors(identification, "m_V")])
        rows.append(("hysteresis", text, "gap of the branches", how, note))
    if TemperatureDependence.name in names:
        t = model.effect(TemperatureDependence)
        text = f"{significant(float(t.activation_K))} K at {celsius(t.reference_C)}"
        rows.append(("Arrhenius activation", text, "measured temperatures", how, ""))
    if TimeSkew.name in names:
        skew = model.effect(TimeSkew).skew_s
        rows.append(("sampling delay", f"{significant(skew)} s", "the drives", how, ""))
    held_out = "accepted on logs held out"
    if ChargeTransfer.name in names:
        k = model.effect(ChargeTransfer).asinh_per_V
        rows.append(("charge transfer", f"k = {significant(k)} / V", "the loads", held_out, ""))
    if SurfaceSoc.name in names:
        surface = model.effect(SurfaceSoc)
        text = f"{percent(surface.depth_h)} of SOC at 1C, after {significant(surface.tau_s)} s"
        rows.append(("surface SOC", text, "the loads", held_out, ""))
    if SelfHeating.name in names:
        heat = model.effect(SelfHeating)
        text = f"{significant(heat.rth_K_per_W)} K/W, {significant(heat.thermal_s)} s"
        rows.append(("self-heating", text, "the loads", held_out, ""))
    return rows


def _error_rows(identification: Identification) -> list[tuple[object, ...]]:
    """What the model may be off by, a row for each time scale."""
    error = identification.model.error
    soc = np.linspace(0.05, 0.95, 19)
    rows: list[tuple[object, ...]] = []
    for k, scale in enumerate(error.scales_s):
        size = np.sqrt(error.variance_V2(k, soc))
        text = (
            f"{millivolt(float(np.median(size)))} (up to {millivolt(float(size.max()))}); "
            f"{percent(error.shares()[k], 1)} of the polarisation, "
            f"charging {percent(error.shares(-1.0)[k], 1)}"
        )
        name = f"voltage error over {significant(scale)} s"
        rows.append((name, text, "logs left out of the fit", "likelihood", ""))
    back = f"{percent(error.persistent_share)} of the slowest"
    rows.append(
        ("voltage error that comes back", back, "logs of a temperature", "their number", "")
    )
    return rows


def _errors(identification: Identification, name: str) -> list[float]:
    """Median standard errors of a quantity, one per refined temperature."""
    stages: Sequence[Any] = identification.model.provenance.get("refinement", ())
    found = [_mapping(_mapping(stage).get("standard_error")).get(name) for stage in stages]
    return [float(v) for v in found if v is not None]


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


ROLES = {"hppc": "HPPC", "ocv": "low rate", "capacity": "capacity", "drive": "drive"}


def scope_content(identification: Identification) -> Markup:
    """Tables of every log given, of the effects that were tried, and of the validity."""
    return Markup(
        _own_logs(identification.own_logs) + _effects(identification) + _validity(identification)
    )


def _own_logs(logs: tuple[OwnLog, ...]) -> Markup:
    return record_table(
        logs,
        ("log", lambda own: clock_of(own.simulation.log)),
        ("test", lambda own: ROLES[own.role]),
        ("in the fit", lambda own: "yes" if own.used else "no"),
        ("initial SOC", lambda own: percent(own.simulation.soc0)),
        ("RMSE", lambda own: millivolt(own.simulation.metrics.rmse_V)),
        ("above 10 % SOC", lambda own: _volt(own.simulation.rmse_above_10pct_V)),
        ("discharge", lambda own: _volt(own.sides_V.get("discharge"))),
        ("charge", lambda own: _volt(own.sides_V.get("charge"))),
        ("remarks", lambda own: own.reason),
        caption="Every log given, simulated back with the finished model from its initial SOC.",
        text_columns=(0, 1, 2, 8),
    )


def _effects(identification: Identification) -> Markup:
    return record_table(
        identification.to_dict()["effects"],
        ("effect", lambda one: str(one["name"]).replace("_", " ")),
        ("decision", lambda one: "in the model" if one["accepted"] else "refused"),
        ("gain", lambda one: "" if one["gain"] is None else percent(one["gain"])),
        ("why", lambda one: one["reason"]),
        caption="Effects beyond the two RC branches. Gain: fall of the RMSE on logs held out.",
        text_columns=(0, 1, 3),
    )


def _validity(identification: Identification) -> Markup:
    validity = identification.model.validity
    rows: list[tuple[str, str]] = []
    if validity.soc is not None:
        rows.append(("SOC", " to ".join(percent(v) for v in validity.soc)))
    if validity.temperature_C is not None:
        logs = [one.log for one in identification.simulations]
        measured = not logs or any(log.temperature_C is not None for log in logs)
        range_C = " to ".join(celsius(v) for v in validity.temperature_C)
        rows.append(("temperature", range_C if measured else f"{range_C}, taken: none measured"))
    if validity.current_A is not None:
        rows.append(("current", " to ".join(significant(v) for v in validity.current_A) + " A"))
    if not rows:
        return Markup("")
    return table(
        ("quantity", "covered by the data"),
        rows,
        caption="Outside, every command says so and the standard deviation grows.",
        text_columns=(0, 1),
    )


def _volt(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else millivolt(value)


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

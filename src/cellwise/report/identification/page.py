"""The page of an identification: its parts, where every number came from, where the model ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.arguments import check_kind
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import Simulation
from cellwise.identify.identification import Identification, OwnLog
from cellwise.report.identification.measured_sections import (
    capacity_content,
    ocv_content,
    ocv_pictures,
    pulse_content,
    pulse_pictures,
    pulse_sets,
)
from cellwise.report.identification.parameter_section import (
    parameter_content,
    parameter_pictures,
)
from cellwise.report.identification.simulation_section import simulation_blocks
from cellwise.report.page.markup import (
    Markup,
    bullets,
    clock_of,
    lead_of,
    linked_among,
    paragraph,
    record_table,
    table,
    tiles,
)
from cellwise.report.page.numerals import (
    SPACE,
    ampere_hours,
    capitalised,
    celsius,
    duration,
    listed,
    millivolt,
    percent,
    plural,
    significant,
    spoken_name,
)
from cellwise.report.page.picture import Figures
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.typing import FloatArray

EFFECTS = {
    "slow_diffusion": "a slow third branch",
    "hysteresis": "hysteresis",
    "temperature_dependence": "an Arrhenius factor",
    "time_skew": "the sampling delay of the logger",
}
LEAST_CAPACITY_STD = 0.005  # of ln of it: a test of the whole charge measures it better
NOT_JUDGED = (
    "Every log here took part in the fit: judge the model on another one "
    "(cellwise simulate, replay or diagnose)."
)


def identify_finding(identification: Identification) -> str:
    """What an identification found: the capacity, and the error on what it saw and did not see."""
    model = identification.model
    error = millivolt(identification.fit.rmse_V)
    text = ampere_hours(model.capacity_Ah)
    if model.posterior is not None and model.posterior.capacity_std > LEAST_CAPACITY_STD:
        band = significant(2.0 * model.capacity_std_Ah, 2)
        text = f"{significant(model.capacity_Ah)} ± {band}{SPACE}Ah"
    text += f": {error} RMSE on its own {fitted_logs(identification)}"
    if unseen := unseen_drives(identification):
        worst = float(np.max([s.rmse_V for s in unseen]))
        one = len(unseen) == 1
        where = unseen[0].log.name or "a log" if one else plural(len(unseen), "log")
        text += f", {'' if one else 'at most '}{millivolt(worst)} on {where} outside the fit"
    return f"{text}."


def unseen_drives(identification: Identification) -> list[Simulation]:
    """The drives that were given and took no part in the fit."""
    return [o.simulation for o in identification.own_logs if not o.used and o.role == "drive"]


def fitted_logs(identification: Identification) -> str:
    """How many logs took part in the fit, as text."""
    logs = sum(own.used for own in identification.own_logs)
    return "log" if logs == 1 else plural(logs, "log")


def model_kind(identification: Identification) -> str:
    """``2-RC model with a slow third branch and hysteresis``."""
    extra = [EFFECTS.get(e.name, spoken_name(e.name)) for e in identification.model.effects]
    return "2-RC model" + (f" with {listed(extra)}" if extra else "")


def provenance_content(identification: Identification) -> Markup:
    """How the tables came about, the effects, what the model may be off by."""
    model = identification.model
    return table(
        ("of the model", "value"),
        [*_effect_rows(model), *_error_rows(model)],
        caption=f"{_how(identification)} Voltage errors are from logs left out of the fit.",
        text_columns=(0, 1),
    )


def _how(identification: Identification) -> str:
    """How the tables came about, and of which logs."""
    sets = [s for t in identification.temperatures for s in t.pulse_sets]
    fitted = sum(len(s.fits) for s in sets)
    logs = [
        p.item.log.name
        for t in identification.temperatures
        if t.refinement
        for p in t.refinement.logs
    ]
    how = [plural(fitted, "pulse")] * bool(fitted) + ["least squares over whole logs"] * bool(logs)
    names = listed(list(dict.fromkeys(logs or [s.log.name for s in sets])))
    return f"Resistances and time constants: {', then '.join(how)}, of {names}." if how else ""


def _effect_rows(model: CellModel) -> list[tuple[str, str]]:
    """Every effect of the model with its parameters, whose names carry their units."""
    rows = []
    for effect in model.effects:
        values = ((one.name, np.asarray(getattr(effect, one.name))) for one in fields(effect))
        known = (f"{name} {_spread(v)}" for name, v in values if v.dtype.kind == "f" and v.any())
        rows.append((spoken_name(effect.name), ", ".join(known)))
    return rows


def _spread(values: FloatArray) -> str:
    """One value, or the lowest and the highest of a table."""
    ends = dict.fromkeys((significant(float(values.min())), significant(float(values.max()))))
    return " to ".join(ends)


def _error_rows(model: CellModel) -> list[tuple[str, str]]:
    """What the model may be off by, a row for each time scale."""
    soc = np.linspace(0.05, 0.95, 19)
    rows = []
    for k, scale in enumerate(model.error.scales_s):
        size = np.sqrt(model.error.variance_V2(k, soc))
        text = f"{millivolt(float(np.median(size)))}, at most {millivolt(float(size.max()))}"
        share = model.error.shares()[k]
        more = f", and {percent(share, 1)} of the polarisation" if share > 5e-4 else ""
        rows.append((f"voltage error over {duration(scale)}", text + more))
    return rows


ROLES = {"hppc": "HPPC", "ocv": "low rate", "capacity": "capacity", "drive": "drive"}


def scope_content(identification: Identification) -> Markup:
    """Tables of every log given, of the effects that were tried, and of the validity."""
    return Markup(
        _own_logs(identification.own_logs) + _effects(identification) + _validity(identification)
    )


# Of a log that was given: how it reads on a page and in a command.
OWN_COLUMNS: tuple[tuple[str, Callable[[OwnLog], str]], ...] = (
    ("log", lambda own: clock_of(own.simulation.log)),
    ("RMSE", lambda own: millivolt(own.simulation.rmse_V)),
    ("above 10 % SOC", lambda own: _volt(own.simulation.rmse_above_10pct_V)),
    ("discharge", lambda own: _volt(own.sides_V.get("discharge"))),
    ("charge", lambda own: _volt(own.sides_V.get("charge"))),
    ("initial SOC", lambda own: percent(own.simulation.soc0)),
    ("test", lambda own: ROLES[own.role]),
    ("in the fit", lambda own: "yes" if own.used else "no"),
)


def _own_logs(logs: tuple[OwnLog, ...]) -> Markup:
    caption = "Every log given, simulated back with the finished model from its initial SOC."
    found = record_table(logs, *OWN_COLUMNS, caption=caption, text_columns=(0, 6, 7))
    remarks = [f"{clock_of(own.simulation.log)}: {own.reason}" for own in logs if own.reason]
    return Markup(found + bullets(remarks))


def _effects(identification: Identification) -> Markup:
    def name(one: Mapping[str, Any]) -> str:
        return spoken_name(str(one["name"]))

    effects = identification.to_dict()["effects"]
    plain = [one for one in effects if one["accepted"] and one["gain"] is None]
    tried = [one for one in effects if one not in plain]
    said = [f"{capitalised(listed([*map(name, plain)]))}: {plain[0]['reason']}."] if plain else []
    return Markup(
        "".join(map(paragraph, said))
        + (
            record_table(
                tried,
                ("effect", name),
                ("decision", lambda one: "in the model" if one["accepted"] else "refused"),
                ("gain", lambda one: "" if one["gain"] is None else percent(one["gain"])),
                ("why", lambda one: one["reason"]),
                caption="Effects that were tried. Gain: fall of the RMSE on logs held out.",
                text_columns=(0, 1, 3),
            )
            if tried
            else ""
        )
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
    covered = "; ".join(f"{name} {text}" for name, text in rows)
    text = f"Covered by the data: {covered}. Outside, every command says so."
    return paragraph(text) if rows else Markup("")


def _volt(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else millivolt(value)


def identify_page(
    identification: Identification,
    path: str | Path,
    *,
    figures: Figures = None,
) -> Path:
    """Write the page of an identification: OCV, capacity, pulses, tables, fit, provenance.

    Parameters
    ----------
    identification : Identification
    path, figures : as of `write_page`, whose errors it raises
    """
    check_kind("identification", identification, Identification, "Pass what identify_cell gives.")
    return write_page(
        path,
        identify_finding(identification),
        f"{model_kind(identification)} of {cell_name(identification)}, by cellwise",
        identify_sections(identification),
        identification.to_dict(),
        lead=lead_of(
            _alerts(identification),
            identify_tiles(identification),
            () if unseen_drives(identification) else (NOT_JUDGED,),
        ),
        figures=figures,
    )


def identify_sections(identification: Identification) -> tuple[Section, ...]:
    """The parts of an identification's page."""
    ocv: Blocks = (*ocv_pictures(identification), ocv_content(identification))
    capacity = (capacity_content(identification),)
    parameters: Blocks = (parameter_content(identification), *parameter_pictures(identification))
    fit = simulation_blocks(identification.simulations, "fit")
    scope = (scope_content(identification),)
    provenance = (provenance_content(identification),)
    sections = [
        Section("scope", "What the model explains, and where it ends", scope, "Scope"),
        Section("ocv", "Open-circuit voltage", ocv),
        Section("capacity", "Capacity", capacity),
        Section("parameters", "Parameters", parameters),
        Section("fit", "Measured and simulated", fit),
        Section("provenance", "Where every number came from", provenance, "Provenance"),
    ]
    if any(s.pulses for _, s in pulse_sets(identification)):
        pulses: Blocks = (*pulse_pictures(identification), pulse_content(identification))
        sections.insert(3, Section("pulses", "Pulses", pulses))
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
    updated = "updated" in identification.capacities
    choice = "updated" if updated else identification.capacity_choice
    limits = identification.model.validity.temperature_C
    facts = [
        (f"capacity ({choice})", capacity),
        ("RMSE on the logs of the fit", millivolt(fit.rmse_V)),
        ("largest error there", millivolt(fit.max_error_V)),
    ]
    if limits is not None:
        facts.append(("temperature of the data", " to ".join(celsius(v) for v in limits)))
    if sum(counts.values()):
        facts.append(("healthy pulses", f"{counts['healthy']} of {sum(counts.values())}"))
    return tiles(facts)


def _alerts(identification: Identification) -> list[Markup]:
    logs = [s.log for s in identification.simulations]
    # What the OCV was made of stands beside it and is no alert.
    said = [n for n in identification.notices if n not in identification.ocv.notes]
    return [linked_among(notice, logs) for notice in said]

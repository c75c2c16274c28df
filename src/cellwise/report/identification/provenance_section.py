"""Where every number came from, what the model explains, and where it ends."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
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
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.markup import Markup, details, escape, finite, record_table, table
from cellwise.report.page.numerals import (
    ampere_hours,
    celsius,
    listed,
    millivolt,
    percent,
    plural,
    significant,
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

"""Where every number came from: one row per quantity, and the model's own record in full."""

from __future__ import annotations

import json
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
from cellwise.identify.identification import Identification
from cellwise.report.page.markup import Markup, details, escape, finite, table
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

"""Capacity by rate and choice, as the LFP paper lays it out; the OCV and what it stands on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.identification import REFERENCE_C, Identification
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, beside, bullets, details, record_table
from cellwise.report.page.numerals import ampere_hours, millivolt, percent, plural, significant
from cellwise.report.page.picture import pictured
from cellwise.typing import FloatArray

FLAT_V = 0.12  # between 20 and 80 % SOC: a plateau, on which voltage says little about charge


def capacity_rows(identification: Identification) -> tuple[CapacityRow, ...]:
    """Means per rate over the tests that count; none without a complete test."""
    try:
        return capacity_table(usable_tests(identification.capacity_tests))
    except InputError:
        return ()


def capacity_content(identification: Identification) -> Markup:
    """Table of the rates, table of the choices with the taken one marked, tests left out."""
    rows = capacity_rows(identification)
    whole = rows[0].total_Ah if rows else None
    taken = identification.model.capacity_Ah
    # An update of a prior moves the chosen capacity: then it has a row of its own.
    same = [n for n, q in identification.capacities.items() if abs(q / taken - 1.0) < 1e-9]
    chosen = identification.capacity_choice
    names = list(identification.capacities)
    marked = chosen if chosen in same or not same else same[0]
    held = any(row.cv_Ah > 5e-4 * row.total_Ah for row in rows)
    columns: list[tuple[object, Any]] = [
        ("rate", lambda row: row.rate),
        ("total", lambda row: ampere_hours(row.total_Ah, whole)),
    ]
    if held:
        columns += [
            ("CC part", lambda row: ampere_hours(row.cc_Ah, whole)),
            ("CV part", lambda row: ampere_hours(row.cv_Ah, whole)),
        ]
    columns.append(("tests", lambda row: row.n))
    if any(row.n > 1 for row in rows):
        columns.append(
            ("spread", lambda row: ampere_hours(row.spread_Ah, whole) if row.n > 1 else "")
        )
    if any(row.coulombic_efficiency is not None for row in rows):
        columns.append(("coulombic efficiency", lambda row: _efficiency(row.coulombic_efficiency)))
    rates = record_table(
        rows,
        *columns,
        caption="Charge taken out from full to the lower limit, mean per rate"
        + (": at constant current (CC), and while the limit was held (CV)." if held else "."),
    )
    choices = record_table(
        identification.capacities.items(),
        ("choice", lambda one: one[0]),
        ("capacity", lambda one: ampere_hours(one[1], taken)),
        ("against the taken one", lambda one: percent(one[1] / taken - 1.0, 1)),
        caption="What could be called the capacity; the marked one defines SOC, and a wrong one "
        "tilts every table.",
        marked=names.index(marked) if marked in names else None,
    )
    lines = [
        f"{test.name} ({significant(test.current_A)} A): {notice}"
        for test in identification.capacity_tests
        for notice in test.notices
    ]
    notes = details("Notices on single tests", bullets(lines)) if lines else ""
    return Markup(beside(rates if rows else "", choices) + notes)


def _efficiency(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


class Rests(NamedTuple):
    """Measured voltages at rest: ``soc`` and ``voltage_V`` (n,), empty without an HPPC log."""

    soc: FloatArray
    voltage_V: FloatArray


def measured_rests(identification: Identification) -> Rests:
    """The rests of the HPPC log that is nearest to the OCV's temperature."""
    logs = [
        (abs(t.temperature_C - REFERENCE_C), t.pulse_sets[0].log)
        for t in identification.temperatures
        if t.pulse_sets
    ]
    try:
        _, log = min(logs, key=lambda one: one[0])
        found = ocv_from_rests(log, capacity_Ah=identification.model.capacity_Ah)
    except (ValueError, InputError):  # no log, or one without rests: the curve came from elsewhere
        return Rests(np.empty(0), np.empty(0))
    return Rests(found.points_soc, found.points_V)


def ocv_content(identification: Identification) -> Markup:
    """Where the curve came from."""
    curve = identification.ocv
    notes = bullets(curve.notes)
    return details(f"Where the OCV came from: {curve.source}", notes) if notes else notes


def _ocv_caption(identification: Identification) -> str:
    curve = identification.ocv
    slow = curve.discharge_V is not None or curve.charge_V is not None
    text = (
        "The model's OCV, and what it stands on. Below: by how much each measurement lies above it."
        if slow or measured_rests(identification).soc.size
        else "The model's OCV; no rest and no slow test was measured."
    )
    if curve.discharge_V is not None and curve.charge_V is not None:
        text += " The gap of slow charge and discharge is polarisation and hysteresis together."
    return text + style.no_data_text(identification.model.validity.soc)


@pictured("ocv", _ocv_caption)
def ocv_picture(identification: Identification) -> style.Figure:
    """The model's curve with branches and rests; what they lie above it."""
    curve, model, rests = identification.ocv, identification.model, measured_rests(identification)
    known = (curve.discharge_V, curve.charge_V, rests.soc if rests.soc.size else None)
    measured = any(one is not None for one in known)
    figure = style.new_figure(5.4 if measured else 3.3)
    heights = (1.5, 1.0) if measured else (1.0,)
    rows = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)
    top, below = rows[0, 0], rows[-1, 0]
    row = int(np.argmin(np.abs(model.temperature_C - REFERENCE_C)))
    ocv_V = np.interp(curve.soc, model.soc, model.ocv_V[row])
    shown: list[FloatArray] = []
    for name, level_V, colour in (
        ("slow discharge", curve.discharge_V, style.SKY),
        ("slow charge", curve.charge_V, style.GREEN),
    ):
        if level_V is not None:
            top.plot(100.0 * curve.soc, level_V, color=colour, linewidth=1.4, label=name)
            below.plot(100.0 * curve.soc, 1e3 * (level_V - ocv_V), color=colour, label=name)
            shown.append(1e3 * (level_V - ocv_V)[(curve.soc > 0.05) & (curve.soc < 0.95)])
    top.plot(100.0 * curve.soc, ocv_V, color=style.MODEL, linewidth=1.6, label="model")
    title = "No rest was measured"
    if rests.soc.size:
        looks: dict[str, Any] = {"color": style.INK, "markersize": 3.0, "zorder": 4}
        name = plural(rests.soc.size, "rest")
        top.plot(100.0 * rests.soc, rests.voltage_V, "o", label=name, **looks)
        error_V = rests.voltage_V - np.interp(rests.soc, model.soc, model.ocv_V[row])
        below.plot(100.0 * rests.soc, 1e3 * error_V, "o", label=name, **looks)
        shown.append(1e3 * error_V)
        title = f"Rests lie {millivolt(float(np.median(np.abs(error_V))))} from it in the median"
    if measured:
        style.zero_line(below)
        errors = np.concatenate(shown)
        low, high = np.percentile(errors[np.isfinite(errors)], (2, 98))
        room = 0.15 * (high - low) + 2.0
        below.set_ylim(min(low, 0.0) - room, max(high, 0.0) + room)
        style.finding(below, title)
    span = float(np.ptp(ocv_V[(curve.soc >= 0.2) & (curve.soc <= 0.8)]))
    slope = f"{millivolt(span / 60.0)} per point of SOC between 20 and {percent(0.8, 0)}"
    flat = "; a plateau, where voltage says little about SOC" if span < FLAT_V else ""
    style.finding(top, f"OCV {ocv_V[0]:.3f} to {ocv_V[-1]:.3f} V, {slope}{flat}")
    if measured:
        style.labels(below, "SOC [%]", "minus the model [mV]")
    style.labels(top, "" if measured else "SOC [%]", "voltage [V]")
    for axes in {top, below}:
        style.soc_axis(axes, label=axes is below)
        style.no_data(axes, model.validity.soc)
    style.legend(top, place="lower right")
    return figure

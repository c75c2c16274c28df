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
from cellwise.report.page.picture import Picture, pictured
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
    rates = record_table(
        rows,
        ("rate", lambda row: row.rate),
        ("total", lambda row: ampere_hours(row.total_Ah, whole)),
        ("CC part", lambda row: ampere_hours(row.cc_Ah, whole) if _held(row) else ""),
        ("CV part", lambda row: ampere_hours(row.cv_Ah, whole) if _held(row) else ""),
        ("tests", lambda row: row.n),
        ("spread", lambda row: ampere_hours(row.spread_Ah, whole) if row.n > 1 else ""),
        ("coulombic efficiency", _efficiency),
        caption="Charge taken out from full to the lower limit, mean per rate; where the limit was "
        "held, at constant current (CC) and while it was held (CV).",
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


def _held(row: CapacityRow) -> bool:
    return row.cv_Ah > 5e-4 * row.total_Ah


def _efficiency(row: CapacityRow) -> str:
    return "" if row.coulombic_efficiency is None else f"{row.coulombic_efficiency:.4f}"


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


def _curve_caption(identification: Identification) -> str:
    return "The model's OCV, and what it stands on." + style.no_data_text(
        identification.model.validity.soc
    )


class _Curve(NamedTuple):
    """A measured branch or the rests: SOC, voltage, and what it lies above the model's OCV [V]."""

    name: str
    soc: FloatArray
    voltage_V: FloatArray
    above_V: FloatArray
    looks: dict[str, Any]


def _model_ocv(identification: Identification) -> FloatArray:
    """The model's OCV nearest to the reference temperature, on its own grid."""
    model = identification.model
    return np.asarray(model.ocv_V[int(np.argmin(np.abs(model.temperature_C - REFERENCE_C)))])


def _measured(identification: Identification) -> list[_Curve]:
    """Slow branches and rests that the OCV stands on."""
    curve, rests = identification.ocv, measured_rests(identification)
    dots = {"color": style.INK, "marker": "o", "linestyle": "", "markersize": 3.0, "zorder": 4}
    known = [
        ("slow discharge", curve.soc, curve.discharge_V, {"color": style.SKY, "linewidth": 1.4}),
        ("slow charge", curve.soc, curve.charge_V, {"color": style.GREEN, "linewidth": 1.4}),
        (plural(rests.soc.size, "rest"), rests.soc, rests.voltage_V, dots),
    ]
    ocv_V = _model_ocv(identification)
    return [
        _Curve(name, soc, volt, volt - np.interp(soc, identification.model.soc, ocv_V), looks)
        for name, soc, volt, looks in known
        if volt is not None and volt.size
    ]


@pictured("ocv", _curve_caption)
def ocv_picture(identification: Identification) -> style.Figure:
    """The model's curve with branches and rests."""
    figure, axes = style.new_axes()
    soc, ocv_V = identification.model.soc, _model_ocv(identification)
    for one in _measured(identification):
        axes.plot(100.0 * one.soc, one.voltage_V, label=one.name, **one.looks)
    axes.plot(100.0 * soc, ocv_V, color=style.MODEL, linewidth=1.6, label="model")
    span = float(np.ptp(ocv_V[(soc >= 0.2) & (soc <= 0.8)]))
    slope = f"{millivolt(span / 60.0)} per point of SOC between 20 and {percent(0.8, 0)}"
    flat = "; a plateau, where voltage says little about SOC" if span < FLAT_V else ""
    style.finding(axes, f"OCV {ocv_V[0]:.3f} to {ocv_V[-1]:.3f} V, {slope}{flat}")
    style.soc_axis(axes, "voltage [V]")
    style.no_data(axes, identification.model.validity.soc)
    style.legend(axes, place="lower right")
    return figure


@pictured(
    "ocv-measured",
    "By how much what was measured lies above the model's OCV. The gap of slow charge and "
    "discharge is polarisation and hysteresis together.",
)
def ocv_error_picture(identification: Identification) -> style.Figure:
    """What branches and rests lie above the model's curve."""
    figure, axes = style.new_axes()
    shown: list[FloatArray] = []
    title = "No rest was measured"
    for one in _measured(identification):
        axes.plot(100.0 * one.soc, 1e3 * one.above_V, label=one.name, **one.looks)
        rests = one.looks.get("marker")
        shown.append(one.above_V if rests else one.above_V[(one.soc > 0.05) & (one.soc < 0.95)])
        if rests:
            size = millivolt(float(np.median(np.abs(one.above_V))))
            title = f"Rests lie {size} from it in the median"
    errors = 1e3 * np.concatenate(shown)
    low, high = np.percentile(errors[np.isfinite(errors)], (2, 98))
    room = 0.15 * (high - low) + 2.0
    axes.set_ylim(min(low, 0.0) - room, max(high, 0.0) + room)
    style.zero_line(axes)
    style.finding(axes, title)
    style.soc_axis(axes, "minus the model [mV]")
    style.legend(axes)
    return figure


def ocv_pictures(identification: Identification) -> tuple[Picture, ...]:
    """The curve, and beside it what was measured where something was."""
    if not _measured(identification):
        return (ocv_picture(identification),)
    return ocv_picture(identification), ocv_error_picture(identification)

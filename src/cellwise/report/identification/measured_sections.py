"""What the tests gave: capacity by rate and choice (laid out as in the LFP paper), OCV, pulses."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.identification import REFERENCE_C, Identification, PulseSet
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.report.page import style
from cellwise.report.page.markup import (
    MOST,
    Markup,
    beside,
    bullets,
    details,
    record_table,
)
from cellwise.report.page.numerals import (
    ampere_hours,
    celsius,
    duration,
    listed,
    millivolt,
    percent,
    plural,
    significant,
)
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
    style.soc_axis(axes, "above the model [mV]")
    style.key_below(axes)
    return figure


def ocv_pictures(identification: Identification) -> tuple[Picture, ...]:
    """The curve, and beside it what was measured where something was."""
    if not _measured(identification):
        return (ocv_picture(identification),)
    return ocv_picture(identification), ocv_error_picture(identification)


def pulse_sets(identification: Identification) -> tuple[tuple[float, PulseSet], ...]:
    """Every HPPC log's pulses with their temperature [degC]."""
    return tuple((t.temperature_C, s) for t in identification.temperatures for s in t.pulse_sets)


def pulse_soc(found: PulseSet, capacity_Ah: float) -> FloatArray:
    """SOC at the start of each pulse, shape (pulses,)."""
    charge = found.log.counted_charge_Ah()
    starts = [max(p.start - 1, 0) for p in found.pulses]
    return np.asarray(found.anchor.soc - charge[starts] / capacity_Ah, dtype=np.float64)


def _warm(found: PulseSet, temperature_C: float) -> str:
    """The temperature of a log, and that it is taken where nobody measured or stated one."""
    known = found.log.temperature_C is not None
    return celsius(temperature_C) if known else f"{celsius(temperature_C)} (taken, not measured)"


def judged(found: PulseSet) -> list[Pulse]:
    """The pulses that count in the summary: the short ones, or the moves where there are none."""
    return [p for p in found.pulses if p.role == "pulse"] or list(found.pulses)


def verdict_counts(pulses: list[Pulse]) -> str:
    """``58 healthy, 8 trimmed``."""
    counts: Counter[str] = Counter(p.quality for p in pulses)
    return listed([f"{counts[q]} {q}" for q in style.VERDICTS if counts[q]]) or "none"


def pulse_content(identification: Identification) -> Markup:
    """Counts by log, and every pulse that was not healthy with its reason."""
    counts = record_table(
        pulse_sets(identification),
        ("log", lambda one: one[1].log.name or "HPPC"),
        ("temperature", lambda one: _warm(one[1], one[0])),
        ("pulses", lambda one: len(judged(one[1]))),
        *(
            (q, lambda one, q=q: sum(p.quality == q for p in judged(one[1])))
            for q in style.VERDICTS
        ),
        ("moves", lambda one: sum(p.role == "move" for p in one[1].pulses)),
        ("fitted", lambda one: len(one[1].fits)),
    )
    unhealthy = [
        (found.log.name or "HPPC", pulse, float(soc))
        for _, found in pulse_sets(identification)
        for pulse, soc in zip(
            found.pulses, pulse_soc(found, identification.model.capacity_Ah), strict=True
        )
        if pulse.quality != "healthy"
    ]
    if not unhealthy:
        return counts
    cut = "" if len(unhealthy) <= MOST.pulses else f" (the first {MOST.pulses})"
    reasons = record_table(
        unhealthy[: MOST.pulses],
        ("log", lambda one: one[0]),
        ("SOC", lambda one: percent(one[2], 1)),
        ("current", lambda one: f"{significant(one[1].current_A)} A"),
        ("duration", lambda one: duration(one[1].duration_s)),
        ("role", lambda one: one[1].role),
        ("verdict", lambda one: one[1].quality),
        ("why", lambda one: one[1].reason),
        text_columns=(0, 4, 5, 6),
    )
    summary = f"Why {plural(len(unhealthy), 'pulse')} and moves were not called healthy{cut}"
    return Markup(counts + details(summary, reasons))


VERDICTS = {
    "healthy": "Healthy: a passive circuit explains the response. Only healthy ones are fitted.",
    "trimmed": "Trimmed: a voltage limit cut the current.",
    "distorted": "Distorted: the response bends as no circuit does.",
    "spurious": "Spurious: a gap, no answer of the voltage, or far too short.",
}


def _caption(identification: Identification) -> str:
    """What the marks that are there mean."""
    sets = [s for _, s in pulse_sets(identification)[: MOST.plots]]
    found = {p.quality for s in sets for p in judged(s)}
    text = "Every short pulse at its SOC and current (discharge positive)"
    if any(len(judged(s)) < len(s.pulses) for s in sets):
        text += "; thin marks are the long moves between levels"
    return " ".join([f"{text}.", *(said for name, said in VERDICTS.items() if name in found)])


def pulse_pictures(identification: Identification) -> tuple[Picture, ...]:
    """One per HPPC log, the first one explained."""
    capacity_Ah, text = identification.model.capacity_Ah, _caption(identification)
    sets = pulse_sets(identification)[: MOST.plots]
    return tuple(
        pulse_picture(found, temperature, capacity_Ah)._replace(
            key="pulses" if k == 0 else f"pulses-{k + 1}", caption="" if k else text
        )
        for k, (temperature, found) in enumerate(sets)
    )


@pictured("pulses")
def pulse_picture(found: PulseSet, temperature_C: float, capacity_Ah: float) -> style.Figure:
    """Every pulse of a log at its SOC and current."""
    figure, axes = style.new_axes()
    soc = 100.0 * pulse_soc(found, capacity_Ah)
    current = np.array([p.current_A for p in found.pulses])
    counted = judged(found)
    role = counted[0].role if counted else "pulse"
    short = np.array([p.role == role for p in found.pulses], dtype=bool)
    style.zero_line(axes)
    if not short.all():
        looks: dict[str, Any] = {"color": style.MUTED, "ms": 9, "mew": 1.0, "zorder": 2}
        axes.plot(soc[~short], current[~short], "_", label="move", **looks)
    for quality, (colour, marker) in style.VERDICTS.items():
        mine = short & np.array([p.quality == quality for p in found.pulses], dtype=bool)
        if mine.any():
            looks = {"color": colour, "ms": 5.5, "mew": 1.2, "zorder": 3}
            axes.plot(soc[mine], current[mine], marker, label=quality, **looks)
    name = found.log.name or "HPPC"
    style.finding(axes, f"{name}, {_warm(found, temperature_C)}: {verdict_counts(counted)}")
    style.soc_axis(axes, "current [A]")
    axes.margins(y=0.15)
    style.key_below(axes)
    return figure

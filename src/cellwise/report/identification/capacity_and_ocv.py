"""Capacity by rate and choice, as the LFP paper lays it out; OCV, its rests and functions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.identification import Identification
from cellwise.identify.ocv.curve import OcvCurve, OcvFit, fit_ocv_function
from cellwise.identify.ocv.ocv_function import OCV_KINDS
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, beside, bullets, details, record_table, table
from cellwise.report.page.numerals import ampere_hours, millivolt, percent, plural, significant
from cellwise.report.page.picture import pictured
from cellwise.typing import FloatArray


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
    names = list(identification.capacities)
    chosen = identification.capacity_choice
    rates = record_table(
        rows,
        ("rate", lambda row: row.rate),
        ("total", lambda row: ampere_hours(row.total_Ah, whole)),
        ("CC part", lambda row: ampere_hours(row.cc_Ah, whole)),
        ("CV part", lambda row: ampere_hours(row.cv_Ah, whole)),
        ("tests", lambda row: row.n),
        ("spread", lambda row: ampere_hours(row.spread_Ah, whole) if row.n > 1 else ""),
        ("coulombic efficiency", lambda row: _efficiency(row.coulombic_efficiency)),
        caption="Charge taken out from full to the lower limit: at constant current (CC), "
        "and while the tester held the limit (CV). Means per rate.",
    )
    choices = record_table(
        identification.capacities.items(),
        ("choice", lambda one: one[0]),
        ("capacity", lambda one: ampere_hours(one[1], taken)),
        ("against the taken one", lambda one: percent(one[1] / taken - 1.0, 1)),
        caption="Every capacity these logs offer; the marked one defines SOC.",
        marked=names.index(chosen) if chosen in names else None,
    )
    content = beside(rates if rows else "", choices)
    lines = [
        f"{test.name} ({significant(test.current_A)} A): {notice}"
        for test in identification.capacity_tests
        for notice in test.notices
    ]
    if lines:
        content = Markup(content + details("Notices on single tests", bullets(lines)))
    return content


def _efficiency(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


@pictured(
    "capacity",
    "First: charge that came out at each rate; a fast discharge meets the lower limit early, "
    "and the remainder flows only while the limit is held. Then: the numbers that could be "
    "called the capacity. SOC, OCV and every table refer to the one that is taken, so a wrong "
    "one tilts them all.",
)
def capacity_picture(identification: Identification) -> style.Figure:
    """Bars of CC and CV charge per rate; dots of the choices."""
    rows = capacity_rows(identification)
    longest = max(len(rows), len(identification.capacities))
    figure = style.new_figure(min(1.3 + 0.24 * longest, 5.0))
    axes = style.panels(figure, 1, 2 if rows else 1)
    if rows:
        _draw_rates(axes[0], rows)
    _draw_choices(axes[-1], identification, 0.41 if rows else 0.9)
    return figure


def _draw_rates(axes: style.Axes, rows: tuple[CapacityRow, ...]) -> None:
    place = np.arange(len(rows))
    axes.barh(place, [r.cc_Ah for r in rows], 0.6, color=style.BLUE, label="constant current")
    held = [max(r.cv_Ah, 0.0) for r in rows]
    if max(held) > 5e-4 * rows[0].total_Ah:
        axes.barh(
            place,
            held,
            0.6,
            left=[r.cc_Ah for r in rows],
            color=style.AMBER,
            label="limit held (CV)",
        )
        axes.set_ylim(len(rows) + 0.1, -0.6)  # a free row for the legend
        style.legend(axes, place="lower left", columns=2)
    else:
        axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(place, [r.rate for r in rows])
    axes.grid(visible=False, axis="y")
    if len(rows) == 1:
        text = f"{ampere_hours(rows[0].total_Ah)} at {rows[0].rate}"
    else:
        lost = 1.0 - rows[-1].cc_Ah / rows[0].cc_Ah
        text = f"{percent(lost, 1)} less at constant current at {rows[-1].rate} than at "
        text += rows[0].rate
    style.finding(axes, text, 0.42)
    style.labels(axes, "charge [Ah]", "rate [1/h]")


def _draw_choices(axes: style.Axes, identification: Identification, share: float) -> None:
    names = list(identification.capacities)
    values = np.array([identification.capacities[n] for n in names])
    taken = identification.model.capacity_Ah
    place = np.arange(len(names))
    axes.hlines(place, taken, values, color=style.MUTED, linewidth=1.0)
    axes.plot(values, place, "o", color=style.INK, markersize=5)
    axes.axvline(taken, color=style.VERMILLION, linewidth=1.3)
    if identification.capacity_choice in names:
        axes.plot(
            [taken],
            [names.index(identification.capacity_choice)],
            "o",
            color=style.VERMILLION,
            ms=8,
        )
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    low, high = values.min() / taken - 1.0, values.max() / taken - 1.0
    text = f"{identification.capacity_choice} taken: {ampere_hours(taken)}"
    style.finding(axes, text + _spread(low, high) if len(names) > 1 else text, share)
    style.labels(axes, "capacity [Ah]", "choice")


def _spread(low: float, high: float) -> str:
    """How the other choices lie to the taken one, as shares of it."""
    if high < 5e-4:
        return f"; the others are up to {percent(-low, 1)} smaller"
    if low > -5e-4:
        return f"; the others are up to {percent(high, 1)} larger"
    return f"; the others lie {percent(low, 1)} to +{percent(high, 1)} from it"


REFERENCE_C = 25.0
FORM_STYLE = {
    "log-linear-exp": (style.AMBER, (0, (4, 2))),
    "spline": (style.BLUE, "solid"),
}


class OcvEvidence(NamedTuple):
    """The curve, both forms of function fitted to its points, and the rests it was moved to.

    ``rests_soc`` and ``rests_V`` (n,) are measured voltages at rest; empty without an HPPC log.
    """

    curve: OcvCurve
    fits: tuple[OcvFit, ...]
    rests_soc: FloatArray
    rests_V: FloatArray


def ocv_evidence(identification: Identification) -> OcvEvidence:
    """What the OCV stands on: fits of both forms, and the rests of the HPPC log it was made of."""
    curve = identification.ocv
    fits: list[OcvFit] = []
    for kind in OCV_KINDS:
        if kind == curve.function.kind:
            fits.append(curve.fit)
            continue
        try:
            fits.append(
                fit_ocv_function(curve.points_soc, curve.points_V, kind, weight=curve.points_weight)
            )
        except InputError:
            continue  # too few points for this form
    empty = np.empty(0)
    soc, level = empty, empty
    near = min(
        (t for t in identification.temperatures if t.pulse_sets),
        key=lambda t: abs(t.temperature_C - REFERENCE_C),
        default=None,
    )
    if near is not None:
        try:
            log = near.pulse_sets[0].log
            rests = ocv_from_rests(log, identification.model.capacity_Ah)
            soc, level = rests.points_soc, rests.points_V
        except InputError:
            pass  # a log without rests: the curve came from elsewhere
    return OcvEvidence(curve, tuple(fits), soc, level)


def ocv_content(identification: Identification, evidence: OcvEvidence) -> Markup:
    """Table of the forms of function, and the notes of the curve."""
    curve, model = evidence.curve, identification.model
    head = ["function", "RMSE", "largest error"]
    rows = [
        [fit.kind, millivolt(fit.rmse_V), millivolt(float(np.max(np.abs(fit.residual_V))))]
        for fit in evidence.fits
    ]
    if evidence.rests_soc.size:
        head += ["rests: RMSE", "median"]
        rows.append(["in the model, refined", "", ""])
        refined = np.interp(evidence.rests_soc, model.soc, _model_ocv(identification))
        levels = [fit.function.evaluate(evidence.rests_soc) for fit in evidence.fits]
        for row, level in zip(rows, [*levels, refined], strict=True):
            error = evidence.rests_V - level
            row += [millivolt(_rms(error)), millivolt(_median_size(error))]
    chosen = next(k for k, fit in enumerate(evidence.fits) if fit is curve.fit)
    text = (
        f"Fits to {plural(curve.points_soc.size, 'point')}; the marked one is taken. Rests: "
        "against the voltages at rest, where a steep end turns errors of SOC into volts."
    )
    notes = bullets(curve.notes)
    return Markup(
        table(head, rows, caption=text, marked=chosen)
        + (details(f"Where the OCV came from: {curve.source}", notes) if notes else "")
    )


def _ocv_caption(identification: Identification, evidence: OcvEvidence) -> str:
    rests = "rests, " if evidence.rests_soc.size else ""
    text = (
        "First: the voltage of the cell at rest against its state of charge, on which every "
        "estimate of SOC leans; where it is flat, voltage says little about charge. Second: how "
        f"far {rests}other forms of function and the refined model are from the chosen function."
    )
    if evidence.curve.gap_V is None:
        return text
    return (
        f"{text} Third: charge branch minus discharge branch of the slow test, which is "
        "polarisation and hysteresis together."
    )


@pictured("ocv", _ocv_caption)
def ocv_picture(identification: Identification, evidence: OcvEvidence) -> style.Figure:
    """Three panels: the curve, deviations from it, the gap between the branches."""
    has_gap = evidence.curve.gap_V is not None
    stacked = not has_gap or style.on_phone()
    figure = style.new_figure(9.0 if has_gap and stacked else 5.6)
    plan = ("AA;BC" if not stacked else "A;B;C") if has_gap else "A;B"
    heights = (1.6, 1.0, 1.0)[: plan.count(";") + 1]
    parts = figure.subplot_mosaic(plan, height_ratios=heights)
    _draw_curve(parts["A"], evidence)
    _draw_deviation(parts["B"], identification, evidence)
    if has_gap:
        _draw_gap(parts["C"], evidence.curve)
    return figure


def _draw_curve(axes: style.Axes, evidence: OcvEvidence) -> None:
    curve = evidence.curve
    x = 100.0 * curve.soc
    if curve.discharge_V is not None:
        axes.plot(x, curve.discharge_V, color=style.SKY, linewidth=1.4, label="slow discharge")
    if curve.charge_V is not None:
        axes.plot(x, curve.charge_V, color=style.GREEN, linewidth=1.4, label="slow charge")
    if evidence.rests_soc.size:
        name = plural(evidence.rests_soc.size, "rest")
        looks: dict[str, Any] = {"color": style.INK, "markersize": 3.2, "zorder": 4}
        axes.plot(100.0 * evidence.rests_soc, evidence.rests_V, "o", label=name, **looks)
    axes.plot(
        x, curve.voltage_V, color=style.MODEL, linewidth=1.6, label=f"OCV ({curve.function.kind})"
    )
    middle = (curve.soc >= 0.2) & (curve.soc <= 0.8)
    span = float(np.ptp(curve.voltage_V[middle]))
    style.finding(
        axes,
        f"OCV from {curve.voltage_V[0]:.3f} to {curve.voltage_V[-1]:.3f} V; "
        f"{millivolt(span / 60.0)} per point of SOC between 20 and {percent(0.8, 0)}"
        + (" – a flat plateau" if span < 0.12 else ""),
    )
    style.labels(axes, "SOC [%]", "voltage [V]")
    style.soc_axis(axes)
    style.legend(axes, place="lower right")


def _draw_deviation(
    axes: style.Axes, identification: Identification, evidence: OcvEvidence
) -> None:
    curve = evidence.curve
    x = 100.0 * curve.soc
    for fit in evidence.fits:
        if fit is curve.fit:
            continue
        colour, dash = FORM_STYLE[fit.kind]
        error = 1e3 * (fit.function.evaluate(curve.soc) - curve.voltage_V)
        axes.plot(x, error, color=colour, linestyle=dash, linewidth=1.1, label=fit.kind)
    refined = np.interp(curve.soc, identification.model.soc, _model_ocv(identification))
    axes.plot(
        x, 1e3 * (refined - curve.voltage_V), color=style.MODEL, linewidth=1.5, label="refined"
    )
    shown = [1e3 * (refined - curve.voltage_V)[(curve.soc > 0.03) & (curve.soc < 0.98)]]
    title = f"Refinement moved the OCV by {millivolt(_rms(refined - curve.voltage_V))} RMS"
    if evidence.rests_soc.size:
        error_V = evidence.rests_V - curve.function.evaluate(evidence.rests_soc)
        axes.plot(
            100 * evidence.rests_soc,
            1e3 * error_V,
            "o",
            color=style.INK,
            markersize=2.8,
            label="rests",
        )
        shown.append(1e3 * error_V)
        title = (
            f"Rests lie {millivolt(_median_size(error_V))} in the median from the chosen function"
        )
    style.zero_line(axes)
    limit = max(1.25 * float(np.percentile(np.abs(np.concatenate(shown)), 97)), 2.0)
    axes.set_ylim(-limit, limit)
    style.finding(axes, title, 0.44)
    style.labels(axes, "SOC [%]", "minus the chosen one [mV]")
    style.soc_axis(axes)
    style.legend(axes, columns=2)


def _draw_gap(axes: style.Axes, curve: OcvCurve) -> None:
    gap = curve.gap_V
    if gap is None:
        return
    axes.fill_between(100.0 * curve.soc, 0.0, 1e3 * gap, color=style.BLUE, alpha=0.2, linewidth=0)
    axes.plot(100.0 * curve.soc, 1e3 * gap, color=style.BLUE)
    known = gap[np.isfinite(gap)]
    if known.size:
        axes.set_ylim(min(0.0, 1e3 * known.min()), 3e3 * max(float(np.median(known)), 1e-3))
        covered = known.size / gap.size
        style.finding(
            axes,
            f"Branches {millivolt(float(np.median(known)))} apart in the median"
            + ("" if covered > 0.95 else f", known over {percent(covered, 0)} of SOC"),
            0.44,
        )
    style.labels(axes, "SOC [%]", "charge − discharge [mV]")
    style.soc_axis(axes)


def _model_ocv(identification: Identification) -> FloatArray:
    """OCV table of the model at its temperature nearest to the reference."""
    model = identification.model
    row = int(np.argmin(np.abs(model.temperature_C - REFERENCE_C)))
    return np.asarray(model.ocv_V[row])


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def _median_size(error: FloatArray) -> float:
    return float(np.median(np.abs(error))) if error.size else float("nan")

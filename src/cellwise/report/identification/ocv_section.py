"""Open-circuit voltage: branches, rests, the functions tried, and what refinement made of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.identification import Identification
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.ocv.ocv_fit import OcvFit, fit_ocv_function
from cellwise.identify.ocv.ocv_functions import OCV_KINDS
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.report.page.markup import Markup, bullets, details, table
from cellwise.report.page.numerals import millivolt, percent, plural
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    AMBER,
    BLUE,
    GREEN,
    INK,
    MODEL,
    PURPLE,
    SKY,
    finding,
    labels,
    legend,
    new_figure,
    soc_axis,
    styled,
    zero_line,
)
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REFERENCE_C = 25.0
FORM_STYLE = {
    "log-linear-exp": (AMBER, (0, (4, 2))),
    "spline": (BLUE, "solid"),
    "table": (PURPLE, (0, (1, 1.5))),
}


class OcvEvidence(NamedTuple):
    """The curve, all forms of function fitted to its points, and the rests it was moved to.

    ``rests_soc`` and ``rests_V`` (n,) are measured voltages at rest; empty without an HPPC log.
    """

    curve: OcvCurve
    fits: tuple[OcvFit, ...]
    rests_soc: FloatArray
    rests_V: FloatArray


def ocv_evidence(identification: Identification) -> OcvEvidence:
    """What the OCV stands on: fits of every form, and the rests of the HPPC log it was made of."""
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
            rests = ocv_from_rests(
                log, capacity_Ah=identification.model.capacity_Ah, extrapolate=True
            )
            soc, level = rests.points_soc, rests.points_V
        except InputError:
            pass  # a log without rests: the curve came from elsewhere
    return OcvEvidence(curve, tuple(fits), soc, level)


def ocv_content(identification: Identification, evidence: OcvEvidence) -> Markup:
    """Table of the forms of function, and the notes of the curve."""
    curve = evidence.curve
    against_rests = evidence.rests_soc.size > 0
    head = ["function", "RMSE", "largest error", "left-out RMSE"]
    if against_rests:
        head += ["rests: RMSE", "median"]
    rows = []
    for fit in evidence.fits:
        row = [
            fit.kind,
            millivolt(fit.rmse_V),
            millivolt(fit.max_error_V),
            millivolt(fit.held_out_rmse_V),
        ]
        if against_rests:
            error = evidence.rests_V - fit.function.evaluate(evidence.rests_soc)
            row += [millivolt(_rms(error)), millivolt(_median_size(error))]
        rows.append(row)
    if against_rests:
        error = evidence.rests_V - np.interp(
            evidence.rests_soc, identification.model.soc, _model_ocv(identification)
        )
        sizes = [millivolt(_rms(error)), millivolt(_median_size(error))]
        rows.append(["in the model, refined", "", "", "", *sizes])
    chosen = next(k for k, fit in enumerate(evidence.fits) if fit is curve.fit)
    text = (
        f"Fits to {plural(curve.points_soc.size, 'point')}; the marked one was chosen. Left-out: "
        "every fifth point in turn predicted from the others. Rests: against the voltages at rest, "
        "where a steep end turns errors of SOC into volts."
    )
    notes = bullets(curve.notes)
    return Markup(
        table(head, rows, caption=text, marked=chosen)
        + (details(f"Where the OCV came from: {curve.source}", notes) if notes else "")
    )


def ocv_picture(identification: Identification, evidence: OcvEvidence) -> Picture:
    """The OCV over SOC, how far the fits are from it, and the gap of the branches."""
    caption = (
        "Above: the voltage of the cell at rest against its state of charge, on which every "
        "estimate of SOC leans; where it is flat, voltage says little about charge. Below left: "
        "how far rests, other forms of function and the refined model are from the chosen "
        "function. Below right: charge branch minus discharge branch of the slow test, which is "
        "polarisation and hysteresis together."
    )
    return Picture("ocv", draw_ocv(identification, evidence), caption)


@styled
def draw_ocv(identification: Identification, evidence: OcvEvidence) -> Figure:
    """Three panels: the curve, deviations from it, the gap between the branches."""
    has_gap = evidence.curve.gap_V is not None
    figure = new_figure(5.6)
    grid = figure.add_gridspec(2, 2 if has_gap else 1, height_ratios=(1.6, 1.0))
    _draw_curve(figure.add_subplot(grid[0, :]), evidence)
    _draw_deviation(figure.add_subplot(grid[1, 0]), identification, evidence)
    if has_gap:
        _draw_gap(figure.add_subplot(grid[1, 1]), evidence.curve)
    return figure


def _draw_curve(axes: Axes, evidence: OcvEvidence) -> None:
    curve = evidence.curve
    x = 100.0 * curve.soc
    if curve.discharge_V is not None:
        axes.plot(x, curve.discharge_V, color=SKY, linewidth=1.4, label="slow discharge")
    if curve.charge_V is not None:
        axes.plot(x, curve.charge_V, color=GREEN, linewidth=1.4, label="slow charge")
    if evidence.rests_soc.size:
        axes.plot(
            100.0 * evidence.rests_soc,
            evidence.rests_V,
            "o",
            color=INK,
            markersize=3.2,
            label=plural(evidence.rests_soc.size, "rest"),
            zorder=4,
        )
    axes.plot(x, curve.voltage_V, color=MODEL, linewidth=1.6, label=f"OCV ({curve.function.kind})")
    middle = (curve.soc >= 0.2) & (curve.soc <= 0.8)
    span = float(np.ptp(curve.voltage_V[middle]))
    finding(
        axes,
        f"OCV from {curve.voltage_V[0]:.3f} to {curve.voltage_V[-1]:.3f} V; "
        f"{millivolt(span / 60.0)} per point of SOC between 20 and {percent(0.8, 0)}"
        + (" – a flat plateau" if span < 0.12 else ""),
    )
    labels(axes, "SOC [%]", "voltage [V]")
    soc_axis(axes)
    legend(axes, place="lower right")


def _draw_deviation(axes: Axes, identification: Identification, evidence: OcvEvidence) -> None:
    curve = evidence.curve
    x = 100.0 * curve.soc
    for fit in evidence.fits:
        if fit is curve.fit:
            continue
        colour, dash = FORM_STYLE[fit.kind]
        error = 1e3 * (fit.function.evaluate(curve.soc) - curve.voltage_V)
        axes.plot(x, error, color=colour, linestyle=dash, linewidth=1.1, label=fit.kind)
    refined = np.interp(curve.soc, identification.model.soc, _model_ocv(identification))
    axes.plot(x, 1e3 * (refined - curve.voltage_V), color=MODEL, linewidth=1.5, label="refined")
    shown = [1e3 * (refined - curve.voltage_V)[(curve.soc > 0.03) & (curve.soc < 0.98)]]
    title = f"Refinement moved the OCV by {millivolt(_rms(refined - curve.voltage_V))} RMS"
    if evidence.rests_soc.size:
        error_V = evidence.rests_V - curve.function.evaluate(evidence.rests_soc)
        axes.plot(
            100 * evidence.rests_soc, 1e3 * error_V, "o", color=INK, markersize=2.8, label="rests"
        )
        shown.append(1e3 * error_V)
        title = (
            f"Rests lie {millivolt(_median_size(error_V))} in the median from the chosen function"
        )
    zero_line(axes)
    limit = max(1.25 * float(np.percentile(np.abs(np.concatenate(shown)), 97)), 2.0)
    axes.set_ylim(-limit, limit)
    finding(axes, title, 0.44)
    labels(axes, "SOC [%]", "minus the chosen one [mV]")
    soc_axis(axes)
    legend(axes, columns=2)


def _draw_gap(axes: Axes, curve: OcvCurve) -> None:
    gap = curve.gap_V
    if gap is None:
        return
    axes.fill_between(100.0 * curve.soc, 0.0, 1e3 * gap, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(100.0 * curve.soc, 1e3 * gap, color=BLUE)
    known = gap[np.isfinite(gap)]
    if known.size:
        axes.set_ylim(min(0.0, 1e3 * known.min()), 3e3 * max(float(np.median(known)), 1e-3))
        covered = known.size / gap.size
        finding(
            axes,
            f"Branches {millivolt(float(np.median(known)))} apart in the median"
            + ("" if covered > 0.95 else f", known over {percent(covered, 0)} of SOC"),
            0.44,
        )
    labels(axes, "SOC [%]", "charge − discharge [mV]")
    soc_axis(axes)


def _model_ocv(identification: Identification) -> FloatArray:
    """OCV table of the model at its temperature nearest to the reference."""
    model = identification.model
    row = int(np.argmin(np.abs(model.temperature_C - REFERENCE_C)))
    return np.asarray(model.ocv_V[row])


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def _median_size(error: FloatArray) -> float:
    return float(np.median(np.abs(error))) if error.size else float("nan")

"""SOC estimates: against the reference, with their band; predicted voltage and innovations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellwise.estimate.replay import CONVERGED_SOC, Replay, SocErrors
from cellwise.report.findings import replay_name
from cellwise.report.page import style
from cellwise.report.page.markup import EMPTY, MOST, Markup, clock_of, paragraph, table
from cellwise.report.page.numerals import (
    NONE,
    counted,
    duration,
    millivolt,
    percent,
    points,
    significant,
    time_unit,
)
from cellwise.report.page.picture import Picture, pictured, safe_key
from cellwise.report.page.traces import robust_limit, symmetric_limits, thin, thin_band, time_axis
from cellwise.typing import FloatArray

WIDE_BAND = 0.5  # RMS of the innovations over their deviation: below, the band is far too wide
CHANGED = 0.9  # probability from which a parameter is said not to be the model's


def replay_pictures(replays: Sequence[Replay], prefix: str = "replay") -> tuple[Picture, ...]:
    """Comparison of all replays of a log, then SOC and voltage of each of the first few."""
    pictures = list(comparison_pictures(replays, prefix))
    for k, r in enumerate(replays[: MOST.replays]):
        drawn = [soc_picture(r)]
        if np.any(np.isfinite(r.trace.innovation_variance_V2)):
            drawn.append(voltage_picture(r))
        for one in drawn:
            named = one.of(r.log, f"{prefix}-{k + 1}-{safe_key(r.estimator)}")
            pictures.append(named._replace(key=f"{named.key}-{one.key}"))
    return tuple(pictures)


def comparison_pictures(replays: Sequence[Replay], prefix: str = "replay") -> tuple[Picture, ...]:
    """One picture per log that was replayed more than once and has a reference."""
    groups: dict[tuple[str, int], list[Replay]] = {}
    for r in replays:
        if r.reference_soc is not None:
            groups.setdefault((r.log.name, len(r.log)), []).append(r)
    pictures = []
    for k, group in enumerate(groups.values()):
        if len(group) > 1:
            picture = comparison_picture(group).of(group[0].log, f"{prefix}-comparison")
            pictures.append(picture._replace(key=f"{picture.key}-{k + 1}"))
    return tuple(pictures)


def _soc_caption(replay: Replay) -> str:
    blue = "The filter's state of charge (blue) with the band of two of its own standard deviations"
    if replay.reference_soc is None:
        return f"{blue}."
    text = f"{blue}, and the reference that the tester counted (grey). Below, their difference; "
    text += "dotted lines mark two points of SOC."
    if _enlarged(replay):
        text += (
            " Once for the whole log, once for the beginning, where the wrong start is corrected."
        )
    return text


def _enlarged(replay: Replay) -> bool:
    """Whether the beginning is worth a picture: a start that was wrong for a while."""
    return replay.reference_soc is not None and replay.convergence_s != 0.0


@pictured("soc", _soc_caption)
def soc_picture(replay: Replay) -> style.Figure:
    """SOC and its error over the log; over its beginning, too, where it converges."""
    reference = replay.reference_soc is not None
    figure = style.new_figure(5.0 if reference else 2.8)
    heights = (1.25, 1.0) if reference else (1.0,)
    seconds = replay.log.time_s - replay.log.time_s[0]
    columns: list[tuple[bool, list[style.Axes], float]]
    if _enlarged(replay):
        wide, narrow = style.two_columns(figure, heights, heights)
        columns = [(True, wide, float(seconds[-1])), (False, narrow, _beginning_s(replay))]
    else:
        rows = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)
        columns = [(True, list(rows.flat), float(seconds[-1]))]
    for whole, axes, end in columns:
        shown = slice(0, int(np.searchsorted(seconds, end, side="right")))
        t, time_label, scale = time_axis(replay.log.time_s[shown], end)
        draw_soc_axes(axes[0], replay, shown, t)
        style.labels(axes[0], "" if reference else time_label, "SOC [%]")
        title = _soc_title(replay) if whole else f"The first {duration(end)}"
        style.finding(axes[0], title, style.WIDE if whole else style.NARROW)
        if whole:
            style.legend(axes[0])
        if reference:
            draw_soc_error(axes[1], replay, shown, t, whole=whole)
            style.labels(axes[1], time_label, "SOC error [points]")
        for one in axes:
            one.set_xlim(0.0, end / scale)
    return figure


def draw_soc_axes(axes: style.Axes, replay: Replay, rows: slice, t: FloatArray) -> None:
    """Estimated SOC with two standard deviations, and the reference [%]."""
    trace = replay.trace
    soc, std = 100.0 * trace.soc[rows], 100.0 * trace.soc_std[rows]
    x, low, high = thin_band(t, soc - 2.0 * std, soc + 2.0 * std)
    axes.fill_between(
        x,
        np.clip(low, 0, 100),
        np.clip(high, 0, 100),
        color=style.FILTER,
        alpha=0.2,
        lw=0,
        label="2σ",
    )
    if replay.reference_soc is not None:
        axes.plot(
            *thin(t, 100.0 * replay.reference_soc[rows]),
            color=style.MEASURED,
            linewidth=2.2,
            label="reference",
        )
    axes.plot(*thin(t, soc), color=style.FILTER, linewidth=1.3, label=replay.estimator)
    # The first row's estimate has seen its voltage already: the start itself stands before it.
    axes.plot(
        [0.0, t[0]],
        [100.0 * replay.start.soc, soc[0]],
        color=style.FILTER,
        lw=1.0,
        ls=(0, (2, 1.5)),
    )
    axes.plot(
        [0.0], [100.0 * replay.start.soc], "o", color=style.FILTER, ms=5, label="start", zorder=5
    )


def draw_soc_error(
    axes: style.Axes, replay: Replay, rows: slice, t: FloatArray, *, whole: bool, mark: bool = True
) -> None:
    """Estimate minus reference in points of SOC, with the band of two standard deviations."""
    error = replay.soc_error
    if error is None:
        return
    e, std = 100.0 * error[rows], 100.0 * replay.trace.soc_std[rows]
    x, low, high = thin_band(t, -2.0 * std, 2.0 * std)
    axes.fill_between(x, low, high, color=style.FILTER, alpha=0.2, linewidth=0)
    axes.plot(*thin(t, e), color=style.FILTER, linewidth=1.0)
    style.zero_line(axes)
    for level in (-100 * CONVERGED_SOC, 100 * CONVERGED_SOC):
        axes.axhline(level, color=style.MUTED, linewidth=0.8, linestyle=(0, (1, 2)))
    settled = replay.settled
    if whole:
        limit = 1.25 * max(robust_limit(e, 97.0)[0], 2.0 * float(np.median(std)), 2.0)
        axes.set_ylim(-limit, limit)
    if settled is not None:
        inside = replay.coverage_2sigma
        begin = "Second half" if replay.convergence_s is None else "Settled"
        text = (
            f"{begin}: {percent(settled.rmse)} RMSE, {percent(settled.max)} at most; "
            f"{percent(inside, 0)} of rows inside 2σ"
            if whole
            else _convergence(replay)
        )
        style.finding(axes, text, style.WIDE if whole else style.NARROW)
    if mark and replay.convergence_s is not None:
        unit = time_unit(float(replay.log.duration_s) if whole else _beginning_s(replay))[0]
        axes.axvline(replay.convergence_s / unit, color=style.GREEN, linewidth=1.0)


def _innovation_finding(replay: Replay) -> str:
    """How the innovations lie to the band, or to what the model states of some time scale."""
    trace = replay.trace
    ratio = trace.innovation_V / np.sqrt(trace.innovation_variance_V2)
    size = float(np.sqrt(np.nanmean(ratio**2)))
    if size < WIDE_BAND:
        return (
            f"The band is {significant(1.0 / size, 2)} times wider than the innovations: "
            "the filter trusts the voltage little"
        )
    if replay.nis is None or replay.model is None:
        return f"Mean NIS {significant(replay.nis_mean)}"
    far = max(zip(replay.nis, replay.model.error.scales_s, strict=True), key=_off)
    return (
        f"Innovations over {duration(far[1])} are {significant(math.sqrt(far[0]), 2)} times what "
        "the model states, on other scales nearer to it"
    )


def _off(entry: tuple[float, float]) -> float:
    return abs(math.log(max(entry[0], 1e-9)))


@pictured(
    "voltage",
    "What the filter sees: the measured voltage (grey) and the one it predicted before the update "
    "(vermillion). Below, the difference, called innovation, within the band of two standard "
    "deviations that the filter expects.",
)
def voltage_picture(replay: Replay) -> style.Figure:
    """Measured and predicted voltage, innovations with their band."""
    figure = style.new_figure(4.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
    log, trace = replay.log, replay.trace
    t, time_label, _ = time_axis(log.time_s)
    top.plot(*thin(t, log.voltage_V), color=style.MEASURED, linewidth=1.5, label="measured")
    top.plot(*thin(t, trace.voltage_V), color=style.MODEL, linewidth=0.8, label="predicted")
    error = f"voltage prediction RMSE {millivolt(replay.voltage_rmse_V)}"
    middle = float(np.nanmedian(trace.innovation_V))
    if abs(middle) > 0.5 * replay.voltage_rmse_V:
        error += f", {millivolt(abs(middle))} too {'low' if middle > 0.0 else 'high'} in the median"
    style.finding(top, f"{replay_name(replay)}: {error}")
    style.labels(top, "", "voltage [V]")
    style.legend(top, columns=2)
    std = np.sqrt(trace.innovation_variance_V2)
    x, low, high = thin_band(t, -2e3 * std, 2e3 * std)
    bottom.fill_between(x, low, high, color=style.FILTER, alpha=0.22, linewidth=0, label="2σ")
    bottom.plot(*thin(t, 1e3 * trace.innovation_V), color=style.MODEL, linewidth=0.7)
    style.zero_line(bottom)
    least = 2.4 * float(np.nanmedian(std))
    symmetric_limits(bottom, trace.innovation_V, "mV", least=least, factor=1e3)
    style.finding(bottom, _innovation_finding(replay))
    style.labels(bottom, time_label, "innovation [mV]")
    for axes in (top, bottom):
        axes.set_xlim(t[0], t[-1])
    return figure


def _comparison_caption(replays: Sequence[Replay]) -> str:
    text = "The same log through every estimator and start."
    # Counting is spoken of only where it is among them, beside a filter.
    if len({r.estimator == "coulomb" for r in replays}) < 2:
        return text
    return (
        f"{text} Counting charge alone keeps its initial error; a filter that also uses the "
        "voltage corrects it."
    )


@pictured("comparison", _comparison_caption)
def comparison_picture(replays: Sequence[Replay]) -> style.Figure:
    """SOC and SOC error of several replays of one log."""
    figure = style.new_figure(4.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
    log = replays[0].log
    t, time_label, _ = time_axis(log.time_s)
    reference = replays[0].reference_soc
    if reference is not None:
        top.plot(*thin(t, 100 * reference), color=style.MEASURED, linewidth=2.6, label="reference")
    for colour, r in zip(_colours(len(replays)), replays, strict=True):
        error = r.soc_error
        top.plot(*thin(t, 100.0 * r.trace.soc), color=colour, linewidth=1.2, label=_start_name(r))
        top.plot([0.0], [100.0 * r.start.soc], "o", color=colour, ms=4.5)
        if error is not None:
            bottom.plot(*thin(t, 100.0 * error), color=colour, linewidth=1.1)
    style.zero_line(bottom)
    ranked = sorted((_rmse(r), k) for k, r in enumerate(replays))
    (low, best), (high, worst) = ranked[0], ranked[-1]
    style.finding(
        top,
        f"{clock_of(log)}, within 2 points: "
        + "; ".join(f"{_start_name(r)} {_after(r)}" for r in replays),
    )
    style.finding(
        bottom,
        f"RMSE over all rows from {percent(low)} ({_start_name(replays[best])}) to "
        f"{percent(high)} ({_start_name(replays[worst])})",
    )
    style.labels(top, "", "SOC [%]")
    style.labels(bottom, time_label, "SOC error [points]")
    bottom.set_xlim(t[0], t[-1])
    style.legend(top, place="upper right")
    return figure


def _rmse(replay: Replay) -> float:
    return float("inf") if replay.errors is None else replay.errors.rmse


def _after(replay: Replay) -> str:
    text = reached(replay)
    return f"after {text}" if replay.convergence_s else text


def _start_name(replay: Replay) -> str:
    return f"{replay.estimator} from {points(replay.start.soc)}"


def _colours(count: int) -> tuple[str, ...]:
    return tuple(style.CYCLE[k % (len(style.CYCLE) - 1)] for k in range(count))


def _soc_title(replay: Replay) -> str:
    name = f"{replay_name(replay)}: SOC {soc_at_end(replay)} at the end"
    if replay.reference_soc is not None:
        name += f", reference {points(float(replay.reference_soc[-1]))}"
    return name


def soc_at_end(replay: Replay) -> str:
    """``13.8 % ± 2.8 %``, two standard deviations."""
    return _soc(float(replay.trace.soc[-1]), float(replay.trace.soc_std[-1]))


def soc_at_start(replay: Replay) -> str:
    """The same of where the filter began."""
    return _soc(replay.start.soc, replay.start.std)


def _soc(soc: float, std: float) -> str:
    return f"{points(soc)} ± {percent(2.0 * std, 1)}"


def _convergence(replay: Replay) -> str:
    if replay.convergence_s is None:
        return "Never within 2 points for ten minutes"
    if replay.convergence_s == 0.0:
        return "Within 2 points from the first row on"
    return f"Within 2 points after {duration(replay.convergence_s)}"


def _beginning_s(replay: Replay) -> float:
    """How much of the start to enlarge: some times the convergence, a tenth where there is none."""
    total = float(replay.log.time_s[-1] - replay.log.time_s[0])
    reached = replay.convergence_s
    wanted = 0.1 * total if reached is None else max(4.0 * reached, 120.0)
    return float(min(max(wanted, 0.005 * total), 0.5 * total))


EXPLAINED = (
    "Errors are estimate minus reference, in points of SOC. Settled: after the error has come "
    "within 2 points and stayed there for ten minutes; where it never did, the log's second half. "
    "Inside 2σ: share of rows whose error is within two of the filter's own standard deviations. "
    "NIS: mean squared innovation over what the model states, by time scale; 1 where its statement "
    "is right."
)


WITHOUT_REFERENCE = (
    "This log has no reference SOC, so the estimate's own error is not known. Where the log holds "
    "the tester's counter, state the true SOC at its start (`reference_soc0`): error, time to "
    "converge and coverage stand here then. NIS: mean squared innovation over what the model "
    "states, by time scale; 1 where its statement is right."
)


def replay_content(replays: Sequence[Replay]) -> Markup:
    """All figures of every replay."""
    columns = [replay_figures(r) for r in replays]
    lines = [(texts[0][0], *(text for _, text in texts)) for texts in zip(*columns, strict=True)]
    known = [line for line in lines if set(line[1:]) != {NONE}]
    note = Markup(paragraph(EXPLAINED, "note"))
    if all(r.reference_soc is None for r in replays):
        note = Markup(paragraph(WITHOUT_REFERENCE, "note"))
    if len(columns) <= MOST.replays_as_columns:
        return Markup(note + table(("", *(r.estimator for r in replays)), known))
    rows = zip((r.estimator for r in replays), *(line[1:] for line in known), strict=True)
    head = ("estimator", *(line[0] for line in known))
    return Markup(note + table(head, list(rows), text_columns=(0, 1)))


def replay_figures(replay: Replay) -> list[tuple[str, str]]:
    """Every figure of a replay by its name, as text."""
    trace = replay.trace
    return [
        ("log", clock_of(replay.log)),
        ("samples", counted(len(trace))),
        ("initial SOC", f"{soc_at_start(replay)}, {replay.start.how}"),
        ("final SOC", soc_at_end(replay)),
        *_errors("", replay.errors),
        (f"within {percent(CONVERGED_SOC, 0)} after", reached(replay)),
        *_errors("settled: ", replay.settled),
        ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ("voltage RMSE", millivolt(replay.voltage_rmse_V)),
        *_nis(replay),
        ("time per step", f"{significant(replay.ns_per_step)} ns"),
    ]


def _nis(replay: Replay) -> list[tuple[str, str]]:
    """NIS of every time scale, or the mean where the model is not known."""
    if replay.nis is None or replay.model is None:
        return [("NIS", significant(replay.nis_mean))]
    each = zip(replay.nis, replay.model.error.scales_s, strict=True)
    return [(f"NIS over {duration(scale)}", significant(nis, 2)) for nis, scale in each]


ESTIMATED = {
    "offset_A": ("the current sensor adds", "A"),
    "gain": ("gain of the current sensor", ""),
    "capacity_Ah": ("capacity", "Ah"),
    "resistance_scale": ("R0 and R1, times the model's", ""),
}


def estimated_content(replay: Replay) -> Markup:
    """What an adaptive filter estimates of sensor and cell; nothing of another filter."""
    found = replay.to_dict().get("parameters")
    if not found or replay.far_off:
        return EMPTY
    rows = []
    for key, (name, unit) in ESTIMATED.items():
        if (one := found.get(key)) is None:
            continue
        sure = one["probability"]
        said = f"held at the model's: {one['held']}" if one["held"] else ""
        if not said and sure is not None:
            said = "as the model's" if sure < CHANGED else f"not the model's ({percent(sure, 0)})"
        places = max(1 - math.floor(math.log10(max(2.0 * one["std"], 1e-9))), 0)
        value = f"{one['value']:.{places}f} ± {2.0 * one['std']:.{places}f} {unit}".strip()
        rows.append((name, "" if one["held"] else value.replace("-", "−"), said))
    caption = f"Beside SOC, by {replay_name(replay)}."
    return table(("", "value", ""), rows, caption=caption, text_columns=(0, 1, 2))


def reached(replay: Replay) -> str:
    """How long the error took to come within two points and stay."""
    if replay.soc_error is None:
        return duration(None)
    if replay.convergence_s is None:
        return "never"
    return "at once" if replay.convergence_s == 0.0 else duration(replay.convergence_s)


def _errors(prefix: str, errors: SocErrors | None) -> list[tuple[str, str]]:
    values = (None, None, None) if errors is None else (errors.rmse, errors.mae, errors.max)
    names = ("SOC RMSE", "SOC MAE", "SOC max. error")
    return [(prefix + n, percent(v)) for n, v in zip(names, values, strict=True)]

"""SOC estimates: against the reference, with their band; predicted voltage and innovations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellwise.estimate.replay import CONVERGED_SOC, Replay, SocErrors
from cellwise.report.findings import replay_name
from cellwise.report.page import style
from cellwise.report.page.markup import MOST, Markup, clock_of, paragraph, table
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

ASIDE = 0.3  # of a standard deviation: more is worth a word


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
    beginning = "the beginning, where a wrong initial SOC is corrected"
    if replay.reference_soc is None:
        return f"{blue}: the whole log, and {beginning}."
    return (
        f"{blue}, and the reference that the tester counted (grey). Below them their difference; a "
        f"filter with consistent uncertainty keeps it inside its band. Once for the whole log, "
        f"once for {beginning}; dotted lines mark two points of SOC."
    )


@pictured("soc", _soc_caption)
def soc_picture(replay: Replay) -> style.Figure:
    """SOC and its error, the whole log and the beginning."""
    reference = replay.reference_soc is not None
    figure = style.new_figure(5.0 if reference else 2.8)
    heights = (1.25, 1.0) if reference else (1.0,)
    seconds = replay.log.time_s - replay.log.time_s[0]
    wide, narrow = style.two_columns(figure, heights, heights)
    for whole, axes, end in (
        (True, wide, float(seconds[-1])),
        (False, narrow, _beginning_s(replay)),
    ):
        rows = slice(0, int(np.searchsorted(seconds, end, side="right")))
        t, time_label, scale = time_axis(replay.log.time_s[rows], end)
        draw_soc_axes(axes[0], replay, rows, t)
        style.labels(axes[0], "" if reference else time_label, "SOC [%]")
        title = _soc_title(replay) if whole else f"The first {duration(end)}"
        style.finding(axes[0], title, style.WIDE if whole else style.NARROW)
        if whole:
            style.legend(axes[0])
        if reference:
            draw_soc_error(axes[1], replay, rows, t, whole=whole)
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
    """The time scale on which the innovations are furthest from what the model states."""
    if replay.nis is None or replay.model is None:
        return f"Mean NIS {significant(replay.nis_mean)}"
    far = max(zip(replay.nis, replay.model.error.scales_s, strict=True), key=_off)
    return (
        f"Over {significant(far[1])} s innovations are {significant(math.sqrt(far[0]), 2)} times "
        "what the model states, on other scales nearer to it"
    )


def _off(entry: tuple[float, float]) -> float:
    return abs(math.log(max(entry[0], 1e-9)))


@pictured(
    "voltage",
    "What the filter sees: the measured voltage (grey) and the one it predicted before the update "
    "(vermillion). Below, the difference, called innovation, within the band of two standard "
    "deviations that the filter expects. Then innovations as multiples of that deviation, "
    "against the normal distribution: a model that is wrong to one side moves them off zero.",
)
def voltage_picture(replay: Replay) -> style.Figure:
    """Measured and predicted voltage, innovations with their band, their distribution."""
    figure = style.new_figure(4.6)
    (top, bottom), (right,) = style.two_columns(figure, (1.2, 1.0), (1.0,))
    log, trace = replay.log, replay.trace
    t, time_label, _ = time_axis(log.time_s)
    top.plot(*thin(t, log.voltage_V), color=style.MEASURED, linewidth=1.5, label="measured")
    top.plot(*thin(t, trace.voltage_V), color=style.MODEL, linewidth=0.8, label="predicted")
    style.finding(
        top,
        f"{replay_name(replay)}: voltage prediction RMSE {millivolt(replay.voltage_rmse_V)}",
        style.WIDE,
    )
    style.labels(top, "", "voltage [V]")
    style.legend(top, columns=2)
    std = np.sqrt(trace.innovation_variance_V2)
    x, low, high = thin_band(t, -2e3 * std, 2e3 * std)
    bottom.fill_between(x, low, high, color=style.FILTER, alpha=0.22, linewidth=0, label="2σ")
    bottom.plot(*thin(t, 1e3 * trace.innovation_V), color=style.MODEL, linewidth=0.7)
    style.zero_line(bottom)
    least = 2.4 * float(np.nanmedian(std))
    symmetric_limits(bottom, trace.innovation_V, "mV", least=least, factor=1e3)
    style.finding(bottom, _innovation_finding(replay), style.WIDE)
    style.labels(bottom, time_label, "innovation [mV]")
    for axes in (top, bottom):
        axes.set_xlim(t[0], t[-1])
    _draw_distribution(right, trace.innovation_V / std)
    return figure


def _draw_distribution(axes: style.Axes, ratio: FloatArray) -> None:
    known = ratio[np.isfinite(ratio)]
    edges = np.linspace(-4.0, 4.0, 65)
    counts = np.histogram(np.clip(known, -3.999, 3.999), edges)[0]
    density = counts / max(known.size, 1) / np.diff(edges)
    axes.stairs(density, edges, fill=True, color=style.MODEL, alpha=0.55, label="innovations")
    axes.plot(
        edges,
        np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi),
        color=style.FILTER,
        label="normal",
        lw=1.6,
    )
    inside = float(np.mean(np.abs(known) <= 2.0)) if known.size else float("nan")
    middle = float(np.median(known)) if known.size else 0.0
    aside = f"; the middle is {middle:+.1f}σ off" if abs(middle) > ASIDE else ""
    text = f"{percent(inside, 1)} within 2σ (95.4 % if normal){aside}".replace("-", "−")
    style.finding(axes, text, style.NARROW)
    style.labels(axes, "innovation [multiples of its σ]", "density [1/σ]")
    axes.set_yticks([])
    style.legend(axes)


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
    trace = replay.trace
    return f"{points(float(trace.soc[-1]))} ± {percent(2.0 * float(trace.soc_std[-1]), 1)}"


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
    start = replay.start
    return [
        ("log", clock_of(replay.log)),
        ("samples", counted(len(trace))),
        ("initial SOC", f"{points(start.soc)} ± {points(2.0 * start.std)}, {start.how}"),
        ("final SOC", soc_at_end(replay)),
        *_errors("", replay.errors),
        (f"within {percent(CONVERGED_SOC, 0)} after", reached(replay)),
        *_errors("settled: ", replay.settled),
        ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ("NIS", nis_text(replay)),
        ("voltage RMSE", millivolt(replay.voltage_rmse_V)),
        ("time per step", f"{significant(replay.ns_per_step)} ns"),
    ]


def nis_text(replay: Replay) -> str:
    """NIS of every time scale, or the mean where the model is not known."""
    if replay.nis is None or replay.model is None:
        return significant(replay.nis_mean)
    each = zip(replay.nis, replay.model.error.scales_s, strict=True)
    return ", ".join(f"{significant(nis, 2)} ({significant(scale)} s)" for nis, scale in each)


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

"""SOC estimates: against the reference, with their band; predicted voltage and innovations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwise.estimate.replay import CONVERGED_SOC, Replay
from cellwise.report.findings import replay_name
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.numerals import (
    duration,
    millivolt,
    percent,
    points,
    significant,
    time_unit,
)
from cellwise.report.page.picture import Picture, safe_key
from cellwise.report.page.style import (
    CYCLE,
    FILTER,
    GREEN,
    MEASURED,
    MODEL,
    MUTED,
    NARROW,
    WIDE,
    finding,
    labels,
    legend,
    new_figure,
    styled,
    two_columns,
    zero_line,
)
from cellwise.report.page.thinning import thin, thin_band
from cellwise.report.page.windows import robust_limit, symmetric_limits
from cellwise.report.replay.replay_figures import reached
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_DETAILED = 4
SOC_CAPTION = (
    "Above: the filter's state of charge (blue) with the band of two of its own standard "
    "deviations, and the reference that the tester counted (grey). Below: their difference; a "
    "filter with consistent uncertainty keeps it inside its band. Right: the beginning, where a "
    "wrong initial SOC is corrected; dotted lines mark two points of SOC."
)
VOLTAGE_CAPTION = (
    "What the filter sees: the measured voltage (grey) and the one it predicted before the update "
    "(vermillion). Below, the difference, called innovation, within the band of two standard "
    "deviations that the filter expects. Right: innovations as multiples of that deviation, "
    "against the normal distribution."
)
COMPARISON_CAPTION = "The same log through every estimator and start."
COUNTING_CAPTION = (
    " Counting charge alone keeps its initial error; a filter that also uses the voltage corrects "
    "it."
)


def replay_pictures(replays: Sequence[Replay], prefix: str = "replay") -> tuple[Picture, ...]:
    """Comparison of all replays of a log, then SOC and voltage of each of the first few."""
    pictures = list(comparison_pictures(replays, prefix))
    for k, r in enumerate(replays[:MOST_DETAILED]):
        key = f"{prefix}-{k + 1}-{safe_key(r.estimator)}-{safe_key(r.log.name or 'log')}"
        pictures.append(Picture(f"{key}-soc", draw_soc(r), SOC_CAPTION, clock_of(r.log)))
        if np.any(np.isfinite(r.trace.innovation_variance_V2)):
            drawn = draw_voltage(r)
            pictures.append(Picture(f"{key}-voltage", drawn, VOLTAGE_CAPTION, clock_of(r.log)))
    return tuple(pictures)


def comparison_pictures(replays: Sequence[Replay], prefix: str = "replay") -> tuple[Picture, ...]:
    """One picture per log that was replayed more than once and has a reference."""
    groups: dict[tuple[str, int], list[Replay]] = {}
    for r in replays:
        if r.reference_soc is not None:
            groups.setdefault((r.log.name, len(r.log)), []).append(r)
    return tuple(
        Picture(
            f"{prefix}-comparison-{safe_key(group[0].log.name or 'log')}-{k + 1}",
            draw_comparison(group),
            comparison_caption(group),
            clock_of(group[0].log),
        )
        for k, group in enumerate(groups.values())
        if len(group) > 1
    )


def comparison_caption(group: Sequence[Replay]) -> str:
    """What is to be seen; of counting only where it is among them, beside a filter."""
    counting = {r.estimator == "coulomb" for r in group}
    return COMPARISON_CAPTION + (COUNTING_CAPTION if len(counting) == 2 else "")


@styled
def draw_soc(replay: Replay) -> Figure:
    """SOC and its error, the whole log and the beginning."""
    reference = replay.reference_soc is not None
    figure = new_figure(5.0 if reference else 2.8)
    heights = (1.25, 1.0) if reference else (1.0,)
    t = replay.log.time_s - replay.log.time_s[0]
    ends = (float(t[-1]), _beginning_s(replay))
    for column, (axes, end) in enumerate(
        zip(two_columns(figure, heights, heights), ends, strict=True)
    ):
        rows = slice(0, int(np.searchsorted(t, end, side="right")))
        scale, unit = time_unit(end)
        draw_soc_axes(axes[0], replay, rows, t[rows] / scale)
        labels(axes[0], "" if reference else f"time [{unit}]", "SOC [%]")
        title = _soc_title(replay) if column == 0 else f"The first {duration(end)}"
        finding(axes[0], title, (WIDE, NARROW)[column])
        if column == 0:
            legend(axes[0])
        if reference:
            draw_soc_error(axes[1], replay, rows, t[rows] / scale, whole=column == 0)
            labels(axes[1], f"time [{unit}]", "SOC error [points]")
        for one in axes:
            one.set_xlim(0.0, end / scale)
    return figure


def draw_soc_axes(axes: Axes, replay: Replay, rows: slice, t: FloatArray) -> None:
    """Estimated SOC with two standard deviations, and the reference [%]."""
    trace = replay.trace
    soc, std = 100.0 * trace.soc[rows], 100.0 * trace.soc_std[rows]
    x, low, high = thin_band(t, soc - 2.0 * std, soc + 2.0 * std)
    axes.fill_between(
        x, np.clip(low, 0, 100), np.clip(high, 0, 100), color=FILTER, alpha=0.2, lw=0, label="2σ"
    )
    if replay.reference_soc is not None:
        axes.plot(
            *thin(t, 100.0 * replay.reference_soc[rows]),
            color=MEASURED,
            linewidth=2.2,
            label="reference",
        )
    axes.plot(*thin(t, soc), color=FILTER, linewidth=1.3, label=replay.estimator)
    # The first row's estimate has seen its voltage already: the start itself stands before it.
    axes.plot(
        [0.0, t[0]], [100.0 * replay.start.soc, soc[0]], color=FILTER, lw=1.0, ls=(0, (2, 1.5))
    )
    axes.plot([0.0], [100.0 * replay.start.soc], "o", color=FILTER, ms=5, label="start", zorder=5)


def draw_soc_error(
    axes: Axes, replay: Replay, rows: slice, t: FloatArray, *, whole: bool, mark: bool = True
) -> None:
    """Estimate minus reference in points of SOC, with the band of two standard deviations."""
    error = replay.soc_error
    if error is None:
        return
    e, std = 100.0 * error[rows], 100.0 * replay.trace.soc_std[rows]
    x, low, high = thin_band(t, -2.0 * std, 2.0 * std)
    axes.fill_between(x, low, high, color=FILTER, alpha=0.2, linewidth=0)
    axes.plot(*thin(t, e), color=FILTER, linewidth=1.0)
    zero_line(axes)
    for level in (-100 * CONVERGED_SOC, 100 * CONVERGED_SOC):
        axes.axhline(level, color=MUTED, linewidth=0.8, linestyle=(0, (1, 2)))
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
        finding(axes, text, WIDE if whole else NARROW)
    if mark and replay.convergence_s is not None:
        unit = time_unit(float(replay.log.duration_s) if whole else _beginning_s(replay))[0]
        axes.axvline(replay.convergence_s / unit, color=GREEN, linewidth=1.0)


def _innovation_finding(replay: Replay) -> str:
    """The time scale on which the innovations are furthest from what the model states."""
    if replay.nis is None or replay.model is None:
        return f"Mean NIS {significant(replay.nis_mean)}"
    far = max(zip(replay.nis, replay.model.error.scales_s, strict=True), key=_off)
    return f"NIS {significant(far[0], 2)} over {significant(far[1])} s, nearer to 1 on others"


def _off(entry: tuple[float, float]) -> float:
    return abs(math.log(max(entry[0], 1e-9)))


@styled
def draw_voltage(replay: Replay) -> Figure:
    """Measured and predicted voltage, innovations with their band, their distribution."""
    figure = new_figure(4.6)
    (top, bottom), (right,) = two_columns(figure, (1.2, 1.0), (1.0,))
    log, trace = replay.log, replay.trace
    scale, unit = time_unit(log.duration_s)
    t = (log.time_s - log.time_s[0]) / scale
    top.plot(*thin(t, log.voltage_V), color=MEASURED, linewidth=1.5, label="measured")
    top.plot(*thin(t, trace.voltage_V), color=MODEL, linewidth=0.8, label="predicted")
    finding(
        top,
        f"{replay_name(replay)}: voltage prediction RMSE {millivolt(replay.voltage_rmse_V)}",
        WIDE,
    )
    labels(top, "", "voltage [V]")
    legend(top, columns=2)
    std = np.sqrt(trace.innovation_variance_V2)
    x, low, high = thin_band(t, -2e3 * std, 2e3 * std)
    bottom.fill_between(x, low, high, color=FILTER, alpha=0.22, linewidth=0, label="2σ")
    bottom.plot(*thin(t, 1e3 * trace.innovation_V), color=MODEL, linewidth=0.7)
    zero_line(bottom)
    least = 2.4 * float(np.nanmedian(std))
    symmetric_limits(bottom, trace.innovation_V, "mV", least=least, factor=1e3)
    finding(bottom, _innovation_finding(replay), WIDE)
    labels(bottom, f"time [{unit}]", "innovation [mV]")
    for axes in (top, bottom):
        axes.set_xlim(t[0], t[-1])
    _draw_distribution(right, trace.innovation_V / std)
    return figure


def _draw_distribution(axes: Axes, ratio: FloatArray) -> None:
    known = ratio[np.isfinite(ratio)]
    edges = np.linspace(-4.0, 4.0, 65)
    counts = np.histogram(np.clip(known, -3.999, 3.999), edges)[0]
    density = counts / max(known.size, 1) / np.diff(edges)
    axes.stairs(density, edges, fill=True, color=MODEL, alpha=0.55, label="innovations")
    axes.plot(
        edges, np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi), color=FILTER, label="normal", lw=1.6
    )
    inside = float(np.mean(np.abs(known) <= 2.0)) if known.size else float("nan")
    finding(axes, f"{percent(inside, 1)} within 2σ (95.4 % if normal)", NARROW)
    labels(axes, "innovation [multiples of its σ]", "density [1/σ]")
    axes.set_yticks([])
    legend(axes)


@styled
def draw_comparison(replays: Sequence[Replay]) -> Figure:
    """SOC and SOC error of several replays of one log."""
    figure = new_figure(4.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(1.2, 1.0))
    log = replays[0].log
    scale, unit = time_unit(log.duration_s)
    t = (log.time_s - log.time_s[0]) / scale
    reference = replays[0].reference_soc
    if reference is not None:
        top.plot(*thin(t, 100 * reference), color=MEASURED, linewidth=2.6, label="reference")
    for colour, r in zip(_colours(len(replays)), replays, strict=True):
        error = r.soc_error
        top.plot(*thin(t, 100.0 * r.trace.soc), color=colour, linewidth=1.2, label=_start_name(r))
        top.plot([0.0], [100.0 * r.start.soc], "o", color=colour, ms=4.5)
        if error is not None:
            bottom.plot(*thin(t, 100.0 * error), color=colour, linewidth=1.1)
    zero_line(bottom)
    ranked = sorted((_rmse(r), k) for k, r in enumerate(replays))
    (low, best), (high, worst) = ranked[0], ranked[-1]
    finding(
        top,
        f"{log.name or 'log'}, within 2 points: "
        + "; ".join(f"{_start_name(r)} {_after(r)}" for r in replays),
    )
    finding(
        bottom,
        f"RMSE over all rows from {percent(low)} ({_start_name(replays[best])}) to "
        f"{percent(high)} ({_start_name(replays[worst])})",
    )
    labels(top, "", "SOC [%]")
    labels(bottom, f"time [{unit}]", "SOC error [points]")
    bottom.set_xlim(t[0], t[-1])
    legend(top, place="upper right")
    return figure


def _rmse(replay: Replay) -> float:
    return float("inf") if replay.errors is None else replay.errors.rmse


def _after(replay: Replay) -> str:
    text = reached(replay)
    return f"after {text}" if replay.convergence_s else text


def _start_name(replay: Replay) -> str:
    return f"{replay.estimator} from {points(replay.start.soc)}"


def _colours(count: int) -> tuple[str, ...]:
    return tuple(CYCLE[k % (len(CYCLE) - 1)] for k in range(count))


def _soc_title(replay: Replay) -> str:
    name = f"{replay_name(replay)}: SOC {points(float(replay.trace.soc[-1]))}"
    name += f" ± {percent(2.0 * float(replay.trace.soc_std[-1]), 1)} at the end"
    if replay.reference_soc is not None:
        name += f", reference {points(float(replay.reference_soc[-1]))}"
    return name


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

"""Measured against simulated voltage: the whole log, the worst minutes, the error by SOC."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.report.page import style
from cellwise.report.page.markup import MOST, Markup, clock_of, record_table
from cellwise.report.page.numerals import counted, duration, millivolt, percent, points
from cellwise.report.page.picture import Picture, pictured
from cellwise.report.page.traces import (
    Shown,
    close_up_s,
    draw_close_up,
    draw_log,
    draw_part_current,
    symmetric_limits,
    worst_window,
)

LOW_SOC = 0.1


def simulation_pictures(
    simulations: Sequence[Simulation], prefix: str = "simulation"
) -> tuple[Picture, ...]:
    """One picture per simulated log; of very many logs those with the largest errors."""
    shown = worst_logs(simulations)
    pictures = [
        simulation_picture(simulations[k]).of(simulations[k].log, f"{prefix}-{k + 1}")
        for k in shown
    ]
    return (*pictures[:1], *(p._replace(caption="") for p in pictures[1:]))


def worst_logs(simulations: Sequence[Simulation]) -> list[int]:
    """The simulations whose pictures are shown: those with the largest errors."""
    order = sorted(
        range(len(simulations)), key=lambda k: -np.nan_to_num(simulations[k].metrics.rmse_V)
    )
    return sorted(order[: MOST.simulations])


def simulation_content(simulations: Sequence[Simulation]) -> Markup:
    """Error metrics of every log."""
    text = "Measured minus simulated voltage. 95 % interval: 1.96 sd to either side of the mean."
    if len(simulations) > MOST.simulations:
        text += f" Pictures show the {MOST.simulations} logs with the largest errors."
    return record_table(
        simulations,
        ("log", lambda s: clock_of(s.log)),
        ("rows", lambda s: counted(s.metrics.samples)),
        ("RMSE", lambda s: millivolt(s.metrics.rmse_V)),
        ("above 10 % SOC", lambda s: millivolt(s.rmse_above_10pct_V)),
        ("MAE", lambda s: millivolt(s.metrics.mae_V)),
        ("max", lambda s: millivolt(s.metrics.max_error_V)),
        ("mean", lambda s: millivolt(s.metrics.mean_error_V)),
        ("sd", lambda s: millivolt(s.metrics.std_error_V)),
        ("95 % interval", lambda s: " to ".join(millivolt(v) for v in s.metrics.ci95_V)),
        caption=text,
    )


@pictured(
    "simulation",
    "Measured voltage (grey), the model's (vermillion) from the current alone, and the "
    "residual. Then: the minutes above 10 % SOC where the model is worst, with their "
    "current; below, the error over SOC – mean, and the band that holds 95 % of it.",
)
def simulation_picture(simulation: Simulation) -> style.Figure:
    """Voltage, current and residual of the whole log; close-up of the worst; error over SOC."""
    log = simulation.log
    figure = style.new_figure(5.7)
    left, right = style.two_columns(figure, (2.3, 0.9, 1.7), (2.1, 0.7, 1.6))
    length_s = close_up_s(log.time_s)
    above = simulation.soc > LOW_SOC
    allowed = above if above.mean() > 0.2 else None
    part = worst_window(log.time_s, simulation.error_V, length_s, allowed, log.known_current_A())
    draw_log(left, log, [as_shown(simulation)], part)
    size, high = millivolt(simulation.metrics.rmse_V), millivolt(simulation.rmse_above_10pct_V)
    title = f"{clock_of(log)}: {size} RMSE over {duration(log.duration_s)} ({high} above 10 % SOC)"
    style.finding(left[0], title, style.WIDE)
    describe_residual(left[2], simulation)
    where = percent(float(np.mean(simulation.soc[slice(*part)])), 0)
    size = draw_close_up(right[0], log, [as_shown(simulation)], part, length_s)
    style.labels(right[0], "", "voltage [V]")
    title = f"Worst {duration(length_s)}: {size} RMSE at {where} SOC"
    style.finding(right[0], title, style.NARROW)
    draw_part_current(right[1], log, part, length_s)
    _draw_error_over_soc(right[2], simulation)
    return figure


def as_shown(simulation: Simulation) -> Shown:
    """A simulation as it is drawn over time."""
    return Shown("simulated", simulation.voltage_V, simulation.error_V, style.MODEL)


def describe_residual(axes: style.Axes, simulation: Simulation) -> None:
    """The residual's 95 % interval [mV] as a band, its limits, where it is largest."""
    error, m = simulation.error_V, simulation.metrics
    low, high = (1e3 * v for v in m.ci95_V)
    axes.axhspan(low, high, color=style.MODEL, alpha=0.12, linewidth=0, zorder=0.6)
    symmetric_limits(axes, error, "mV", least=1.3 * max(abs(v) for v in m.ci95_V), factor=1e3)
    worst = int(np.argmax(np.where(np.isfinite(error), np.abs(error), -1.0)))
    style.finding(
        axes,
        f"Largest error {millivolt(error[worst])} at {points(float(simulation.soc[worst]))} SOC; "
        f"95 % lie within {millivolt(m.ci95_V[0])} to {millivolt(m.ci95_V[1])}",
        style.WIDE,
    )


def _draw_error_over_soc(axes: style.Axes, simulation: Simulation) -> None:
    """Mean error and the interval of 95 % in every tenth of SOC."""
    bands = [b for b in simulation.bands if np.isfinite(b.metrics.rmse_V)]
    if bands:
        centre = np.array([50.0 * (b.soc_low + b.soc_high) for b in bands])
        low, high = (np.array([1e3 * b.metrics.ci95_V[k] for b in bands]) for k in (0, 1))
        mean = np.array([1e3 * b.metrics.mean_error_V for b in bands])
        axes.bar(centre, high - low, 8.6, bottom=low, color=style.MODEL, alpha=0.25)
        axes.hlines(mean, centre - 4.3, centre + 4.3, color=style.MODEL, linewidth=1.8)
        symmetric_limits(axes, np.concatenate((low, high)), "mV")
        worst = max(bands, key=lambda b: b.metrics.rmse_V)
        where = f"{100 * worst.soc_low:.0f}–{percent(worst.soc_high, 0)} SOC"
        title = f"Worst tenth: {where}, {millivolt(worst.metrics.rmse_V)} RMSE"
        style.finding(axes, title, style.NARROW)
    style.zero_line(axes)
    style.labels(axes, "SOC [%]", "error [mV]")
    style.soc_axis(axes)

"""Measured against simulated voltage: the whole log, the worst minutes, the error by SOC."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.metrics import error_metrics
from cellwise.cell.simulate import Simulation
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.markup import Markup, details, table
from cellwise.report.page.numerals import counted, duration, millivolt, percent, points, time_unit
from cellwise.report.page.picture import Picture, safe_key
from cellwise.report.page.style import (
    MEASURED,
    MODEL,
    NARROW,
    WIDE,
    finding,
    labels,
    legend,
    new_figure,
    soc_axis,
    styled,
    two_columns,
    zero_line,
)
from cellwise.report.page.thinning import thin
from cellwise.report.page.windows import (
    close_up_s,
    mark_window,
    symmetric_limits,
    worst_window,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOW_SOC = 0.1
MOST_PICTURES = 8
CAPTION = (
    "Left: measured voltage (grey), the model's (vermillion) from the current alone, and the "
    "residual. Right: the minutes above 10 % SOC where the model is worst, with their "
    "current; below, the error over SOC – mean, and the band that holds 95 % of it."
)


def log_name(simulation: Simulation) -> str:
    """Name of the simulated log."""
    return simulation.log.name or "log"


def simulation_pictures(
    simulations: Sequence[Simulation], prefix: str = "simulation"
) -> tuple[Picture, ...]:
    """One picture per simulated log; of very many logs those with the largest errors."""
    return tuple(
        Picture(
            f"{prefix}-{k + 1}-{safe_key(log_name(s))}",
            draw_simulation(s),
            CAPTION,
            clock_of(s.log),
        )
        for k, s in enumerate(simulations)
        if k in worst_logs(simulations)
    )


def worst_logs(simulations: Sequence[Simulation]) -> list[int]:
    """The simulations whose pictures are shown: those with the largest errors."""
    order = sorted(
        range(len(simulations)), key=lambda k: -np.nan_to_num(simulations[k].metrics.rmse_V)
    )
    return sorted(order[:MOST_PICTURES])


def simulation_content(simulations: Sequence[Simulation]) -> Markup:
    """Error metrics of every log, and by tenth of SOC."""
    rows = []
    for s in simulations:
        m = s.metrics
        rows.append(
            (
                log_name(s),
                counted(m.samples),
                millivolt(m.rmse_V),
                millivolt(s.rmse_above_10pct_V),
                millivolt(m.mae_V),
                millivolt(m.max_error_V),
                millivolt(m.mean_error_V),
                millivolt(m.std_error_V),
                f"{millivolt(m.ci95_V[0])} to {millivolt(m.ci95_V[1])}",
            )
        )
    head = ("log", "rows", "RMSE", "above 10 % SOC", "MAE", "max", "mean", "sd", "95 % interval")
    text = "Measured minus simulated voltage. 95 % interval: mean ± 1.96 sd."
    if len(simulations) > MOST_PICTURES:
        text += f" Pictures show the {MOST_PICTURES} logs with the largest errors."
    return Markup(table(head, rows, caption=text) + _band_table(simulations))


def _band_table(simulations: Sequence[Simulation]) -> Markup:
    bands = sorted({b.soc_low for s in simulations for b in s.bands}, reverse=True)
    rows = []
    for low in bands:
        row = [f"{100 * low:.0f} to {100 * low + 10:.0f} %"]
        for s in simulations:
            found = next((b for b in s.bands if b.soc_low == low), None)
            if found is None:
                row += ["", ""]
            else:
                row += [millivolt(found.metrics.rmse_V), millivolt(found.metrics.mean_error_V)]
        rows.append(row)
    head = ["SOC"]
    for s in simulations:
        head += [f"{log_name(s)}: RMSE", "mean"]
    return details("Error by tenth of SOC", table(head, rows))


@styled
def draw_simulation(simulation: Simulation) -> Figure:
    """Voltage, current and residual of the whole log; close-up of the worst; error over SOC."""
    figure = new_figure(5.7)
    left, right = two_columns(figure, (2.3, 0.9, 1.7), (2.1, 0.7, 1.6))
    length_s = close_up_s(simulation.log.time_s)
    start, stop = _worst_part(simulation, length_s)
    _draw_whole(left, simulation, (start, stop))
    where = percent(float(np.mean(simulation.soc[start:stop])), 0)
    title = f"Worst {{length}}: {{rmse}} RMSE at {where} SOC"
    draw_close_up(right[0], right[1], simulation, (start, stop), title, length_s)
    draw_error_over_soc(right[2], simulation)
    return figure


def _worst_part(simulation: Simulation, length_s: float) -> tuple[int, int]:
    log = simulation.log
    above = simulation.soc > LOW_SOC
    return worst_window(
        log.time_s,
        simulation.error_V,
        length_s,
        above if above.mean() > 0.2 else None,
        log.known_current_A(),
    )


def _draw_whole(axes: list[Axes], simulation: Simulation, part: tuple[int, int]) -> None:
    log = simulation.log
    scale, unit = time_unit(log.duration_s)
    t = (log.time_s - log.time_s[0]) / scale
    gaps = log.gap_rows
    top, middle, bottom = axes
    top.plot(*thin(t, log.voltage_V, gaps=gaps), color=MEASURED, linewidth=1.5, label="measured")
    top.plot(
        *thin(t, simulation.voltage_V, gaps=gaps), color=MODEL, linewidth=0.8, label="simulated"
    )
    m = simulation.metrics
    finding(
        top,
        f"{log_name(simulation)}: {millivolt(m.rmse_V)} RMSE over {duration(log.duration_s)} "
        f"({millivolt(simulation.rmse_above_10pct_V)} above 10 % SOC)",
        WIDE,
    )
    labels(top, "", "voltage [V]")
    legend(top, columns=2)
    middle.plot(*thin(t, log.known_current_A(), gaps=gaps), color=MEASURED, linewidth=0.8)
    labels(middle, "", "current [A]")
    draw_residual(bottom, t, simulation)
    labels(bottom, f"time [{unit}]", "residual [mV]")
    for one in axes:
        one.set_xlim(t[0], t[-1])
        mark_window(one, t[part[0]], t[part[1] - 1])


def draw_residual(axes: Axes, t: np.ndarray, simulation: Simulation) -> None:
    """Measured minus simulated voltage over time [mV], with its 95 % interval."""
    error = simulation.error_V
    m = simulation.metrics
    axes.plot(*thin(t, 1e3 * error, gaps=simulation.log.gap_rows), color=MODEL, linewidth=0.65)
    low, high = (1e3 * v for v in m.ci95_V)
    axes.axhspan(low, high, color=MODEL, alpha=0.12, linewidth=0, zorder=0.6)
    zero_line(axes)
    symmetric_limits(axes, error, "mV", least=1.3 * max(abs(v) for v in m.ci95_V), factor=1e3)
    known = np.where(np.isfinite(error), np.abs(error), -1.0)
    worst = int(np.argmax(known))
    finding(
        axes,
        f"Largest error {millivolt(error[worst])} at {points(float(simulation.soc[worst]))} SOC; "
        f"95 % lie within {millivolt(m.ci95_V[0])} to {millivolt(m.ci95_V[1])}",
        WIDE,
    )


def draw_close_up(
    top: Axes,
    bottom: Axes,
    simulation: Simulation,
    part: tuple[int, int],
    title: str,
    length_s: float,
) -> None:
    """Voltages and current of a part of the log; ``{length}`` and ``{rmse}`` in the title."""
    log = simulation.log
    rows = slice(*part)
    scale, unit = time_unit(length_s)
    t = (log.time_s[rows] - log.time_s[part[0]]) / scale
    top.plot(*thin(t, log.voltage_V[rows], 300), color=MEASURED, linewidth=2.0)
    top.plot(*thin(t, simulation.voltage_V[rows], 300), color=MODEL, linewidth=1.2)
    rmse = error_metrics(simulation.error_V[rows]).rmse_V
    finding(top, title.format(length=duration(length_s), rmse=millivolt(rmse)), NARROW)
    labels(top, "", "voltage [V]")
    current = thin(t, log.known_current_A()[rows], 300)
    bottom.plot(*current, color=MEASURED, linewidth=1.1, drawstyle="steps-pre")
    labels(bottom, f"time [{unit}]", "current [A]")
    for axes in (top, bottom):
        axes.set_xlim(0.0, length_s / scale)


def draw_error_over_soc(axes: Axes, simulation: Simulation, share: float = NARROW) -> None:
    """Mean error and the interval of 95 % in every tenth of SOC."""
    bands = [b for b in simulation.bands if np.isfinite(b.metrics.rmse_V)]
    if bands:
        centre = np.array([50.0 * (b.soc_low + b.soc_high) for b in bands])
        low, high = (np.array([1e3 * b.metrics.ci95_V[k] for b in bands]) for k in (0, 1))
        mean = np.array([1e3 * b.metrics.mean_error_V for b in bands])
        axes.bar(centre, high - low, 8.6, bottom=low, color=MODEL, alpha=0.25)
        axes.hlines(mean, centre - 4.3, centre + 4.3, color=MODEL, linewidth=1.8)
        symmetric_limits(axes, np.concatenate((low, high)), "mV")
    zero_line(axes)
    if bands:
        worst = max(bands, key=lambda b: b.metrics.rmse_V)
        finding(
            axes,
            f"Worst tenth: {100 * worst.soc_low:.0f}–{percent(worst.soc_high, 0)} SOC, "
            f"{millivolt(worst.metrics.rmse_V)} RMSE",
            share,
        )
    labels(axes, "SOC [%]", "error [mV]")
    soc_axis(axes)

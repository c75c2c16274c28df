"""One picture of the main result: a held-out drive simulated, and its SOC estimated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import Replay
from cellwise.identify.identification import Identification
from cellwise.report.findings import fitted_drives
from cellwise.report.identification.simulation_section import draw_close_up, draw_residual
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.numerals import (
    ampere_hours,
    millivolt,
    percent,
    plural,
    time_unit,
)
from cellwise.report.page.picture import Picture, save_figure
from cellwise.report.page.style import (
    MEASURED,
    MODEL,
    NARROW,
    WIDE,
    finding,
    labels,
    legend,
    new_figure,
    styled,
    two_columns,
)
from cellwise.report.page.thinning import thin
from cellwise.report.page.windows import close_up_s, mark_window
from cellwise.report.replay.replay_section import draw_soc_axes, draw_soc_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CAPTION = (
    "A drive that took no part in the identification: voltage from the current alone, the "
    "residual, and the state of charge that the filter finds from a wrong start."
)
HEIGHT_IN = 6.4
CLOSE_UP_S = 180.0


def hero_figure(
    identification: Identification, simulation: Simulation, replay: Replay, path: str | Path
) -> Path:
    """Write the picture of one held-out drive as PNG, SVG or PDF.

    Parameters
    ----------
    simulation : Simulation      of a log that was not fitted
    replay : Replay              of the same log, from a wrong start, with a reference
    path : str or Path           its suffix says the format

    Raises
    ------
    InputError        matplotlib is missing; another suffix; a path that cannot be written
    """
    return save_figure(draw_hero(identification, simulation, replay), path)


def hero_picture(identification: Identification, simulation: Simulation, replay: Replay) -> Picture:
    """The same with its explanation, for a page."""
    figure = draw_hero(identification, simulation, replay)
    return Picture("hero", figure, CAPTION, clock_of(simulation.log))


@styled
def draw_hero(identification: Identification, simulation: Simulation, replay: Replay) -> Figure:
    """Voltage, residual, SOC over the drive; to the right a close-up of each."""
    figure = new_figure(HEIGHT_IN)
    left, right = two_columns(figure, (1.5, 0.9, 1.3), (1.5, 0.7, 1.3))
    log = simulation.log
    scale, unit = time_unit(log.duration_s)
    t = (log.time_s - log.time_s[0]) / scale
    length_s = min(CLOSE_UP_S, close_up_s(log.time_s))
    start, stop = _typical_window(simulation, length_s)
    left[0].plot(*thin(t, log.voltage_V), color=MEASURED, linewidth=1.6, label="measured")
    left[0].plot(*thin(t, simulation.voltage_V), color=MODEL, linewidth=0.7, label="simulated")
    finding(
        left[0],
        f"{log.name or 'A drive'}, never fitted: voltage to "
        f"{millivolt(simulation.rmse_above_10pct_V)} RMSE above 10 % SOC",
        WIDE,
    )
    labels(left[0], "", "voltage [V]")
    legend(left[0], columns=2, place="lower left")
    draw_residual(left[1], t, simulation)
    labels(left[1], "", "residual [mV]")
    draw_soc_axes(left[2], replay, slice(None), (replay.log.time_s - replay.log.time_s[0]) / scale)
    labels(left[2], f"time [{unit}]", "SOC [%]")
    finding(left[2], _soc_title(replay), WIDE)
    legend(left[2], place="lower left")
    for axes in left:
        axes.set_xlim(t[0], t[-1])
    mark_window(left[0], t[start], t[stop - 1])
    title = "{length} at full size: {rmse} RMSE"
    draw_close_up(right[0], right[1], simulation, (start, stop), title, length_s)
    finding(right[1], "All the model is given", NARROW)
    _draw_start(right[2], replay)
    figure.suptitle(_headline(identification), x=0.01, ha="left", fontsize=11.5, fontweight="bold")
    return figure


def _headline(identification: Identification) -> str:
    model = identification.model
    name = f"{model.name}: " if model.name else ""
    drives = len(fitted_drives(identification))
    used = f"laboratory tests and {plural(drives, 'drive')}" if drives else "laboratory tests alone"
    return f"{name}{ampere_hours(model.capacity_Ah)}, identified on {used}"


def _typical_window(simulation: Simulation, length: float) -> tuple[int, int]:
    """A busy part whose error is like that of the whole log, away from its ends."""
    log = simulation.log
    dt = np.diff(log.time_s, prepend=log.time_s[0])
    error = np.cumsum(np.nan_to_num(simulation.error_V) ** 2 * dt)
    moved = np.cumsum(np.abs(np.diff(log.known_current_A(), prepend=0.0)))
    starts = np.searchsorted(
        log.time_s, np.linspace(log.time_s[0] + 0.1 * log.duration_s, log.time_s[-1] - length, 200)
    )
    stops = np.minimum(np.searchsorted(log.time_s, log.time_s[starts] + length), len(log) - 1)
    rms = np.sqrt(np.maximum(error[stops] - error[starts], 0.0) / length)
    busy = moved[stops] - moved[starts]
    high = simulation.soc[stops] > 0.15
    candidates = (busy >= np.quantile(busy, 0.6)) & (high if high.any() else True)
    overall = simulation.rmse_above_10pct_V
    cost = np.where(candidates, np.abs(rms - (overall if np.isfinite(overall) else 0.0)), np.inf)
    best = int(np.argmin(cost))
    return int(starts[best]), max(int(stops[best]), int(starts[best]) + 2)


def _draw_start(axes: Axes, replay: Replay) -> None:
    """SOC error of the first minutes, where the wrong start is forgotten."""
    t = replay.log.time_s - replay.log.time_s[0]
    reached = replay.convergence_s
    end = float(min(max(120.0, 4.0 * (reached or 0.0)), 0.5 * t[-1]))
    rows = slice(0, int(np.searchsorted(t, end, side="right")))
    scale, unit = time_unit(end)
    if replay.soc_error is None:
        draw_soc_axes(axes, replay, rows, t[rows] / scale)
        labels(axes, f"time [{unit}]", "SOC [%]")
        return
    draw_soc_error(axes, replay, rows, t[rows] / scale, whole=False, mark=False)
    labels(axes, f"time [{unit}]", "SOC error [points]")
    axes.set_xlim(0.0, end / scale)


def _soc_title(replay: Replay) -> str:
    settled = replay.settled
    if settled is None or replay.reference_soc is None:
        return f"SOC by {replay.estimator.upper()}"
    off = abs(float(replay.start.soc - replay.reference_soc[0]))
    return (
        f"SOC from {100.0 * off:.0f} points off: then {percent(settled.rmse)} RMSE, "
        f"{percent(settled.max)} at most"
    )

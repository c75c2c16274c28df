"""The page that ``make demo`` ends with: from laboratory logs to SOC on the road."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.estimate.replay import Replay
from cellwise.identify.identification import Identification
from cellwise.report.findings import demo_finding, fitted_drives, replay_finding, simulation_finding
from cellwise.report.identification.page import cell_name, identify_sections, identify_tiles
from cellwise.report.identification.simulation_section import (
    as_shown,
    describe_residual,
    simulation_content,
    simulation_pictures,
)
from cellwise.report.page import style
from cellwise.report.page.markup import bullets, clock_of, details, lead_of, paragraph
from cellwise.report.page.numerals import (
    ampere_hours,
    duration,
    millivolt,
    percent,
    plural,
)
from cellwise.report.page.picture import FigureFiles, pictured, save_figure
from cellwise.report.page.section import Blocks, Section, write_page
from cellwise.report.page.traces import (
    close_up_s,
    draw_close_up,
    draw_part_current,
    mark_window,
    thin,
    time_axis,
)
from cellwise.report.replay.page import replay_data
from cellwise.report.replay.replay_section import (
    comparison_pictures,
    draw_soc_axes,
    draw_soc_error,
    replay_content,
    replay_pictures,
)

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
    return save_figure(hero_picture(identification, simulation, replay).figure, path)


@pictured(
    "hero",
    "A drive that took no part in the identification: voltage from the current alone, the "
    "residual, and the state of charge that the filter finds from a wrong start.",
)
def hero_picture(
    identification: Identification, simulation: Simulation, replay: Replay
) -> style.Figure:
    """Voltage, residual, SOC over the drive; to the right a close-up of each."""
    figure = style.new_figure(6.4)
    left, right = style.two_columns(figure, (1.5, 0.9, 1.3), (1.5, 0.7, 1.3))
    log, shown = simulation.log, as_shown(simulation)
    t, time_label, scale = time_axis(log.time_s)
    length_s = min(CLOSE_UP_S, close_up_s(log.time_s))
    part = _typical_window(simulation, length_s)
    left[0].plot(*thin(t, log.voltage_V), color=style.MEASURED, linewidth=1.6, label="measured")
    left[0].plot(*thin(t, shown.voltage_V), color=shown.colour, linewidth=0.7, label=shown.name)
    error = millivolt(simulation.rmse_above_10pct_V)
    title = f"{log.name or 'A drive'}, never fitted: voltage to {error} RMSE above 10 % SOC"
    style.finding(left[0], title, style.WIDE)
    style.labels(left[0], "", "voltage [V]")
    style.legend(left[0], columns=2, place="lower left")
    gaps = log.gap_rows
    left[1].plot(*thin(t, 1e3 * shown.error_V, gaps=gaps), color=shown.colour, linewidth=0.65)
    style.zero_line(left[1])
    describe_residual(left[1], simulation)
    style.labels(left[1], "", "residual [mV]")
    draw_soc_axes(left[2], replay, slice(None), (replay.log.time_s - replay.log.time_s[0]) / scale)
    style.labels(left[2], time_label, "SOC [%]")
    style.finding(left[2], _soc_title(replay), style.WIDE)
    style.legend(left[2], place="lower left")
    for axes in left:
        axes.set_xlim(t[0], t[-1])
    mark_window(left[0], t[part[0]], t[part[1] - 1])
    size = draw_close_up(right[0], log, [shown], part, length_s)
    style.labels(right[0], "", "voltage [V]")
    style.finding(right[0], f"{duration(length_s)} at full size: {size} RMSE", style.NARROW)
    draw_part_current(right[1], log, part, length_s)
    style.finding(right[1], "All the model is given", style.NARROW)
    _draw_start(right[2], replay)
    style.heading(figure, _headline(identification))
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


def _draw_start(axes: style.Axes, replay: Replay) -> None:
    """SOC error of the first minutes, where the wrong start is forgotten."""
    seconds = replay.log.time_s - replay.log.time_s[0]
    end = float(min(max(120.0, 4.0 * (replay.convergence_s or 0.0)), 0.5 * seconds[-1]))
    rows = slice(0, int(np.searchsorted(seconds, end, side="right")))
    t, time_label, scale = time_axis(replay.log.time_s[rows], end)
    if replay.soc_error is None:
        draw_soc_axes(axes, replay, rows, t)
        style.labels(axes, time_label, "SOC [%]")
        return
    draw_soc_error(axes, replay, rows, t, whole=False, mark=False)
    style.labels(axes, time_label, "SOC error [points]")
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


def demo_page(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
    path: str | Path,
    *,
    figures: str | Path | FigureFiles | None = None,
) -> Path:
    """Write one page from tests to SOC, every picture explained for a newcomer.

    Parameters
    ----------
    identification : Identification
    simulations : of Simulation   drives that were not fitted
    replays : of Replay           the first one from a wrong start, of a simulated log
    path, figures : as of `write_page`, whose errors it raises
    """
    judged = [replay_finding(r) for r in replays if r.settled is not None]
    return write_page(
        path,
        demo_finding(identification, simulations),
        f"cellwise demo on {cell_name(identification)}",
        demo_sections(identification, simulations, replays),
        {"identification": identification.to_dict(), **replay_data(replays, simulations)},
        lead=lead_of((), identify_tiles(identification), judged[:1]),
        figures=figures,
    )


def demo_sections(
    identification: Identification,
    simulations: Sequence[Simulation],
    replays: Sequence[Replay],
) -> tuple[Section, ...]:
    """The result, then the identification, the drives that it has not seen, and SOC on them."""
    own = [s for s in identify_sections(identification) if s.key != "trace"]
    parts = [
        Section("result", "The result", _result(identification, simulations, replays)),
        *own,
    ]
    if simulations:
        drives: Blocks = (
            paragraph(simulation_finding(simulations)),
            simulation_content(simulations),
            *simulation_pictures(simulations, "held-out"),
        )
        title = "Does it predict drives it was not fitted on?"
        parts.append(Section("held-out", title, drives, "Held-out drives"))
    if replays:
        soc: Blocks = (
            bullets(replay_finding(r) for r in replays),
            *comparison_pictures(replays),
            *replay_pictures(replays[:1]),
            details("All figures of the replays", replay_content(replays)),
        )
        parts.append(Section("soc", "State of charge on the road", soc, "State of charge"))
    return tuple(parts)


def _result(
    identification: Identification, simulations: Sequence[Simulation], replays: Sequence[Replay]
) -> Blocks:
    """The main picture: the first drive that was simulated and replayed."""
    text = paragraph(
        "A battery's state of charge cannot be measured, only inferred from current, voltage "
        "and temperature. cellwise does it in two steps: in the laboratory it identifies a "
        "model of the cell, a small electric circuit whose parts change with the state of "
        "charge; on the road a Kalman filter runs this model beside the cell and corrects "
        "itself by what it sees."
    )
    pairs = ((s, r) for r in replays for s in simulations)
    pair = next(((s, r) for s, r in pairs if s.log is r.log or s.log.name == r.log.name), None)
    if pair is None:
        return (text,)
    return text, hero_picture(identification, *pair)._replace(clock=clock_of(pair[0].log))

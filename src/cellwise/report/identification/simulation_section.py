"""Measured against simulated voltage: figures, every sample over time, the error by SOC."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.cell.metrics import NEAR_EMPTY, error_metrics
from cellwise.cell.simulate import Simulation
from cellwise.report.page import style
from cellwise.report.page.markup import MOST, Markup, clock_of, jump, paragraph, record_table
from cellwise.report.page.numerals import (
    counted,
    duration,
    millivolt,
    percent,
    plural,
    points,
)
from cellwise.report.page.picture import Picture, pictured, safe_key
from cellwise.report.page.plot import Plot, as_model, simulation_plot, worst_part
from cellwise.report.page.section import Block, plots_within

CAPTION = (
    "Measured voltage (grey), the model's from the current alone, their difference, the current "
    "and the simulated SOC."
)


def simulation_finding(simulations: Sequence[Simulation]) -> str:
    """How well the model predicts the logs it is simulated on."""
    each = [s.rmse_above_10pct_V for s in simulations]
    known = [e for e in each if np.isfinite(e)]
    if not known:
        return f"{plural(len(simulations), 'log')} simulated."
    if len(known) == 1:
        name = simulations[0].log.name or "a log"
        size = f"{millivolt(known[0])} RMSE above {percent(NEAR_EMPTY, 0)} SOC"
        return f"The voltage of {name} is simulated with {size}."
    mean = float(np.mean(known))
    return (
        f"The voltage of {plural(len(known), 'log')} is simulated with {millivolt(mean)} RMSE "
        f"above {percent(NEAR_EMPTY, 0)} SOC in the mean, {millivolt(max(known))} at worst."
    )


def simulation_blocks(
    simulations: Sequence[Simulation], prefix: str = "simulation"
) -> tuple[Block, ...]:
    """Figures of every log, links to their worst minutes, then plots of those with most error."""
    order = sorted(simulations, key=lambda s: -np.nan_to_num(s.rmse_V))
    worst = {id(s) for s in order[: MOST.plots]}
    shown = [(k, s) for k, s in enumerate(simulations, start=1) if id(s) in worst]
    plots = [_plot(s, f"{prefix}-{k}-{safe_key(clock_of(s.log))}") for k, s in shown]
    if plots:
        plots[0] = plots[0]._replace(caption=CAPTION)
    by_soc = [error_by_soc_picture(s)._replace(key=f"{prefix}-{k}-by-soc") for k, s in shown]
    return (
        _table(simulations),
        _worst_minutes([s for _, s in shown]),
        *plots_within(plots),
        *_first_explained(by_soc),
    )


def _table(simulations: Sequence[Simulation]) -> Markup:
    text = "Measured minus simulated voltage. 95 % interval: 1.96 sd to either side of the mean."
    if len(simulations) > MOST.plots:
        text += f" Plots show the {MOST.plots} logs with the largest errors."
    return record_table(
        simulations,
        ("log", lambda s: clock_of(s.log)),
        ("rows", lambda s: counted(s.metrics.samples)),
        ("RMSE", lambda s: millivolt(s.rmse_V)),
        ("above 10 % SOC", lambda s: millivolt(s.rmse_above_10pct_V)),
        ("MAE", lambda s: millivolt(s.metrics.mae_V)),
        ("max", lambda s: millivolt(s.metrics.max_error_V)),
        ("mean", lambda s: millivolt(s.metrics.mean_error_V)),
        ("sd", lambda s: millivolt(s.metrics.std_error_V)),
        ("95 % interval", lambda s: " to ".join(millivolt(v) for v in s.metrics.ci95_V)),
        caption=text,
    )


def _plot(simulation: Simulation, key: str) -> Plot:
    log, error = simulation.log, simulation.residual_V
    size, high = millivolt(simulation.rmse_V), millivolt(simulation.rmse_above_10pct_V)
    worst = int(np.argmax(np.where(np.isfinite(error), np.abs(error), -1.0)))
    title = (
        f"{clock_of(log)}: {size} RMSE over {duration(log.duration_s)} ({high} above 10 % SOC), "
        f"at most {millivolt(error[worst])} at {points(float(simulation.soc[worst]))} SOC"
    )
    return simulation_plot(key, title, log, [as_model(simulation)], simulation.soc)


def _worst_minutes(simulations: Sequence[Simulation]) -> Markup:
    """Links to where the model is worst above 10 % SOC."""
    said = []
    for s in simulations:
        part = worst_part(s.log, s.residual_V, s.soc > NEAR_EMPTY)
        size = millivolt(error_metrics(s.residual_V[part]).rmse_V)
        length = duration(float(s.log.time_s[part][-1] - s.log.time_s[part][0]))
        where = percent(float(np.mean(s.soc[part])), 0)
        said.append(jump(f"{length} of {clock_of(s.log)} at {where} SOC, {size}", s.log, part))
    return paragraph(Markup("Worst minutes above 10 % SOC: " + "; ".join(said)))


def _first_explained(pictures: Sequence[Picture]) -> list[Picture]:
    """The same caption stands below one of them."""
    return [p if k == 0 else p._replace(caption="") for k, p in enumerate(pictures)]


@pictured(
    "by-soc",
    "Error by tenth of SOC: the mean, and as a bar what holds 95 % of it.",
)
def error_by_soc_picture(simulation: Simulation) -> style.Figure:
    """Mean error and the interval of 95 % in every tenth of SOC."""
    figure, axes = style.new_axes()
    bands = [b for b in simulation.bands if np.isfinite(b.rmse_V)]
    title = clock_of(simulation.log)
    if bands:
        centre = np.array([50.0 * (b.soc_low + b.soc_high) for b in bands])
        low, high = (np.array([1e3 * b.metrics.ci95_V[k] for b in bands]) for k in (0, 1))
        mean = np.array([1e3 * b.metrics.mean_error_V for b in bands])
        axes.bar(centre, high - low, 8.6, bottom=low, color=style.MODEL, alpha=0.25)
        axes.hlines(mean, centre - 4.3, centre + 4.3, color=style.MODEL, linewidth=1.8)
        worst = max(bands, key=lambda b: b.rmse_V)
        where = f"{100 * worst.soc_low:.0f}–{percent(worst.soc_high, 0)} SOC"
        title += f": {millivolt(worst.rmse_V)} RMSE at {where}"
    style.finding(axes, title)
    style.zero_line(axes)
    style.soc_axis(axes, "error [mV]")
    return figure

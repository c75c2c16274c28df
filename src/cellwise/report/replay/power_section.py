"""State of power along a replay beside the power that was measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwise.estimate.power.along import PowerTrace
from cellwise.estimate.power.state_of_power import PowerLimit
from cellwise.estimate.replay import Replay
from cellwise.report.page.jumps import clock_of
from cellwise.report.page.markup import Markup, paragraph, table
from cellwise.report.page.numerals import significant, time_unit
from cellwise.report.page.picture import Picture, safe_key
from cellwise.report.page.section import Section
from cellwise.report.page.style import (
    FILTER,
    MEASURED,
    finding,
    labels,
    legend,
    new_figure,
    styled,
)
from cellwise.report.page.thinning import thin, thin_band

if TYPE_CHECKING:
    from matplotlib.figure import Figure

USUAL_S = 10.0
CAPTION = (
    "At every moment: the power that the cell can give (above zero) and take (below) for "
    "{horizon:g} s within its limits, each with the band down to what it sustains with 95 %; grey "
    "is the power that was measured."
)
EXPLAINED = (
    "The largest constant {hold} which keeps terminal voltage, current and SOC within their limits "
    "to the end of the horizon, from the state that the filter has at that moment; the power is "
    "that at the horizon's end. The lower bound keeps 1.645 standard deviations of the predicted "
    "voltage and of the SOC from the limits. Powers are those of one cell, at the end of the log."
)


def power_section(replays: Sequence[Replay]) -> Section:
    """A picture of every replay that has a power, then their figures."""
    known = [(r, r.power) for r in replays if r.power is not None]
    pictures = [
        Picture(
            f"power-{k + 1}-{safe_key(r.estimator)}-{safe_key(r.log.name or 'log')}",
            draw_power(r, power),
            CAPTION.format(horizon=power.horizons_s[usual(power)]),
            clock_of(r.log),
        )
        for k, (r, power) in enumerate(known)
    ]
    tables = [power_content(r, power, several=len(known) > 1) for r, power in known]
    return Section("power", "State of power", (*pictures, *tables))


def power_content(replay: Replay, power: PowerTrace, *, several: bool) -> Markup:
    """The power at the log's end, at every horizon."""

    def limit(way: PowerLimit) -> tuple[str, ...]:
        return (
            f"{significant(way.power_W)} W",
            f"{significant(way.power_low_W)} W",
            f"{significant(way.current_A)} A",
            way.by,
        )

    rows = [(f"{s.horizon_s:g} s", *limit(s.discharge), *limit(s.charge)) for s in power.last]
    name = f"{replay.estimator} on {replay.log.name or 'log'}. " if several else ""
    one_way = ("at least (95 %)", "current", "limited by")
    head = ("for", "discharge", *one_way, "charge", *one_way)
    text = name + EXPLAINED.format(hold=power.hold)
    return Markup(paragraph(text, "note") + table(head, rows, text_columns=(0, 4, 8)))


def usual(power: PowerTrace) -> int:
    """Number of the horizon that is drawn: the one nearest to ten seconds."""
    return int(np.argmin([abs(h - USUAL_S) for h in power.horizons_s]))


@styled
def draw_power(replay: Replay, power: PowerTrace) -> Figure:
    """Power limits over the log, charge below zero, and the measured power."""
    j = usual(power)
    log = replay.log
    figure = new_figure(2.9)
    axes = figure.subplots()
    scale, unit = time_unit(log.duration_s or 1.0)
    t = (log.time_s - log.time_s[0]) / scale
    ways = (
        (power.discharge_W[j], power.discharge_low_W[j], 1.0, "limits, down to 95 %"),
        (power.charge_W[j], power.charge_low_W[j], -1.0, None),
    )
    for value, low, sign, name in ways:
        x, least, most = thin_band(t, np.minimum(sign * low, sign * value),
                                   np.maximum(sign * low, sign * value))  # fmt: skip
        axes.fill_between(x, least, most, color=FILTER, alpha=0.25, linewidth=0, label=name)
        axes.plot(*thin(t, sign * value), color=FILTER)
    measured = log.interval_current_A * log.voltage_V
    axes.plot(*thin(t, measured), color=MEASURED, label="measured")
    labels(axes, f"time [{unit}]", f"power for {power.horizons_s[j]:g} s [W per cell]")
    finding(axes, power_finding(power))
    legend(axes)
    return figure


def power_finding(power: PowerTrace) -> str:
    """One line of the state of power at the log's end."""
    now = power.last[usual(power)]
    return (
        f"At the end each cell can give {significant(now.discharge.power_W)} W for "
        f"{now.horizon_s:g} s (at least {significant(now.discharge.power_low_W)} W) and take "
        f"{significant(now.charge.power_W)} W."
    )

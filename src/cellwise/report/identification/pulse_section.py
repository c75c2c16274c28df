"""Pulses: which were found, what they were judged to be, and why."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.identification import Identification, PulseSet
from cellwise.report.page.markup import Markup, details, table
from cellwise.report.page.numerals import celsius, duration, listed, percent, plural, significant
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    MUTED,
    VERDICTS,
    finding,
    labels,
    new_figure,
    soc_axis,
    styled,
    zero_line,
)
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS = 6
MOST_ROWS = 300


def pulse_sets(identification: Identification) -> tuple[tuple[float, PulseSet], ...]:
    """Every HPPC log's pulses with their temperature [degC]."""
    return tuple((t.temperature_C, s) for t in identification.temperatures for s in t.pulse_sets)


def pulse_soc(found: PulseSet, capacity_Ah: float) -> FloatArray:
    """SOC at the start of each pulse, shape (pulses,)."""
    charge = found.log.counted_charge_Ah()
    starts = [max(p.start - 1, 0) for p in found.pulses]
    return np.asarray(found.anchor.soc - charge[starts] / capacity_Ah, dtype=np.float64)


def judged(found: PulseSet) -> list[Pulse]:
    """The pulses that count in the summary: the short ones, or the moves where there are none."""
    return [p for p in found.pulses if p.role == "pulse"] or list(found.pulses)


def verdict_counts(pulses: list[Pulse]) -> str:
    """``58 healthy, 8 trimmed``."""
    counts: Counter[str] = Counter(p.quality for p in pulses)
    return listed([f"{counts[q]} {q}" for q in VERDICTS if counts[q]]) or "none"


def pulse_content(identification: Identification) -> Markup:
    """Counts by log, and every pulse that was not healthy with its reason."""
    sets = pulse_sets(identification)
    counts = table(
        ("log", "temperature", "pulses", *VERDICTS, "moves", "fitted"),
        [
            (
                found.log.name or "HPPC",
                celsius(temperature),
                len(judged(found)),
                *(sum(p.quality == q for p in judged(found)) for q in VERDICTS),
                sum(p.role == "move" for p in found.pulses),
                len(found.fits),
            )
            for temperature, found in sets
        ],
    )
    rows = _unhealthy_rows(identification)
    if not rows:
        return counts
    shown = rows[:MOST_ROWS]
    cut = "" if len(rows) == len(shown) else f" (the first {MOST_ROWS})"
    reasons = table(
        ("log", "SOC", "current", "duration", "role", "verdict", "score", "why"),
        shown,
        text_columns=(0, 4, 5, 7),
    )
    summary = f"Why {plural(len(rows), 'pulse')} and moves were not called healthy{cut}"
    return Markup(counts + details(summary, reasons))


def _unhealthy_rows(identification: Identification) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for _, found in pulse_sets(identification):
        soc = pulse_soc(found, identification.model.capacity_Ah)
        rows += [
            (
                found.log.name or "HPPC",
                percent(float(s), 1),
                f"{significant(p.current_A)} A",
                duration(p.duration_s),
                p.role,
                p.quality,
                f"{p.score:.2f}",
                p.reason,
            )
            for p, s in zip(found.pulses, soc, strict=True)
            if p.quality != "healthy"
        ]
    return rows


def pulse_picture(identification: Identification) -> Picture:
    """Pulses over SOC and current, coloured by verdict."""
    caption = (
        "Every short pulse at the SOC and current it was driven with; thin marks are the long "
        "moves between levels. Healthy: a passive circuit explains the response. Trimmed: a "
        "voltage limit cut the current. Distorted: the response bends as no circuit does, mostly "
        "at the ends of SOC. Only healthy ones are fitted."
    )
    return Picture("pulses", draw_pulses(identification), caption)


@styled
def draw_pulses(identification: Identification) -> Figure:
    """One panel per HPPC log."""
    sets = pulse_sets(identification)[:MOST_PANELS]
    figure = new_figure(0.5 + 2.1 * max(len(sets), 1))
    for k, (temperature, found) in enumerate(sets):
        axes = figure.add_subplot(len(sets), 1, k + 1)
        _draw_set(axes, found, temperature, identification.model.capacity_Ah)
        soc_axis(axes)
    return figure


def _draw_set(axes: Axes, found: PulseSet, temperature_C: float, capacity_Ah: float) -> None:
    soc = 100.0 * pulse_soc(found, capacity_Ah)
    current = np.array([p.current_A for p in found.pulses])
    counted = judged(found)
    role = counted[0].role if counted else "pulse"
    short = np.array([p.role == role for p in found.pulses], dtype=bool)
    zero_line(axes)
    if not short.all():
        axes.plot(
            soc[~short], current[~short], "_", color=MUTED, ms=9, mew=1.0, label="move", zorder=2
        )
    for quality, (colour, marker) in VERDICTS.items():
        mine = short & np.array([p.quality == quality for p in found.pulses], dtype=bool)
        if mine.any():
            axes.plot(
                soc[mine],
                current[mine],
                marker,
                color=colour,
                markersize=5.5,
                markeredgewidth=1.2,
                label=f"{quality} ({int(mine.sum())})",
                zorder=3,
            )
    name = found.log.name or "HPPC"
    finding(axes, f"{name}, {celsius(temperature_C)}: {verdict_counts(counted)}")
    labels(axes, "SOC [%]", "current [A], + discharge")
    axes.margins(y=0.15)
    handles, names = axes.get_legend_handles_labels()
    if handles:
        axes.legend(handles, names, loc="center left", bbox_to_anchor=(1.0, 0.5))

"""Pulses: which were found, what they were judged to be and why; one of them explained."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.identify.identification import Identification, PulseSet
from cellwise.report.page import style
from cellwise.report.page.markup import MOST, Markup, details, record_table
from cellwise.report.page.numerals import (
    celsius,
    duration,
    listed,
    percent,
    plural,
    significant,
)
from cellwise.report.page.picture import Picture, pictured
from cellwise.typing import FloatArray


def pulse_sets(identification: Identification) -> tuple[tuple[float, PulseSet], ...]:
    """Every HPPC log's pulses with their temperature [degC]."""
    return tuple((t.temperature_C, s) for t in identification.temperatures for s in t.pulse_sets)


def pulse_soc(found: PulseSet, capacity_Ah: float) -> FloatArray:
    """SOC at the start of each pulse, shape (pulses,)."""
    charge = found.log.counted_charge_Ah()
    starts = [max(p.start - 1, 0) for p in found.pulses]
    return np.asarray(found.anchor.soc - charge[starts] / capacity_Ah, dtype=np.float64)


def _warm(found: PulseSet, temperature_C: float) -> str:
    """The temperature of a log, and that it is taken where nobody measured or stated one."""
    known = found.log.temperature_C is not None
    return celsius(temperature_C) if known else f"{celsius(temperature_C)} (taken, not measured)"


def judged(found: PulseSet) -> list[Pulse]:
    """The pulses that count in the summary: the short ones, or the moves where there are none."""
    return [p for p in found.pulses if p.role == "pulse"] or list(found.pulses)


def verdict_counts(pulses: list[Pulse]) -> str:
    """``58 healthy, 8 trimmed``."""
    counts: Counter[str] = Counter(p.quality for p in pulses)
    return listed([f"{counts[q]} {q}" for q in style.VERDICTS if counts[q]]) or "none"


def pulse_content(identification: Identification) -> Markup:
    """Counts by log, and every pulse that was not healthy with its reason."""
    counts = record_table(
        pulse_sets(identification),
        ("log", lambda one: one[1].log.name or "HPPC"),
        ("temperature", lambda one: _warm(one[1], one[0])),
        ("pulses", lambda one: len(judged(one[1]))),
        *(
            (q, lambda one, q=q: sum(p.quality == q for p in judged(one[1])))
            for q in style.VERDICTS
        ),
        ("moves", lambda one: sum(p.role == "move" for p in one[1].pulses)),
        ("fitted", lambda one: len(one[1].fits)),
    )
    unhealthy = [
        (found.log.name or "HPPC", pulse, float(soc))
        for _, found in pulse_sets(identification)
        for pulse, soc in zip(
            found.pulses, pulse_soc(found, identification.model.capacity_Ah), strict=True
        )
        if pulse.quality != "healthy"
    ]
    if not unhealthy:
        return counts
    cut = "" if len(unhealthy) <= MOST.pulses else f" (the first {MOST.pulses})"
    reasons = record_table(
        unhealthy[: MOST.pulses],
        ("log", lambda one: one[0]),
        ("SOC", lambda one: percent(one[2], 1)),
        ("current", lambda one: f"{significant(one[1].current_A)} A"),
        ("duration", lambda one: duration(one[1].duration_s)),
        ("role", lambda one: one[1].role),
        ("verdict", lambda one: one[1].quality),
        ("why", lambda one: one[1].reason),
        text_columns=(0, 4, 5, 6),
    )
    summary = f"Why {plural(len(unhealthy), 'pulse')} and moves were not called healthy{cut}"
    return Markup(counts + details(summary, reasons))


VERDICTS = {
    "healthy": "Healthy: a passive circuit explains the response. Only healthy ones are fitted.",
    "trimmed": "Trimmed: a voltage limit cut the current.",
    "distorted": "Distorted: the response bends as no circuit does.",
    "spurious": "Spurious: a gap, no answer of the voltage, or far too short.",
}


def _caption(identification: Identification) -> str:
    """What the marks that are there mean."""
    sets = [s for _, s in pulse_sets(identification)[: MOST.pulse_logs]]
    found = {p.quality for s in sets for p in judged(s)}
    text = "Every short pulse at its SOC and current (discharge positive)"
    if any(len(judged(s)) < len(s.pulses) for s in sets):
        text += "; thin marks are the long moves between levels"
    return " ".join([f"{text}.", *(said for name, said in VERDICTS.items() if name in found)])


def pulse_pictures(identification: Identification) -> tuple[Picture, ...]:
    """One per HPPC log, the first one explained."""
    capacity_Ah, text = identification.model.capacity_Ah, _caption(identification)
    sets = pulse_sets(identification)[: MOST.pulse_logs]
    return tuple(
        pulse_picture(found, temperature, capacity_Ah)._replace(
            key="pulses" if k == 0 else f"pulses-{k + 1}", caption="" if k else text
        )
        for k, (temperature, found) in enumerate(sets)
    )


@pictured("pulses")
def pulse_picture(found: PulseSet, temperature_C: float, capacity_Ah: float) -> style.Figure:
    """Every pulse of a log at its SOC and current."""
    figure, axes = style.new_axes()
    soc = 100.0 * pulse_soc(found, capacity_Ah)
    current = np.array([p.current_A for p in found.pulses])
    counted = judged(found)
    role = counted[0].role if counted else "pulse"
    short = np.array([p.role == role for p in found.pulses], dtype=bool)
    style.zero_line(axes)
    if not short.all():
        looks: dict[str, Any] = {"color": style.MUTED, "ms": 9, "mew": 1.0, "zorder": 2}
        axes.plot(soc[~short], current[~short], "_", label="move", **looks)
    for quality, (colour, marker) in style.VERDICTS.items():
        mine = short & np.array([p.quality == quality for p in found.pulses], dtype=bool)
        if mine.any():
            looks = {"color": colour, "ms": 5.5, "mew": 1.2, "zorder": 3}
            axes.plot(soc[mine], current[mine], marker, label=quality, **looks)
    name = found.log.name or "HPPC"
    style.finding(axes, f"{name}, {_warm(found, temperature_C)}: {verdict_counts(counted)}")
    style.soc_axis(axes, "current [A]")
    axes.margins(y=0.15)
    style.key_below(axes)
    return figure

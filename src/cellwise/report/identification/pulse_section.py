"""Pulses: which were found, what they were judged to be and why; one of them explained."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.identification import Identification, PulseSet
from cellwise.report.page import style
from cellwise.report.page.markup import MOST, Markup, details, record_table
from cellwise.report.page.numerals import (
    celsius,
    duration,
    listed,
    millivolt,
    percent,
    plural,
    points,
    significant,
    time_unit,
)
from cellwise.report.page.picture import Picture, pictured
from cellwise.report.page.traces import thin
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
        ("score", lambda one: f"{one[1].score:.2f}"),
        ("why", lambda one: one[1].reason),
        text_columns=(0, 4, 5, 7),
    )
    summary = f"Why {plural(len(unhealthy), 'pulse')} and moves were not called healthy{cut}"
    return Markup(counts + details(summary, reasons))


@pictured(
    "pulses",
    "Every short pulse at its SOC and current (discharge positive); thin marks are the long moves "
    "between levels. Healthy: a passive circuit explains the response. Trimmed: a voltage limit "
    "cut the current. Distorted: the response bends as no circuit does. Only healthy ones are "
    "fitted.",
)
def pulse_picture(identification: Identification) -> style.Figure:
    """One panel per HPPC log."""
    sets = pulse_sets(identification)[: MOST.pulse_logs]
    figure = style.new_figure(0.5 + 2.2 * max(len(sets), 1))
    for k, (temperature, found) in enumerate(sets):
        axes = figure.add_subplot(len(sets), 1, k + 1)
        _draw_set(axes, found, temperature, identification.model.capacity_Ah)
        style.soc_axis(axes)
    style.key_below(figure)
    return figure


def _draw_set(axes: style.Axes, found: PulseSet, temperature_C: float, capacity_Ah: float) -> None:
    soc = 100.0 * pulse_soc(found, capacity_Ah)
    current = np.array([p.current_A for p in found.pulses])
    counted = judged(found)
    role = counted[0].role if counted else "pulse"
    short = np.array([p.role == role for p in found.pulses], dtype=bool)
    style.zero_line(axes)
    if not short.all():
        axes.plot(
            soc[~short],
            current[~short],
            "_",
            color=style.MUTED,
            ms=9,
            mew=1.0,
            label="move",
            zorder=2,
        )
    for quality, (colour, marker) in style.VERDICTS.items():
        mine = short & np.array([p.quality == quality for p in found.pulses], dtype=bool)
        if mine.any():
            looks: dict[str, Any] = {
                "markersize": 5.5,
                "markeredgewidth": 1.2,
                "zorder": 3,
                "color": colour,
            }
            axes.plot(soc[mine], current[mine], marker, label=quality, **looks)
    name = found.log.name or "HPPC"
    style.finding(axes, f"{name}, {_warm(found, temperature_C)}: {verdict_counts(counted)}")
    style.labels(axes, "SOC [%]", "current [A]")
    axes.margins(y=0.15)


BEFORE_PART, AFTER_PARTS = 0.4, 3.6
_ARROW = {"arrowstyle": "<->", "color": style.INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}


class Example(NamedTuple):
    """A pulse near half charge, its SOC, and the simulation of the log it is in."""

    pulse: Pulse
    soc: float
    simulation: Simulation


def pulse_example_picture(identification: Identification) -> Picture | None:
    """A healthy pulse near half charge with the model beside it; None where there is none."""
    example = find_example(identification)
    return None if example is None else _example_picture(example)


def find_example(identification: Identification) -> Example | None:
    """The healthy pulse nearest to half charge, of those the strongest discharge."""
    found: list[tuple[float, float, Example]] = []
    simulated = {id(s.log): s for s in identification.simulations}
    for temperature in identification.temperatures:
        for one in temperature.pulse_sets:
            simulation = simulated.get(id(one.log))
            if simulation is None:
                continue
            for pulse in one.fitted:
                soc = float(simulation.soc[max(pulse.start - 1, 0)])
                far = round(abs(soc - 0.5), 1)
                found.append((far, -pulse.current_A, Example(pulse, soc, simulation)))
    return min(found, key=lambda item: item[:2])[2] if found else None


@pictured(
    "pulse-example",
    "A current is switched on and off again. The voltage drops at once (R₀), sags further while "
    "the current flows (the RC branches), and creeps back afterwards. From how far and how fast "
    "it does so at each state of charge, the parts of the circuit are read.",
)
def _example_picture(example: Example) -> style.Figure:
    """Current and voltage around one pulse, the parts of the answer named."""
    pulse, simulation = example.pulse, example.simulation
    log = simulation.log
    begin = float(log.time_s[max(pulse.start - 1, 0)])
    scale, unit = time_unit(pulse.duration_s)
    length = pulse.duration_s / scale
    ends = (-BEFORE_PART * length, (1.0 + AFTER_PARTS) * length)
    # A row more on either side, for rows may be far apart at rest.
    first = int(np.searchsorted(log.time_s, begin + ends[0] * scale)) - 1
    last = int(np.searchsorted(log.time_s, begin + ends[1] * scale)) + 1
    rows = slice(max(first, pulse.rest_before_start, 0), max(last, pulse.stop))
    t = (log.time_s[rows] - begin) / scale
    figure = style.new_figure(3.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    top.plot(*thin(t, log.voltage_V[rows]), color=style.MEASURED, lw=2.2, label="measured")
    top.plot(*thin(t, simulation.voltage_V[rows]), color=style.MODEL, lw=1.3, label="model")
    v0 = pulse.voltage_before_V
    at_once = float(log.voltage_V[min(pulse.start + 1, pulse.stop - 1)])
    at_end = float(log.voltage_V[pulse.stop - 1])
    _measure(top, length, (v0, at_once), f"{millivolt(abs(v0 - at_once))} at once: R₀")
    _measure(
        top,
        length,
        (at_once, at_end),
        f"{millivolt(abs(at_once - at_end))} within {duration(pulse.duration_s)}: R₁, R₂",
    )
    style.finding(
        top,
        f"{significant(pulse.current_A)} A for {duration(pulse.duration_s)} at "
        f"{points(round(example.soc, 2))} SOC moves the voltage by {millivolt(abs(v0 - at_end))}",
    )
    style.labels(top, "", "voltage [V]")
    style.legend(top, place="lower right")
    bottom.plot(t, log.known_current_A()[rows], color=style.MEASURED, lw=1.4, drawstyle="steps-pre")
    style.labels(bottom, f"time since the current was switched on [{unit}]", "current [A]")
    bottom.set_xlim(*ends)
    return figure


def _measure(axes: style.Axes, length: float, levels: tuple[float, float], text: str) -> None:
    """A double arrow between two voltages beside the pulse, with its meaning."""
    at = 1.12 * length
    for level in levels:
        axes.plot([0.0, at], [level, level], color=style.MUTED, lw=0.7, ls=(0, (2, 2)))
    axes.annotate("", (at, levels[0]), xytext=(at, levels[1]), arrowprops=_ARROW)
    middle = 0.5 * (levels[0] + levels[1])
    looks = {"va": "center", "color": style.INK, "fontsize": "medium"}
    style.note(axes, text, (at, middle), (8, 0), **looks)

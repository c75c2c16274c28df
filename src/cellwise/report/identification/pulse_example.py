"""One pulse, explained: what drops at once, what follows, what comes back."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cellwise.cell.simulate import Simulation
from cellwise.identify.hppc.pulses import Pulse
from cellwise.identify.identification import Identification
from cellwise.report.page.numerals import duration, millivolt, points, significant, time_unit
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    INK,
    MEASURED,
    MODEL,
    MUTED,
    finding,
    labels,
    legend,
    new_figure,
    styled,
)
from cellwise.report.page.thinning import thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEFORE_PART, AFTER_PARTS = 0.4, 3.6
_ARROW = {"arrowstyle": "<->", "color": INK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
CAPTION = (
    "A current is switched on and off again. The voltage drops at once (R₀), sags further while "
    "the current flows (the RC branches), and creeps back afterwards. From how far and how fast "
    "it does so at each state of charge, the parts of the circuit are read."
)


class Example(NamedTuple):
    """A pulse near half charge, its SOC, and the simulation of the log it is in."""

    pulse: Pulse
    soc: float
    simulation: Simulation


def pulse_example_picture(identification: Identification) -> Picture | None:
    """A healthy pulse near half charge with the model beside it; None where there is none."""
    example = find_example(identification)
    return None if example is None else Picture("pulse-example", draw_example(example), CAPTION)


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


@styled
def draw_example(example: Example) -> Figure:
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
    figure = new_figure(3.6)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    top.plot(*thin(t, log.voltage_V[rows]), color=MEASURED, lw=2.2, label="measured")
    top.plot(*thin(t, simulation.voltage_V[rows]), color=MODEL, lw=1.3, label="model")
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
    finding(
        top,
        f"{significant(pulse.current_A)} A for {duration(pulse.duration_s)} at "
        f"{points(round(example.soc, 2))} SOC moves the voltage by {millivolt(abs(v0 - at_end))}",
    )
    labels(top, "", "voltage [V]")
    legend(top, place="lower right")
    bottom.plot(t, log.known_current_A()[rows], color=MEASURED, lw=1.4, drawstyle="steps-pre")
    labels(bottom, f"time since the current was switched on [{unit}]", "current [A]")
    bottom.set_xlim(*ends)
    return figure


def _measure(axes: Axes, length: float, levels: tuple[float, float], text: str) -> None:
    """A double arrow between two voltages beside the pulse, with its meaning."""
    at = 1.12 * length
    for level in levels:
        axes.plot([0.0, at], [level, level], color=MUTED, lw=0.7, ls=(0, (2, 2)))
    axes.annotate("", (at, levels[0]), xytext=(at, levels[1]), arrowprops=_ARROW)
    axes.annotate(
        text,
        (at, 0.5 * (levels[0] + levels[1])),
        xytext=(8, 0),
        textcoords="offset points",
        va="center",
        color=INK,
    )

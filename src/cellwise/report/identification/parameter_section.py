"""Resistances, time constants and capacitances over SOC: single pulses and refined tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.identify.identification import Identification
from cellwise.report.identification.parameter_tables import (
    NAMES,
    PulseValues,
    model_table,
    pulse_values,
    shown_names,
    table_error,
)
from cellwise.report.page.markup import Markup, details, table
from cellwise.report.page.numerals import celsius, farad_unit, ohm_unit, percent, significant
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    COLD_TO_WARM,
    MEASURED,
    MODEL,
    finding,
    labels,
    new_figure,
    soc_axis,
    styled,
)
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Beyond this ratio of largest to smallest a table is drawn over a logarithmic axis.
LOG_FROM = 5.0
PRINTED_SOC = tuple(k / 10 for k in range(11))
MIDDLE = 0.5


def parameter_picture(identification: Identification) -> Picture:
    """Every parameter over SOC."""
    refined = any(t.refinement is not None for t in identification.temperatures)
    caption = (
        "R₀ is the drop at once, the RC branches are what follows within seconds (1), minutes (2) "
        "and longer (3). Marks, if any, are single pulses with one standard error (▼ discharge, "
        "▲ charge; pale where the pulse does not show the parameter), lines are the tables in "
        "the model"
    )
    caption += (
        ", refined on whole logs, with a band of two standard errors. They need not meet: a short "
        "pulse sees only the beginning of what a drive shows."
        if refined
        else ", smooth through the pulses."
    )
    return Picture("parameters", draw_parameters(identification), caption)


@styled
def draw_parameters(identification: Identification) -> Figure:
    """A grid of panels, one per parameter, resistance first."""
    rows = shown_names(identification)
    figure = new_figure(0.3 + 2.0 * len(rows))
    grid = figure.add_gridspec(len(rows), 3)
    for i, names in enumerate(rows):
        for j, name in enumerate(names):
            axes = figure.add_subplot(grid[i, j])
            if name:
                _draw_parameter(axes, identification, name)
                soc_axis(axes, label=i == len(rows) - 1)
            else:
                _draw_key(axes, identification)
    return figure


def parameter_content(identification: Identification) -> Markup:
    """The tables of the model at every tenth of SOC."""
    model = identification.model
    parts = []
    for row, temperature in enumerate(model.temperature_C):
        names = [n for n in NAMES if model_table(model, n, row) is not None and n != "dc_ohm"]
        units = {n: _unit(n, _finite(model_table(model, n, row))) for n in names}
        body = []
        for soc in PRINTED_SOC:
            at = [
                soc,
                *(np.interp(soc, model.soc, _finite(model_table(model, n, row))) for n in names),
            ]
            body.append(
                (
                    percent(soc, 0),
                    f"{np.interp(soc, model.soc, model.ocv_V[row]):.4f}",
                    *(significant(units[n][0] * v) for n, v in zip(names, at[1:], strict=True)),
                )
            )
        head = ("SOC", "OCV [V]", *(f"{NAMES[n]} [{units[n][1]}]" for n in names))
        parts.append(
            table(head, body, caption=f"Tables of the model at {celsius(float(temperature))}")
        )
    return details("The tables in numbers", Markup("".join(parts)))


def _draw_parameter(axes: Axes, identification: Identification, name: str) -> None:
    model = identification.model
    lines = [_finite(model_table(model, name, row)) for row in range(model.temperature_C.size)]
    shown = slice(None, None, max(model.points // 100, 1))
    soc = model.soc[shown]
    factor, unit = _unit(name, lines[0])
    colours = temperature_colours(len(lines))
    seen: list[FloatArray] = []
    error_at_middle = float("nan")
    for row, line in enumerate(lines):
        here = model.temperature_C[row]
        found = next((t for t in identification.temperatures if t.temperature_C == here), None)
        colour = colours[row]
        if found is not None:
            values = pulse_values(found, name)
            if values is not None:
                many = len(lines) > 1
                seen += _draw_pulse_values(axes, values, factor, colour if many else MEASURED)
            band = table_error(found, name, model.soc)
            if band is not None:
                low, high = line * np.exp(-2.0 * band), line * np.exp(2.0 * band)
                axes.fill_between(
                    100 * soc,
                    factor * low[shown],
                    factor * high[shown],
                    color=colour,
                    alpha=0.18,
                    lw=0,
                )
                if row == _reference_row(identification):
                    error_at_middle = float(np.interp(MIDDLE, model.soc, band))
        axes.plot(100.0 * soc, factor * line[shown], color=colour, linewidth=1.6, zorder=4)
        seen.append(factor * line)
    _scale(axes, np.concatenate(seen))
    middle = float(np.interp(MIDDLE, model.soc, lines[_reference_row(identification)]))
    where = f", {celsius(float(model.temperature_C[_reference_row(identification)]))}"
    where = where if len(lines) > 1 else ""
    title = f"{NAMES[name]} = {significant(factor * middle)} {unit}"
    if np.isfinite(error_at_middle):
        title += f" ± {percent(2.0 * error_at_middle, 0)}"
    finding(axes, f"{title} at {percent(MIDDLE, 0)}{where}", 0.27)
    labels(axes, "SOC [%]", f"{NAMES[name]} [{unit}]")


def _draw_pulse_values(
    axes: Axes, values: PulseValues, factor: float, colour: str
) -> list[FloatArray]:
    """Marks of the single pulses; what they show well sets the axis."""
    for rows, marker in ((values.discharge, "v"), (~values.discharge, "^")):
        sure, vague = rows & values.known, rows & ~values.known & np.isfinite(values.value)
        axes.plot(
            100 * values.soc[vague],
            factor * values.value[vague],
            marker,
            color=colour,
            alpha=0.28,
            markersize=3.5,
            markeredgewidth=0,
        )
        x, y = 100.0 * values.soc[sure], factor * values.value[sure]
        error = np.nan_to_num(factor * values.error[sure], nan=0.0, posinf=0.0)
        error = np.minimum(error, 0.9 * y)
        # All bars as one broken line: a hundred times smaller than as many lines.
        bars = np.column_stack((y - error, y + error, np.full(x.size, np.nan)))
        axes.plot(np.repeat(x, 3), bars.ravel(), color=colour, linewidth=0.7, zorder=3)
        axes.plot(x, y, marker, color=colour, markersize=3.5, markeredgewidth=0, zorder=3)
    well = factor * values.value[values.known]
    return [np.percentile(well, [3, 97])] if well.size else []


def _draw_key(axes: Axes, identification: Identification) -> None:
    """The panel without a parameter names the marks and lines."""
    model = identification.model
    axes.axis("off")
    for colour, t in zip(
        temperature_colours(model.temperature_C.size), model.temperature_C, strict=True
    ):
        axes.plot([], [], color=colour, linewidth=1.8, label=f"model at {celsius(float(t))}")
    if any(found.fits for t in identification.temperatures for found in t.pulse_sets):
        for marker, alpha, name in (
            ("v", 1.0, "single discharge pulse"),
            ("^", 1.0, "single charge pulse"),
            ("^", 0.28, "not shown by its pulse"),
        ):
            axes.plot([], [], marker, color=MEASURED, markersize=4, alpha=alpha, label=name)
    axes.legend(loc="center left", bbox_to_anchor=(0.0, 0.5), labelspacing=0.6)


def temperature_colours(count: int) -> tuple[str, ...]:
    """One colour per temperature from cold to warm; a single one has the model's colour."""
    if count == 1:
        return (MODEL,)
    if count <= len(COLD_TO_WARM) - 1:
        picks = np.linspace(0, len(COLD_TO_WARM) - 2, count).round().astype(int)
        return tuple(COLD_TO_WARM[k] for k in picks)
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return tuple(to_hex(colormaps["viridis"](x)) for x in np.linspace(0.0, 0.9, count))


def _scale(axes: Axes, seen: FloatArray) -> None:
    """Limits from what is known well; logarithmic where it spans much."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    seen = seen[np.isfinite(seen) & (seen > 0.0)]
    if seen.size == 0:
        return
    low, high = float(seen.min()), float(seen.max())
    if high / low > LOG_FROM:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.3, high * 1.3)
        dense = (1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)
        axes.yaxis.set_major_locator(LogLocator(subs=dense, numticks=12))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        room = 0.12 * (high - low) + 1e-3 * high
        axes.set_ylim(max(low - room, 0.0), high + room)


def _reference_row(identification: Identification) -> int:
    return int(np.argmin(np.abs(identification.model.temperature_C - 25.0)))


def _unit(name: str, line: FloatArray) -> tuple[float, str]:
    typical = float(np.median(line))
    if name.endswith("_ohm"):
        return ohm_unit(typical)
    return farad_unit(typical) if name.endswith("_F") else (1.0, "s")


def _finite(line: FloatArray | None) -> FloatArray:
    return np.empty(0) if line is None else line

"""Parameters over SOC: the model's tables, their standard errors, the single pulses' values."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.effects import SlowDiffusion, effect_table
from cellwise.cell.model import CellModel
from cellwise.identify.identification import Identification, TemperatureResult
from cellwise.identify.refinement.splines import greville
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, details, record_table
from cellwise.report.page.numerals import celsius, farad_unit, ohm_unit, percent, significant
from cellwise.report.page.picture import Picture, pictured
from cellwise.typing import BoolArray, FloatArray

NAMES = {
    "r0_ohm": "R₀",
    "r1_ohm": "R₁",
    "r2_ohm": "R₂",
    "r3_ohm": "R₃",
    "tau1_s": "τ₁",
    "tau2_s": "τ₂",
    "tau3_s": "τ₃",
    "c1_F": "C₁",
    "c2_F": "C₂",
    "c3_F": "C₃",
    "dc_ohm": "R₀ + R₁ + R₂",
}


# Beyond this ratio of largest to smallest a table is drawn over a logarithmic axis.
LOG_FROM = 5.0
VAGUE = 0.5  # two standard errors as a share: beyond, other values do nearly as well
MIDDLE = 0.5  # SOC at which a panel's title states the value
REFINED_CAPTION = (
    ", refined on whole logs, with a band of two standard errors. They need not meet: a short "
    "pulse sees only the beginning of what a drive shows."
)


class PulseValues(NamedTuple):
    """Values of one parameter from single pulses: arrays of shape (pulses,)."""

    soc: FloatArray
    value: FloatArray
    error: FloatArray
    discharge: BoolArray
    known: BoolArray


def model_table(model: CellModel, name: str, row: int) -> FloatArray | None:
    """One of ``NAMES`` over the model's SOC grid at one of its temperatures; None if absent."""
    slow = model.effect(SlowDiffusion)
    r3 = effect_table(slow.r3_ohm, model.ocv_V.shape)[row]
    has_slow = bool(np.any(r3 > 0.0))
    if name in ("r3_ohm", "tau3_s", "c3_F") and not has_slow:
        return None
    tau3 = effect_table(slow.tau3_s, model.ocv_V.shape)[row]
    if name == "r3_ohm":
        return np.asarray(r3)
    if name == "tau3_s":
        return np.asarray(tau3)
    if name == "c3_F":
        return np.asarray(tau3 / np.maximum(r3, 1e-12))
    if name == "dc_ohm":
        return np.asarray(model.r0_ohm[row] + model.r1_ohm[row] + model.r2_ohm[row])
    return np.asarray(getattr(model, name)[row])


def table_error(found: TemperatureResult, name: str, soc: FloatArray) -> FloatArray | None:
    """Standard error of a refined table as a share of its value, over SOC; None if unknown.

    The tables are splines of ln R and ln tau, whose coefficients act at the Greville points; the
    errors are joined by lines between these. That of C = tau / R leaves out their correlation.
    """
    result = found.refinement
    if result is None:
        return None
    lay, at = result.layout, greville(result.knots)

    def block(first: int) -> FloatArray:
        return np.asarray(np.interp(soc, at, result.theta_std[first : first + lay.knots]))

    if name == "r0_ohm":
        return block(lay.r0)
    if name == "dc_ohm":
        return None
    branch = int(next(c for c in name if c.isdigit())) - 1
    if branch >= lay.branches:
        return None
    if name.startswith("r"):
        return block(lay.r(branch))
    if name.startswith("tau"):
        return block(lay.tau(branch))
    return np.hypot(block(lay.r(branch)), block(lay.tau(branch)))


def pulse_values(found: TemperatureResult, name: str) -> PulseValues | None:
    """Values of one parameter from the single pulses of a temperature; None if they have none."""
    fits = [f for s in found.pulse_sets for f in s.fits if np.isfinite(f.soc)]
    if not fits or name in ("r3_ohm", "tau3_s", "c3_F"):
        return None
    soc = np.array([f.soc for f in fits])
    discharge = np.array([f.current_A > 0.0 for f in fits], dtype=bool)
    if name == "dc_ohm":
        value = np.array([f.r0_ohm + f.r1_ohm + f.r2_ohm for f in fits])
        error = np.full(value.size, np.nan)
        known = np.array([f.identified.r2_ohm > 0 or f.method == "segments" for f in fits])
        return PulseValues(soc, value, error, discharge, known)
    parts = [f"r{name[1]}_ohm", f"tau{name[1]}_s"] if name.startswith("c") else [name]
    value = np.array([getattr(f, name) for f in fits])
    shares = np.array(
        [[getattr(f.error, p) / max(getattr(f.value, p), 1e-12) for p in parts] for f in fits]
    )
    error = value * np.sqrt(np.sum(shares**2, axis=1))
    # A method without standard errors claims nothing: its values are shown as they are.
    known = np.array(
        [
            f.method == "segments" or all(getattr(f.identified, p) > 0.0 for p in parts)
            for f in fits
        ],
        dtype=bool,
    )
    return PulseValues(soc, value, error, discharge, known & np.isfinite(value) & (value > 0.0))


def shown_names(identification: Identification) -> tuple[str, ...]:
    """Panels, three a row: the resistances, then the branches that the model has."""
    slow = model_table(identification.model, "r3_ohm", 0) is not None
    branches = (1, 2, 3) if slow else (1, 2)
    rows = [(f"r{j}_ohm", f"tau{j}_s", f"c{j}_F") for j in branches]
    return ("r0_ohm", "dc_ohm", "", *(name for row in rows for name in row))


def parameter_picture(identification: Identification) -> Picture:
    """Every parameter over SOC."""
    picture = _parameter_picture(identification)
    if any(t.refinement is not None for t in identification.temperatures):
        return picture._replace(caption=picture.caption + REFINED_CAPTION)
    return picture._replace(caption=f"{picture.caption}, smooth through the pulses.")


@pictured(
    "parameters",
    "R₀ is the drop at once, the RC branches are what follows within seconds (1), minutes (2) "
    "and longer (3). Marks, if any, are single pulses with two standard errors (▼ discharge, "
    "▲ charge; pale where the pulse does not show the parameter), lines are the tables in "
    "the model",
)
def _parameter_picture(identification: Identification) -> style.Figure:
    """A grid of panels, one per parameter, resistance first."""
    names = shown_names(identification)
    figure = style.new_figure(0.3 + 2.0 * len(names) / 3)
    for axes, name in zip(style.panels(figure, len(names) // 3, 3), names, strict=True):
        if name:
            _draw_parameter(axes, identification, name)
            style.soc_axis(axes, label=name in names[-3:])
        else:
            _draw_key(axes, identification)
    return figure


def parameter_content(identification: Identification) -> Markup:
    """The tables of the model at every tenth of SOC."""
    model = identification.model
    parts = []
    for row, temperature in enumerate(model.temperature_C):
        named = ((n, model_table(model, n, row)) for n in NAMES if n != "dc_ohm")
        tables = {n: line for n, line in named if line is not None}
        units = {n: _unit(n, line) for n, line in tables.items()}
        shown = record_table(
            [k / 10 for k in range(11)],
            ("SOC", lambda soc: percent(soc, 0)),
            ("OCV [V]", partial(_read_ocv, model.soc, model.ocv_V[row])),
            *(
                (f"{NAMES[n]} [{units[n][1]}]", partial(_read, model.soc, units[n][0] * line))
                for n, line in tables.items()
            ),
            caption=f"Tables of the model at {celsius(float(temperature))}",
        )
        parts.append(shown)
    return details("The tables in numbers", Markup("".join(parts)))


def _read_ocv(grid: FloatArray, ocv_V: FloatArray, soc: float) -> str:
    return f"{np.interp(soc, grid, ocv_V):.4f}"


def _read(grid: FloatArray, line: FloatArray, soc: float) -> str:
    return significant(float(np.interp(soc, grid, line)))


def _draw_parameter(axes: style.Axes, identification: Identification, name: str) -> None:
    model = identification.model
    tables = [model_table(model, name, row) for row in range(model.temperature_C.size)]
    lines = [line for line in tables if line is not None]
    shown = slice(None, None, max(model.points // 100, 1))
    soc = 100.0 * model.soc[shown]
    factor, unit = _unit(name, lines[0])
    reference, many = _reference_row(identification), len(lines) > 1
    seen: list[FloatArray] = []
    error_at_middle = float("nan")
    fitted = {t.temperature_C: t for t in identification.temperatures}
    for row, (line, colour) in enumerate(zip(lines, temperature_colours(len(lines)), strict=True)):
        found = fitted.get(model.temperature_C[row])
        values = None if found is None else pulse_values(found, name)
        band = None if found is None else table_error(found, name, model.soc)
        if values is not None:
            seen += _draw_pulse_values(axes, values, factor, colour if many else style.MEASURED)
        if band is not None:
            low, high = (factor * line * np.exp(sign * 2.0 * band) for sign in (-1.0, 1.0))
            axes.fill_between(soc, low[shown], high[shown], color=colour, alpha=0.18, lw=0)
            if row == reference:
                error_at_middle = float(np.interp(MIDDLE, model.soc, band))
        axes.plot(soc, factor * line[shown], color=colour, linewidth=1.6, zorder=4)
        seen.append(factor * line)
    _scale(axes, np.concatenate(seen))
    middle = float(np.interp(MIDDLE, model.soc, lines[reference]))
    where = f", {celsius(float(model.temperature_C[reference]))}" if many else ""
    title = f"{NAMES[name]} = {significant(factor * middle)} {unit}"
    if np.isfinite(error_at_middle):
        vague = ", hardly determined," if 2.0 * error_at_middle > VAGUE else ""
        title += f" ± {percent(2.0 * error_at_middle, 0)}{vague}"
    style.finding(axes, f"{title} at {percent(MIDDLE, 0)}{where}", 0.27)
    style.labels(axes, "SOC [%]", f"{NAMES[name]} [{unit}]")


def _draw_pulse_values(
    axes: style.Axes, values: PulseValues, factor: float, colour: str
) -> list[FloatArray]:
    """Marks of the single pulses; what they show well sets the axis."""
    for rows, marker in ((values.discharge, "v"), (~values.discharge, "^")):
        sure, vague = rows & values.known, rows & ~values.known & np.isfinite(values.value)
        looks: dict[str, Any] = {"color": colour, "markersize": 3.5, "markeredgewidth": 0}
        x, y = 100.0 * values.soc, factor * values.value
        axes.plot(x[vague], y[vague], marker, alpha=0.28, **looks)
        x, y = x[sure], y[sure]
        error = np.nan_to_num(2.0 * factor * values.error[sure], nan=0.0, posinf=0.0)
        error = np.minimum(error, 0.9 * y)
        # All bars as one broken line: a hundred times smaller than as many lines.
        bars = np.column_stack((y - error, y + error, np.full(x.size, np.nan)))
        axes.plot(np.repeat(x, 3), bars.ravel(), color=colour, linewidth=0.7, zorder=3)
        axes.plot(x, y, marker, zorder=3, **looks)
    well = factor * values.value[values.known]
    return [np.percentile(well, [3, 97])] if well.size else []


def _draw_key(axes: style.Axes, identification: Identification) -> None:
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
            axes.plot([], [], marker, color=style.MEASURED, markersize=4, alpha=alpha, label=name)
    axes.legend(loc="center left", bbox_to_anchor=(0.0, 0.5), labelspacing=0.6)


def temperature_colours(count: int) -> tuple[str, ...]:
    """One colour per temperature from cold to warm; a single one has the model's colour."""
    if count == 1:
        return (style.MODEL,)
    if count <= len(style.COLD_TO_WARM) - 1:
        picks = np.linspace(0, len(style.COLD_TO_WARM) - 2, count).round().astype(int)
        return tuple(style.COLD_TO_WARM[k] for k in picks)
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return tuple(to_hex(colormaps["viridis"](x)) for x in np.linspace(0.0, 0.9, count))


def _scale(axes: style.Axes, seen: FloatArray) -> None:
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

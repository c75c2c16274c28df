"""Parameters over SOC: the model's tables, their standard errors, the single pulses' values."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cellwise.cell.effects import SlowDiffusion, effect_table
from cellwise.cell.model import CellModel
from cellwise.fit.splines import TABLE_KNOTS, greville
from cellwise.identify.identification import REFERENCE_C, Identification, TemperatureResult
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, details, paragraph, record_table
from cellwise.report.page.numerals import celsius, listed, ohm_unit, percent, significant
from cellwise.report.page.picture import Picture, pictured
from cellwise.typing import BoolArray, FloatArray

NAMES = {
    "r0_ohm": "R₀",
    "r1_ohm": "R₁",
    "r2_ohm": "R₂",
    "r3_ohm": "R₃",
    "dc_ohm": "R₀ + R₁ + R₂",
    "tau1_s": "τ₁",
    "tau2_s": "τ₂",
    "tau3_s": "τ₃",
}
DC = ("r0_ohm", "r1_ohm", "r2_ohm")


# Beyond this ratio of largest to smallest a table is drawn over a logarithmic axis.
LOG_FROM = 5.0
VAGUE = 0.5  # two standard errors as a share: beyond, other values do nearly as well
MIDDLE = 0.5  # SOC at which a panel's title states the value


class PulseValues(NamedTuple):
    """Values of one parameter from single pulses: arrays of shape (pulses,)."""

    soc: FloatArray
    value: FloatArray
    error: FloatArray
    discharge: BoolArray
    known: BoolArray


def model_tables(model: CellModel, row: int = 0) -> dict[str, FloatArray]:
    """Tables over the model's SOC grid at one of its temperatures, those of ``NAMES`` it has."""
    slow, shape = model.effect(SlowDiffusion), model.ocv_V.shape
    found = {n: np.asarray(getattr(model, n)[row]) for n in (*DC, "tau1_s", "tau2_s")}
    found["dc_ohm"] = np.sum([found[n] for n in DC], axis=0)
    r3_ohm = effect_table(slow.r3_ohm, shape)[row]
    if np.any(r3_ohm > 0.0):
        found |= {"r3_ohm": r3_ohm, "tau3_s": effect_table(slow.tau3_s, shape)[row]}
    return {n: found[n] for n in NAMES if n in found}


def table_error(found: TemperatureResult, name: str, soc: FloatArray) -> FloatArray | None:
    """Standard error of a refined table as a share of its value, over SOC; None if unknown.

    The tables are splines of ln R and ln tau, whose coefficients act at the Greville points; the
    errors are joined by lines between these.
    """
    result = found.refinement
    if result is None or name == "dc_ohm":
        return None
    lay = result.layout
    branch = int(next(c for c in name if c.isdigit())) - 1
    if branch >= lay.branches:
        return None
    first = lay.r0 if branch < 0 else lay.r(branch) if name.startswith("r") else lay.tau(branch)
    errors = result.theta_std[first : first + lay.knots]
    return np.asarray(np.interp(soc, greville(TABLE_KNOTS), errors))


def pulse_values(found: TemperatureResult, name: str) -> PulseValues | None:
    """Values of one parameter from the single pulses of a temperature; None if they have none."""
    fits = [f for s in found.pulse_sets for f in s.fits if np.isfinite(f.soc)]
    if not fits or name in ("r3_ohm", "tau3_s"):
        return None
    parts = DC if name == "dc_ohm" else (name,)
    value = np.array([sum(getattr(f, part) for part in parts) for f in fits])
    shares = [getattr(f.error, part) / max(getattr(f.value, part), 1e-12)
              for part in parts[:1] for f in fits]  # fmt: skip
    # A method without standard errors claims nothing: its values are shown as they are.
    known = [f.method == "segments" or getattr(f.identified, parts[-1]) > 0.0 for f in fits]
    return PulseValues(
        soc=np.array([f.soc for f in fits]),
        value=value,
        error=value * (np.array(shares) if len(parts) == 1 else np.nan),
        discharge=np.array([f.current_A > 0.0 for f in fits], dtype=bool),
        known=np.array(known, dtype=bool) & np.isfinite(value) & (value > 0.0),
    )


def shown_rows(identification: Identification) -> list[int]:
    """The temperatures of the model that tests were run at; all of them where none says so.

    Those between are interpolated and show nothing of their own.
    """
    tested = {t.temperature_C for t in identification.temperatures}
    every = range(identification.model.temperature_C.size)
    return [k for k in every if identification.model.temperature_C[k] in tested] or list(every)


def vague_names(identification: Identification) -> list[str]:
    """Parameters that the logs hardly determine at half charge, at any tested temperature."""
    middle = np.array([MIDDLE])
    errors = {
        name: [table_error(t, name, middle) for t in identification.temperatures]
        for name in model_tables(identification.model)
    }
    return [
        NAMES[name]
        for name, of in errors.items()
        if any(e is not None and 2.0 * float(e[0]) > VAGUE for e in of)
    ]


EXPLAINED = (
    "R₀ is the drop at once, the branches are what follows within seconds (1), minutes (2) and "
    "longer (3, where there is one). Lines are the model's tables at the temperatures of the tests "
    "with two standard errors, which are left out beyond 50 % (≈ in a title). Marks are single "
    "pulses; they need not meet the lines, for a short pulse sees only the beginning of what a "
    "whole log shows."
)


def has_pulses(identification: Identification) -> bool:
    """Whether single pulses were fitted."""
    return any(found.fits for t in identification.temperatures for found in t.pulse_sets)


def parameter_pictures(identification: Identification) -> tuple[Picture, ...]:
    """One per parameter, resistances first; the first one has the key."""
    names = model_tables(identification.model)
    return tuple(
        parameter_picture(identification, name, k == 0)._replace(
            key=f"parameter-{name.replace('_', '-')}"
        )
        for k, name in enumerate(names)
    )


def parameter_content(identification: Identification) -> Markup:
    """What cannot be read from the tables, and the tables at every tenth of SOC."""
    model = identification.model
    vague = vague_names(identification)
    said = f"{listed(vague)} {'is' if len(vague) == 1 else 'are'} hardly determined alone (two "
    said += "standard errors are more than half of the value): other values do nearly as well "
    said += "together. Rely on the sum and on the simulated voltage, not on one of them."
    parts = [paragraph(EXPLAINED + style.no_data_text(model.validity.soc), "note")] + [
        paragraph(said)
    ] * bool(vague)
    tables = []
    for row, temperature in enumerate(model.temperature_C):
        known = {n: line for n, line in model_tables(model, row).items() if n != "dc_ohm"}
        units = {n: _unit(n, line) for n, line in known.items()}
        shown = record_table(
            [k / 10 for k in range(11)],
            ("SOC", lambda soc: percent(soc, 0)),
            ("OCV [V]", partial(_read_ocv, model.soc, model.ocv_V[row])),
            *(
                (f"{NAMES[n]} [{units[n][1]}]", partial(_read, model.soc, units[n][0] * line))
                for n, line in known.items()
            ),
            caption=f"Tables of the model at {celsius(float(temperature))}",
        )
        tables.append(shown)
    return Markup("".join([*parts, details("The tables in numbers", Markup("".join(tables)))]))


def _read_ocv(grid: FloatArray, ocv_V: FloatArray, soc: float) -> str:
    return f"{np.interp(soc, grid, ocv_V):.4f}"


def _read(grid: FloatArray, line: FloatArray, soc: float) -> str:
    return significant(float(np.interp(soc, grid, line)))


@pictured("parameter")
def parameter_picture(identification: Identification, name: str, key: bool) -> style.Figure:
    """One table over SOC at the tested temperatures, its band, the single pulses' values."""
    figure, axes = style.new_axes()
    model = identification.model
    rows = shown_rows(identification)
    lines = {row: model_tables(model, row)[name] for row in rows}
    shown = slice(None, None, max(model.points // 100, 1))
    soc = 100.0 * model.soc[shown]
    middle = min(rows, key=lambda k: abs(model.temperature_C[k] - REFERENCE_C))
    factor, unit = _unit(name, lines[middle])
    seen: list[FloatArray] = []
    size = float(np.interp(MIDDLE, model.soc, lines[middle]))
    sign, band_text = "=", ""
    fitted = {t.temperature_C: t for t in identification.temperatures}
    for (row, line), colour in zip(lines.items(), temperature_colours(len(lines)), strict=True):
        found = fitted.get(model.temperature_C[row])
        values = None if found is None else pulse_values(found, name)
        error = None if found is None else table_error(found, name, model.soc)
        if values is not None:
            mark = colour if len(lines) > 1 else style.MEASURED
            seen += _draw_pulse_values(axes, values, factor, mark)
        if error is not None:
            band = np.where(2.0 * error > VAGUE, np.nan, 2.0 * error)
            low, high = (factor * line * np.exp(sign * band) for sign in (-1.0, 1.0))
            axes.fill_between(soc, low[shown], high[shown], color=colour, alpha=0.18, lw=0)
            at = float(np.interp(MIDDLE, model.soc, error))
            if row == middle:
                sign, band_text = (
                    ("=", f" ± {percent(2.0 * at, 0)}") if 2.0 * at <= VAGUE else ("≈", "")
                )
        axes.plot(soc, factor * line[shown], color=colour, linewidth=1.6, zorder=4)
        seen.append(factor * line)
    _scale(axes, np.concatenate(seen))
    style.no_data(axes, model.validity.soc)
    where = f", {celsius(float(model.temperature_C[middle]))}" if len(lines) > 1 else ""
    title = f"{NAMES[name]} {sign} {significant(factor * size)} {unit}{band_text}"
    style.finding(axes, f"{title} at {percent(MIDDLE, 0)}{where}")
    style.soc_axis(axes, f"{NAMES[name]} [{unit}]")
    if key:
        _draw_key(axes, identification)
    return figure


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
    """Names of lines and marks."""
    from matplotlib.lines import Line2D

    rows = shown_rows(identification)
    keys = [
        Line2D([], [], color=colour, label=celsius(float(identification.model.temperature_C[row])))
        for colour, row in zip(temperature_colours(len(rows)), rows, strict=True)
    ]
    if has_pulses(identification):
        for marker, alpha, name in (
            ("v", 1.0, "discharge pulse"),
            ("^", 1.0, "charge pulse"),
            ("^", 0.28, "not shown by its pulse"),
        ):
            looks: dict[str, Any] = {"color": style.MEASURED, "alpha": alpha, "linestyle": "none"}
            keys.append(Line2D([], [], marker=marker, markersize=4, label=name, **looks))
    if len(keys) > 1:
        style.key_below(axes, keys)


def temperature_colours(count: int) -> list[str]:
    """One colour per temperature from cold to warm; a single one has the model's colour."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    places = np.linspace(0.08, 0.92, count)
    return [style.MODEL] if count == 1 else [to_hex(colormaps["turbo"](x)) for x in places]


def _scale(axes: style.Axes, seen: FloatArray) -> None:
    """Limits from what is known well; logarithmic where it spans much."""
    seen = seen[np.isfinite(seen) & (seen > 0.0)]
    if seen.size == 0:
        return
    low, high = float(seen.min()), float(seen.max())
    if high / low > LOG_FROM:
        axes.set_yscale("log", subs=[2, 5] if high / low < 300.0 else [])
        axes.set_ylim(low / 1.3, high * 1.3)
        for ticks in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
            ticks("{x:g}")
    else:
        room = 0.12 * (high - low) + 1e-3 * high
        axes.set_ylim(max(low - room, 0.0), high + room)


def _unit(name: str, line: FloatArray) -> tuple[float, str]:
    typical = float(np.median(line))
    return ohm_unit(typical) if name.endswith("_ohm") else (1.0, "s")

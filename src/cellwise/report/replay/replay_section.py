"""SOC estimates: plots against the reference, with their band; every figure of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellwise.estimate.replay import CONVERGED_SOC, Replay, SocErrors, soc_errors
from cellwise.plotting import Line, Panel
from cellwise.report.page.markup import EMPTY, MOST, Markup, clock_of, paragraph, table
from cellwise.report.page.numerals import (
    NONE,
    capitalised,
    counted,
    duration,
    millivolt,
    percent,
    points,
    significant,
)
from cellwise.report.page.picture import safe_key
from cellwise.report.page.plot import Plot, robust_limits, time_axis
from cellwise.typing import FloatArray

TWO = percent(CONVERGED_SOC, 0)
ESTIMATORS = {
    "ekf": "the EKF",
    "filterpy-ekf": "filterpy's EKF",
    "coulomb": "coulomb counting",
}
WIDE_NIS = 0.25  # below, the band of the innovations is far too wide
CHANGED = 0.9  # probability from which a parameter is said not to be the model's

CAPTION = (
    "The filter's state of charge with the band of two of its own standard deviations{reference}; "
    "the measured voltage (grey) and the one it predicted before the update (vermillion); their "
    "difference, called innovation, within the band that the filter expects; and the current."
)
REFERENCE = ", the reference that the tester counted (grey) and their difference"


def replay_finding(replay: Replay) -> str:
    """What a replay found: its initial error, its convergence, its settled error."""
    who = ESTIMATORS.get(replay.estimator, replay.estimator)
    settled = replay.settled
    if replay.reference_soc is None or settled is None:
        return capitalised(
            f"{who} ends at {points(float(replay.trace.soc[-1]))} ± "
            f"{percent(2.0 * float(replay.trace.soc_std[-1]), 1)} SOC; there is no reference."
        )
    off = abs(float(replay.start.soc - replay.reference_soc[0]))
    begin = "From the right initial SOC" if off < 0.005 else f"From {100.0 * off:.0f} points off"
    if replay.convergence_s is None:
        return (
            f"{begin} {who} never comes within {TWO} for ten minutes: {percent(settled.rmse)} RMSE "
            "over the second half."
        )
    if replay.settled_s and replay.error is not None:
        row = np.searchsorted(replay.time_s, replay.time_s[0] + replay.settled_s)
        settled = soc_errors(replay.error[row:])
    held = f"{percent(settled.rmse)} SOC RMSE, {percent(settled.max)} at most."
    if off < 0.005 and replay.convergence_s == 0.0:
        reached = ""
    elif replay.settled_s is None:  # before that a small error is luck
        reached = f"is within {TWO}, though its own deviation stays above, "
    elif replay.settled_s > 0.0:
        reached = f"is within {TWO} after {duration(replay.settled_s)} "
    else:
        reached = f"is within {TWO} from the first row on "
    # It has come within two points and stayed for ten minutes; later it may leave them again.
    then = "but drifts off later: " if settled.max > 1.5 * CONVERGED_SOC else "and then holds "
    return f"{begin} {who} {reached}{then if reached else 'holds '}{held}"


def replay_name(replay: Replay) -> str:
    """``ekf on drive_b from 70 %``."""
    return f"{replay.estimator} on {replay.log.name or 'log'} from {points(replay.start.soc)}"


def replay_plots(replays: Sequence[Replay]) -> tuple[Plot, ...]:
    """Comparison of all replays of a log, then each of the first few."""
    shown = [
        replay_plot(r, f"replay-{k}-{safe_key(r.estimator)}-{safe_key(clock_of(r.log))}")
        for k, r in enumerate(replays[: MOST.plots], start=1)
    ]
    if shown:
        text = CAPTION.format(reference=REFERENCE if replays[0].reference_soc is not None else "")
        shown[0] = shown[0]._replace(caption=text)
    return (*comparison_plots(replays), *shown)


def replay_plot(replay: Replay, key: str) -> Plot:
    """SOC and its error, voltage and innovation with their bands, current, temperature."""
    log, trace = replay.log, replay.trace
    t, label = time_axis(log)
    ends = (trace.soc + sign * 2.0 * trace.soc_std for sign in (-1.0, 1.0))
    band = 100.0 * np.clip(np.column_stack(list(ends)), 0.0, 1.0)
    soc = [Line(replay.estimator, t, 100.0 * trace.soc, band)]
    panels = []
    if replay.reference_soc is not None and replay.error is not None:
        soc.insert(0, Line("reference", t, 100.0 * replay.reference_soc))
        error = 100.0 * replay.error
        panels.append(_within("SOC error [points]", t, error, 100.0 * trace.soc_std))
    panels.insert(0, Panel("SOC [%]", tuple(soc)))
    measured = Line("measured", t, log.voltage_V)
    predicted = Line("predicted", t, trace.voltage_V)
    panels += [Panel("voltage [V]", (measured, predicted))] * bool(np.isfinite(predicted.y).any())
    std = 1e3 * np.sqrt(trace.innovation_variance_V2)
    if np.isfinite(std).any():
        panels.append(_within("innovation [mV]", t, 1e3 * trace.innovation_V, std))
    panels.append(Panel("current [A]", (Line("current", t, log.current_A),)))
    if log.temperature_C is not None:
        temperature_C = Line("temperature", t, log.temperature_C)
        panels.append(Panel("temperature [°C]", (temperature_C,)))
    return Plot(key, _title(replay), label, tuple(panels), "", clock_of(log))


def _within(name: str, t: FloatArray, value: FloatArray, std: FloatArray) -> Panel:
    """A difference around zero with the band that two deviations leave it."""
    band = np.column_stack((-2.0 * std, 2.0 * std))
    line = Line(name.partition(" [")[0], t, value, band)
    largest = (robust_limits(value) or (0.0, float(np.nanmax(np.abs(value)))))[1]
    limit = 1.1 * max(largest, 2.0 * float(np.nanmedian(std)))
    return Panel(name, (line,), (-limit, limit) if limit > 0.0 else None)


def _title(replay: Replay) -> str:
    text = f"{replay_name(replay)}: SOC {soc_at_end(replay)} at the end"
    if replay.reference_soc is not None:
        text += f", reference {points(float(replay.reference_soc[-1]))}"
    if replay.settled is not None:
        begin = "second half" if replay.convergence_s is None else "settled"
        text += (
            f"; {begin} {percent(replay.settled.rmse)} RMSE, "
            f"{percent(replay.coverage_2sigma, 0)} of rows inside 2σ"
        )
    text += f"; voltage prediction {millivolt(replay.voltage_rmse_V)} RMSE"
    if replay.nis_mean is not None and 0.0 < replay.nis_mean < WIDE_NIS:
        times = significant(1.0 / math.sqrt(replay.nis_mean), 2)
        text += f", its band {times} times wider: the voltage counts little"
    return text


def comparison_plots(replays: Sequence[Replay]) -> list[Plot]:
    """One per log that was replayed more than once and has a reference."""
    groups: dict[tuple[str, int], list[Replay]] = {}
    for r in replays:
        if r.reference_soc is not None:
            groups.setdefault((r.log.name, len(r.log)), []).append(r)
    several = [own for own in groups.values() if len(own) > 1]
    return [comparison_plot(own, f"replay-comparison-{k}") for k, own in enumerate(several, 1)]


def comparison_plot(replays: Sequence[Replay], key: str) -> Plot:
    """SOC and SOC error of several replays of one log."""
    log = replays[0].log
    t, label = time_axis(log)
    names = list(map(_start_name, replays))
    soc = [Line(n, t, 100.0 * r.trace.soc) for n, r in zip(names, replays, strict=True)]
    if replays[0].reference_soc is not None:
        soc.insert(0, Line("reference", t, 100.0 * replays[0].reference_soc))
    errors = [
        Line(n, t, 100.0 * r.error)
        for n, r in zip(names, replays, strict=True)
        if r.error is not None
    ]
    title = f"{clock_of(log)}, within 2 points: "
    title += "; ".join(f"{n} {_after(r)}" for n, r in zip(names, replays, strict=True))
    panels = (Panel("SOC [%]", tuple(soc)), Panel("SOC error [points]", tuple(errors)))
    caption = "The same log through every estimator and start."
    # Counting is spoken of only where it is among them, beside a filter.
    if len({r.estimator == "coulomb" for r in replays}) > 1:
        caption += " Counting charge alone keeps its initial error; a filter that also uses the "
        caption += "voltage corrects it."
    return Plot(key, title, label, panels, caption, clock_of(log))


def _after(replay: Replay) -> str:
    text = reached(replay)
    return f"after {text}" if replay.settled_s else text


def _start_name(replay: Replay) -> str:
    return f"{replay.estimator} from {points(replay.start.soc)}"


def soc_at_end(replay: Replay) -> str:
    """``13.8 % ± 2.8 %``, two standard deviations."""
    return _soc(float(replay.trace.soc[-1]), float(replay.trace.soc_std[-1]))


def soc_at_start(replay: Replay) -> str:
    """The same of where the filter began."""
    return _soc(replay.start.soc, replay.start.std)


def _soc(soc: float, std: float) -> str:
    return f"{points(soc)} ± {percent(min(2.0 * std, 1.0), 1)}"


EXPLAINED = (
    "Errors are estimate minus reference, in points of SOC. Settled: after the error has come "
    "within 2 points and stayed there for ten minutes; where it never did, the log's second half. "
    "Inside 2σ: share of rows whose error is within two of the filter's own standard deviations. "
    "NIS: mean squared innovation over what the model states, by time scale; 1 where its statement "
    "is right."
)


WITHOUT_REFERENCE = (
    "This log has no reference SOC, so the estimate's own error is not known. Where the log holds "
    "the tester's counter, state the true SOC at its start (`reference_soc0`): error, time to "
    "converge and coverage stand here then. NIS: mean squared innovation over what the model "
    "states, by time scale; 1 where its statement is right."
)


def replay_content(replays: Sequence[Replay]) -> Markup:
    """All figures of every replay."""
    columns = [replay_figures(r) for r in replays]
    lines = [(texts[0][0], *(text for _, text in texts)) for texts in zip(*columns, strict=True)]
    known = [line for line in lines if set(line[1:]) != {NONE}]
    note = Markup(paragraph(EXPLAINED, "note"))
    if all(r.reference_soc is None for r in replays):
        note = Markup(paragraph(WITHOUT_REFERENCE, "note"))
    if len(columns) <= MOST.listed:
        return Markup(note + table(("", *(r.estimator for r in replays)), known))
    rows = zip((r.estimator for r in replays), *(line[1:] for line in known), strict=True)
    head = ("estimator", *(line[0] for line in known))
    return Markup(note + table(head, list(rows), text_columns=(0, 1)))


def replay_figures(replay: Replay) -> list[tuple[str, str]]:
    """Every figure of a replay by its name, as text."""
    trace = replay.trace
    return [
        ("log", clock_of(replay.log)),
        ("samples", counted(len(trace))),
        ("initial SOC", f"{soc_at_start(replay)}, {replay.start.how}"),
        ("final SOC", soc_at_end(replay)),
        *_errors("", replay.errors),
        (f"within {TWO} after", duration(replay.convergence_s)),
        (f"within {TWO}, and stated so, after", reached(replay)),
        *_errors("settled: ", replay.settled),
        ("error inside 2σ", percent(replay.coverage_2sigma, 1)),
        ("voltage RMSE, one step ahead", millivolt(replay.voltage_rmse_V)),
        *_nis(replay),
        ("time per step", f"{significant(replay.ns_per_step)} ns"),
    ]


def _nis(replay: Replay) -> list[tuple[str, str]]:
    """NIS of every time scale, or the mean where the model is not known."""
    if replay.nis is None or replay.model is None:
        return [("NIS", significant(replay.nis_mean))]
    each = zip(replay.nis, replay.model.error.scales_s, strict=True)
    return [(f"NIS over {duration(scale)}", significant(nis, 2)) for nis, scale in each]


ESTIMATED = {
    "offset_A": ("the current sensor adds", "A"),
    "gain": ("gain of the current sensor", ""),
    "capacity_Ah": ("capacity", "Ah"),
    "resistance_scale": ("R0 and R1, times the model's", ""),
}


def estimated_content(replay: Replay) -> Markup:
    """What an adaptive filter estimates of sensor and cell; nothing of another filter."""
    rows = [] if replay.model_mismatch else estimated_rows(replay)
    caption = f"Beside SOC, by {replay_name(replay)}."
    shown = table(("", "value", ""), rows, caption=caption, text_columns=(0, 1, 2))
    return shown if rows else EMPTY


def estimated_rows(replay: Replay) -> list[tuple[str, str, str]]:
    """The same as text: what it is, its value, whether it is the model's."""
    found = replay.to_dict().get("parameters") or {}
    rows = []
    for key, (name, unit) in ESTIMATED.items():
        if (one := found.get(key)) is None:
            continue
        sure = one["probability"]
        said = f"held at the model's: {one['held']}" if one["held"] else ""
        if not said and sure is not None:
            said = "as the model's" if sure < CHANGED else f"not the model's ({percent(sure, 0)})"
        places = max(1 - math.floor(math.log10(max(2.0 * one["std"], 1e-9))), 0)
        value = f"{one['value']:.{places}f} ± {2.0 * one['std']:.{places}f} {unit}".strip()
        rows.append((name, "" if one["held"] else value.replace("-", "−"), said))
    return rows


def reached(replay: Replay) -> str:
    """How long error and stated deviation took to come within two points and stay."""
    if replay.error is None:
        return duration(None)
    if replay.settled_s is None:
        return "never" if replay.convergence_s is None else "never by its own band"
    return "at once" if replay.settled_s == 0.0 else duration(replay.settled_s)


def _errors(prefix: str, errors: SocErrors | None) -> list[tuple[str, str]]:
    values = (None, None, None) if errors is None else (errors.rmse, errors.mae, errors.max)
    names = ("SOC RMSE", "SOC MAE", "SOC max. error")
    return [(prefix + n, percent(v)) for n, v in zip(names, values, strict=True)]

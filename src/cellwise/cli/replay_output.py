"""What is said of a replay: rows for other programs, figures and what is ahead for people."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cellwise.cli.common import log_options, printing
from cellwise.cli.common.printing import band
from cellwise.estimate.adaptive import AdaptiveTrace
from cellwise.estimate.power.along import PowerTrace
from cellwise.estimate.replay import Replay
from cellwise.fit.start import InitialSoc
from cellwise.forecast.plan import Outcome
from cellwise.forecast.remaining import Flight, Forecast
from cellwise.logs.files.source import open_source
from cellwise.logs.formats.ros_bag import start_of
from cellwise.logs.writing import write_columns
from cellwise.typing import FloatArray

UNITS = {"offset_A": ("sensor offset", "A"), "gain": ("sensor gain", ""),
         "capacity_Ah": ("capacity", "Ah"), "resistance_scale": ("R0, R1 times", "")}  # fmt: skip


@dataclass(frozen=True)
class Run:
    """A replay, when it was to converge, and what remains by it; ``far``: why none is said.

    ``began`` is the start that the whole log shows, as every other command finds it.
    """

    found: Replay
    expected: float | None
    began: InitialSoc | None
    far: str | None
    flight: Flight | None = None
    at_load: Forecast | None = None
    charge: Flight | None = None
    plan: Outcome | None = None
    displayed_percent: FloatArray | None = None
    hold: str = "power"
    cutoff_V: float = math.nan

    @property
    def notices(self) -> tuple[str, ...]:
        """What a person should know, of the forecast first."""
        of_flight = () if self.flight is None else self.flight.notices
        if self.far is None:
            return (*of_flight, *self.found.notices)
        return tuple(self.far if self.far.startswith(n) else n for n in self.found.notices)

    @property
    def power(self) -> PowerTrace | None:
        """The state of power, unless the log is far off."""
        return None if self.far else self.found.power

    def figures(self) -> dict[str, Any]:
        """The replay's figures; of a log that is far off no parameters and no power."""
        figures = self.found.to_dict()
        withheld = {"parameters", "power"} if self.far else set()
        return {key: None if key in withheld else value for key, value in figures.items()}

    def to_dict(self) -> dict[str, Any]:
        """As the command prints it."""
        shown = self.displayed_percent
        charge = self.charge
        if charge is not None and charge.time_s[-1] < self.found.log.time_s[-1]:
            charge = None  # no longer on the charger
        return {
            "log": self.found.log.name,
            **self.figures(),
            "soc0_whole_log": None if self.began is None else self.began.to_dict(),
            "convergence_predicted_s": self.expected,
            "forecast": None if self.flight is None else self.flight.to_dict(),
            "forecast_charge": None if charge is None else charge.to_dict(),
            "forecast_plan": None if self.plan is None else self.plan.to_dict(),
            "displayed_percent": None if shown is None else float(shown[-1]),
            "forecast_given": None if self.at_load is None else self.at_load._asdict(),
            "notices": list(self.notices),
        }


def write_rows(arguments: argparse.Namespace, runs: Sequence[Run]) -> None:
    """The rows of a log's stretches as a file: a table, or topics with a layout for Foxglove."""
    found = runs[0].found
    parts = [rows_of(run) for run in runs]
    names = [name for name in parts[0] if all(name in part for part in parts)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    if Path(arguments.output).suffix == ".mcap":
        from cellwise.report.viewer_files import write_foxglove, write_mcap

        start_s = 0.0
        if found.log.format == "ros-bag":
            reading = log_options.read_options(arguments)
            start_s = start_of(open_source(found.log.source, options=reading))
        write_mcap(arguments.output, columns, start_s)
        write_foxglove(Path(arguments.output).with_suffix(".foxglove.json"))
        return
    write_columns(columns, Path(arguments.output))


def rows_of(run: Run) -> dict[str, Any]:
    """What the estimator said of every row; of a log that is far off no parameters and no power."""
    log, trace = run.found.log, run.found.trace
    columns = replace(run.found, power=None).columns()
    columns |= {"current_A": log.interval_current_A, "measured_voltage_V": log.voltage_V}
    if isinstance(trace, AdaptiveTrace) and not run.far:
        names = ["offset_A", "offset_std_A", "gain", "gain_std", "capacity_Ah", "capacity_std_Ah"]
        names += ["resistance_scale", "resistance_std"]
        columns |= {name: getattr(trace, name) for name in names}
        held = ("held_offset", "held_resistance", "held_charge")
        columns |= dict(zip(held, trace.held, strict=True))
    if run.displayed_percent is not None:
        columns["displayed_percent"] = run.displayed_percent
    return columns if run.power is None else columns | run.power.columns()


def print_runs(runs: Sequence[Run], *, sure: bool) -> None:
    """Replays for people: the figures, and what is ahead of the last one's end."""
    first: tuple[str, ...] = ()
    for run in runs:
        if run.far is not None:
            first += run.notices[: run.notices.index(run.far) + 1]
    printing.say_notices(first)
    last = runs[-1]
    if len(runs) > 1:
        printing.record_table(
            f"{last.found.estimator} on {len(runs)} logs",
            [run.found for run in runs],
            ("log", lambda found: found.log.name),
            ("hours", lambda found: f"{found.log.duration_s / 3600.0:.2f}"),
            ("initial SOC", lambda found: band(found.start.soc, found.start.std)),
            (
                "final SOC",
                lambda found: band(found.trace.soc[-1], found.trace.soc_std[-1]),
            ),
            ("one step ahead mV", lambda found: printing.millivolt(found.voltage_rmse_V)),
            ("SOC RMSE %", lambda found: printing.percent(found.to_dict()["soc_rmse"])),
        )
    else:
        print_replay(last.found, last, sure=sure)
    print_forecasts(last)
    print_ahead(last.to_dict())
    if last.power is not None:
        print_power(last.power)
    printing.say_notices(n for run in runs for n in run.notices if n not in first)


def print_replay(found: Replay, run: Run | None = None, *, sure: bool = True) -> None:
    """A replay for people, and what its run knows; ``sure``: how sure a start is was stated."""
    data = found.to_dict() if run is None else run.figures()
    start, settled, percent = found.start, data["settled"], printing.percent
    how = start.how if sure or start.how != "given" else "given; --soc0-std states how sure"
    rows = {"initial SOC": f"{band(start.soc, start.std, 4)} ({how})"}
    began = None if run is None else run.began
    if began is not None and began.beginning is not None:  # the whole log says more
        rows["began at, seen afterwards"] = f"{band(began.soc, began.std, 4)} ({began.how})"
    rows["final SOC"] = band(data["soc_final"], data["soc_final_std"], 4)
    rows["voltage RMSE, one step ahead"] = f"{printing.millivolt(data['voltage_rmse_V'])} mV"
    if found.nis is not None and found.model is not None:
        each = zip(found.nis, found.model.error.scales_s, strict=True)
        rows["NIS by time scale"] = ", ".join(f"{nis:.2f} ({scale:g} s)" for nis, scale in each)
    rows["time per step"] = f"{data['ns_per_step']:.0f} ns"
    if run is not None:
        rows["within 2 %, by model and current"] = _after(run.expected)
    if settled is None:
        rows["SOC error"] = "no reference: give --reference-capacity-ah and a counter"
    else:
        each_of = " / ".join(percent(settled[k]) for k in ("rmse", "mae", "max"))
        rows["SOC RMSE, all rows"] = f"{percent(data['soc_rmse'])} %"
        rows["within 2 %"] = _after(data["convergence_s"])
        rows["settled RMSE / MAE / max"] = f"{each_of} %"
        rows["rows within 2 sigma"] = f"{percent(data['coverage_2sigma'], 1)} %"
    values: dict[str, Any] = data.get("parameters") or {}
    for name, (label, unit) in UNITS.items() if values else ():
        one = values[name]
        rows[label] = f"{band(one['value'], one['std'], 4)} {unit}".rstrip()
        if one["held"] is not None:
            rows[label] += f" (held: {one['held']})"
        elif one["probability"] is not None:
            rows[label] += f" ({100 * one['probability']:.0f} % that it is not the model's)"
    if values:
        by_capacity = f"{percent(values['soh_capacity'], 1)} % by capacity"
        rows["state of health"] = f"{by_capacity}, resistance x {values['soh_resistance']:.3f}"
    printing.table(f"{found.estimator} on {found.log.name}", ("what", "found"), list(rows.items()))


def _after(seconds: float | None) -> str:
    return "not on this log" if seconds is None else f"after {seconds:.1f} s"


def print_forecasts(run: Run) -> None:
    """Remaining time and energy, for people; nothing where there is no load."""
    flight, at_load = run.flight, run.at_load
    forecasts = [] if flight is None else [("at the present load", flight.last)]
    if flight is not None and flight.typical is not None:
        forecasts.insert(0, ("at the log's usual load", flight.typical.last))
    if at_load is not None:
        forecasts.append((f"at the given load, from {at_load.time_s:.0f} s", at_load))
    if not forecasts:
        return

    def span(value: float, band: tuple[float, float], scale: float, digits: int) -> str:
        low, high = (f"{x / scale:.{digits}f}" for x in band)
        return f"{value / scale:.{digits}f} ({low} to {high})"

    now = forecasts[0][1]
    printing.record_table(
        f"remaining in each cell at {now.time_s:.0f} s, SOC {100 * now.soc:.1f} +- "
        f"{200 * now.soc_std:.1f} %, {run.hold} held to {run.cutoff_V:.2f} V",
        forecasts,
        ("", lambda one: one[0]),
        ("A", lambda one: f"{one[1].load_A:.2f}"),
        ("W", lambda one: f"{one[1].load_W:.1f}"),
        ("minutes", lambda one: span(one[1].remaining_s, one[1].remaining_s_band, 60.0, 1)),
        ("Wh", lambda one: span(one[1].remaining_Wh, one[1].remaining_Wh_band, 1.0, 2)),
        ("end V", lambda one: f"{one[1].end_voltage_V:.3f}"),
        ("end SOC %", lambda one: f"{100 * one[1].end_soc:.1f}"),
        ("ends by", lambda one: one[1].by),
    )


def print_power(power: PowerTrace) -> None:
    """The state of power at the log's end, for people."""
    known = power.known.limits
    ways = [(f"{s.horizon_s:g} s, {name}", way)
            for s in power.last
            for name, way in (("discharge", s.discharge), ("charge", s.charge))]  # fmt: skip
    printing.record_table(
        f"power of each cell at the end, {power.hold} held, {known.voltage_min_V:g} to "
        f"{known.voltage_max_V:g} V",
        ways,
        ("for", lambda one: one[0]),
        ("W", lambda one: f"{one[1].power_W:.1f}"),
        ("at least W (95 %)", lambda one: f"{one[1].power_low_W:.1f}"),
        ("A", lambda one: f"{one[1].current_A:.1f}"),
        ("limited by", lambda one: one[1].by),
    )


def print_ahead(row: dict[str, Any]) -> None:
    """What of a replay's object is ahead, for people."""
    charge, plan = row["forecast_charge"], row["forecast_plan"]
    if charge is not None:
        low, high = (x / 60.0 for x in charge["full_s_band"])
        printing.say(
            f"full in {charge['full_s'] / 60.0:.0f} min ({low:.0f} to {high:.0f}) from "
            f"{charge['time_s']:.0f} s, with {charge['full_Wh']:.2f} Wh for each cell: "
            f"{charge['charge_A']:.2f} A to {charge['limit_V']:.2f} V, held down to "
            f"{charge['taper_A']:.3g} A"
        )
    if plan is not None:
        low, high = (100.0 * x for x in plan["end_soc_band"])
        printing.say(
            f"{plan['plans']} plan(s) of {plan['seconds'] / 60.0:.0f} min end at SOC "
            f"{100.0 * plan['end_soc']:.1f} % ({low:.1f} to {high:.1f}, 95 %), with "
            f"{plan['energy_Wh']:.2f} Wh from each cell; at {100.0 * plan['above']:.0f} % or more "
            f"with a chance of {100.0 * plan['chance']:.0f} %, {plan['cutoff_V']:.2f} V is reached "
            f"with one of {100.0 * plan['chance_cutoff']:.0f} %"
        )
    if row["displayed_percent"] is not None:
        printing.say(f"displayed: {row['displayed_percent']:.0f} %")

"""What is said of a replay, for people: its figures, and what is ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cellwise.cli.common import printing
from cellwise.cli.common.printing import band
from cellwise.estimate.power.power_along_log import PowerTrace
from cellwise.estimate.replay import Replay
from cellwise.estimate.sensor import assumed_text
from cellwise.report.page.numerals import NONE
from cellwise.report.replay.page import forecast_table, forecasts_of, power_table
from cellwise.report.replay.replay_section import estimated_rows, replay_figures
from cellwise.workflows.replaying import ReplayAndForecast


def data_of(run: ReplayAndForecast) -> dict[str, Any]:
    """A replay as JSON, with notices in a command's words."""
    return {**run.to_dict(), "notices": printing.rendered(run.notices)}


def print_runs(runs: Sequence[ReplayAndForecast], *, sure: bool) -> None:
    """Replays for people: the figures, and what is ahead of the last one's end."""
    first = [notice for run in runs for notice in run.critical]
    printing.say_notices(first)
    last = runs[-1]
    if len(runs) > 1:
        printing.record_table(
            f"{last.replay.estimator} on {len(runs)} logs",
            [run.replay for run in runs],
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
        print_replay(last.replay, last, sure=sure)
    said = last.replay.to_dict().get("sensor")
    if said and said["by_default"]:
        printing.say(assumed_text(said))
    print_forecasts(last)
    print_ahead(last.to_dict())
    if last.power is not None:
        print_power(last.power, last.cells)
    printing.say_notices(n for run in runs for n in run.notices if n not in first)


def print_replay(found: Replay, run: ReplayAndForecast | None = None, *, sure: bool = True) -> None:
    """A replay for people, and what its run knows; ``sure``: how sure a start is was stated."""
    rows = {name: text for name, text in replay_figures(found) if text != NONE and name != "log"}
    if found.start.how == "given" and not sure:
        rows["initial SOC"] += "; --soc0-std states how sure"
    if run is not None:
        if run.began is not None and run.began.beginning is not None:  # the whole log says more
            began = f"{band(run.began.soc, run.began.std, 4)} ({run.began.how})"
            rows["began at, seen afterwards"] = began
        if run.far is None:
            rows["within 2 %, by model and current"] = _after(run.expected_s)
    if found.settled is None:
        rows["SOC error"] = "no reference: give --reference-capacity-ah and a counter"
    values = (found.to_dict() if run is None else run.figures()).get("parameters")
    if values:
        for name, value, said in estimated_rows(found):
            rows[name] = f"{value} ({said})" if value and said else value or said
        rows["state of health"] = state_of_health(values)
    printing.table(f"{found.estimator} on {found.log.name}", ("what", "found"), list(rows.items()))


def state_of_health(values: Mapping[str, Any]) -> str:
    """Of the parameters of an adaptive replay: only what the log shows, not what was stated."""
    capacity, share = values["capacity_Ah"], values["soh_capacity"]
    std = share * capacity["std"] / capacity["value"]
    by_capacity = (
        f"{band(100.0 * share, 100.0 * std, 1)} % of the stated capacity"
        if capacity["shown"]
        else "not determined: this log does not show another capacity than the stated one"
    )
    return f"{by_capacity}, resistance x {values['soh_resistance']:.3f}"


def _after(seconds: float | None) -> str:
    return "not on this log" if seconds is None else f"after {seconds:.1f} s"


def print_forecasts(run: ReplayAndForecast) -> None:
    """Remaining time and energy, for people; nothing where there is no load."""
    forecasts = forecasts_of(run.flight, run.at_load)
    if not forecasts:
        return
    now = next(iter(forecasts.values()))
    printing.table(
        f"remaining at {now.time_s:.0f} s, SOC {100 * now.soc:.1f} +- {200 * now.soc_std:.1f} %, "
        f"{run.hold} held to {run.cutoff_V:.2f} V in each cell",
        *forecast_table(forecasts, run.cells),
    )
    if run.flight is not None and run.flight.stands and run.flight.typical is not None:
        printing.say(
            f"  the log ends at a rest: the {run.flight.last.load_A:.2g} A of its last minute are "
            "no load to go on with"
        )


def print_power(power: PowerTrace, cells: int = 1) -> None:
    """The state of power at the log's end, for people."""
    known = power.known.limits
    printing.table(
        f"power of each cell at the end, {power.hold} held, {known.voltage_min_V:g} to "
        f"{known.voltage_max_V:g} V",
        *power_table(power, cells),
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

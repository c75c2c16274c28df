"""cellwise simulate, cellwise replay."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import (
    forecast_options,
    log_options,
    options,
    page_options,
    printing,
)
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.initial_soc.initial_soc import InitialSoc
    from cellwise.cell.model import CellModel
    from cellwise.cell.simulate import Simulation
    from cellwise.estimate.power.along import PowerTrace
    from cellwise.estimate.power.state_of_power import PowerLimit
    from cellwise.estimate.replay import Replay
    from cellwise.forecast.charging import Charge
    from cellwise.forecast.convergence import ExpectedConvergence
    from cellwise.forecast.plan import Outcome
    from cellwise.forecast.remaining import Flight, Forecast
    from cellwise.logs import CellLog
    from cellwise.typing import FloatArray

UNITS = {"offset_A": ("sensor offset", "A"), "gain": ("sensor gain", ""),
         "capacity_Ah": ("capacity", "Ah"), "resistance_scale": ("R0, R1 times", ""),
         "polarisation_scale": ("R2 times", "")}  # fmt: skip


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands that run a model."""
    simulate = commands.add_parser("simulate", help="model and log to voltage error")
    _common(simulate)
    simulate.set_defaults(run=run_simulate)
    replay = commands.add_parser("replay", help="model and log to SOC")
    _common(replay)
    replay.add_argument(
        "--estimator",
        default="ekf",
        metavar="E",
        help="coulomb, rest-ocv, ekf, ukf, adaptive, fixed-step, firmware, filterpy-ekf, "
        "filterpy-ukf [ekf]",
    )
    options.add_soc0_std(replay)
    options.number(replay, "--dt", "S", "resample to an even step")
    options.add_reference(replay)
    options.number(replay, "--cutoff-v", "V", "cell voltage at which the load stops [model]")
    text = "what of the load is held constant [power]"
    replay.add_argument("--hold", choices=("power", "current"), default="power", help=text)
    text = "how long, too, at a load of X W in each cell (A with --hold current)"
    options.number(replay, "--load", "X", text)
    forecast_options.add_charger(replay)
    forecast_options.add_plan(replay)
    forecast_options.add_display(replay)
    text = "layout of PlotJuggler for the rows of -o OUT.csv"
    replay.add_argument("--plotjuggler", metavar="F.xml", help=text)
    forecast_options.add_power_options(replay)
    options.flag(replay, "--anyway", "forecasts, power and health of a log far off the model, too")
    page_options.add_page_options(replay)
    replay.set_defaults(run=run_replay)


def _common(parser: argparse.ArgumentParser) -> None:
    options.add_model(parser, scalable=True)
    parser.add_argument("log", metavar="LOG", help=log_options.LOG_HELP)
    options.add_soc0(parser)
    parser.add_argument("-o", "--output", metavar="OUT", help="rows as .csv, .csv.gz or .parquet")
    log_options.add_log_options(parser)
    options.add_json(parser)


def read_logs_of(model: CellModel, arguments: argparse.Namespace) -> tuple[CellLog, ...]:
    """The logs that the arguments name, of one cell as the model is."""
    from cellwise.cell.plausibility.validity import check_cells_in_series

    logs = log_options.read_all([arguments.log], arguments)
    for log in logs:
        check_cells_in_series(model, log)
    return logs


def run_simulate(arguments: argparse.Namespace) -> None:
    """Simulate a log and print the error."""
    import time

    from cellwise.cell.initial_soc.initial_soc import initial_soc
    from cellwise.cell.initial_soc.pauses import simulate_stretches
    from cellwise.cell.simulate import simulate
    from cellwise.logs.writing import write_columns

    options.check_places(arguments.output)
    model = options.read_model(arguments)
    check_one_output(arguments)
    logs = read_logs_of(model, arguments)
    printed = []
    for log in logs:
        asked = options.start_of(log.soc0, options.soc0_of(arguments))
        start = initial_soc(model, log, asked, whole_log=True)
        simulate(model, log.part(0, 2), start.soc)  # compiles outside the clock
        began = time.perf_counter()
        found = simulate_stretches(model, log, start)
        seconds = time.perf_counter() - began
        if arguments.output:
            write_columns(found.columns(), Path(arguments.output))
        data = {**found.to_dict(), "soc0": start.to_dict(), "seconds": seconds}
        printed.append({"log": log.name, **data, "notices": list(found.notices)})
        if not arguments.json:
            print_simulation(found, start)
    if arguments.json:
        printing.print_json(printed[0] if len(logs) == 1 else {"logs": printed})


def check_one_output(arguments: argparse.Namespace) -> None:
    """Refuse one file for the rows of several logs.

    Raises
    ------
    InputError        there are several
    """
    from cellwise.logs.stated import logs_of

    logs = logs_of(arguments.log).logs
    if arguments.output and len(logs) > 1:
        raise InputError(
            f"-o {arguments.output} for {len(logs)} logs",
            "the rows of one log",
            "Leave out -o, or name one log; `cellwise fleet replay` writes a row for each.",
        )


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay a log through an estimator and print how it did."""
    from cellwise.cell.initial_soc.initial_soc import initial_soc
    from cellwise.cell.plausibility.notice import ends_forecasts
    from cellwise.estimate.estimators import make_estimator
    from cellwise.estimate.replay import replay
    from cellwise.forecast.charging import forecast_charge
    from cellwise.forecast.convergence import expected_convergence
    from cellwise.forecast.remaining import check_load, cutoff_of, forecast, forecast_at
    from cellwise.logs.cell_log import resample
    from cellwise.logs.gaps import cut_at_pauses

    options.check_places(arguments.output, arguments.plotjuggler)
    check_layout(arguments)
    page_options.check_page_options(arguments)
    true0 = arguments.reference_soc0
    options.check_fraction("--reference-soc0", true0)
    model = options.read_model(arguments)
    make_estimator(arguments.estimator, model)
    held = {"cutoff_V": cutoff_of(model, arguments.cutoff_v), "hold": arguments.hold}
    power = forecast_options.power_of(arguments, model, arguments.hold)
    if arguments.load is not None:
        check_load(arguments.load, arguments.hold)
    check_one_output(arguments)
    plans = forecast_options.plans_of(arguments)
    charger = {"limit_V": arguments.charge_limit_v, "taper_A": arguments.charge_end_a}
    whole = read_logs_of(model, arguments)
    logs = [(one, k == 0) for log in whole for k, one in enumerate(cut_at_pauses(log))]
    runs: list[Run] = []
    with printing.working(arguments.estimator) as follow:
        for part, begins in logs:
            log = part if arguments.dt is None else resample(part, arguments.dt)
            follow(f"{arguments.estimator} over {len(log):,} samples", len(runs), len(logs))
            found = replay(
                model,
                log,
                arguments.estimator,
                # What is stated holds for the first row, not behind a pause that nobody counted.
                soc0=options.start_of(log.soc0, options.soc0_of(arguments)) if begins else None,
                soc0_std=arguments.soc0_std if begins else None,
                reference_soc0=options.start_of(log.soc0, true0, "--reference-soc0"),
                reference_capacity_Ah=arguments.reference_capacity_ah if begins else None,
                power=power or False,
            )
            fresh = make_estimator(arguments.estimator, model)
            expected = expected_convergence(model, found, fresh)
            far = None if arguments.anyway else ends_forecasts(found.far_off, found.log)
            flight, at_load = None if far else forecast(model, found, **held), None
            charge = None if far else forecast_charge(model, found, **charger)
            plan = None if far else forecast_options.outcome_of(arguments, model, found, plans)
            shown = forecast_options.display_of(arguments, model, found, flight, charge)
            if arguments.load is not None and not far:
                at_load = forecast_at(model, found, arguments.load, **held)
                flight = None if flight is None else dataclasses.replace(flight, given=at_load)
            begun = found.start.how in ("given", "stated")
            began = None if begun else initial_soc(model, found.log, whole_log=True)
            runs.append(Run(found, expected, flight, at_load, far, charge, plan, shown, began))
    if arguments.output:
        write_rows(arguments, runs)
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            from cellwise.report import replay_page

            flights = tuple(run.flight for run in runs if run.flight is not None)
            replays = [dataclasses.replace(run.found, power=run.power) for run in runs]
            replay_page(replays, pages.page, flights=flights, figures=pages.figures)
    if arguments.json:
        printed = [run.to_dict() for run in runs]
        # Of one file that was cut, what holds at its end; beside it every stretch.
        last_of_one = printed[-1] if len(whole) == 1 else {}
        printing.print_json({**last_of_one, "logs": printed} if len(runs) > 1 else printed[0])
        return
    first = tuple(
        notice
        for run in runs
        if run.far is not None
        for notice in run.notices[: run.notices.index(run.far) + 1]
    )
    printing.say_notices(first)
    last = runs[-1]
    if len(runs) > 1:
        print_runs(runs)
    else:
        sure = arguments.soc0_std is not None
        print_replay(last.found, last.expected, last.figures(), last.began, sure=sure)
    print_forecasts(last.flight, last.at_load, held["cutoff_V"], arguments.hold)
    forecast_options.say(last.to_dict())
    if last.power is not None:
        print_power(last.power)
    printing.say_notices(n for run in runs for n in run.notices if n not in first)
    page_options.say_pages(arguments)


@dataclasses.dataclass(frozen=True)
class Run:
    """A replay, when it was to converge, and what remains by it; ``far``: why none is said.

    ``began`` is the start that the whole log shows, as every other command finds it.
    """

    found: Replay
    expected: ExpectedConvergence
    flight: Flight | None
    at_load: Forecast | None
    far: str | None
    charge: Charge | None
    plan: Outcome | None
    displayed_percent: FloatArray | None
    began: InitialSoc | None

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
            "convergence_predicted_s": self.expected.convergence_s,
            "forecast": None if self.flight is None else self.flight.to_dict(),
            "forecast_charge": None if charge is None else charge.to_dict(),
            "forecast_plan": None if self.plan is None else self.plan.to_dict(),
            "displayed_percent": None if shown is None else float(shown[-1]),
            "forecast_given": None if self.at_load is None else self.at_load._asdict(),
            "notices": list(self.notices),
        }


def write_rows(arguments: argparse.Namespace, runs: Sequence[Run]) -> None:
    """The rows of a log's stretches as a file, and the layout that PlotJuggler shows them in."""
    import numpy as np

    from cellwise.logs.writing import write_columns

    found = runs[0].found
    parts = [rows_of(run) for run in runs]
    names = [name for name in parts[0] if all(name in part for part in parts)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    if Path(arguments.output).suffix == ".mcap":
        from cellwise.logs.files.source import open_source
        from cellwise.logs.formats.ros_bag import start_of
        from cellwise.report.viewer_files import write_foxglove, write_mcap

        start_s = 0.0
        if found.log.format == "ros-bag":
            reading = log_options.read_options(arguments)
            start_s = start_of(open_source(found.log.source, options=reading))
        write_mcap(arguments.output, columns, start_s)
        write_foxglove(Path(arguments.output).with_suffix(".foxglove.json"))
        return
    write_columns(columns, Path(arguments.output))
    if arguments.plotjuggler:
        from cellwise.report.viewer_files import write_layout

        write_layout(arguments.plotjuggler, arguments.output, columns)


def rows_of(run: Run) -> dict[str, Any]:
    """What the estimator said of every row; of a log that is far off no parameters and no power."""
    from cellwise.estimate.adaptive.trace import AdaptiveTrace

    found, trace = run.found, run.found.trace
    names = ["time_s", "soc", "soc_std", "voltage_V", "innovation_V", "innovation_variance_V2"]
    columns = {name: getattr(trace, name) for name in (*names, "test_ratio", "status")}
    columns["current_A"] = found.log.interval_current_A
    columns["measured_voltage_V"] = found.log.voltage_V
    if isinstance(trace, AdaptiveTrace) and not run.far:
        names = ["offset_A", "offset_std_A", "gain", "gain_std", "capacity_Ah", "capacity_std_Ah"]
        names += ["resistance_scale", "resistance_std", "polarisation_scale", "polarisation_std"]
        columns |= {name: getattr(trace, name) for name in names}
        held = ("held_offset", "held_resistance", "held_charge")
        columns |= dict(zip(held, trace.held, strict=True))
    if found.reference_soc is not None:
        columns["reference_soc"] = found.reference_soc
    if run.displayed_percent is not None:
        columns["displayed_percent"] = run.displayed_percent
    return columns if run.power is None else columns | run.power.columns()


def check_layout(arguments: argparse.Namespace) -> None:
    """Refuse a layout without the rows that PlotJuggler reads.

    Raises
    ------
    InputError        no output, or none that is plain CSV
    """
    if arguments.plotjuggler and not str(arguments.output or "").endswith(".csv"):
        raise InputError(
            f"--plotjuggler with {arguments.output or 'no output'}",
            "the rows as CSV beside it, which PlotJuggler reads",
            "Add -o OUT.csv.",
        )


def print_simulation(found: Simulation, start: InitialSoc) -> None:
    """A simulation for people."""
    notices, far_off = found.notices, found.far_off
    first = () if far_off is None else notices[: notices.index(far_off) + 1]
    printing.say_notices(first)
    bands = ((f"SOC {b.soc_low:.1f} to {b.soc_high:.1f}", b.metrics) for b in found.bands)
    printing.record_table(
        f"{found.log.name}: measured minus simulated, from SOC {_soc_of(start)} ({start.how})",
        (("all rows", found.metrics), *bands),
        ("where", lambda row: row[0]),
        ("RMSE mV", lambda row: printing.millivolt(row[1].rmse_V)),
        ("MAE mV", lambda row: printing.millivolt(row[1].mae_V)),
        ("max mV", lambda row: printing.millivolt(row[1].max_error_V)),
        ("mean", lambda row: printing.millivolt(row[1].mean_error_V)),
        ("sd", lambda row: printing.millivolt(row[1].std_error_V)),
        ("95 % from", lambda row: printing.millivolt(row[1].ci95_V[0])),
        ("to", lambda row: printing.millivolt(row[1].ci95_V[1])),
        ("rows", lambda row: f"{row[1].samples:,}"),
    )
    printing.say(f"RMSE above 10 % SOC: {printing.millivolt(found.rmse_above_10pct_V)} mV")
    printing.say_notices(n for n in notices if n not in first)


def _soc_of(start: InitialSoc) -> str:
    """A start with its band; without one where a simulation takes it as given."""
    given = start.how == "given"
    return f"{start.soc:.3f}" if given else f"{start.soc:.3f} +- {2 * start.std:.3f}"


def print_runs(runs: Sequence[Run]) -> None:
    """Several logs, or the stretches of one, a row each."""

    def soc(value: float, std: float) -> str:
        return f"{value:.3f} +- {2 * std:.3f}"

    printing.record_table(
        f"{runs[0].found.estimator} on {len(runs)} logs",
        runs,
        ("log", lambda run: run.found.log.name),
        ("hours", lambda run: f"{run.found.log.duration_s / 3600.0:.2f}"),
        ("initial SOC", lambda run: soc(run.found.start.soc, run.found.start.std)),
        ("final SOC", lambda run: soc(run.found.trace.soc[-1], run.found.trace.soc_std[-1])),
        ("one step ahead mV", lambda run: printing.millivolt(run.found.voltage_rmse_V)),
        (
            "SOC RMSE %",
            lambda run: printing.percent(
                None if run.found.errors is None else run.found.errors.rmse
            ),
        ),
    )


def _began(began: InitialSoc | None) -> list[tuple[str, str]]:
    """The start by the whole log, where that says more than its beginning."""
    if began is None or began.beginning is None:
        return []
    text = f"{began.soc:.4f} +- {2 * began.std:.4f} ({began.how})"
    return [("began at, seen afterwards", text)]


def print_replay(
    found: Replay,
    expected: ExpectedConvergence | None = None,
    figures: dict[str, Any] | None = None,
    began: InitialSoc | None = None,
    *,
    sure: bool = True,
) -> None:
    """A replay for people; ``sure``: how sure a start is was stated."""
    data = found.to_dict() if figures is None else figures
    settled = data["settled"]
    how = found.start.how
    if how == "given" and not sure:
        how += "; --soc0-std states how sure"
    rows = [
        ("initial SOC", f"{found.start.soc:.4f} +- {2 * found.start.std:.4f} ({how})"),
        *_began(began),
        ("final SOC", f"{data['soc_final']:.4f} +- {2 * data['soc_final_std']:.4f}"),
        ("voltage RMSE, one step ahead", f"{printing.millivolt(data['voltage_rmse_V'])} mV"),
        ("NIS by time scale", _nis(found)),
        ("time per step", f"{data['ns_per_step']:.0f} ns"),
    ]
    if expected is not None:
        rows.append(("within 2 %, by model and current", _after(expected.convergence_s)))
    if settled is None:
        rows.append(("SOC error", "no reference: give --reference-capacity-ah and a counter"))
    else:
        rows += [
            ("SOC RMSE, all rows", f"{printing.percent(data['soc_rmse'])} %"),
            ("within 2 %", _after(data["convergence_s"])),
            (
                "settled RMSE / MAE / max",
                " / ".join(printing.percent(settled[k]) for k in ("rmse", "mae", "max")) + " %",
            ),
            ("rows within 2 sigma", f"{printing.percent(data['coverage_2sigma'], 1)} %"),
        ]
    rows += parameter_rows(data)
    printing.table(f"{found.estimator} on {found.log.name}", ("what", "found"), rows)


def parameter_rows(data: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of the table of a replay; none for an estimator without parameters."""
    values = data.get("parameters")
    if values is None:
        return []
    rows = []
    for name, (label, unit) in UNITS.items():
        one = values[name]
        text = f"{one['value']:.4f} +- {2 * one['std']:.4f} {unit}".rstrip()
        if one["held"] is not None:
            text += f" (held: {one['held']})"
        elif one["probability"] is not None:
            text += f" ({100 * one['probability']:.0f} % that it is not the model's)"
        rows.append((label, text))
    soh = f"{printing.percent(values['soh_capacity'], 1)} % by capacity, resistance x "
    rows.append(("state of health", soh + f"{values['soh_resistance']:.3f}"))
    return rows


def _nis(found: Replay) -> str:
    if found.nis is None or found.model is None:
        return "-"
    each = zip(found.nis, found.model.error.scales_s, strict=True)
    return ", ".join(f"{nis:.2f} ({scale:g} s)" for nis, scale in each)


def _after(seconds: float | None) -> str:
    return "not on this log" if seconds is None else f"after {seconds:.1f} s"


def print_forecasts(
    flight: Flight | None, at_load: Forecast | None, cutoff_V: float, hold: str
) -> None:
    """Remaining time and energy, for people; nothing where there is no load."""
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
        f"{200 * now.soc_std:.1f} %, {hold} held to {cutoff_V:.2f} V",
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

    def limit(way: PowerLimit) -> tuple[str, ...]:
        return (f"{way.power_W:.1f}", f"{way.power_low_W:.1f}", f"{way.current_A:.1f}", way.by)

    rows = [(f"{s.horizon_s:g} s", *limit(s.discharge), *limit(s.charge)) for s in power.last]
    known = power.known.limits
    printing.table(
        f"power of each cell at the end, {power.hold} held, {known.voltage_min_V:g} to "
        f"{known.voltage_max_V:g} V",
        ("for", "discharge W", "at least W (95 %)", "A", "limited by",
         "charge W", "at least W (95 %)", "A", "limited by"),
        rows,
    )  # fmt: skip

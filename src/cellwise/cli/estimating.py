"""cellwise simulate, cellwise replay."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

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
    from cellwise.cli.replay_output import Run
    from cellwise.estimate.power.state_of_power import PowerSettings
    from cellwise.forecast.plan import Plan
    from cellwise.logs import CellLog


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
    from cellwise.cli.replay_output import print_runs, write_rows
    from cellwise.estimate.estimators import make_estimator
    from cellwise.forecast.remaining import check_load
    from cellwise.logs.gaps import cut_at_pauses

    options.check_places(arguments.output)
    page_options.check_page_options(arguments)
    options.check_fraction("--reference-soc0", arguments.reference_soc0)
    model = options.read_model(arguments)
    make_estimator(arguments.estimator, model)  # refuses an unknown name before any work
    power = forecast_options.power_of(arguments, model, arguments.hold)
    if arguments.load is not None:
        check_load(arguments.load, arguments.hold)
    check_one_output(arguments)
    plans = forecast_options.plans_of(arguments)
    whole = read_logs_of(model, arguments)
    logs = [(one, k == 0) for log in whole for k, one in enumerate(cut_at_pauses(log))]
    runs: list[Run] = []
    with printing.working(arguments.estimator) as follow:
        for log, begins in logs:
            follow(f"{arguments.estimator} over {len(log):,} samples", len(runs), len(logs))
            runs.append(run_of(model, log, plans, power, arguments, begins=begins))
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
    else:
        print_runs(runs, sure=arguments.soc0_std is not None)
        page_options.say_pages(arguments)


def run_of(
    model: CellModel,
    log: CellLog,
    plans: Sequence[Plan],
    power: PowerSettings | None,
    arguments: argparse.Namespace,
    *,
    begins: bool,
) -> Run:
    """Replay one stretch and say what is ahead of its end.

    What is stated of the start holds where it ``begins``: not behind a pause that nobody counted.
    """
    from cellwise.cell.initial_soc.initial_soc import initial_soc
    from cellwise.cell.plausibility.notice import ends_forecasts
    from cellwise.cli.replay_output import Run
    from cellwise.estimate.estimators import make_estimator
    from cellwise.estimate.replay import expected_convergence_s, replay
    from cellwise.forecast.charging import forecast_charge
    from cellwise.forecast.remaining import cutoff_of, forecast, forecast_at
    from cellwise.logs.cell_log import resample

    log = log if arguments.dt is None else resample(log, arguments.dt)
    reference_soc0 = options.start_of(log.soc0, arguments.reference_soc0, "--reference-soc0")
    found = replay(
        model,
        log,
        arguments.estimator,
        soc0=options.start_of(log.soc0, options.soc0_of(arguments)) if begins else None,
        soc0_std=arguments.soc0_std if begins else None,
        reference_soc0=reference_soc0,
        reference_capacity_Ah=arguments.reference_capacity_ah if begins else None,
        power=power or False,
    )
    begun = found.start.how in ("given", "stated")
    run = Run(
        found,
        expected_convergence_s(model, found, make_estimator(arguments.estimator, model)),
        None if begun else initial_soc(model, found.log, whole_log=True),
        None if arguments.anyway else ends_forecasts(found.far_off, found.log),
    )
    if run.far is None:
        held = {"cutoff_V": cutoff_of(model, arguments.cutoff_v), "hold": arguments.hold}
        charger = {"limit_V": arguments.charge_limit_v, "taper_A": arguments.charge_end_a}
        at_load = None
        if arguments.load is not None:
            at_load = forecast_at(model, found, arguments.load, **held)
        flight = forecast(model, found, **held)
        run = dataclasses.replace(
            run,
            hold=arguments.hold,
            cutoff_V=held["cutoff_V"],
            flight=None if flight is None else dataclasses.replace(flight, given=at_load),
            at_load=at_load,
            charge=forecast_charge(model, found, **charger),
            plan=forecast_options.outcome_of(arguments, model, found, plans),
        )
    shown = forecast_options.display_of(arguments, model, found, run.flight, run.charge)
    return dataclasses.replace(run, displayed_percent=shown)


def print_simulation(found: Simulation, start: InitialSoc) -> None:
    """A simulation for people."""
    millivolt, notices, far_off = printing.millivolt, found.notices, found.far_off
    first = () if far_off is None else notices[: notices.index(far_off) + 1]
    printing.say_notices(first)
    began = (
        f"{start.soc:.3f}" if start.how == "given" else f"{start.soc:.3f} +- {2 * start.std:.3f}"
    )
    bands = ((f"SOC {b.soc_low:.1f} to {b.soc_high:.1f}", b.metrics) for b in found.bands)
    printing.record_table(
        f"{found.log.name}: measured minus simulated, from SOC {began} ({start.how})",
        (("all rows", found.metrics), *bands),
        ("where", lambda row: row[0]),
        ("RMSE mV", lambda row: millivolt(row[1].rmse_V)),
        ("MAE mV", lambda row: millivolt(row[1].mae_V)),
        ("max mV", lambda row: millivolt(row[1].max_error_V)),
        ("mean", lambda row: millivolt(row[1].mean_error_V)),
        ("sd", lambda row: millivolt(row[1].std_error_V)),
        ("95 % from", lambda row: millivolt(row[1].ci95_V[0])),
        ("to", lambda row: millivolt(row[1].ci95_V[1])),
        ("rows", lambda row: f"{row[1].samples:,}"),
    )
    printing.say(f"RMSE above 10 % SOC: {millivolt(found.rmse_above_10pct_V)} mV")
    printing.say_notices(n for n in notices if n not in first)

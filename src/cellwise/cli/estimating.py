"""A model over logs.

cellwise simulate: model and log to voltage error
    requires a model (a file or the name of a stock model) and a log with voltages
    $ simulate --model cell.json drive.csv
    $ simulate --model nmc-18650 --capacity-ah 3 drive.csv --soc0 1
<scaled model>
<log>
<start>
    -o, --output OUT  rows as .csv, .csv.gz or .parquet
<log options>

cellwise replay: model and log to SOC
    requires a model and a log; where it stands at the start is found, or stated with --soc0
    $ replay --model cell.json drive.csv --report replay.html
    $ replay --model cell.json flight.bin --series 4 --estimator adaptive -o soc.csv
<scaled model>
<log>
    --estimator E=ekf  coulomb, rest-ocv, ekf, ukf, adaptive, fixed-step, firmware, filterpy-ekf,
        filterpy-ukf
<start>
<start std>
<sensor>
    --dt S  resample to an even step
<reference>
    --hold power|current=power  what of the load is held constant
    --load X  how long, too, at a load of X W in each cell (A with --hold current)
<ahead>
    --plan P+  what lies ahead: CSV of time_s and power_W or current_A of the pack, or past logs
    --land-above X  with which chance it ends above this SOC [0]
    --sketch FILE  what a target exported with --sketch would keep after these logs, for diagnose;
        estimator fixed-step or firmware
    --sketch-from FILE  an earlier one of the same target, to go on with
    -o, --output OUT  rows as .csv, .csv.gz or .parquet
<page>
<log options>
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.cell.simulate import Simulation
from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.cli.replay_output import data_of, print_runs
from cellwise.errors import InputError
from cellwise.estimate.sensor import seen_by
from cellwise.files import write_atomically
from cellwise.logs import CellLog
from cellwise.logs.stated import logs_of
from cellwise.logs.writing import write_columns
from cellwise.workflows.replaying import ReplayRequest, check_replay, replay_each, write_replays
from cellwise.workflows.simulating import simulate_from_start
from cellwise.workflows.sketches import check_keeper, keep_sketch, read_block


def read_logs_of(model: CellModel, arguments: argparse.Namespace) -> tuple[CellLog, ...]:
    """The logs that the arguments name, of one cell as the model is.

    Raises
    ------
    InputError        as `log_options.read`; one file for the rows of several logs
    """
    named = logs_of(arguments.log).logs
    if arguments.output and len(named) > 1:
        raise InputError(
            f"-o {arguments.output} for {len(named)} logs",
            "the rows of one log",
            "Leave out -o, or name one log; `cellwise fleet replay` writes a row for each.",
        )
    logs = log_options.read_all([arguments.log], arguments)

    def checked(log: CellLog) -> CellLog:
        check_cells_in_series(model, log)
        return log

    return tuple(log_options.each_that_serves(logs, checked))


def run_simulate(arguments: argparse.Namespace) -> None:
    """Simulate a log and print the error."""
    options.check_places(arguments.output)
    model = options.read_model(arguments)

    def simulated(log: CellLog) -> dict[str, Any]:
        found = simulate_from_start(model, log, options.soc0_of(arguments))
        if arguments.output:
            write_columns(found.simulation.columns(), Path(arguments.output))
        if not arguments.json:
            print_simulation(found.simulation, found.start)
        return {**found.to_dict(), "notices": printing.rendered(found.simulation.notices)}

    printed = log_options.each_that_serves(read_logs_of(model, arguments), simulated)
    if arguments.json:
        printing.print_json(printed[0] if len(printed) == 1 else {"logs": printed})


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay a log through an estimator and print how it did."""
    options.check_places(arguments.output, arguments.sketch)
    page_options.check_page_options(arguments)
    options.check_fraction("--reference-soc0", arguments.reference_soc0)
    model = options.read_model(arguments)
    before = sketch_before(arguments)
    ahead = forecast_options.ahead_of(arguments, forecast_options.plans_of(arguments))
    asked = asked_of(model, arguments)
    check_replay(model, asked, ahead)
    whole = read_logs_of(model, arguments)
    with printing.working(arguments.estimator) as follow:
        runs = log_options.serving(replay_each(model, whole, asked, ahead, follow))
    if arguments.output:
        write_replays(runs, arguments.output, log_options.read_options(arguments))
    if arguments.sketch:
        asked_for = arguments.estimator, whole, options.soc0_of(arguments), arguments.dt, before
        write_atomically(arguments.sketch, keep_sketch(model, *asked_for))
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            from cellwise.report.replay.page import replay_page

            flights = tuple(run.flight for run in runs if run.flight is not None)
            replays = [replace(run.replay, power=run.power) for run in runs]
            replay_page(replays, pages.page, flights=flights, figures=pages.figures)
    if arguments.json:
        printed = [data_of(run) for run in runs]
        # Of one file that was cut, what holds at its end; beside it every stretch.
        last_of_one = printed[-1] if len(whole) == 1 else {}
        printing.print_json({**last_of_one, "logs": printed} if len(runs) > 1 else printed[0])
    else:
        print_runs(runs, sure=arguments.soc0_std is not None)
        page_options.say_pages(arguments)


def sketch_before(arguments: argparse.Namespace) -> bytes | None:
    """The sketch that is gone on with; None: none.

    Raises
    ------
    InputError        without a place for what comes of it; no such file; another estimator
    """
    if arguments.sketch is not None:
        check_keeper(arguments.estimator)
    if arguments.sketch_from is None:
        return None
    if arguments.sketch is None:
        raise InputError("--sketch-from without --sketch", "both", "Add --sketch FILE.")
    return read_block(arguments.sketch_from)


def asked_of(model: CellModel, arguments: argparse.Namespace) -> ReplayRequest:
    """How the arguments ask for a log to be replayed."""
    sensor = options.sensor_of(arguments)
    seen = seen_by(model, sensor).model
    return ReplayRequest(
        arguments.estimator,
        soc0=options.soc0_of(arguments),
        soc0_std=arguments.soc0_std,
        reference_soc0=arguments.reference_soc0,
        reference_capacity_Ah=arguments.reference_capacity_ah,
        dt_s=arguments.dt,
        sensor=sensor,
        power=forecast_options.power_of(arguments, seen, arguments.hold),
    )


def print_simulation(found: Simulation, start: InitialSoc) -> None:
    """A simulation for people."""
    millivolt, notices, mismatch = printing.millivolt, found.notices, found.model_mismatch
    first = () if mismatch is None else notices[: notices.index(mismatch) + 1]
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
    printing.say(
        f"RMSE above 10 % SOC: {millivolt(found.rmse_above_10pct_V)} mV, where the model states "
        f"{millivolt(found.band_above_10pct_V)} mV; of all rows: {millivolt(found.rmse_V)} mV, "
        f"{millivolt(found.band_V)} mV (one deviation over logs)"
    )
    printing.say_notices(n for n in notices if n not in first)

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
    --dt S  resample to an even step
<reference>
    --hold power|current=power  what of the load is held constant
    --load X  how long, too, at a load of X W in each cell (A with --hold current)
<ahead>
    --plan P+  what lies ahead: CSV of time_s and power_W or current_A of the pack, or past logs
    --land-above X  with which chance it ends above this SOC [0]
    -o, --output OUT  rows as .csv, .csv.gz or .parquet
<page>
<log options>
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import ends_forecasts
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.cell.simulate import Simulation, simulate
from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.cli.replay_output import Run, print_runs, write_rows
from cellwise.errors import InputError
from cellwise.estimate.estimators import make_estimator
from cellwise.estimate.power.state_of_power import PowerSettings
from cellwise.estimate.replay import expected_convergence_s, replay
from cellwise.fit.pauses import simulate_stretches
from cellwise.fit.start import InitialSoc, initial_soc
from cellwise.forecast.charging import forecast_charge
from cellwise.forecast.display import display_along
from cellwise.forecast.plan import Plan, forecast_plan
from cellwise.forecast.remaining import check_load, cutoff_of, forecast, forecast_at
from cellwise.logs import CellLog
from cellwise.logs.cell_log import resample
from cellwise.logs.gaps import cut_at_pauses
from cellwise.logs.stated import logs_of
from cellwise.logs.writing import write_columns


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
        asked = options.start_of(log.soc0, options.soc0_of(arguments))
        start = initial_soc(model, log, asked, whole_log=True)
        simulate(model, log.part(0, 2), start.soc)  # compiles outside the clock
        began = time.perf_counter()
        found = simulate_stretches(model, log, start)
        seconds = time.perf_counter() - began
        if arguments.output:
            write_columns(found.columns(), Path(arguments.output))
        data = {**found.to_dict(), "soc0": start.to_dict(), "seconds": seconds}
        if not arguments.json:
            print_simulation(found, start)
        return {"log": log.name, **data, "notices": list(found.notices)}

    printed = log_options.each_that_serves(read_logs_of(model, arguments), simulated)
    if arguments.json:
        printing.print_json(printed[0] if len(printed) == 1 else {"logs": printed})


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay a log through an estimator and print how it did."""
    options.check_places(arguments.output)
    page_options.check_page_options(arguments)
    options.check_fraction("--reference-soc0", arguments.reference_soc0)
    model = options.read_model(arguments)
    make_estimator(arguments.estimator, model)  # refuses an unknown name before any work
    power = forecast_options.power_of(arguments, model, arguments.hold)
    if arguments.load is not None:
        check_load(arguments.load, arguments.hold)
    plans = forecast_options.plans_of(arguments)
    whole = read_logs_of(model, arguments)
    logs = [(one, k == 0) for log in whole for k, one in enumerate(cut_at_pauses(log))]
    with printing.working(arguments.estimator) as follow:

        def replayed(one: tuple[CellLog, bool]) -> Run:
            name = f"{arguments.estimator} over {len(one[0]):,} samples"
            follow(name, logs.index(one), len(logs))
            return run_of(model, one[0], plans, power, arguments, begins=one[1])

        runs = log_options.each_that_serves(logs, replayed)
    if arguments.output:
        write_rows(arguments, runs)
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            from cellwise.report import replay_page

            flights = tuple(run.flight for run in runs if run.flight is not None)
            replays = [replace(run.found, power=run.power) for run in runs]
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
    log = log if arguments.dt is None else resample(log, arguments.dt)
    found = replay(
        model,
        log,
        arguments.estimator,
        soc0=options.start_of(log.soc0, options.soc0_of(arguments)) if begins else None,
        soc0_std=arguments.soc0_std if begins else None,
        reference_soc0=options.start_of(log.soc0, arguments.reference_soc0, "--reference-soc0"),
        reference_capacity_Ah=arguments.reference_capacity_ah if begins else None,
        power=power or False,
    )
    begun = found.start.how in ("given", "stated")
    cutoff_V = cutoff_of(model, arguments.cutoff_v)
    far = None if arguments.anyway else ends_forecasts(found.far_off, found.log)
    ahead: dict[str, Any] = {}
    if far is None:
        held: dict[str, Any] = {"cutoff_V": cutoff_V, "hold": arguments.hold}
        charger = {"limit_V": arguments.charge_limit_v, "taper_A": arguments.charge_end_a}
        load, above = arguments.load, arguments.land_above or 0.0
        at_load = None if load is None else forecast_at(model, found, load, **held)
        flight = forecast(model, found, **held)
        ahead["at_load"] = at_load
        ahead["flight"] = None if flight is None else replace(flight, given=at_load)
        ahead["charge"] = forecast_charge(model, found, **charger)
        if plans:
            how_far = {"above": above, "cutoff_V": arguments.cutoff_v}
            ahead["plan"] = forecast_plan(model, found, plans, **how_far)
    how = forecast_options.how_displayed(arguments, model)
    shown = None
    if how is not None:
        shown = display_along(how, found, ahead.get("flight"), ahead.get("charge"))
    return Run(
        found,
        expected_convergence_s(model, found, make_estimator(arguments.estimator, model)),
        None if begun else initial_soc(model, found.log, whole_log=True),
        far,
        displayed_percent=shown,
        hold=arguments.hold,
        cutoff_V=cutoff_V,
        **ahead,
    )


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
    printing.say(
        f"RMSE above 10 % SOC: {millivolt(found.rmse_above_10pct_V)} mV; the model states "
        f"{millivolt(found.band_V)} mV (one deviation)"
    )
    printing.say_notices(n for n in notices if n not in first)

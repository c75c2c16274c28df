"""cellwise simulate, cellwise replay."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import (
    log_options,
    model_options,
    page_options,
    parameters,
    power_options,
    printing,
)
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.initial_soc.initial_soc import InitialSoc
    from cellwise.cell.simulate import Simulation
    from cellwise.estimate.power.along import PowerTrace
    from cellwise.estimate.power.state_of_power import PowerLimit
    from cellwise.estimate.replay import Replay
    from cellwise.forecast.convergence import ExpectedConvergence
    from cellwise.forecast.remaining import Flight, Forecast


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
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
    replay.add_argument(
        "--soc0-std",
        type=float,
        metavar="S",
        help="standard deviation of the initial SOC (of a stated --soc0 0.15 unless given)",
    )
    replay.add_argument("--dt", type=float, metavar="S", help="resample to an even step")
    replay.add_argument("--reference-soc0", type=float, metavar="X", help="true SOC at the start")
    replay.add_argument(
        "--reference-capacity-ah", type=float, metavar="X", help="for the reference by the counter"
    )
    replay.add_argument(
        "--cutoff-v",
        type=float,
        metavar="V",
        help="cell voltage at which the load stops [model]",
    )
    replay.add_argument(
        "--hold",
        choices=("power", "current"),
        default="power",
        help="what of the load is held constant [power]",
    )
    replay.add_argument(
        "--load",
        type=float,
        metavar="X",
        help="how long, too, at a load of X W in each cell (A with --hold current)",
    )
    replay.add_argument(
        "--plotjuggler", metavar="F.xml", help="layout of PlotJuggler for the rows of -o OUT.csv"
    )
    power_options.add_power_options(replay)
    page_options.add_page_options(replay)
    replay.set_defaults(run=run_replay)


def _common(parser: argparse.ArgumentParser) -> None:
    model_options.add_model(parser, scalable=True)
    parser.add_argument("log", metavar="LOG", help=log_options.LOG_HELP)
    parser.add_argument("--soc0", default="auto", metavar="X", help="0..1, or auto [auto]")
    parser.add_argument("-o", "--output", metavar="OUT", help="rows as .csv, .csv.gz or .parquet")
    log_options.add_log_options(parser)
    printing.add_json(parser)


def run_simulate(arguments: argparse.Namespace) -> None:
    """Simulate a log and print the error."""
    import time

    from cellwise.cell.initial_soc.initial_soc import initial_soc
    from cellwise.cell.plausibility.cells_in_series import check_cells_in_series
    from cellwise.cell.simulate import simulate

    printing.check_places(arguments.output)
    model = model_options.read(arguments)
    log = log_options.read(arguments.log, arguments)
    check_cells_in_series(model, log)
    given = log_options.start_of(log.soc0, log_options.parse_soc0(arguments.soc0))
    start = initial_soc(model, log, given, likeliest=True, whole_log=True)
    simulate(model, log.part(0, 2), start.soc)  # compiles outside the clock
    began = time.perf_counter()
    found = simulate(model, log, start.soc)
    seconds = time.perf_counter() - began
    if arguments.output:
        _write(
            arguments.output,
            {
                "time_s": log.time_s,
                "current_A": log.current_A,
                "measured_voltage_V": log.voltage_V,
                "voltage_V": found.voltage_V,
                "error_V": found.error_V,
                "soc": found.soc,
            },
        )
    data = {**found.to_dict(), "soc0": start.to_dict(), "seconds": seconds}
    data["notices"] = list(found.notices)
    if arguments.json:
        printing.print_json(data)
        return
    print_simulation(found, start)


def run_replay(arguments: argparse.Namespace) -> None:
    """Replay a log through an estimator and print how it did."""
    from cellwise.cell.plausibility.cells_in_series import check_cells_in_series
    from cellwise.estimate.estimators import make_estimator
    from cellwise.estimate.replay import replay
    from cellwise.forecast.convergence import expected_convergence
    from cellwise.forecast.remaining import check_load, cutoff_of, forecast, forecast_at
    from cellwise.logs.resample import resample

    printing.check_places(arguments.output, arguments.plotjuggler)
    check_layout(arguments)
    page_options.check_page_options(arguments)
    true0 = arguments.reference_soc0
    if true0 is not None and not 0.0 <= true0 <= 1.0:
        raise InputError(f"--reference-soc0 {true0:g}", "a fraction from 0 to 1", "Correct it.")
    model = model_options.read(arguments)
    make_estimator(arguments.estimator, model)
    cutoff = cutoff_of(model, arguments.cutoff_v)
    power = power_options.power_of(arguments, model, arguments.hold)
    if arguments.load is not None:
        check_load(arguments.load, arguments.hold)
    log = log_options.read(arguments.log, arguments)
    check_cells_in_series(model, log)
    if arguments.dt is not None:
        log = resample(log, arguments.dt)
    with printing.bar() as progress:
        progress.add_task(f"{arguments.estimator} over {len(log):,} samples", total=None)
        found = replay(
            model,
            log,
            arguments.estimator,
            soc0=log_options.start_of(log.soc0, log_options.parse_soc0(arguments.soc0)),
            soc0_std=arguments.soc0_std,
            reference_soc0=log_options.start_of(log.soc0, true0, "--reference-soc0"),
            reference_capacity_Ah=arguments.reference_capacity_ah,
            power=power or False,
        )
    expected = expected_convergence(model, found, make_estimator(arguments.estimator, model))
    flight, given = forecast(model, found, cutoff_V=cutoff, hold=arguments.hold), None
    if arguments.load is not None:
        given = forecast_at(model, found, arguments.load, cutoff_V=cutoff, hold=arguments.hold)
        flight = None if flight is None else dataclasses.replace(flight, given=given)
    if arguments.output:
        trace = found.trace
        columns = {
            "time_s": trace.time_s,
            "soc": trace.soc,
            "soc_std": trace.soc_std,
            "voltage_V": trace.voltage_V,
            "innovation_V": trace.innovation_V,
            "innovation_variance_V2": trace.innovation_variance_V2,
            "test_ratio": trace.test_ratio,
            "status": trace.status,
            "current_A": log.interval_current_A,
            "measured_voltage_V": log.voltage_V,
        }
        columns |= parameters.parameter_columns(trace)
        if found.reference_soc is not None:
            columns["reference_soc"] = found.reference_soc
        if found.power is not None:
            columns |= found.power.columns()
        _write(arguments.output, columns)
        if arguments.plotjuggler:
            from cellwise.report.plotjuggler import write_layout

            write_layout(arguments.plotjuggler, arguments.output, columns)
    with page_options.page_places(arguments) as places:
        if places is not None:
            from cellwise.report import replay_page

            flights = () if flight is None else (flight,)
            replay_page([found], places.page, flights=flights, figures=places.figures)
    notices = found.notices if flight is None else (*flight.notices, *found.notices)
    if arguments.json:
        outlook = None if flight is None else flight.to_dict()
        data = {
            **found.to_dict(),
            "convergence_predicted_s": expected.convergence_s,
            "forecast": outlook,
            "forecast_given": None if given is None else given._asdict(),
            "notices": list(notices),
        }
        printing.print_json(data)
        return
    print_replay(found, expected, sure=arguments.soc0_std is not None)
    print_forecasts(flight, given, cutoff, arguments.hold)
    if found.power is not None:
        print_power(found.power)
    say_notices(notices)
    page_options.say_pages(arguments)


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
    rows = []
    for label, m in (
        ("all rows", found.metrics),
        *((f"SOC {b.soc_low:.1f} to {b.soc_high:.1f}", b.metrics) for b in found.bands),
    ):
        values = (m.rmse_V, m.mae_V, m.max_error_V, m.mean_error_V, m.std_error_V, *m.ci95_V)
        rows.append((label, *(printing.millivolt(v) for v in values), f"{m.samples:,}"))
    printing.table(
        f"{found.log.name}: measured minus simulated, from SOC {start.soc:.3f} +- "
        f"{2 * start.std:.3f} ({start.how})",
        ("where", "RMSE mV", "MAE mV", "max mV", "mean", "sd", "95 % from", "to", "rows"),
        rows,
    )
    printing.say(f"RMSE above 10 % SOC: {printing.millivolt(found.rmse_above_10pct_V)} mV")
    say_notices(found.notices)


def say_notices(notices: Sequence[str]) -> None:
    """Notices for people."""
    for notice in notices:
        printing.say(f"  ! {notice}")


def print_replay(
    found: Replay, expected: ExpectedConvergence | None = None, *, sure: bool = True
) -> None:
    """A replay for people; ``sure``: how sure a start is was stated."""
    data = found.to_dict()
    settled = data["settled"]
    how = found.start.how
    if how == "given" and not sure:
        how += "; --soc0-std states how sure"
    rows = [
        ("initial SOC", f"{found.start.soc:.4f} +- {2 * found.start.std:.4f} ({how})"),
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
    rows += parameters.parameter_rows(data)
    printing.table(f"{found.estimator} on {found.log.name}", ("what", "found"), rows)


def _nis(found: Replay) -> str:
    if found.nis is None or found.model is None:
        return "-"
    each = zip(found.nis, found.model.error.scales_s, strict=True)
    return ", ".join(f"{nis:.2f} ({scale:g} s)" for nis, scale in each)


def _after(seconds: float | None) -> str:
    return "not on this log" if seconds is None else f"after {seconds:.1f} s"


def print_forecasts(
    flight: Flight | None, given: Forecast | None, cutoff_V: float, hold: str
) -> None:
    """Remaining time and energy, for people; nothing where there is no load."""
    forecasts = [] if flight is None else [("at the present load", flight.last)]
    if flight is not None and flight.typical is not None:
        forecasts.append(("at the log's median load", flight.typical.last))
    if given is not None:
        forecasts.append((f"at the given load, from {given.time_s:.0f} s", given))
    if not forecasts:
        return

    def span(value: float, band: tuple[float, float], scale: float, digits: int) -> str:
        low, high = (f"{x / scale:.{digits}f}" for x in band)
        return f"{value / scale:.{digits}f} ({low} to {high})"

    rows = [
        (
            name,
            f"{at.load_A:.2f}",
            f"{at.load_W:.1f}",
            span(at.remaining_s, at.remaining_s_band, 60.0, 1),
            span(at.remaining_Wh, at.remaining_Wh_band, 1.0, 2),
            f"{at.end_voltage_V:.3f}",
            f"{100 * at.end_soc:.1f}",
            at.by,
        )
        for name, at in forecasts
    ]
    now = forecasts[0][1]
    printing.table(
        f"remaining in each cell at {now.time_s:.0f} s, SOC {100 * now.soc:.1f} +- "
        f"{200 * now.soc_std:.1f} %, {hold} held to {cutoff_V:.2f} V",
        ("", "A", "W", "minutes", "Wh", "end V", "end SOC %", "ends by"),
        rows,
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


def _write(path: str, columns: dict[str, Any]) -> None:
    from cellwise.logs.writing import write_columns

    write_columns(columns, Path(path))

"""cellwise identify."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cellwise.cli.common import log_options, page_options, printing

if TYPE_CHECKING:
    from cellwise.identify import Identification


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command that makes models."""
    p = commands.add_parser("identify", help="laboratory tests to a model")
    for option, metavar, text in (
        ("--hppc", "LOG[@...]", "pulse test; @-10 or @temperature_C=-10,soc0=1 says what is known"),
        ("--ocv", "LOG[@...]", "low-rate discharge, charge or both"),
        ("--capacity", "LOG[@...]", "capacity test"),
        ("--drive", "LOG[@...]", "drive log to refine on"),
    ):
        p.add_argument(option, action="append", default=[], metavar=metavar, help=text)
    p.add_argument("--nominal-ah", type=float, metavar="X", help="rated capacity")
    p.add_argument(
        "--capacity-choice",
        metavar="C",
        help="nominal, cc-average, cc-cv-average, hppc-total or rate:C/20 "
        "[the slowest complete discharge]",
    )
    p.add_argument(
        "--prior",
        metavar="MODEL",
        help="a stock model (`cellwise data list`) or a model file of such a cell: scaled to the "
        "capacity, and corrected as far as the logs determine",
    )
    p.add_argument("--method", choices=("varpro", "segments", "pso"), default="varpro")
    p.add_argument("--tables", choices=("spline", "cubic"), default="spline")
    p.add_argument("--no-refine", action="store_true", help="keep the tables of the single pulses")
    p.add_argument("--branches", type=int, choices=(2, 3), default=3, help="RC branches [3]")
    p.add_argument("--hysteresis", choices=("auto", "on", "off"), default="auto")
    p.add_argument("--temperature-c", type=float, metavar="T", help="of tests that measured none")
    p.add_argument("--name", default="", help="name of the cell, written into the model")
    p.add_argument("--chemistry", default="")
    p.add_argument("-o", "--output", required=True, metavar="MODEL", help="model file (JSON)")
    page_options.add_page_options(p)
    log_options.add_log_options(p)
    printing.add_json(p)
    p.set_defaults(run=run_identify)


def run_identify(arguments: argparse.Namespace) -> None:
    """Identify a cell, write the model and the page."""
    from cellwise.cell.model_file import write_model
    from cellwise.cell.stock.catalogue import named_model
    from cellwise.identify import IdentifySettings, TestLogs, identify_cell
    from cellwise.logs.stated import check_temperature

    printing.check_places(arguments.output)
    page_options.check_page_options(arguments)
    check_temperature(arguments.temperature_c)

    tests = TestLogs(
        hppc=log_options.read_with_temperature(arguments.hppc, arguments),
        drive=log_options.read_with_temperature(arguments.drive, arguments),
        ocv=tuple(log_options.read(path, arguments) for path in arguments.ocv),
        capacity=tuple(log_options.read(path, arguments) for path in arguments.capacity),
    )
    settings = IdentifySettings(
        nominal_Ah=arguments.nominal_ah,
        capacity_choice=arguments.capacity_choice,
        method=arguments.method,
        tables=arguments.tables,
        refine=not arguments.no_refine,
        branches=arguments.branches,
        hysteresis={"auto": None, "on": True, "off": False}[arguments.hysteresis],
        temperature_C=arguments.temperature_c,
        prior=None if arguments.prior is None else named_model(arguments.prior),
        name=arguments.name,
        chemistry=arguments.chemistry,
    )
    with printing.bar() as progress:
        task = progress.add_task("identify", total=None)
        found = identify_cell(tests, settings, lambda text: progress.update(task, description=text))
        with page_options.page_places(arguments) as places:
            if places is not None:
                from cellwise.report import identify_page

                progress.update(task, description="page")
                identify_page(found, places.page, figures=places.figures)
    write_model(found.model, arguments.output)
    if arguments.json:
        printing.print_json({**found.to_dict(), "model": arguments.output})
        return
    print_identification(found)
    printing.say(f"model written to {arguments.output}")
    page_options.say_pages(arguments)


def print_identification(found: Identification) -> None:
    """An identification for people."""
    from cellwise.identify.capacity.capacity_choice import capacity_table, format_capacity_table

    # Logs that do not go together come before every figure that was made of them.
    for notice in found.contradictions:
        printing.say(f"  ! {notice}")
    complete = [t for t in found.capacity_tests if t.complete]
    if complete:
        printing.say(format_capacity_table(capacity_table(complete)))
    printing.table(
        f"capacity: {found.model.capacity_Ah:.4f} Ah, by {found.capacity_choice}",
        ("choice", "Ah"),
        [(name, f"{value:.4f}") for name, value in found.capacities.items()],
    )
    counts = ", ".join(f"{n} {quality}" for quality, n in found.pulse_counts.items())
    printing.say(f"pulses: {counts}")
    rows = [
        (
            s.log.name,
            printing.millivolt(s.metrics.rmse_V),
            printing.millivolt(s.metrics.mae_V),
            printing.millivolt(s.metrics.max_error_V),
            printing.millivolt(s.rmse_above_10pct_V),
        )
        for s in found.simulations
    ]
    columns = ("log (fitted on it)", "RMSE mV", "MAE mV", "max mV", "RMSE above 10 % SOC")
    printing.table(f"{found.model!r}", columns, rows)
    known = {k: v for k, v in found.model.validity.to_dict().items() if v is not None}
    printing.say(
        "valid for " + ", ".join(f"{k} {v[0]:.3g} to {v[1]:.3g}" for k, v in known.items())
    )
    for notice in found.notices:
        if notice not in found.contradictions:
            printing.say(f"  ! {notice}")
    printing.say(f"{found.seconds:.1f} s")

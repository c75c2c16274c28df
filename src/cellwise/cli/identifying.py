"""cellwise identify."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cellwise.cli.common import log_options, options, page_options, printing

if TYPE_CHECKING:
    from cellwise.identify import Identification


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that makes models."""
    p = commands.add_parser("identify", help="laboratory tests to a model")
    log_options.add_test_options(p)
    options.number(p, "--nominal-ah", "X", "rated capacity")
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
    options.flag(p, "--no-refine", "keep the tables of the single pulses")
    options.count(p, "--branches", None, "RC branches [3]", choices=(2, 3), default=3)
    p.add_argument("--hysteresis", choices=("auto", "on", "off"), default="auto")
    options.number(p, "--temperature-c", "T", "of tests that measured none")
    p.add_argument("--name", default="", help="name of the cell, written into the model")
    p.add_argument("--chemistry", default="")
    p.add_argument("-o", "--output", required=True, metavar="MODEL", help="model file (JSON)")
    page_options.add_page_options(p)
    log_options.add_log_options(p)
    options.add_json(p)
    p.set_defaults(run=run_identify)


def run_identify(arguments: argparse.Namespace) -> None:
    """Identify a cell, write the model and the page."""
    from cellwise.cell.model_file import write_model
    from cellwise.cell.stock import named_model
    from cellwise.identify import IdentifySettings, identify_cell
    from cellwise.logs.stated import check_temperature

    options.check_places(arguments.output)
    page_options.check_page_options(arguments)
    check_temperature(arguments.temperature_c)

    tests = log_options.test_logs(arguments)
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
    with printing.working("identify") as follow:
        found = identify_cell(tests, settings, follow)
        with page_options.page_places(arguments) as pages:
            if pages is not None:
                from cellwise.report import identify_page

                follow("page")
                identify_page(found, pages.page, figures=pages.figures)
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
    from cellwise.identify.own_logs import start_notices

    # Logs that do not go together come before every figure that was made of them.
    printing.say_notices(found.contradictions)
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
    printing.record_table(
        f"{found.model!r}",
        [o for o in found.own_logs if o.used],
        ("log (fitted on it)", lambda o: o.simulation.log.name),
        ("begins at SOC", lambda o: f"{o.start.soc:.3f} +- {2 * o.start.std:.3f}"),
        ("RMSE mV", lambda o: printing.millivolt(o.simulation.metrics.rmse_V)),
        ("MAE mV", lambda o: printing.millivolt(o.simulation.metrics.mae_V)),
        ("max mV", lambda o: printing.millivolt(o.simulation.metrics.max_error_V)),
        ("RMSE above 10 % SOC", lambda o: printing.millivolt(o.simulation.rmse_above_10pct_V)),
    )
    known = {k: v for k, v in found.model.validity.to_dict().items() if v is not None}
    printing.say(
        "valid for " + ", ".join(f"{k} {v[0]:.3g} to {v[1]:.3g}" for k, v in known.items())
    )
    # Where the logs begin stands in the table.
    above = (*found.contradictions, *start_notices(found.own_logs))
    printing.say_notices(n for n in found.notices if n not in above)
    printing.say(f"{found.seconds:.1f} s")

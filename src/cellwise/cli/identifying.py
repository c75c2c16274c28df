"""Laboratory tests to a model.

cellwise identify: laboratory tests to a model
    requires -o, and one test at least: pulses with an OCV test, or drives with --prior
    $ identify --hppc hppc.csv --ocv c20.csv --nominal-ah 2.9 -o cell.json
    $ identify --drive flight.bin --series 4 --prior lipo-pouch --nominal-ah 5.2 -o cell.json
<tests>
    --nominal-ah X  rated capacity
    --capacity-choice C  nominal, cc-average, cc-cv-average, hppc-total or rate:C/20 [the slowest
        complete discharge]
    --prior MODEL  a stock model (`cellwise data list`), which stands for its class, or a model file
        of this cell or its kind: corrected as far as the logs determine
    --without-lineage NAME...  a stock model that is left out of what is known of cells, for judging
    --method varpro|segments|pso=varpro  of the pulses
    --tables spline|cubic=spline  over SOC
    --no-refine  keep the tables of the single pulses
    --branches 2|3=3  RC branches
    --hysteresis auto|on|off=auto  of the OCV
    --temperature-c X  of tests that measured none
    --name NAME  name of the cell, written into the model
    --chemistry NAME  written into the model
    -o, --output MODEL!  model file (JSON)
<page>
<log options>
"""

from __future__ import annotations

import argparse

from cellwise.cell.model_file import write_model
from cellwise.cell.stock import named_model
from cellwise.cli.common import log_options, options, page_options, printing
from cellwise.identify import Identification, IdentifySettings, identify_cell
from cellwise.identify.capacity.capacity_choice import capacity_table, format_capacity_table
from cellwise.identify.fit_notices import start_notices
from cellwise.logs.stated import check_temperature


def run_identify(arguments: argparse.Namespace) -> None:
    """Identify a cell, write the model and the page."""
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
        without_lineage=tuple(arguments.without_lineage or ()),
        name=arguments.name or "",
        chemistry=arguments.chemistry or "",
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
        said = {"notices": printing.rendered(found.notices), "model": arguments.output}
        printing.print_json({**found.to_dict(), **said})
        return
    print_identification(found)
    printing.say(f"model written to {arguments.output}")
    page_options.say_pages(arguments)


def print_identification(found: Identification) -> None:
    """An identification for people."""
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
        ("RMSE mV", lambda o: printing.millivolt(o.simulation.rmse_V)),
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

"""Laboratory tests to a model.

cellwise identify: laboratory tests to a model
    requires -o, and pulses with an OCV test, or drives with --prior, or --voltage-only
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
    --sketch  keep how causes look in sketches of the drives, for `cellwise diagnose --sketch`
    --temperature-c X  of tests that measured none
    --name NAME  name of the cell, written into the model
    --chemistry NAME  written into the model
    -o, --output MODEL!  model file (JSON), or the table's
<page>
<log options>
    voltage alone:
    --voltage-only LOG+  discharges of one kind of device without a current sensor, from full to
        empty: a table of the remaining time, for `cellwise export --what table`
    --points N=11  of the table
    --full-v V  voltage that counts as full [the highest of every log]
    --empty-v V  voltage at which the device ends [the lowest of every log]
    --average S=60  over how many seconds the device averages its voltage
"""

from __future__ import annotations

import argparse

from cellwise.cell.model_file import write_model
from cellwise.cell.stock import named_model
from cellwise.cli.common import log_options, options, page_options, printing
from cellwise.errors import InputError
from cellwise.identify import Identification, IdentifySettings, identify_cell
from cellwise.identify.capacity.capacity_choice import capacity_table, format_capacity_table
from cellwise.identify.fit_notices import start_notices
from cellwise.identify.ocv.voltage_only import (
    UNKNOWN,
    identify_voltage_table,
    read_voltage,
    write_voltage_table,
)
from cellwise.logs.stated import check_temperature
from cellwise.report.identification.page import OWN_COLUMNS, identify_page
from cellwise.workflows.sketches import with_pictures

# What voltages alone have no use for.
OF_TESTS = (
    *("hppc", "ocv", "capacity", "drive", "nominal_ah", "capacity_choice", "prior"),
    *("without_lineage", "sketch", "temperature_c", "name", "chemistry", "report", "figures"),
)


def run_identify(arguments: argparse.Namespace) -> None:
    """Identify a cell, write the model and the page."""
    options.check_places(arguments.output)
    if arguments.voltage_only:
        run_voltage_only(arguments)
        return
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
        if arguments.sketch:
            follow("how causes look in sketches")
            found = with_pictures(found)
        with page_options.page_places(arguments) as pages:
            if pages is not None:
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


def run_voltage_only(arguments: argparse.Namespace) -> None:
    """A table of the remaining time from voltages alone, written and printed."""
    others = [name for name in OF_TESTS if getattr(arguments, name)]
    if others:
        option = f"--{others[0].replace('_', '-')}"
        raise InputError(
            f"--voltage-only beside {option}",
            "discharges by voltage alone, or tests with a current",
            f"Leave {option} out.",
        )
    said = log_options.arguments_of_read(arguments)
    taken = ("series", "channels", "partial", "decimal", "dbc")
    read = log_options.read_each(
        arguments.voltage_only, lambda one: read_voltage(one, **{k: said[k] for k in taken})
    )
    table = identify_voltage_table(
        [log for log, _ in read],
        points=arguments.points,
        full_V=arguments.full_v,
        empty_V=arguments.empty_v,
        average_s=arguments.average,
    )
    write_voltage_table(table, arguments.output)
    if arguments.json:
        printing.print_json({**table.to_dict(), "model": arguments.output})
        return
    rows = zip(table.remaining, table.voltage_V, table.low, table.high, strict=True)
    printing.table(
        f"remaining time at the usual load, by {len(table.hours)} discharges of "
        f"{min(table.hours):.3g} to {max(table.hours):.3g} h",
        ("remaining", "voltage V", "band of 95 %"),
        [(f"{r:.0%}", f"{v:.3f}", f"{low:.0%} to {high:.0%}") for r, v, low, high in rows],
    )
    printing.say_notices(table.notices)
    printing.say("What voltages alone do not show:")
    for text in UNKNOWN:
        printing.say(f"- {text}")
    printing.say(f"table written to {arguments.output}")


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
    printing.record_table(f"{found.model!r}", found.own_logs, *OWN_COLUMNS)
    known = {k: v for k, v in found.model.validity.to_dict().items() if v is not None}
    printing.say(
        "valid for " + ", ".join(f"{k} {v[0]:.3g} to {v[1]:.3g}" for k, v in known.items())
    )
    # Where the logs begin stands in the table.
    above = (*found.contradictions, *start_notices(found.own_logs))
    printing.say_notices(n for n in found.notices if n not in above)
    printing.say(f"{found.seconds:.1f} s")

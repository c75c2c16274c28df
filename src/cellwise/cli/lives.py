"""cellwise history."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cellwise.cli.common import log_options, options, page_options, printing

if TYPE_CHECKING:
    from cellwise.history.life import Life


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the command that follows a cell over its life."""
    history = commands.add_parser("history", help="a cell's logs in order to its ageing")
    options.add_model(history, scalable=True)
    history.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help="of one cell, in the order of time; a folder or a pattern",
    )
    history.add_argument("-o", "--output", metavar="OUT", help="logs as .csv, .csv.gz or .parquet")
    text = "write the model as the cell is now, for every command"
    history.add_argument("--save-model", metavar="MODEL", help=text)
    options.flag(history, "--anyway", "capacity and resistance by logs far off the model, too")
    log_options.add_log_options(history)
    page_options.add_page_options(history)
    options.add_json(history)
    history.set_defaults(run=run_history)


def run_history(arguments: argparse.Namespace) -> None:
    """Follow a cell over its life."""
    from cellwise.cell.model_file import write_model
    from cellwise.history.life import life_of
    from cellwise.logs.writing import write_columns
    from cellwise.report import history_page

    options.check_places(arguments.output, arguments.save_model)
    page_options.check_page_options(arguments)
    model = options.read_model(arguments)
    logs = log_options.read_cut(arguments.logs, arguments)
    with printing.working("comparing"):
        found = life_of(model, logs, anyway=arguments.anyway)
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.save_model and found.withheld:
        printing.warn("cellwise history: no model was written: all logs are far off the one given")
    elif arguments.save_model:
        write_model(found.aged_model, arguments.save_model)
    page_options.hand_over(arguments, found, history_page, print_life)


def print_life(found: Life) -> None:
    """A life for people."""
    data = found.to_dict()
    printing.say_notices(found.far_off)
    printing.record_table(
        f"{len(data['logs'])} logs over {found.way[-1]:.0f} {found.over}",
        zip(data["logs"], found.trend.share, found.trend.std, strict=True),
        ("log", lambda o: o[0]["log"]),
        ("capacity Ah", lambda o: _with_band(o[0]["capacity_Ah"], o[0]["capacity_std_Ah"])),
        ("resistance", lambda o: _with_band(o[0]["resistance_scale"], o[0]["resistance_std"])),
        ("trend %", lambda o: _with_band(100 * float(o[1]), 100 * float(o[2]), 1)),
        ("by", lambda o: o[0]["how"]),
    )
    trend, use = data["trend"], data["trend"]["use"]
    if not found.withheld:
        printing.say(
            f"use now: {use['capacity_Ah']:.3f} +- {2 * use['capacity_std_Ah']:.3f} Ah, resistance "
            f"{use['resistance_scale']:.2f} +- {2 * use['resistance_std']:.2f} of the model's"
        )
    if trend["knee"] is not None:
        printing.say(f"the fade is faster from '{trend['knee']}' on")
    printing.say(f"next reference test: {trend['next_reference']}")
    notices = (*data["notices"], *(n for o in data["logs"] for n in o["notices"]))
    printing.say_notices(n for n in notices if n not in found.far_off)


def _with_band(value: float, std: float, digits: int = 3) -> str:
    return "-" if value != value else f"{value:.{digits}f} +- {2 * std:.{digits}f}"

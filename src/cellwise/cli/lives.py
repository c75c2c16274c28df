"""cellwise history."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cellwise.cli.common import log_options, model_options, page_options, printing

if TYPE_CHECKING:
    from cellwise.history.life import Life


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command that follows a cell over its life."""
    history = commands.add_parser("history", help="a cell's logs in order to its ageing")
    model_options.add_model(history, scalable=True)
    history.add_argument("logs", nargs="+", metavar="LOG", help="of one cell, in the order of time")
    history.add_argument("-o", "--output", metavar="OUT", help="logs as .csv, .csv.gz or .parquet")
    history.add_argument(
        "--save-model",
        metavar="MODEL",
        help="write the model as the cell is now, for every command",
    )
    log_options.add_log_options(history)
    page_options.add_page_options(history)
    printing.add_json(history)
    history.set_defaults(run=run_history)


def run_history(arguments: argparse.Namespace) -> None:
    """Follow a cell over its life."""
    from cellwise.cell.model_file import write_model
    from cellwise.history.life import life_of
    from cellwise.logs.writing import write_columns
    from cellwise.report import history_page

    printing.check_places(arguments.output, arguments.save_model)
    page_options.check_page_options(arguments)
    model = model_options.read(arguments)
    with printing.bar() as progress:
        task = progress.add_task("reading", total=len(arguments.logs))
        logs = []
        for path in arguments.logs:
            logs.append(log_options.read(path, arguments))
            progress.advance(task)
        progress.add_task("comparing", total=None)
        found = life_of(model, logs)
    if arguments.output:
        write_columns(found.columns(), Path(arguments.output))
    if arguments.save_model:
        write_model(found.aged_model, arguments.save_model)
    page_options.hand_over(arguments, found, history_page, print_life)


def print_life(found: Life) -> None:
    """A life for people."""
    data = found.to_dict()
    rows = [
        (
            one["log"],
            f"{one['capacity_Ah']:.3f} +- {2 * one['capacity_std_Ah']:.3f}",
            f"{one['resistance_scale']:.3f} +- {2 * one['resistance_std']:.3f}",
            f"{printing.percent(share, 1)} +- {printing.percent(2 * std, 1)}",
            one["how"],
        )
        for one, share, std in zip(data["logs"], found.trend.share, found.trend.std, strict=True)
    ]
    printing.table(
        f"{len(rows)} logs over {found.way[-1]:.0f} {found.over}",
        ("log", "capacity Ah", "resistance", "trend %", "by"),
        rows,
    )
    trend, use = data["trend"], data["trend"]["use"]
    printing.say(
        f"use now: {use['capacity_Ah']:.3f} +- {2 * use['capacity_std_Ah']:.3f} Ah, resistance "
        f"{use['resistance_scale']:.2f} +- {2 * use['resistance_std']:.2f} of the model's"
    )
    if trend["knee"] is not None:
        printing.say(f"the fade is faster from '{trend['knee']}' on")
    printing.say(f"next reference test: {trend['next_reference']}")
    for notice in dict.fromkeys(
        (*data["notices"], *(n for o in data["logs"] for n in o["notices"]))
    ):
        printing.say(f"  ! {notice}")

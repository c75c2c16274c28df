"""cellwise inspect, cellwise convert."""

from __future__ import annotations

import argparse
from typing import Any

from cellwise.cli.common import log_options, options, printing


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands that look at logs."""
    inspect = commands.add_parser("inspect", help="say what is in a log")
    convert = commands.add_parser("convert", help="write a log in the tidy form")
    convert.add_argument("-o", "--output", required=True, metavar="OUT")
    for command, run in ((inspect, run_inspect), (convert, run_convert)):
        log_options.add_log(command)
        options.add_json(command)
        command.set_defaults(run=run)


def run_inspect(arguments: argparse.Namespace) -> None:
    """Print what is in a log."""
    from cellwise.logs import inspect_log

    found = inspect_log(log_options.read(arguments.log, arguments)).to_dict()
    if arguments.json:
        printing.print_json(found)
        return
    print_inspection(found)


def run_convert(arguments: argparse.Namespace) -> None:
    """Write a log in the tidy form."""
    from cellwise.logs import write_log

    options.check_places(arguments.output)
    log = log_options.read(arguments.log, arguments)
    if log.soc0 is not None:
        said = f"the file has no place for the stated start: write LOG@soc0={log.soc0:g} behind it"
        log = log.with_notices((*log.notices, said))
    path = write_log(log, arguments.output)
    if arguments.json:
        printing.print_json({"output": str(path), "samples": len(log), "notices": log.notices})
        return
    printing.say(f"{len(log)} rows written to {path}")
    printing.say_notices(log.notices)


def print_inspection(found: dict[str, Any]) -> None:
    """An inspection for people."""

    def span(key: str, unit: str) -> str:
        value = found[key]
        return "not measured" if value is None else f"{value['min']:g} to {value['max']:g} {unit}"

    sampling = found["sampling"]
    rows = [
        ("format", str(found["format"])),
        ("samples", f"{found['samples']:,}"),
        ("duration", f"{found['duration_s'] / 3600:.3f} h"),
        ("interval", f"{sampling['median_s']:g} s median, {sampling['max_s']:g} s longest"),
        ("current", span("current_A", "A")),
        ("voltage", span("voltage_V", "V")),
        ("temperature", span("temperature_C", "degC")),
        ("net charge out", f"{found['charge_Ah']:.4f} Ah"),
        ("sign (positive = discharge)", str(found["sign"])),
        ("rests", str(len(found["rests"]))),
        ("gaps", str(len(found["gaps"]))),
        ("repeated stamps", str(found["duplicates"])),
    ]
    if found["soc0"] is not None:
        rows.append(("initial SOC", f"{found['soc0']:g}, as stated"))
    if found["counter_mismatch_percent"] is not None:
        rows.append(("counter against current", f"{found['counter_mismatch_percent']:.3f} %"))
    printing.table(str(found["name"]), ("what", "found"), rows)
    for gap in found["gaps"]:
        printing.say(f"  gap of {gap['duration_s']:.0f} s after {gap['start_s']:.0f} s")
    printing.say_notices(found["notices"])

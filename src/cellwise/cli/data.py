"""cellwise inspect, convert; data list, generate, fetch, import."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from cellwise.cli.common import log_options, options, printing


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands about logs as they are, and about data sets."""
    inspect = commands.add_parser("inspect", help="say what is in a log")
    convert = commands.add_parser("convert", help="write a log in the tidy form")
    data = commands.add_parser("data", help="embedded data sets and public originals")
    actions = data.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="what there is, with DOI and licence")
    text = "generate the embedded data again (needs PyBaMM)"
    generate = actions.add_parser("generate", help=text)
    fetch = actions.add_parser("fetch", help="download a public original, checksums verified")
    bring = actions.add_parser("import", help="a downloaded original to tidy parquet")
    for command in (inspect, convert):
        log_options.add_log(command)
    for command in (fetch, bring):
        command.add_argument("name", metavar="NAME", help="as in `cellwise data list`")
    bring.add_argument("source", metavar="SOURCE", help="folder or zip archive as downloaded")
    text = "list of files with checksums [the registry's]"
    fetch.add_argument("--listing", metavar="URL", help=text)
    options.several(generate, "--only", "NAME", "a test or a cell", default=None)
    for command, place in ((convert, "OUT"), (generate, "DIR"), (fetch, "DIR"), (bring, "DIR")):
        command.add_argument("-o", "--output", required=True, metavar=place)
    runs = {inspect: run_inspect, convert: run_convert, listing: run_list,
            generate: run_generate, fetch: run_fetch, bring: run_import}  # fmt: skip
    for command, run in runs.items():
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


def run_list(arguments: argparse.Namespace) -> None:
    """Print the stock models, the embedded data sets and the registry."""
    from cellwise.cell.stock import list_stock
    from cellwise.data import datasets_folder, list_datasets, list_originals

    embedded, originals, stock = list_datasets(), list_originals(), list_stock()
    if arguments.json:
        found = {"embedded": embedded, "originals": originals, "stock": stock}
        printing.print_json({"folder": str(datasets_folder()), **found})
        return
    printing.record_table(
        "stock models: names for --model and --prior",
        stock,
        ("name", lambda s: s["name"]),
        ("cell", lambda s: s["cell"]),
        ("Ah", lambda s: f"{s['capacity_Ah']:.3g}"),
        ("V", lambda s: "{:g} to {:g}".format(*s["window_V"])),
        ("degC", lambda s: "{:g} to {:g}".format(*s["validity"]["temperature_C"])),
        ("OCV +- mV", lambda s: f"{1e3 * s['spread']['ocv_V']:.0f}"),
        ("R times or /", lambda s: f"{math.exp(s['spread']['ln_resistance']):.2g}"),
        ("licence of the data", lambda s: s["source"]["licence"]),
    )
    printing.record_table(
        f"embedded data in {datasets_folder()}",
        embedded,
        ("name", lambda e: e["name"]),
        ("cell", lambda e: e["cell"]),
        ("kind", lambda e: e["kind"]),
        ("degC", lambda e: f"{e['temperature_C']:g}"),
        ("rows", lambda e: f"{e['rows']:,}"),
        ("kB", lambda e: f"{e['bytes'] / 1000:.0f}"),
    )
    printing.record_table(
        "public originals (not part of cellwise)",
        originals,
        ("name", lambda o: o["name"]),
        ("cell", lambda o: o["cell"]),
        ("Ah", lambda o: f"{o.get('nominal_Ah', 0):g}"),
        ("DOI", lambda o: o.get("doi") or "-"),
        ("licence as its source states it", lambda o: o["licence"]),
    )


def run_generate(arguments: argparse.Namespace) -> None:
    """Generate data sets."""
    from cellwise.data import generate_datasets

    with printing.working("generate") as follow:
        written = generate_datasets(Path(arguments.output), arguments.only, follow)
    if arguments.json:
        printing.print_json({"written": [str(path) for path in written]})
        return
    for path in written:
        printing.say(str(path))


def run_fetch(arguments: argparse.Namespace) -> None:
    """Fetch a public original."""
    from cellwise.datasets import fetch_dataset

    with printing.working("fetch") as follow:
        files = fetch_dataset(arguments.name, arguments.output, arguments.listing, follow)
    if arguments.json:
        printing.print_json({"files": [str(path) for path in files]})
        return
    printing.say(f"{len(files)} file(s) in {arguments.output}, every checksum right")


def run_import(arguments: argparse.Namespace) -> None:
    """Import a public original."""
    from cellwise.datasets import import_dataset

    with printing.working("import") as follow:
        found = import_dataset(arguments.name, arguments.source, arguments.output, follow)
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    printing.record_table(
        f"{len(found.entries)} log(s) in {found.folder}",
        found.entries,
        ("name", lambda e: e["name"]),
        ("kind", lambda e: e["kind"]),
        ("degC", lambda e: "-" if e["temperature_C"] is None else f"{e['temperature_C']:g}"),
        ("rows", lambda e: f"{e['rows']:,}"),
        ("format", lambda e: e["format"]),
    )
    for name, reason in found.left_out:
        printing.say(f"  ! {name} left out: {reason}")

"""cellwise data list, generate, fetch, import."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from cellwise.cli.common import options, printing


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add the commands about data sets."""
    data = commands.add_parser("data", help="embedded data sets and public originals")
    actions = data.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="what there is, with DOI and licence")
    options.add_json(listing)
    listing.set_defaults(run=run_list)
    text = "generate the embedded data again (needs PyBaMM)"
    generate = actions.add_parser("generate", help=text)
    generate.add_argument("-o", "--output", required=True, metavar="DIR")
    options.several(generate, "--only", "NAME", "a test or a cell", default=None)
    options.add_json(generate)
    generate.set_defaults(run=run_generate)
    fetch = actions.add_parser("fetch", help="download a public original, checksums verified")
    fetch.add_argument("name", metavar="NAME", help="as in `cellwise data list`")
    fetch.add_argument("-o", "--output", required=True, metavar="DIR")
    text = "list of files with checksums [the registry's]"
    fetch.add_argument("--listing", metavar="URL", help=text)
    options.add_json(fetch)
    fetch.set_defaults(run=run_fetch)
    bring = actions.add_parser("import", help="a downloaded original to tidy parquet")
    bring.add_argument("name", metavar="NAME", help="as in `cellwise data list`")
    bring.add_argument("source", metavar="SOURCE", help="folder or zip archive as downloaded")
    bring.add_argument("-o", "--output", required=True, metavar="DIR")
    options.add_json(bring)
    bring.set_defaults(run=run_import)


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

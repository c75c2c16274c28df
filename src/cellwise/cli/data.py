"""cellwise data list, generate, fetch, import."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cellwise.cli.common import printing


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands about data sets."""
    data = commands.add_parser("data", help="embedded data sets and public originals")
    actions = data.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="what there is, with DOI and licence")
    printing.add_json(listing)
    listing.set_defaults(run=run_list)
    generate = actions.add_parser(
        "generate", help="generate the embedded data again (needs PyBaMM)"
    )
    generate.add_argument("-o", "--output", required=True, metavar="DIR")
    generate.add_argument("--only", action="append", metavar="NAME", help="a test or a cell")
    printing.add_json(generate)
    generate.set_defaults(run=run_generate)
    fetch = actions.add_parser("fetch", help="download a public original, checksums verified")
    fetch.add_argument("name", metavar="NAME", help="as in `cellwise data list`")
    fetch.add_argument("-o", "--output", required=True, metavar="DIR")
    fetch.add_argument(
        "--listing", metavar="URL", help="list of files with checksums [the registry's]"
    )
    printing.add_json(fetch)
    fetch.set_defaults(run=run_fetch)
    bring = actions.add_parser("import", help="a downloaded original to tidy parquet")
    bring.add_argument("name", metavar="NAME", help="as in `cellwise data list`")
    bring.add_argument("source", metavar="SOURCE", help="folder or zip archive as downloaded")
    bring.add_argument("-o", "--output", required=True, metavar="DIR")
    printing.add_json(bring)
    bring.set_defaults(run=run_import)


def run_list(arguments: argparse.Namespace) -> None:
    """Print the stock models, the embedded data sets and the registry."""
    from cellwise.cell.stock.catalogue import list_stock
    from cellwise.data import datasets_folder, list_datasets, list_originals

    embedded, originals, stock = list_datasets(), list_originals(), list_stock()
    if arguments.json:
        printing.print_json(
            {
                "folder": str(datasets_folder()),
                "embedded": embedded,
                "originals": originals,
                "stock": stock,
            }
        )
        return
    printing.table(
        "stock models: names for --model and --prior",
        ("name", "cell", "Ah", "V", "degC", "OCV +- mV", "R times or /", "licence of the data"),
        [
            (
                s["name"],
                s["cell"],
                f"{s['capacity_Ah']:.3g}",
                "{:g} to {:g}".format(*s["window_V"]),
                "{:g} to {:g}".format(*s["validity"]["temperature_C"]),
                f"{1e3 * s['spread']['ocv_V']:.0f}",
                f"{math.exp(s['spread']['ln_resistance']):.2g}",
                s["source"]["licence"],
            )
            for s in stock
        ],
    )
    printing.table(
        f"embedded data in {datasets_folder()}",
        ("name", "cell", "kind", "degC", "rows", "kB"),
        [
            (
                e["name"],
                e["cell"],
                e["kind"],
                f"{e['temperature_C']:g}",
                f"{e['rows']:,}",
                f"{e['bytes'] / 1000:.0f}",
            )
            for e in embedded
        ],
    )
    printing.table(
        "public originals (not part of cellwise)",
        ("name", "cell", "Ah", "DOI", "licence as its source states it"),
        [
            (
                o["name"],
                o["cell"],
                f"{o.get('nominal_Ah', 0):g}",
                o.get("doi") or "-",
                o["licence"],
            )
            for o in originals
        ],
    )


@contextmanager
def _followed(what: str) -> Iterator[Callable[[str, int, int | None], None]]:
    """A bar, and what moves it: the item at work, how much is done, of how much."""
    with printing.bar() as progress:
        task = progress.add_task(what, total=None)

        def follow(name: str, done: int, total: int | None) -> None:
            progress.update(task, description=name, completed=done, total=total)

        yield follow


def run_generate(arguments: argparse.Namespace) -> None:
    """Generate data sets."""
    from cellwise.data import generate_datasets

    with _followed("generate") as follow:
        written = generate_datasets(
            Path(arguments.output),
            arguments.only,
            follow,
        )
    if arguments.json:
        printing.print_json({"written": [str(path) for path in written]})
        return
    for path in written:
        printing.say(str(path))


def run_fetch(arguments: argparse.Namespace) -> None:
    """Fetch a public original."""
    from cellwise.datasets import fetch_dataset

    with _followed("fetch") as follow:
        files = fetch_dataset(
            arguments.name,
            arguments.output,
            arguments.listing,
            follow,
        )
    if arguments.json:
        printing.print_json({"files": [str(path) for path in files]})
        return
    printing.say(f"{len(files)} file(s) in {arguments.output}, every checksum right")


def run_import(arguments: argparse.Namespace) -> None:
    """Import a public original."""
    from cellwise.datasets import import_dataset

    with _followed("import") as follow:
        found = import_dataset(
            arguments.name,
            arguments.source,
            arguments.output,
            follow,
        )
    if arguments.json:
        printing.print_json(found.to_dict())
        return
    printing.table(
        f"{len(found.entries)} log(s) in {found.folder}",
        ("name", "kind", "degC", "rows", "format"),
        [
            (
                e["name"],
                e["kind"],
                "-" if e["temperature_C"] is None else f"{e['temperature_C']:g}",
                f"{e['rows']:,}",
                e["format"],
            )
            for e in found.entries
        ],
    )
    for name, reason in found.left_out:
        printing.say(f"  ! {name} left out: {reason}")

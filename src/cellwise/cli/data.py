"""cellwise data list, cellwise data generate."""

from __future__ import annotations

import argparse
from pathlib import Path

from cellwise.cli import printing


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the commands about data sets."""
    data = commands.add_parser("data", help="embedded data sets and public originals")
    actions = data.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="what there is, with DOI and licence")
    printing.add_json(listing)
    listing.set_defaults(run=run_list)
    generate = actions.add_parser("generate", help="make the embedded data anew (needs PyBaMM)")
    generate.add_argument("-o", "--output", required=True, metavar="DIR")
    generate.add_argument("--only", action="append", metavar="NAME", help="a test or a cell")
    printing.add_json(generate)
    generate.set_defaults(run=run_generate)


def run_list(arguments: argparse.Namespace) -> None:
    """Print the embedded data sets and the registry."""
    from cellwise.data import datasets_folder, list_datasets, list_originals

    embedded, originals = list_datasets(), list_originals()
    if arguments.json:
        printing.print_json(
            {"folder": str(datasets_folder()), "embedded": embedded, "originals": originals}
        )
        return
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


def run_generate(arguments: argparse.Namespace) -> None:
    """Generate data sets."""
    from cellwise.data import generate_datasets

    with printing.bar() as progress:
        task = progress.add_task("generate", total=None)
        written = generate_datasets(
            Path(arguments.output),
            arguments.only,
            lambda name, done, total: progress.update(
                task, description=name, completed=done, total=total
            ),
        )
    if arguments.json:
        printing.print_json({"written": [str(path) for path in written]})
        return
    for path in written:
        printing.say(str(path))

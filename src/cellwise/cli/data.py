"""Logs as they are, and data sets.

cellwise inspect: say what is in a log
    requires a log; a text needs columns with units, native files need nothing
    $ inspect drive.csv
    $ inspect flight.bin --series 4
<log>
<log options>

cellwise convert: write a log in the tidy form
    requires a log, and where to write it (.csv, .csv.gz or .parquet)
    $ convert cycler.mpt -o test.csv
    $ convert bms.csv --channel current_mA=I_pack -o drive.parquet
<log>
    -o, --output OUT!  the file
<log options>

cellwise data: embedded data sets and public originals

cellwise data list: what there is, with DOI and licence
    requires nothing
    $ data list
    $ data list --json

cellwise data generate: generate the embedded data again (needs PyBaMM)
    requires the extra 'generate' (PyBaMM) and a new folder
    $ data generate -o made
    $ data generate -o made --json
    --only NAME...  a test or a cell
    -o, --output DIR!  the folder

cellwise data fetch: download a public original, checksums verified
    requires the name of a registered set, a folder and a network
    $ data fetch panasonic_18650pf -o originals
    $ data fetch nissan_leaf -o originals --json
    NAME  as in `cellwise data list`
    --listing URL  list of files with checksums [the registry's]
    -o, --output DIR!  the folder

cellwise data import: a downloaded original to tidy parquet
    requires the name of a registered set and the folder of its originals
    $ data import panasonic_18650pf originals -o tidy
    $ data import nissan_leaf originals -o tidy --json
    NAME  as in `cellwise data list`
    SOURCE  folder or zip archive as downloaded
    -o, --output DIR!  the folder
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from cellwise.cli.common import log_options, options, printing
from cellwise.data import datasets_folder, generate_datasets, list_datasets, list_originals
from cellwise.datasets import fetch_dataset, import_dataset
from cellwise.logs import inspect_log, write_log
from cellwise.notices import Code, Notice


def run_inspect(arguments: argparse.Namespace) -> None:
    """Print what is in a log."""
    found = inspect_log(log_options.read(arguments.log, arguments))
    if arguments.json:
        printing.print_json({**found.to_dict(), "notices": printing.rendered(found.notices)})
        return
    print_inspection(found.to_dict())
    printing.say_notices(found.notices)


def run_convert(arguments: argparse.Namespace) -> None:
    """Write a log in the tidy form."""
    options.check_places(arguments.output)
    log = log_options.read(arguments.log, arguments)
    if log.soc0 is not None:
        text = f"the file has no place for the stated start: write LOG@soc0={log.soc0:g} behind it"
        log = log.with_notices((*log.notices, Notice(Code.START_NOT_WRITTEN, text)))
    path = write_log(log, arguments.output)
    if arguments.json:
        said = printing.rendered(log.notices)
        printing.print_json({"output": str(path), "samples": len(log), "notices": said})
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


def run_list(arguments: argparse.Namespace) -> None:
    """Print the stock models, the embedded data sets and the registry."""
    from cellwise.cell.stock import list_stock  # waits for a compiler

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
    with printing.working("generate") as follow:
        written = generate_datasets(Path(arguments.output), arguments.only or None, follow)
    if arguments.json:
        printing.print_json({"written": [str(path) for path in written]})
        return
    for path in written:
        printing.say(str(path))


def run_fetch(arguments: argparse.Namespace) -> None:
    """Fetch a public original."""
    with printing.working("fetch") as follow:
        files = fetch_dataset(arguments.name, arguments.output, arguments.listing, follow)
    if arguments.json:
        printing.print_json({"files": [str(path) for path in files]})
        return
    printing.say(f"{len(files)} file(s) in {arguments.output}, every checksum right")


def run_import(arguments: argparse.Namespace) -> None:
    """Import a public original."""
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

"""cellwise certify."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import options, printing

if TYPE_CHECKING:
    from cellwise.certify import Certificate

JSON_FILE, PAGE_FILE = "certificate.json", "index.html"
BEYOND = 1  # exit code where a limit is not kept


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add ``cellwise certify``."""
    certify = commands.add_parser(
        "certify", help="an exported filter over a virtual fleet: how wrong it will be, and where"
    )
    certify.add_argument("export", metavar="EXPORT", help="folder that `cellwise export` wrote")
    text = "that was exported [the one in the folder]"
    certify.add_argument("--model", metavar="MODEL", help=text)
    options.count(certify, "--cells", "N", "cells [200]", default=200)
    options.number(certify, "--hours", "H", "hours of each [100]", default=100.0)
    text = "what the target's sensors are off by, as TOML [as vehicles have them]"
    certify.add_argument("--sensor", metavar="F.toml", help=text)
    options.count(certify, "--seed", "N", "of all that is drawn [1]", default=1)
    options.number(certify, "--most-rmse", "X", "limit of the SOC error, RMS (0.03: three points)")
    options.number(certify, "--most-p95", "X", "limit of the SOC error in 95 % of the time")
    options.number(certify, "--most-worst", "X", "limit of the worst SOC error")
    options.number(certify, "--least-coverage", "X", "limit of the time within two deviations")
    text = "for the certificate, its page and finished cells; a run goes on there"
    certify.add_argument("-o", "--output", metavar="DIR", help=text)
    options.add_json(certify)
    certify.set_defaults(run=run_certify)


def run_certify(arguments: argparse.Namespace) -> None:
    """Run the exported C over cells that vary and age; exit 1 beyond a stated limit."""
    from cellwise.cell.model_file import read_model
    from cellwise.certify import Limits, certify, read_export, read_sensor
    from cellwise.files import write_atomically
    from cellwise.report.certificate_page import certificate_page

    limits = Limits(
        arguments.most_rmse, arguments.most_p95, arguments.most_worst, arguments.least_coverage
    )
    sensor = None if arguments.sensor is None else read_sensor(arguments.sensor)
    model = None if arguments.model is None else read_model(arguments.model)
    exported = read_export(arguments.export, model)
    with printing.working("cells") as follow:
        found = certify(
            exported,
            arguments.cells,
            arguments.hours,
            sensor=sensor,
            seed=arguments.seed,
            limits=limits,
            folder=arguments.output,
            follow=lambda done, of: follow(f"cell {done} of {of}", done, of),
        )
    data = found.to_dict()
    if arguments.output is not None:
        place = Path(arguments.output)
        text = json.dumps(printing.clean(data), indent=1, allow_nan=False) + "\n"
        write_atomically(place / JSON_FILE, text)
        certificate_page(data, exported.description["model"], place / PAGE_FILE)
    if arguments.json:
        printing.print_json(data)
    else:
        print_certificate(found, data, arguments.output)
    if found.beyond:
        sys.stdout.flush()
        raise SystemExit(BEYOND)


def print_certificate(found: Certificate, data: dict[str, Any], folder: str | None) -> None:
    """The certificate for people: whole, by what, verdict."""
    percent = printing.percent
    printing.say(repr(found))
    printing.say(
        f"{percent(data['discharges_within_3_points'], 1)} % of {data['discharges']} discharges "
        "end within three points of SOC"
    )
    for name, groups in data["by"].items():
        printing.record_table(
            f"by {name}",
            list(groups.items()),
            (name, lambda g: g[0]),
            ("cells", lambda g: str(g[1]["cells"])),
            ("RMSE %", lambda g: percent(g[1]["rmse"])),
            ("95 % of the time below %", lambda g: percent(g[1]["p95"], 1)),
            ("worst %", lambda g: percent(g[1]["worst"], 1)),
            ("within two deviations %", lambda g: percent(g[1]["coverage"], 0)),
        )
    printing.say("The cells are the exported model, varied and aged: none is measured or physics.")
    if data["verdict"]["limits"]:
        beyond = data["verdict"]["beyond"]
        printing.say("BEYOND: " + "; ".join(beyond) if beyond else "within every stated limit")
    if folder is not None:
        printing.say(f"{Path(folder) / PAGE_FILE}")

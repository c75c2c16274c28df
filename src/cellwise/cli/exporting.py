"""A model as C sources, and as what other programs take: FMU, page, PyBaMM, DBC.

cellwise export: model to C sources and other programs' formats
    requires a model, the sample time of the target and a new folder
    $ export --model cell.json --dt 1 -o firmware
    $ export --model cell.json --dt 0.1 -o firmware --log drive.csv --report cost.html
<model>
    --dt S  time step [s]
    -o, --output DIR  folder of C sources
    --layout cmake|zephyr|platformio|arduino|esp-idf|foxbms|px4|ardupilot  arrange the folder of -o
        as a module of this tree
    --fmu OUT.fmu  FMI 3.0 co-simulation, with a binary for this machine
    --page OUT.html  a page that estimates in the browser [--dt 1]
    --pybamm OUT.py  parameters of PyBaMM's Thevenin model, or its JSON of them: OUT.json
    --submission OUT.py  Model(X, z) -> (soc, z) for benches, in NumPy alone; OUT.m: in MATLAB
    --can OUT.dbc  SOC, band, power, remaining time: a DBC, and C that packs
    --what estimator|cell|table  of --fmu: the estimator, or the cell alone [estimator]; table: the
        model is a table of `cellwise identify --voltage-only`, written in C, CSV, JSON and as
        Zephyr, Meshtastic and ESPHome take it
    --points N  SOC points [as few of 51, 101, 201 as the model's stated error allows]
    --lean  smaller code, slower from a start far off, no watch for frozen or lost sensors
    --offset  ask rests and voltages whether the current is off all the time, as `replay` does
    --sketch N  keep sums of the residual for `diagnose --sketch`, in N bytes at most, say 1024
    --without EFFECT...  leave out an effect of the model, e.g. the laboratory's time_skew; several
    --sensor F.toml  what the target's sensors are off by, as TOML [a car's]
    --noise NAME=X...  of the filter, e.g. gap_soc=0.2; several [the model's, with the sensors']
    --prefix NAME  of every file and name, for several models
    --power S  state of power: held for S seconds, 10 say
<limits>
    --remaining V  time and energy left down to V volts per cell
    --cells N=0  follow N cells in series, on one table
    --health  take capacity and resistance from `cellwise history` without a new export
    --soh  estimate on the target capacity and resistance, at the ends of long rests
    --log LOG  accuracy lost, against the float64 EKF
    --soc0 X  SOC at the log's start [auto]
<page>
<log options>
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.errors import InputError
from cellwise.estimate.fixed.options import Asked, CellSettings
from cellwise.estimate.noise import Noise
from cellwise.estimate.sensor import assumed_text
from cellwise.export.package import Export
from cellwise.logs import CellLog
from cellwise.report.export_page import ACCURACY_COLUMNS, cost_rows, export_page
from cellwise.workflows.exporting import (
    FORMATS,
    ExportedFirmware,
    check_export,
    export_firmware,
    export_voltage_table,
    firmware_of,
    without_effects,
)

OF_FOLDER = ("layout", "report", "figures", "log")  # options that the others ignore
STEPPED = (
    "output",
    "fmu",
    "submission",
)  # outputs that hold for one time step, which must be stated


def run_export(arguments: argparse.Namespace) -> None:
    """Write the C of a model and say what it costs."""
    if arguments.what == "table":
        run_table(arguments)
        return
    page_options.check_page_options(arguments)
    check(arguments)
    model = without_effects(options.read_model(arguments), arguments.without)
    export = export_of(model, arguments)
    log = read(export.model, arguments)
    with printing.working("export") as follow:
        found = export_firmware(
            export,
            arguments.output,
            log,
            soc0=arguments.soc0,
            formats=formats_of(arguments),
            follow=follow,
        )
    if arguments.output:
        write_pages(found, arguments)
    report = found.report
    if arguments.json:
        printing.print_json(report)
        return
    if arguments.output:
        print_export(arguments.output, report)
        page_options.say_pages(arguments)
    printing.say_notices(found.notices)
    for place in report["sockets"].values():
        printing.say(f"written: {place}")


def run_table(arguments: argparse.Namespace) -> None:
    """Write a table of remaining time in every form."""
    said = vars(arguments)
    others = [name for name in (*FORMATS, "dt", *OF_FOLDER) if said[name] is not None]
    if others or not arguments.output:
        found = f"--what table with --{others[0]}" if others else "--what table without -o"
        raise InputError(found, "--model TABLE -o DIR, and no more", "Correct it.")
    written = export_voltage_table(arguments.model, arguments.output)
    if arguments.json:
        printing.print_json({"files": list(written), "sources": written})
        return
    for name, place in written.items():
        printing.say(f"written: {arguments.output}/{name}" + (f", as {place}" if place else ""))


def export_of(model: CellModel, arguments: argparse.Namespace) -> Export:
    """What the arguments ask to export."""
    return firmware_of(
        model,
        arguments.dt,
        Asked(
            points=arguments.points,
            wide=not arguments.lean,
            power=forecast_options.power_of(arguments, model, "current"),
            remaining_V=arguments.remaining,
            health=arguments.health,
            cells=CellSettings() if arguments.cells else None,
            offset=arguments.offset,
            soh=arguments.soh,
            sketch=arguments.sketch or 0,
        ),
        noise=noise_of(arguments.noise),
        sensor=options.sensor_of(arguments),
        cells=arguments.cells,
        prefix=arguments.prefix or "",
        layout=arguments.layout,
        what=arguments.what or "estimator",
    )


def formats_of(arguments: argparse.Namespace) -> dict[str, str]:
    """The formats that are wanted beside the folder, each with its file."""
    return {name: place for name in FORMATS if (place := getattr(arguments, name))}


def check(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        nothing to write; no time step; a suffix of another format; no place; a
                      package or a compiler that is missing
    """
    said = vars(arguments)
    wanted = [name for name in ("output", *FORMATS) if said[name]]
    if not wanted:
        known = ", ".join(f"--{name}" for name in FORMATS)
        raise InputError("nothing to write", f"-o DIR or one of {known}", "Add -o DIR.")
    if arguments.dt is None and any(name in STEPPED for name in wanted):
        raise InputError(
            "no time step", "--dt S, the seconds from one sample to the next", "Add --dt 1, say."
        )
    for name in OF_FOLDER:
        if said[name] and not arguments.output:
            raise InputError(f"--{name} without -o", "a folder of C sources", "Add -o DIR.")
    if arguments.what and not arguments.fmu:
        raise InputError("--what without --fmu", "an FMU to write", "Add --fmu OUT.fmu.")
    check_export(arguments.output, formats_of(arguments))


def noise_of(stated: list[str]) -> dict[str, float]:
    """The fields of `Noise` that are stated, with their values.

    Raises
    ------
    InputError        no NAME=X, a name that is none
    """
    names = [f.name for f in fields(Noise)]
    values: dict[str, float] = {}
    for text in stated:
        name, equals, number = text.partition("=")
        try:
            values[name] = int(number) if name == "recovery_after" else float(number)
        except ValueError:
            equals = ""
        if not equals or name not in names:
            raise InputError(
                f"--noise {text}",
                f"NAME=X with one of {', '.join(names)}",
                "Write e.g. --noise voltage_V=0.005.",
            )
    return values


def write_pages(found: ExportedFirmware, arguments: argparse.Namespace) -> None:
    """The page and its pictures, where they are wanted."""
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            export_page(found.report, pages.page, found.own_run, figures=pages.figures)


def read(model: CellModel, arguments: argparse.Namespace) -> CellLog | None:
    """The log to measure on, None where none is named."""
    if arguments.log is None:
        return None
    options.check_fraction("--soc0", arguments.soc0)
    log = log_options.read(arguments.log, arguments)
    check_cells_in_series(model, log)
    return log


def print_export(folder: str, report: dict[str, Any]) -> None:
    """What was written, for people."""
    options_of, cells = report["options"], report["cells"]
    on = [k for k, v in options_of.items() if v and k not in ("points", "temperatures")]
    rows = {
        "model": f"{report['model'] or 'unnamed'}, sha256 {report['model_sha256'][:16]}...",
        "SOC points x temperatures": f"{options_of['points']} x {options_of['temperatures']}",
        "states": str(report["states"]),
        "compiled in": ", ".join(on) or "nothing beyond the plain model",
        "tables in flash": f"{report['model_bytes']:,} bytes",
        "state per cell": f"{report['state_bytes']} bytes",
    }
    if cells:
        rows["state of a pack"] = f"{report['pack_bytes']:,} bytes for {cells} cells"
    title = f"{folder}: {len(report['files'])} files for a step of {report['dt_s']:g} s"
    printing.table(title, ("what", "value"), list(rows.items()))
    printing.say(report["soc_grid"]["text"])
    if report["sensor"]["by_default"]:
        printing.say(assumed_text(report["sensor"]))
    if report["targets"]:
        about = "Cost on the target (instructions, not cycles; counted in QEMU)"
        printing.table(about, *cost_rows(report["targets"]))
    else:
        printing.say("no cross compiler: code size, stack and instructions are not known")
    if report["accuracy"]:
        about = "SOC against the float64 EKF on the log"
        printing.record_table(about, report["accuracy"], *ACCURACY_COLUMNS)

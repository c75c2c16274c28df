"""A model as C sources, and as what other programs take: FMU, page, PyBaMM, DBC.

cellwise export: model to C sources and other programs' formats
    requires a model, the sample time of the target and a new folder
    $ export --model cell.json --dt 1 -o firmware
    $ export --model cell.json --dt 0.1 -o firmware --log drive.csv --report cost.html
<model>
    --dt S  time step [s]
    -o, --output DIR  folder of C sources
    --layout cmake|zephyr|platformio|arduino|esp-idf|foxbms  arrange the folder of -o as a module
        of this tree
    --fmu OUT.fmu  FMI 3.0 co-simulation, with a binary for this machine
    --page OUT.html  a page that estimates in the browser [--dt 1]
    --pybamm OUT.py  parameters of PyBaMM's Thevenin model, or its JSON of them: OUT.json
    --can OUT.dbc  SOC, band, power, remaining time: a DBC, and C that packs
    --what estimator|cell  of --fmu: the estimator, or the cell alone [estimator]
    --points N  SOC points [the model's]
    --lean  smaller code, slower from a start far off, no watch for frozen or lost sensors
    --without EFFECT...  leave out an effect of the model, e.g. the laboratory's time_skew; several
    --sensor F.toml  what the target's sensors are off by, as TOML [a car's]
    --noise NAME=X...  of the filter, e.g. gap_soc=0.2; several [the model's, with the sensors']
    --prefix NAME  of every file and name, for several models
    --power S  state of power: held for S seconds, 10 say
<limits>
    --remaining V  time and energy left down to V volts per cell
    --cells N=0  follow N cells in series, on one table
    --health  take capacity and resistance from `cellwise history` without a new export
    --log LOG  accuracy lost, against the float64 EKF
    --soc0 X  SOC at the log's start [auto]
<page>
<log options>
"""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.validity import check_cells_in_series
from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.errors import InputError
from cellwise.estimate.fixed.options import Asked, CellSettings
from cellwise.estimate.noise import Noise
from cellwise.estimate.sensor import assumed_text, seen_by
from cellwise.export.accuracy import FixedAndFloat, fixed_and_float, target_costs
from cellwise.export.package import Export, check_folder, write_package
from cellwise.logs import CellLog
from cellwise.report.export_page import ACCURACY_COLUMNS, cost_rows, export_page
from cellwise.workflows.starts import start_of

# Options that name what is written beside the folder, each by the module of its name.
FORMATS = {name: f"cellwise.export.{name}" for name in ("fmu", "page", "pybamm", "can")}
OF_FOLDER = ("layout", "report", "figures", "log")  # options that the others ignore
STEPPED = ("output", "fmu")  # outputs that hold for one time step, which must be stated


def run_export(arguments: argparse.Namespace) -> None:
    """Write the C of a model and say what it costs."""
    page_options.check_page_options(arguments)
    check(arguments)
    model = without(options.read_model(arguments), arguments.without)
    sensor = options.sensor_of(arguments)
    export = Export(
        model,
        arguments.dt,
        noise_of(seen_by(model, sensor).noise, arguments.noise),
        Asked(
            points=arguments.points,
            wide=not arguments.lean,
            power=forecast_options.power_of(arguments, model, "current"),
            remaining_V=arguments.remaining,
            health=arguments.health,
            cells=CellSettings() if arguments.cells else None,
        ),
        arguments.cells,
        arguments.prefix or "",
        arguments.layout,
        arguments.what or "estimator",
        sensor,
    )
    report = export.description
    log = read(model, arguments)
    report |= write_formats(export, arguments)
    if arguments.output:
        with printing.working("counting instructions") as follow:
            report["targets"] = target_costs(export, log, follow)
        runs = [] if log is None else beside_float64(export, log, arguments)
        report["accuracy"] = [run.to_dict() for run in runs]
        report["files"] = write_package(export, Path(arguments.output), report)
        write_pages(export, report, runs, arguments)
    if arguments.json:
        printing.print_json(report)
        return
    if arguments.output:
        print_export(arguments.output, report)
        page_options.say_pages(arguments)
    for notice in report["notices"]:
        printing.say(f"note: {notice}")
    for place in report["sockets"].values():
        printing.say(f"written: {place}")


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
    if arguments.output:
        check_folder(Path(arguments.output))
    if arguments.what and not arguments.fmu:
        raise InputError("--what without --fmu", "an FMU to write", "Add --fmu OUT.fmu.")
    for name in (name for name in FORMATS if said[name]):
        options.check_places(said[name])
        module = import_module(FORMATS[name])
        if not said[name].lower().endswith(module.SUFFIXES):
            ends = " or ".join(module.SUFFIXES)
            found = f"--{name} {said[name]}"
            raise InputError(found, f"a name that ends in {ends}", "Name it so.")
        module.check(said[name])


def write_formats(export: Export, arguments: argparse.Namespace) -> dict[str, Any]:
    """Write every format that is wanted: places by the option's name, and what to know of them."""
    written: dict[str, str] = {}
    said: list[str] = []
    for name, module in FORMATS.items():
        if place := getattr(arguments, name):
            places, notices = import_module(module).write(export, place)
            written[name] = ", ".join(map(str, places))
            said += notices
    return {"sockets": written, "notices": said}


def without(model: CellModel, names: list[str]) -> CellModel:
    """The model without some of its effects.

    Raises
    ------
    InputError        an effect that it does not have
    """
    there = {effect.name: effect for effect in model.effects}
    for name in names:
        if name not in there:
            expected = f"an effect of the model: {', '.join(there) or 'it has none'}"
            raise InputError(f"--without {name}", expected, "Leave it out, or correct its name.")
    kept = tuple(effect for name, effect in there.items() if name not in names)
    return replace(model, effects=kept) if names else model


def noise_of(noise: Noise, stated: list[str]) -> Noise:
    """The noise with what is stated in its place.

    Raises
    ------
    InputError        no NAME=X, a name that is none, a value that `Noise` refuses
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
    return replace(noise, **values)  # type: ignore[arg-type]


def write_pages(
    export: Export,
    report: dict[str, Any],
    runs: list[FixedAndFloat],
    arguments: argparse.Namespace,
) -> None:
    """The page and its pictures, where they are wanted."""
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            mine = export.tables.options.points
            run = next((run for run in runs if run.points == mine), None)
            export_page(report, pages.page, run, figures=pages.figures)


def beside_float64(
    export: Export, log: CellLog, arguments: argparse.Namespace
) -> list[FixedAndFloat]:
    """What is exported and the float64 EKF on the log, by number of SOC points."""
    return fixed_and_float(
        export.seen.model,
        log,
        arguments.dt,
        soc0=start_of(log.soc0, arguments.soc0),
        lean=arguments.lean,
        points=export.asked.points,
        noise=export.seen.noise,
    )


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

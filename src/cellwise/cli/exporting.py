"""cellwise export: C sources, and what other programs take as it is: FMU, page, PyBaMM, DBC."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.fixed.tables import FixedStepTables
    from cellwise.estimate.noise import Noise
    from cellwise.export.accuracy import FixedAndFloat
    from cellwise.logs import CellLog

STEPS_TO_MEASURE = 4000
LAYOUT_NAMES = ("cmake", "zephyr", "platformio", "arduino", "esp-idf", "foxbms")
# Option: what is written, suffixes, meaning.
FORMATS = {
    "fmu": ("OUT.fmu", (".fmu",), "FMI 3.0 co-simulation, with a binary for this machine"),
    "page": ("OUT.html", (".html", ".htm"), "a page that estimates in the browser [--dt 1]"),
    "pybamm": ("OUT.py", (".py", ".json"), "parameters of PyBaMM's Thevenin model"),
    "can": ("OUT.dbc", (".dbc",), "SOC, band, power, remaining time: a DBC, and C that packs"),
}
PAGE_STEP_S = 1.0  # of --page without --dt
OF_FOLDER = ("layout", "report", "figures", "log")  # options that the others ignore
STEPPED = ("output", "fmu")  # outputs that hold for one time step, which must be stated


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add ``cellwise export``."""
    export = commands.add_parser("export", help="model to C sources and other programs' formats")
    options.add_model(export)
    options.number(export, "--dt", "S", "time step [s]")
    export.add_argument("-o", "--output", metavar="DIR", help="folder of C sources")
    text = "arrange the folder of -o as a module of this tree"
    export.add_argument("--layout", choices=LAYOUT_NAMES, help=text)
    for name, (place, _, text) in FORMATS.items():
        export.add_argument(f"--{name}", metavar=place, help=text)
    text = "of --fmu: the estimator, or the cell alone [estimator]"
    export.add_argument("--what", choices=("estimator", "cell"), help=text)
    options.count(export, "--points", "N", "SOC points [the model's]")
    text = "smaller code, slower from a start far off, no watch for frozen or lost sensors"
    options.flag(export, "--lean", text)
    text = "leave out an effect of the model, e.g. the laboratory's time_skew; several"
    options.several(export, "--without", "EFFECT", text)
    text = "of the target's sensors, e.g. voltage_V=0.005, current_A=0.05; several [the model's]"
    options.several(export, "--noise", "NAME=X", text)
    text = "of every file and name, for several models"
    export.add_argument("--prefix", default="", metavar="NAME", help=text)
    options.number(export, "--power", "S", "state of power: held for S seconds, 10 say")
    forecast_options.add_limit_options(export)
    text = "time and energy left down to V volts per cell"
    options.number(export, "--remaining", "V", text)
    text = "follow N cells in series, on one table"
    options.count(export, "--cells", "N", text, default=0)
    text = "take capacity and resistance from `cellwise history` without a new export"
    options.flag(export, "--health", text)
    export.add_argument("--log", metavar="LOG", help="accuracy lost, against the float64 EKF")
    options.number(export, "--soc0", "X", "SOC at the log's start [auto]")
    page_options.add_page_options(export)
    log_options.add_log_options(export)
    options.add_json(export)
    export.set_defaults(run=run_export)


def run_export(arguments: argparse.Namespace) -> None:
    """Write the C of a model and say what it costs."""
    from functools import partial

    from cellwise.estimate.fixed.options import CellSettings
    from cellwise.estimate.fixed.tables import fixed_step_tables
    from cellwise.export.c_tables import prefixed
    from cellwise.export.package import (
        check_cells,
        check_step,
        describe,
        model_sha256,
        write_package,
    )

    page_options.check_page_options(arguments)
    check(arguments)
    check_cells(arguments.cells)
    model = without(options.read_model(arguments), arguments.without)
    noise = noise_of(model, arguments.noise)
    if arguments.prefix:
        prefixed({}, arguments.prefix)  # refuses now what it would refuse later
    tables_at = partial(
        fixed_step_tables,
        model,
        noise=noise,
        points=arguments.points,
        wide=not arguments.lean,
        power=forecast_options.exported_power(arguments, model),
        health=arguments.health,
        cells=CellSettings() if arguments.cells else None,
    )
    report: dict[str, Any] = {"model": model.name, "model_sha256": model_sha256(model)}
    tables = None
    if arguments.dt is not None:
        check_step(arguments.dt)
        tables = tables_at(arguments.dt, remaining_V=arguments.remaining)
        report = describe(model, tables, noise, arguments.cells)
    log = read(model, arguments)
    report["sockets"] = write_formats(model, tables_at, noise, report, arguments)
    if arguments.output and tables is not None:
        report["targets"] = target_costs(model, tables, log, arguments)
        runs = [] if log is None else beside_float64(model, noise, log, arguments)
        report["accuracy"] = [run.to_dict() for run in runs]
        folder = Path(arguments.output)
        report["files"] = write_package(
            model, tables, folder, report, arguments.prefix, arguments.layout
        )
        mine = tables.options.points
        write_pages(report, next((run for run in runs if run.points == mine), None), arguments)
    if arguments.json:
        printing.print_json(report)
        return
    if arguments.output:
        print_export(arguments.output, report)
        page_options.say_pages(arguments)
    for notice in report.get("notices", ()):
        printing.say(f"note: {notice}")
    for place in report["sockets"].values():
        printing.say(f"written: {place}")


def check(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        nothing to write; no time step; a suffix of another format; no place; a
                      package that is missing
    """
    wanted = [name for name in ("output", *FORMATS) if getattr(arguments, name)]
    if not wanted:
        known = ", ".join(f"--{name}" for name in FORMATS)
        raise InputError("nothing to write", f"-o DIR or one of {known}", "Add -o DIR.")
    options.check_places(*(getattr(arguments, name) for name in FORMATS))
    for name, (_, suffixes, _) in FORMATS.items():
        place = getattr(arguments, name)
        if place and not place.lower().endswith(suffixes):
            raise InputError(
                f"--{name} {place}", f"a name that ends in {' or '.join(suffixes)}", "Name it so."
            )
    if arguments.dt is None and any(name in STEPPED for name in wanted):
        raise InputError(
            "no time step", "--dt S, the seconds from one sample to the next", "Add --dt 1, say."
        )
    for name in OF_FOLDER:
        if getattr(arguments, name) and not arguments.output:
            option = name.replace("_", "-")
            raise InputError(f"--{option} without -o", "a folder of C sources", "Add -o DIR.")
    if arguments.what and not arguments.fmu:
        raise InputError("--what without --fmu", "an FMU to write", "Add --fmu OUT.fmu.")
    check_tools(arguments)


def check_tools(arguments: argparse.Namespace) -> None:
    """Refuse what needs a compiler or a package that is not here."""
    from cellwise.export.firmware import host_compiler, need_package
    from cellwise.export.page import check_wasm_compiler

    if arguments.fmu:
        host_compiler()
        need_package("fmpy", "fmu")
    if arguments.page:
        check_wasm_compiler()
    if arguments.can:
        need_package("cantools", "importers")
    if arguments.pybamm and arguments.pybamm.lower().endswith(".json"):
        need_package("pybamm", "generate")


def write_formats(
    model: CellModel,
    tables_at: Callable[..., FixedStepTables],
    noise: Noise,
    report: dict[str, Any],
    arguments: argparse.Namespace,
) -> dict[str, str]:
    """Write every format that is wanted: its place by the option's name.

    ``tables_at`` makes the tables of a time step; ``report`` is that of the folder.
    """
    written: dict[str, str] = {}
    if arguments.pybamm:
        from cellwise.export.pybamm import write_pybamm

        place, report["notices"] = write_pybamm(model, arguments.pybamm)
        written["pybamm"] = str(place)
    if arguments.can:
        from cellwise.export.can import write_dbc

        written["can"] = ", ".join(map(str, write_dbc(model, arguments.can, arguments.cells)))
    if arguments.fmu:
        from cellwise.export.fmu import What, write_fmu

        what: What = arguments.what or "estimator"
        tables = tables_at(arguments.dt, remaining_V=arguments.remaining)
        written["fmu"] = str(write_fmu(model, tables, arguments.fmu, report, what))
    if arguments.page:
        from cellwise.export.package import describe, package_files
        from cellwise.export.page import write_estimator_page
        from cellwise.forecast.remaining import cutoff_of

        cutoff_V = cutoff_of(model, arguments.remaining)
        tables = tables_at(arguments.dt or PAGE_STEP_S, remaining_V=cutoff_V)
        described = describe(model, tables, noise, arguments.cells)
        files = package_files(model, tables, described, arguments.prefix, arguments.layout)
        page = write_estimator_page(model, tables, arguments.page, described, files)
        written["page"] = str(page)
    return written


def without(model: CellModel, names: list[str]) -> CellModel:
    """The model without some of its effects.

    Raises
    ------
    InputError        an effect that it does not have
    """
    from dataclasses import replace

    there = {effect.name: effect for effect in model.effects}
    for name in names:
        if name not in there:
            expected = f"an effect of the model: {', '.join(there) or 'it has none'}"
            raise InputError(f"--without {name}", expected, "Leave it out, or correct its name.")
    kept = tuple(effect for name, effect in there.items() if name not in names)
    return replace(model, effects=kept) if names else model


def noise_of(model: CellModel, stated: list[str]) -> Noise:
    """The model's noise, with what is stated of the target's sensors.

    Raises
    ------
    InputError        no NAME=X, a name that is none, a value that `Noise` refuses
    """
    from dataclasses import fields, replace

    from cellwise.estimate.noise import Noise

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
    return replace(Noise.of_model(model), **values)  # type: ignore[arg-type]


def write_pages(
    report: dict[str, Any], run: FixedAndFloat | None, arguments: argparse.Namespace
) -> None:
    """The page and its pictures, where they are wanted."""
    with page_options.page_places(arguments) as pages:
        if pages is not None:
            from cellwise.report.export_page import export_page

            export_page(report, pages.page, run, figures=pages.figures)


def target_costs(
    model: CellModel, tables: FixedStepTables, log: CellLog | None, arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    """Code, stack and instructions on every core; empty without a cross compiler.

    Counted on the log that is given, else on the embedded drive of an NMC cell; and under stress:
    every fault, and the step that re-initialises SOC after a lock-out.
    """
    from dataclasses import asdict
    from functools import partial

    from cellwise.data import load_dataset
    from cellwise.estimate.fixed.fixed_step import samples_of
    from cellwise.export.accuracy import worst_case
    from cellwise.export.cross import cores_here, run_on_target

    here = cores_here()
    if not here:
        return []
    drive = load_dataset("nmc_drive_b") if log is None else log
    records = samples_of(model, drive, arguments.dt).records[:STEPS_TO_MEASURE]
    costs = []
    with printing.working("counting instructions") as follow:
        for core in here:
            follow(f"counting instructions on {core}")
            count = partial(run_on_target, tables, core, records, 0.5, 0.0225, measure_every=10)
            worst = worst_case(model, tables, core)
            report = asdict(count().cost)
            report["stack_bytes"] = max(report["stack_bytes"], worst.stack_bytes)
            report["instructions_stress"] = worst.stress
            report["instructions_anew"] = worst.reset
            if arguments.cells:
                pack = count(cells=arguments.cells).cost
                report["pack_instructions_mean"] = pack.instructions_mean
                report["pack_instructions_most"] = pack.instructions_most
            costs.append(report)
    return costs


def beside_float64(
    model: CellModel, noise: Noise, log: CellLog, arguments: argparse.Namespace
) -> list[FixedAndFloat]:
    """What is exported and the float64 EKF on the log, by number of SOC points."""
    from cellwise.export.accuracy import GRIDS, fixed_and_float

    return fixed_and_float(
        model,
        log,
        arguments.dt,
        soc0=options.start_of(log.soc0, arguments.soc0),
        lean=arguments.lean,
        grids=(*GRIDS, arguments.points or model.points),
        noise=noise,
    )


def read(model: CellModel, arguments: argparse.Namespace) -> CellLog | None:
    """The log to measure on, None where none is named."""
    from cellwise.cell.plausibility.validity import check_cells_in_series

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
    if report["targets"]:
        printing.record_table(
            "Cost on the target (instructions, not cycles; counted in QEMU)",
            report["targets"],
            ("core", lambda c: c["core"]),
            ("code", lambda c: f"{c['text_bytes']:,} B"),
            ("static RAM", lambda c: f"{c['ram_bytes']} B"),
            ("stack", lambda c: f"{c['stack_bytes']} B"),
            ("instructions a step", lambda c: _counted(c["instructions_mean"])),
            ("most on the log", lambda c: _counted(c["instructions_most"])),
            ("worst case", lambda c: _counted(c["instructions_stress"])),
            ("SOC re-initialised", lambda c: _counted(c["instructions_anew"])),
            *((f"{cells} cells, mean", lambda c: _counted(c["pack_instructions_mean"])),
              ("most", lambda c: _counted(c["pack_instructions_most"])))[: 2 * bool(cells)],
        )  # fmt: skip
    else:
        printing.say("no cross compiler: code size, stack and instructions are not known")
    if report["accuracy"]:
        printing.record_table(
            "SOC against the float64 EKF on the log, in points of SOC",
            report["accuracy"],
            ("SOC points", lambda a: str(a["points"])),
            ("tables", lambda a: f"{a['flash_bytes']:,} B"),
            ("RMSE", lambda a: f"{100 * a['soc_rmse']:.4f}"),
            ("max", lambda a: f"{100 * a['soc_max']:.4f}"),
        )


def _counted(instructions: float | None) -> str:
    """Instructions of a step; those of one that re-initialises SOC may not be known."""
    return "-" if instructions is None else f"{instructions:,.0f}"

"""cellwise export."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import forecast_options, log_options, options, page_options, printing
from cellwise.cli.common import socket_options as sockets
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.fixed.tables import FixedStepTables
    from cellwise.estimate.noise import Noise
    from cellwise.export.accuracy import FixedAndFloat
    from cellwise.logs import CellLog

STEPS_TO_MEASURE = 4000


def add_commands(commands: options.Commands[argparse.ArgumentParser]) -> None:
    """Add ``cellwise export``."""
    export = commands.add_parser("export", help="model to C sources and other programs' formats")
    options.add_model(export)
    options.number(export, "--dt", "S", "time step [s]")
    export.add_argument("-o", "--output", metavar="DIR", help="folder of C sources")
    sockets.add_options(export)
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
    options.count(export, "--flash", "BYTES", "refuse larger tables")
    export.add_argument("--log", metavar="LOG", help="accuracy lost, against the float64 EKF")
    options.number(export, "--soc0", "X", "SOC at the log's start [auto]")
    page_options.add_page_options(export)
    log_options.add_log_options(export)
    options.add_json(export)
    export.set_defaults(run=run_export)


def run_export(arguments: argparse.Namespace) -> None:
    """Write the C of a model and say what it costs."""
    from functools import partial

    from cellwise.estimate.cells.settings import CellSettings
    from cellwise.estimate.fixed.tables import fixed_step_tables
    from cellwise.export.c_tables import prefixed
    from cellwise.export.package import (
        check_cells,
        check_flash,
        check_step,
        describe,
        model_sha256,
        write_package,
    )

    page_options.check_page_options(arguments)
    sockets.check(arguments)
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
        watch=not arguments.lean,
        power=forecast_options.exported_power(arguments, model),
        health=arguments.health,
        cells=CellSettings() if arguments.cells else None,
    )
    report: dict[str, Any] = {"model": model.name, "model_sha256": model_sha256(model)}
    tables = None
    if arguments.dt is not None:
        check_step(arguments.dt)
        tables = tables_at(arguments.dt, remaining_V=arguments.remaining)
        check_flash(tables, arguments.flash)
        report = describe(model, tables, noise, arguments.cells)
    log = read(model, arguments)
    report["sockets"] = sockets.write(model, tables_at, noise, report, arguments)
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


def without(model: CellModel, names: list[str]) -> CellModel:
    """The model without some of its effects.

    Raises
    ------
    InputError        an effect that it does not have
    """
    from dataclasses import replace

    there = [effect.name for effect in model.effects]
    for name in names:
        if name not in there:
            raise InputError(
                f"--without {name}",
                f"an effect of the model: {', '.join(there) or 'it has none'}",
                "Leave it out, or correct its name.",
            )
    kept = tuple(effect for effect in model.effects if effect.name not in names)
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
            run = run_on_target(tables, core, records, 0.5, 0.0225, measure_every=10)
            worst = worst_case(model, tables, core)
            report = asdict(run.cost)
            report["stack_bytes"] = max(report["stack_bytes"], worst.stack_bytes)
            report["instructions_stress"] = worst.stress
            report["instructions_anew"] = worst.reset
            if arguments.cells:
                pack = run_on_target(
                    tables, core, records, 0.5, 0.0225, measure_every=10, cells=arguments.cells
                )
                report["pack_instructions_mean"] = pack.cost.instructions_mean
                report["pack_instructions_most"] = pack.cost.instructions_most
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
    on = [k for k, v in report["options"].items() if v and k not in ("points", "temperatures")]
    printing.table(
        f"{folder}: {len(report['files'])} files for a step of {report['dt_s']:g} s",
        ("what", "value"),
        [
            ("model", f"{report['model'] or 'unnamed'}, sha256 {report['model_sha256'][:16]}..."),
            ("SOC points x temperatures", f"{report['options']['points']} x "
             f"{report['options']['temperatures']}"),
            ("states", str(report["states"])),
            ("compiled in", ", ".join(on) or "nothing beyond the plain model"),
            ("tables in flash", f"{report['model_bytes']:,} bytes"),
            ("state per cell", f"{report['state_bytes']} bytes"),
            *(
                [("state of a pack", f"{report['pack_bytes']:,} bytes for {report['cells']} cells")]
                if report["cells"]
                else []
            ),
        ],
    )  # fmt: skip
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
        )
        if "pack_instructions_mean" in report["targets"][0]:
            printing.record_table(
                f"A sample of {report['cells']} cells (instructions)",
                report["targets"],
                ("core", lambda c: c["core"]),
                ("mean", lambda c: _counted(c["pack_instructions_mean"])),
                ("most on the log", lambda c: _counted(c["pack_instructions_most"])),
            )
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

"""cellwise export: what other programs take as it is. FMU, page, PyBaMM, DBC."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cellwise.cli.common.options import check_places
from cellwise.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cellwise.cell.model import CellModel
    from cellwise.estimate.fixed.tables import FixedStepTables
    from cellwise.estimate.noise import Noise

LAYOUT_NAMES = ("cmake", "zephyr", "platformio", "arduino", "esp-idf", "foxbms")
# Option: what is written, suffixes, meaning.
FORMATS = {
    "fmu": ("OUT.fmu", (".fmu",), "FMI 3.0 co-simulation, with a binary for this machine"),
    "page": ("OUT.html", (".html", ".htm"), "a page that estimates in the browser [--dt 1]"),
    "pybamm": ("OUT.py", (".py", ".json"), "parameters of PyBaMM's Thevenin model"),
    "can": (
        "OUT.dbc",
        (".dbc",),
        "SOC, band, power, remaining time: a DBC, and C that packs",
    ),
}
PAGE_STEP_S = 1.0  # of --page without --dt
FOLDERS_OWN = ("layout", "report", "figures", "log", "flash")  # options that the others ignore
STEPPED = ("output", "fmu")  # outputs that hold for one time step, which must be stated


def add_options(export: argparse.ArgumentParser) -> None:
    """Add the option of every format."""
    text = "arrange the folder of -o as a module of this tree"
    export.add_argument("--layout", choices=LAYOUT_NAMES, help=text)
    for name, (place, _, text) in FORMATS.items():
        export.add_argument(f"--{name}", metavar=place, help=text)
    text = "of --fmu: the estimator, or the cell alone [estimator]"
    export.add_argument("--what", choices=("estimator", "cell"), help=text)


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
    check_places(*(getattr(arguments, name) for name in FORMATS))
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
    for name in FOLDERS_OWN:
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


def write(
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

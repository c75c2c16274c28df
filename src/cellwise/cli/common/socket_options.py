"""cellwise export: what other programs take as it is. FMU, page, PyBaMM, DBC."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cellwise.cli.common.places import check_places
from cellwise.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cellwise.cell.model import CellModel
    from cellwise.estimate.fixed.tables import FixedStepTables
    from cellwise.estimate.noise import Noise

LAYOUT_NAMES = ("cmake", "zephyr", "platformio", "arduino", "esp-idf", "foxbms")
SUFFIXES = {
    "fmu": (".fmu",),
    "page": (".html", ".htm"),
    "pybamm": (".py", ".json"),
    "can": (".dbc",),
}
PAGE_STEP_S = 1.0  # of --page without --dt
FOLDERS_OWN = ("layout", "report", "figures", "log", "flash")  # options that the others ignore
STEPPED = ("output", "fmu")  # outputs that hold for one time step, which must be stated


def add_options(export: argparse.ArgumentParser) -> None:
    """Add the option of every format."""
    text = "arrange the folder of -o as a module of this tree"
    export.add_argument("--layout", choices=LAYOUT_NAMES, help=text)
    text = "FMI 3.0 co-simulation: C sources and a binary for this machine (extra `fmu`)"
    export.add_argument("--fmu", metavar="OUT.fmu", help=text)
    text = "a page that estimates in the browser; step 1 s without --dt"
    export.add_argument("--page", metavar="OUT.html", help=text)
    text = "parameters of PyBaMM's Thevenin model; .json is written by PyBaMM"
    export.add_argument("--pybamm", metavar="OUT.py", help=text)
    text = "DBC of SOC, band, power and remaining time, and the C beside it that packs them"
    export.add_argument("--can", metavar="OUT.dbc", help=text)
    text = "of --fmu: the estimator, or the cell alone [estimator]"
    export.add_argument("--what", choices=("estimator", "cell"), help=text)


def check(arguments: argparse.Namespace) -> None:
    """Refuse what could only fail after the work is done.

    Raises
    ------
    InputError        nothing to write; no time step; a suffix of another format; no place; a
                      package that is missing
    """
    wanted = [name for name in ("output", *SUFFIXES) if getattr(arguments, name)]
    if not wanted:
        known = ", ".join(f"--{name}" for name in SUFFIXES)
        raise InputError("nothing to write", f"-o DIR or one of {known}", "Add -o DIR.")
    check_places(*(getattr(arguments, name) for name in SUFFIXES))
    for name, suffixes in SUFFIXES.items():
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
    if arguments.fmu:
        from cellwise.export.firmware import host_compiler
        from cellwise.export.fmu import header_folder

        host_compiler()
        header_folder()
    if arguments.page:
        from cellwise.export.page import check_wasm_compiler

        check_wasm_compiler()
    if arguments.can:
        from cellwise.export.can import require_cantools

        require_cantools()
    if arguments.pybamm and arguments.pybamm.lower().endswith(".json"):
        from cellwise.export.pybamm import require_pybamm

        require_pybamm()


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
    if arguments.can:
        from cellwise.export.can import write_dbc

        written["can"] = ", ".join(map(str, write_dbc(model, arguments.can, arguments.cells)))
    if arguments.pybamm:
        from cellwise.export.pybamm import write_pybamm

        place, report["notices"] = write_pybamm(model, arguments.pybamm)
        written["pybamm"] = str(place)
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

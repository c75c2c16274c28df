"""cellwise export: what other programs take as it is. FMU, page, PyBaMM, DBC."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cellwise.cli.common.places import check_places
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.fixed.tables import FixedStepTables

LAYOUT_NAMES = ("cmake", "zephyr", "platformio", "arduino", "esp-idf", "foxbms")
SUFFIXES = {"fmu": (".fmu",)}
STEPPED = ("output", "fmu")  # outputs that hold for one time step, which must be stated


def add_options(export: argparse.ArgumentParser) -> None:
    """Add the option of every format."""
    text = "arrange the folder of -o as a module of this tree"
    export.add_argument("--layout", choices=LAYOUT_NAMES, help=text)
    text = "FMI 3.0 co-simulation: C sources and a binary for this machine (extra `fmu`)"
    export.add_argument("--fmu", metavar="OUT.fmu", help=text)
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
    if arguments.layout and not arguments.output:
        raise InputError("--layout without -o", "a folder to arrange", "Add -o DIR.")
    if arguments.what and not arguments.fmu:
        raise InputError("--what without --fmu", "an FMU to write", "Add --fmu OUT.fmu.")
    if arguments.fmu:
        from cellwise.export.firmware import host_compiler
        from cellwise.export.fmu import header_folder

        host_compiler()
        header_folder()


def write(
    model: CellModel,
    tables: FixedStepTables | None,
    report: dict[str, Any],
    arguments: argparse.Namespace,
) -> dict[str, str]:
    """Write every format that is wanted: its place by the option's name."""
    written: dict[str, str] = {}
    if arguments.fmu and tables is not None:
        from cellwise.export.fmu import What, write_fmu

        what: What = arguments.what or "estimator"
        written["fmu"] = str(write_fmu(model, tables, arguments.fmu, report, what))
    return written

"""What the options say that several commands share, and the places that they write to."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwise.cli.common import printing
from cellwise.errors import InputError
from cellwise.files import file_place

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.sensor import Sensor


OUTPUTS = ("output", "report")
LOGS = (
    *("log", "logs", "packlogs", "holdout", "baseline", "hppc", "ocv", "capacity", "drive"),
    "voltage_only",
)


def check_places(*paths: str | None) -> None:
    """Refuse output files that could not be written, before the work is done.

    Raises
    ------
    InputError        as `file_place`
    """
    for path in paths:
        if path is not None:
            file_place(path)


def check_overwriting(arguments: argparse.Namespace) -> None:
    """Refuse an output that is one of the command's own inputs, under whatever name.

    Raises
    ------
    InputError        it is
    """
    said = vars(arguments)
    outputs = [said[name] for name in OUTPUTS if isinstance(said.get(name), str)]
    for output in filter(_is_file, outputs):
        for name, value in said.items():
            read = () if name in (*OUTPUTS, "state") else _paths(value, logs=name in LOGS)
            if any(_is_file(path) and Path(path).samefile(output) for path in read):
                raise InputError(
                    f"'{output}' both to read and to write",
                    "an output that is none of the inputs",
                    "Name another one: nothing was overwritten.",
                )


def _paths(value: Any, *, logs: bool) -> Iterator[str]:
    """The texts of an argument as paths, without what is stated behind them; of logs each file."""
    from cellwise.logs.stated import logs_of

    if isinstance(value, (list, tuple)):
        for one in value:
            yield from _paths(one, logs=logs)
    elif isinstance(value, str):
        yield value
        yield value.rpartition("@")[0]
        with suppress(InputError):  # refused where it is read
            yield from (one.path for one in (logs_of(value).logs if logs else ()))


def _is_file(text: str) -> bool:
    try:
        return bool(text) and Path(text).is_file()
    except (OSError, ValueError):
        return False


def read_model(arguments: argparse.Namespace) -> CellModel:
    """The model that the arguments name, scaled where they say so.

    Raises
    ------
    InputError        as `named_model`
    """
    from cellwise.cell.stock import named_model

    return named_model(arguments.model, getattr(arguments, "capacity_ah", None))


def soc0_of(arguments: argparse.Namespace) -> float | None:
    """``--soc0`` as a number, None for ``auto``.

    Raises
    ------
    InputError        neither; no fraction from 0 to 1
    """
    from cellwise.arguments import beyond  # with numpy, which a help need not wait for
    from cellwise.cell.simulate import check_soc0

    if arguments.soc0 == "auto":
        return None
    try:
        soc0 = float(arguments.soc0)
    except ValueError:
        expected = "auto or a fraction from 0 to 1"
        raise InputError(f"--soc0 {arguments.soc0}", expected, "Correct it.") from None
    held = check_soc0(soc0)
    if held != soc0:
        printing.warn(f"--soc0: {beyond(soc0)}")
    return held


def sensor_of(arguments: argparse.Namespace) -> Sensor | None:
    """The sensors that the arguments state, None where they state none.

    Raises
    ------
    InputError        as `read_sensor`
    """
    from cellwise.estimate.sensor import read_sensor

    return None if arguments.sensor is None else read_sensor(arguments.sensor)


def check_fraction(option: str, value: float | None) -> None:
    """Refuse what is no SOC.

    Raises
    ------
    InputError        not from 0 to 1
    """
    if value is not None and not 0.0 <= value <= 1.0:
        raise InputError(f"{option} {value:g}", "a fraction from 0 to 1", "Correct it.")


def data_folder(arguments: argparse.Namespace) -> Path | None:
    """The folder of measured data, as stated or as the environment has it; None without one.

    Raises
    ------
    InputError        no such folder
    """
    folder = arguments.data or os.environ.get("CELLWISE_DATA")
    if folder and not Path(folder).is_dir():
        expected = "the folder of measured cells"
        raise InputError(f"no folder '{folder}'", expected, "Correct --data.")
    return Path(folder) if folder else None

"""The model of a command: a file or a stock model, at its own capacity or at another one."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

HELP = "model file, or a stock model (`cellwise data list`)"


def add_model(parser: argparse.ArgumentParser, *, scalable: bool = False) -> None:
    """Add the option that names the model, and that which scales it to a capacity."""
    parser.add_argument("--model", required=True, metavar="MODEL", help=HELP)
    if scalable:
        parser.add_argument(
            "--capacity-ah",
            type=float,
            metavar="X",
            help="scale the model to this capacity: resistances by the inverse ratio [its own]",
        )


def read(arguments: argparse.Namespace) -> CellModel:
    """The model that the arguments name, scaled where they say so.

    Raises
    ------
    InputError        as `named_model`
    """
    from cellwise.cell.stock.catalogue import named_model

    return named_model(arguments.model, getattr(arguments, "capacity_ah", None))

"""Options of the state of power, of `replay` and of `live`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.power.state_of_power import Hold, PowerSettings

NEEDS_POWER = ("horizons", "voltage_limits", "current_limits", "soc_limits")


def add_power_options(parser: argparse.ArgumentParser) -> None:
    """Add what is asked of a power, and within what."""
    parser.add_argument(
        "--power", action="store_true", help="what the cell can give and take within its limits"
    )
    parser.add_argument(
        "--horizons", metavar="S,S", help="for how long it is held, in seconds [2,10,30]"
    )
    limits = (
        ("--voltage-limits", ("LOW", "HIGH"), "of a cell, in volts [model, else its chemistry's]"),
        ("--current-limits", ("DISCHARGE", "CHARGE"), "without sign, in amperes [the data's]"),
        ("--soc-limits", ("LOW", "HIGH"), "fractions [0 1]"),
    )
    for name, values, text in limits:
        parser.add_argument(name, nargs=2, type=float, metavar=values, help=text)


def power_of(
    arguments: argparse.Namespace, model: CellModel, hold: Hold = "power"
) -> PowerSettings | None:
    """What is asked of the power; None where it is not asked for.

    Raises
    ------
    InputError        an option of the power without --power; as `power_limits`
    """
    if not arguments.power:
        for name in NEEDS_POWER:
            if getattr(arguments, name) is not None:
                option = "--" + name.replace("_", "-")
                raise InputError(
                    f"{option} without --power",
                    "--power beside it",
                    f"Add --power, or omit {option}.",
                )
        return None
    from cellwise.estimate.power.limits import OperatingLimits
    from cellwise.estimate.power.state_of_power import HORIZONS_S, power_settings

    low_V, high_V = arguments.voltage_limits or (arguments.cutoff_v, None)
    discharge_A, charge_A = arguments.current_limits or (None, None)
    low_soc, high_soc = arguments.soc_limits or (0.0, 1.0)
    limits = OperatingLimits(low_V, high_V, discharge_A, charge_A, low_soc, high_soc)
    horizons = HORIZONS_S if arguments.horizons is None else _seconds(arguments.horizons)
    return power_settings(model, horizons_s=horizons, limits=limits, hold=hold)


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--horizons {text}", "seconds, separated by commas", "Give 2,10,30, say."
        ) from None

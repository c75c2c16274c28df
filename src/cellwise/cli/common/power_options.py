"""Options of the state of power, of `replay`, `live` and `export`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cellwise.cli.common import options
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.power.limits import OperatingLimits
    from cellwise.estimate.power.state_of_power import Hold, PowerSettings

LIMITS = ("voltage_limits", "current_limits", "soc_limits")


def add_power_options(parser: argparse.ArgumentParser) -> None:
    """Add what is asked of a power, and within what."""
    options.flag(parser, "--power", "what the cell can give and take within its limits")
    text = "for how long it is held, in seconds [2,10,30]"
    parser.add_argument("--horizons", metavar="S,S", help=text)
    add_limit_options(parser)


def add_limit_options(parser: argparse.ArgumentParser) -> None:
    """Add the limits that a power keeps."""
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
        _refuse_without_power(arguments, ("horizons", *LIMITS))
        return None
    from cellwise.estimate.power.state_of_power import HORIZONS_S, power_settings

    limits = limits_of(arguments, arguments.cutoff_v)
    horizons = HORIZONS_S if arguments.horizons is None else _seconds(arguments.horizons)
    return power_settings(model, horizons_s=horizons, limits=limits, hold=hold)


def limits_of(arguments: argparse.Namespace, cutoff_V: float | None = None) -> OperatingLimits:
    """Limits as they were stated; ``cutoff_V`` is the lower voltage where no other was."""
    from cellwise.estimate.power.limits import OperatingLimits

    low_V, high_V = arguments.voltage_limits or (cutoff_V, None)
    discharge_A, charge_A = arguments.current_limits or (None, None)
    low_soc, high_soc = arguments.soc_limits or (0.0, 1.0)
    return OperatingLimits(low_V, high_V, discharge_A, charge_A, low_soc, high_soc)


def exported_power(arguments: argparse.Namespace, model: CellModel) -> PowerSettings | None:
    """The power of a fixed step: one horizon, currents held; None where none is asked for.

    Raises
    ------
    InputError        limits without --power; as `power_limits`
    """
    if arguments.power is None:
        _refuse_without_power(arguments, LIMITS)
        return None
    from cellwise.estimate.power.state_of_power import power_settings

    limits = limits_of(arguments)
    return power_settings(model, horizons_s=(arguments.power,), limits=limits, hold="current")


def _refuse_without_power(arguments: argparse.Namespace, names: tuple[str, ...]) -> None:
    for name in names:
        if getattr(arguments, name) is not None:
            option = "--" + name.replace("_", "-")
            way_out = f"Add --power, or omit {option}."
            raise InputError(f"{option} without --power", "--power beside it", way_out)


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--horizons {text}", "seconds, separated by commas", "Give 2,10,30, say."
        ) from None

"""Options of what is predicted: remaining time and energy, power within limits."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cellwise.cli.common import log_options, options
from cellwise.errors import InputError

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel
    from cellwise.estimate.power.limits import OperatingLimits
    from cellwise.estimate.power.state_of_power import Hold, PowerSettings
    from cellwise.estimate.replay import Replay
    from cellwise.forecast.display import Display
    from cellwise.forecast.plan import Outcome, Plan
    from cellwise.forecast.remaining import Flight
    from cellwise.typing import FloatArray


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


def add_charger(parser: options.Parser) -> None:
    """Options of the charger that a time to full is for."""
    text = "voltage that a charger holds at one cell [model]"
    options.number(parser, "--charge-limit-v", "V", text)
    options.number(parser, "--charge-end-a", "A", "current at which it ends, of one cell [C/20]")


def add_plan(parser: options.Parser) -> None:
    """Options of a plan of loads."""
    text = "what lies ahead: CSV of time_s and power_W or current_A of the pack, or past logs"
    parser.add_argument("--plan", nargs="+", default=[], metavar="P", help=text)
    options.number(parser, "--land-above", "SOC", "with which chance it ends above SOC [0]")


def add_display(parser: options.Parser) -> None:
    """The option of a displayed percentage."""
    text = "a percentage as products show it; a difference fades over C of the charge [0.1]"
    parser.add_argument("--display", nargs="?", type=float, const=0.1, metavar="C", help=text)


def plans_of(arguments: argparse.Namespace) -> list[Plan]:
    """The plans that the arguments name, of one cell.

    Raises
    ------
    InputError        --land-above without a plan; as `read_plan` and the reading of logs
    """
    from cellwise.forecast.plan import is_plan, plan_of_log, read_plan

    if arguments.land_above is not None and not arguments.plan:
        raise InputError("--land-above without a plan", "--plan P", "Name what lies ahead.")
    plans: list[Plan] = []
    for path in arguments.plan:
        if is_plan(path):
            count = arguments.series
            if count == "auto":
                raise InputError(
                    f"--series auto for the plan '{path}'", "a number", "Give --series N."
                )
            options_of = log_options.read_options(arguments)
            plans.append(read_plan(path, int(count), options_of.parallel))
        else:
            plans += [plan_of_log(log) for log in log_options.read_all([path], arguments)]
    return plans


def outcome_of(
    arguments: argparse.Namespace, model: CellModel, found: Replay, plans: Sequence[Plan]
) -> Outcome | None:
    """Where the plans end from the end of a log; None without a plan."""
    if not plans:
        return None
    from cellwise.forecast.plan import forecast_plan

    above = arguments.land_above or 0.0
    return forecast_plan(model, found, plans, above=above, cutoff_V=arguments.cutoff_v)


def how_displayed(arguments: argparse.Namespace, model: CellModel) -> Display | None:
    """How a percentage is shown; None where it is not asked for."""
    if arguments.display is None:
        return None
    from cellwise.forecast.charging import limit_of, taper_of
    from cellwise.forecast.display import display_of
    from cellwise.forecast.remaining import cutoff_of

    limit_V = limit_of(model, arguments.charge_limit_v)
    taper_A = taper_of(model, arguments.charge_end_a)
    cutoff_V = cutoff_of(model, arguments.cutoff_v)
    return display_of(model, cutoff_V, limit_V, taper_A, arguments.display)


def display_of(
    arguments: argparse.Namespace,
    model: CellModel,
    found: Replay,
    flight: Flight | None,
    charge: Flight | None,
) -> FloatArray | None:
    """The displayed percentage at every row; None where it is not asked for."""
    how = how_displayed(arguments, model)
    if how is None:
        return None
    from cellwise.forecast.display import display_along

    return display_along(how, found, flight, charge)

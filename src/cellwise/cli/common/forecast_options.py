"""What the arguments ask of predictions: power within limits, plans, a displayed percentage."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from cellwise.cell.model import CellModel
from cellwise.cli.common import log_options
from cellwise.errors import InputError
from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import (
    HORIZONS_S,
    Hold,
    PowerSettings,
    power_settings,
)
from cellwise.forecast.plan import Plan, is_plan, plan_of_log, read_plan
from cellwise.workflows.replaying import Ahead

LIMITS = ("voltage_limits", "current_limits", "soc_limits")


def power_of(
    arguments: argparse.Namespace, model: CellModel, hold: Hold = "power"
) -> PowerSettings | None:
    """What is asked of the power; None where it is not asked for.

    An export has one horizon, that of its ``--power``.

    Raises
    ------
    InputError        an option of the power without --power; as `power_limits`
    """
    said = vars(arguments)
    asked = said["power"]
    if asked is None or asked is False:
        for name in ("horizons", *LIMITS):
            if said.get(name) is not None:
                option = "--" + name.replace("_", "-")
                way_out = f"Add --power, or omit {option}."
                raise InputError(f"{option} without --power", "--power beside it", way_out)
        return None
    low_V, high_V = said["voltage_limits"] or (said.get("cutoff_v"), None)
    limits = OperatingLimits(
        low_V,
        high_V,
        *(said["current_limits"] or (None, None)),
        *(said["soc_limits"] or (0.0, 1.0)),
    )
    horizons: tuple[float, ...] = HORIZONS_S if asked is True else (asked,)
    if said.get("horizons") is not None:
        horizons = _seconds(said["horizons"])
    return power_settings(model, horizons_s=horizons, limits=limits, hold=hold)


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--horizons {text}", "seconds, separated by commas", "Give 2,10,30, say."
        ) from None


def plans_of(arguments: argparse.Namespace) -> list[Plan]:
    """The plans that the arguments name, of one cell.

    Raises
    ------
    InputError        --land-above without a plan; as `read_plan` and the reading of logs
    """
    if arguments.land_above is not None and not arguments.plan:
        raise InputError("--land-above without a plan", "--plan P", "Name what lies ahead.")
    plans: list[Plan] = []
    for path in arguments.plan:
        if is_plan(path):
            said = log_options.read_options(arguments)
            if said.series == "auto":
                found = f"--series auto for the plan '{path}'"
                raise InputError(found, "a number", "Give --series N.")
            plans.append(read_plan(path, said.series, said.parallel))
        else:
            plans += [plan_of_log(log) for log in log_options.read_all([path], arguments)]
    return plans


def ahead_of(arguments: argparse.Namespace, plans: Sequence[Plan] = ()) -> Ahead:
    """What the arguments ask to foresee; a stream's have no load or plan of their own."""
    said = vars(arguments)
    return Ahead(
        hold=said.get("hold") or "power",
        cutoff_V=arguments.cutoff_v,
        load=said.get("load"),
        charge_limit_V=arguments.charge_limit_v,
        charge_end_A=arguments.charge_end_a,
        plans=plans,
        above=said.get("land_above") or 0.0,
        display=arguments.display,
        anyway=arguments.anyway,
    )

"""Is a model of a size that a cell can have? What is not is mostly a slip of a unit."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from cellwise.arguments import check_kind
from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import RESISTANCES, CellModel
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.charge import check_current
from cellwise.logs.checks.units import LARGEST_AH, LARGEST_V, check_is_log
from cellwise.logs.files.columns import KELVIN_OFFSET


class AllowedRange(NamedTuple):
    """What a number of a model may be, and the slip that mostly stands behind another.

    ``factor`` and ``offset`` undo the slip.
    """

    low: float
    high: float
    unit: str
    hint: str
    factor: float = 1.0
    offset: float = 0.0

    def holds(self, low: float, high: float) -> bool:
        """Whether all from ``low`` to ``high`` is possible."""
        return self.low <= low and high <= self.high


MILLI = 1e-3
# Of a cell: wider than any chemistry, narrow enough for every slip of a unit by a thousand.
VOLTAGE = AllowedRange(
    0.0, LARGEST_V, "V", "Volts of one cell: not mV, and not a pack in series.", MILLI
)
# What a resistance takes at 1C: resistances alone differ by cells' sizes. Today's cells take
# 0.02 to 0.2 V at room temperature, in the cold and empty up to some volts.
DROP = AllowedRange(1e-9, 30.0, "V at 1C", "Ohms: not mohm.", MILLI)
TIME = AllowedRange(1e-6, 1e7, "s", "Seconds: not ms, not minutes.", MILLI)
TEMPERATURE = AllowedRange(-80.0, 120.0, "degC", "Degrees Celsius, not kelvin.", 1.0, KELVIN_OFFSET)
SHARE = AllowedRange(0.0, 10.0, "of the polarisation", "A share, not per cent.")
SIZES = {
    "capacity_Ah": AllowedRange(1e-7, 1e5, "Ah", "Ampere hours: not mAh, not coulombs.", MILLI),
    "temperature_C": TEMPERATURE,
    "ocv_V": VOLTAGE,
    "tau1_s": TIME,
    "tau2_s": TIME,
    "voltage_min_V": VOLTAGE,
    "voltage_max_V": VOLTAGE,
    "error.std_V": AllowedRange(0.0, LARGEST_V, "V", "Volts: not mV."),
    "error.scales_s": TIME._replace(low=0.0),
    "error.correlation_soc": AllowedRange(0.0, 10.0, "of the SOC", "A fraction, not per cent."),
    "error.temperature_C": TEMPERATURE,
    # Of its data: a counter may run a little beyond 0..1, a sensor see a short circuit.
    "validity.soc": AllowedRange(-0.5, 1.5, "", "A fraction, not per cent."),
    "validity.temperature_C": TEMPERATURE,
}
RATE = AllowedRange(-1e3, 1e3, "C", "Ampere: not mA.")


def check_is_model(model: CellModel | None) -> CellModel:
    """Refuse what is no model, and one that no cell can be.

    Raises
    ------
    InputError        another type; as :func:`check_physical`
    """
    model = check_kind("model", model, CellModel, "Read one with read_model('model.json').")
    check_physical(model)
    return model


def check_log_of(model: CellModel, log: CellLog) -> None:
    """Refuse what is no model, what is no log, and a log of which this cannot be the model.

    Raises
    ------
    InputError        as :func:`check_is_model`; millivolts, kelvin, mAh or milliamperes in the log
    """
    check_is_model(model)
    check_is_log(log)
    check_current(log, model.capacity_Ah)


def check_physical(model: CellModel, where: str = "") -> None:
    """Refuse numbers that no cell can have: they are slips of a unit, or a file that is damaged.

    Parameters
    ----------
    model : CellModel
    where : str           what it was read from; empty for a model in memory

    Raises
    ------
    InputError        names the entry, its values, what is possible, and the likely slip; of a
                      model in memory the line that corrects it
    """
    for name, values, allowed in _sizes(model):
        low, high = float(np.min(values)), float(np.max(values))
        if not allowed.holds(low, high):
            raise InputError(
                f"{name} of {_span(low, high)} {allowed.unit} in {where or 'the model'}",
                f"{allowed.low:g} to {allowed.high:g} {allowed.unit}",
                allowed.hint if where else _corrected(model, name, low, high, allowed),
            )


def _corrected(model: CellModel, name: str, low: float, high: float, allowed: AllowedRange) -> str:
    """What to do about a model in memory: the line that undoes the slip, where it is one."""
    field, hint = name.partition(" ")[0], allowed.hint
    undone = [value * allowed.factor + allowed.offset for value in (low, high)]
    if not (hasattr(model, field) and allowed.holds(*undone)):
        return hint
    if allowed.unit == DROP.unit and model.capacity_Ah > LARGEST_AH:
        field, hint = "capacity_Ah", SIZES["capacity_Ah"].hint
    slip = "/ 1000" if allowed.factor == MILLI else f"- {-allowed.offset:g}"
    return f"{hint} Write dataclasses.replace(model, {field}=model.{field} {slip})."


def _sizes(model: CellModel) -> Iterator[tuple[str, Any, AllowedRange]]:
    """Every entry with its range; resistances as the voltage that they take at 1C."""
    for path, allowed in SIZES.items():
        holder, _, name = path.rpartition(".")
        values = attrgetter(path)(model)
        if values is not None and np.size(values):
            yield f"{name} of the {holder}" if holder else name, values, allowed
    with np.errstate(over="ignore"):  # beyond every number is beyond every bound
        for name in RESISTANCES:
            yield f"{name} with a drop", getattr(model, name) * model.capacity_Ah, DROP
        slow = np.asarray(model.effect(SlowDiffusion).r3_ohm) * model.capacity_Ah
        yield "r3_ohm with a drop", slow, DROP._replace(low=0.0)
    shares = (*model.error.shares(), *model.error.shares(-1.0))
    yield "share and charge_share of the error", shares, SHARE
    if model.validity.current_A is not None:
        rate = np.array(model.validity.current_A) / model.capacity_Ah
        yield "current_A of the validity, a rate", rate, RATE


def _span(low: float, high: float) -> str:
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"

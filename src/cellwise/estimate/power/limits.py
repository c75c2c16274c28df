"""Limits of voltage, current and SOC that a power has to keep, and where each is known from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cellwise.arguments import number
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.power.limit_kernels import LimitScalars
from cellwise.notices import Code, Notice
from cellwise.wording import arg

# The usual window of a cell by what its chemistry's name begins with [V].
WINDOWS: Mapping[str, tuple[float, float]] = {
    "LFP": (2.0, 3.6),
    "LTO": (1.5, 2.8),
    "LMO": (3.0, 4.2),
    "LCO": (3.0, 4.2),
    "NCA": (2.5, 4.2),
    "NMC": (2.5, 4.2),
}
# Currents of the data below this rate say nothing of what a cell can carry.
LEAST_RATE = 0.1
LEAST_LOAD_C = 0.02  # a load below C/50 counts as that: below it nothing flies


@dataclass(frozen=True)
class OperatingLimits:
    """What a cell may be taken to; None: not known, and looked for in the model.

    Parameters
    ----------
    voltage_min_V, voltage_max_V : float or None    terminal voltage [V]
    discharge_A, charge_A : float or None           largest currents, both without sign [A]
    soc_min, soc_max : float                        0..1

    Raises
    ------
    InputError        a limit that is not finite, limits that are inverted, a current not above zero
    """

    voltage_min_V: float | None = None
    voltage_max_V: float | None = None
    discharge_A: float | None = None
    charge_A: float | None = None
    soc_min: float = 0.0
    soc_max: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not np.isfinite(number(name, value, "a finite number")):
                raise InputError(f"a limit {name} = {value}", "a finite number", "Correct it.")
        for name in ("discharge_A", "charge_A"):
            value = getattr(self, name)
            if value is not None and value <= 0.0:
                raise InputError(
                    f"a largest current {name} = {value:g} A",
                    "a size above zero, for discharge and for charge alike",
                    "Give it without a sign.",
                )
        _check_window("voltage", self.voltage_min_V, self.voltage_max_V, " V")
        _check_window("SOC", self.soc_min, self.soc_max, "")
        if not (self.soc_min >= 0.0 and self.soc_max <= 1.0):
            raise InputError(
                f"SOC limits of {self.soc_min:g} and {self.soc_max:g}",
                "fractions from 0 to 1",
                "Per cent? Divide by 100.",
            )


@dataclass(frozen=True)
class KnownLimits:
    """Limits that a power is computed within, and where each one of them comes from.

    ``sources`` has an entry for each limit: ``given``, ``model``, ``chemistry``, ``data`` (the
    largest current that the model's data hold) or ``none``.
    """

    limits: OperatingLimits
    sources: Mapping[str, str] = field(default_factory=dict)

    def scalars(self) -> LimitScalars:
        """What the kernels take."""
        none = {"voltage_min_V": -np.inf}
        return LimitScalars(
            *(none.get(n, np.inf) if v is None else float(v) for n, v in vars(self.limits).items())
        )

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know: limits that nobody stated."""
        found = []
        known = self.limits
        if "chemistry" in (self.sources["voltage_min_V"], self.sources["voltage_max_V"]):
            found.append(
                f"the model states no voltage limits: power within {known.voltage_min_V:g} to "
                f"{known.voltage_max_V:g} V, usual for its chemistry"
            )
        ways = {
            source: [w for w in ("discharge", "charge") if self.sources[f"{w}_A"] == source]
            for source in ("data", "none")
        }
        if ways["data"]:
            each = " and ".join(f"{getattr(known, f'{w}_A'):.3g} A on {w}" for w in ways["data"])
            found.append(
                "no limit of current is stated: power within the largest currents of the model's "
                f"data, {each}"
            )
        if ways["none"]:
            found.append(
                "no limit of current is stated or in the model's data on "
                f"{' and '.join(ways['none'])}: voltage and SOC alone limit that power"
            )
        return tuple(Notice(Code.POWER_LIMIT_ASSUMED, text) for text in found)


def operating_limits(model: CellModel, given: OperatingLimits | None = None) -> KnownLimits:
    """Limits as given; where not, the model's, its chemistry's window, its data's currents.

    Raises
    ------
    InputError        no voltage limit is known; limits that are inverted; a window that the cell's
                      OCV never lies in
    """
    asked = OperatingLimits() if given is None else given
    sources: dict[str, str] = {}
    window = _window(model.chemistry)
    voltages = []
    for k, name in enumerate(("voltage_min_V", "voltage_max_V")):
        choices = (
            ("given", getattr(asked, name)),
            ("model", getattr(model, name)),
            ("chemistry", None if window is None else window[k]),
        )
        sources[name], value = next(((s, v) for s, v in choices if v is not None), ("none", None))
        if value is None:
            raise InputError(
                f"no {'lower' if k == 0 else 'upper'} voltage limit for the power: the model "
                f"states none, and its chemistry is '{model.chemistry or 'not stated'}'",
                "limits given, in the model, or a chemistry of " + ", ".join(WINDOWS),
                "Give both voltages: " + arg("limits", letter="...") + ".",
            )
        voltages.append(float(value))
    currents = []
    for name, sign in (("discharge_A", 1.0), ("charge_A", -1.0)):
        value = getattr(asked, name)
        sources[name] = "none" if value is None else "given"
        if value is None and model.validity.current_A is not None:
            seen = max(sign * x for x in model.validity.current_A)
            if seen >= LEAST_RATE * model.capacity_Ah:
                value, sources[name] = float(seen), "data"
        currents.append(value)
    found = OperatingLimits(
        voltages[0], voltages[1], currents[0], currents[1], asked.soc_min, asked.soc_max
    )
    low, high = float(np.min(model.ocv_V)), float(np.max(model.ocv_V))
    if voltages[0] >= high or voltages[1] <= low:
        raise InputError(
            f"voltage limits of {voltages[0]:g} and {voltages[1]:g} V for a cell whose OCV lies "
            f"between {low:.2f} and {high:.2f} V",
            "a window that the OCV lies in",
            "Give the limits of a cell, not of the pack.",
        )
    return KnownLimits(found, sources)


def _window(chemistry: str) -> tuple[float, float] | None:
    name = chemistry.strip().upper()
    return next((w for begins, w in WINDOWS.items() if name.startswith(begins)), None)


def _check_window(what: str, low: float | None, high: float | None, unit: str) -> None:
    if low is not None and high is not None and low >= high:
        raise InputError(
            f"{what} limits of {low:g}{unit} and {high:g}{unit}",
            "the lower one below the upper one",
            "Exchange them, or correct the wrong one.",
        )

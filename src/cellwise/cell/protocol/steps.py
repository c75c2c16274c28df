"""Steps of a tester as frozen records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import FloatArray


@dataclass(frozen=True)
class Rest:
    """No current for ``duration_s`` [s]; a row every ``period_s`` [s], None: the run's own."""

    duration_s: float
    period_s: float | None = None

    def __post_init__(self) -> None:
        _check(self, positive="duration_s period_s")


@dataclass(frozen=True, kw_only=True)
class ConstantCurrent:
    """Hold ``current_A`` [A] (positive = discharge) until the first of the limits given.

    Parameters
    ----------
    current_A : float
    duration_s : float or None        time in the step [s]
    voltage_min_V, voltage_max_V : float or None   limit on discharge, on charge; None: the model's
    charge_Ah : float or None         charge moved in the step, either way, > 0
    soc : float or None               SOC reached (a design aid: no real tester knows it)
    period_s : float or None          a row every so many seconds; None: the run's own

    Raises
    ------
    InputError        values that are not finite or not positive; nothing that could end the step
    """

    current_A: float
    duration_s: float | None = None
    voltage_min_V: float | None = None
    voltage_max_V: float | None = None
    charge_Ah: float | None = None
    soc: float | None = None
    period_s: float | None = None

    def __post_init__(self) -> None:
        limits = "current_A voltage_min_V voltage_max_V soc"
        _check(self, finite=limits, positive="duration_s charge_Ah period_s")
        if self.current_A == 0.0 and self.duration_s is None:
            raise InputError(
                "a constant current of 0 A without a duration",
                "something that ends the step",
                "Use Rest(duration_s).",
            )


@dataclass(frozen=True, kw_only=True)
class ConstantVoltage:
    """Hold ``voltage_V`` [V] until the current has come down to ``until_current_A`` [A].

    The supply charges or discharges, as the cell asks for, with at most ``current_limit_A`` [A];
    where the voltage is out of its reach it delivers that limit until it gets there (CC, then CV).
    ``duration_s`` [s] ends the step too. Currents are magnitudes.

    Raises
    ------
    InputError        values that are not positive; neither a current nor a duration to end it
    """

    voltage_V: float
    until_current_A: float | None = None
    duration_s: float | None = None
    current_limit_A: float | None = None
    period_s: float | None = None

    def __post_init__(self) -> None:
        ends = "until_current_A duration_s current_limit_A period_s"
        _check(self, finite="voltage_V", positive=ends)
        if self.until_current_A is None and self.duration_s is None:
            raise InputError(
                "a constant voltage without until_current_A or duration_s",
                "something that ends the step: the current only ever approaches zero",
                "Give e.g. until_current_A of a twentieth of the capacity.",
            )
        if (
            self.until_current_A is not None
            and self.current_limit_A is not None
            and self.until_current_A >= self.current_limit_A
        ):
            raise InputError(
                f"until_current_A = {self.until_current_A} with a current limit of "
                f"{self.current_limit_A} A",
                "a final current below the limit",
                "Lower until_current_A.",
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class DriveProfile:
    """Follow a current, row by row; where a voltage limit would be passed, hold the limit.

    Parameters
    ----------
    time_s : (n,) float       rising, from the profile's start [s]; the current of a row flows
                              during the interval that ends there, so a row at 0 has none
    current_A : (n,) float    [A], positive = discharge
    voltage_min_V, voltage_max_V : float or None   limits; None: the model's
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_min_V: float | None = None
    voltage_max_V: float | None = None

    def __post_init__(self) -> None:
        for name in ("time_s", "current_A"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        _check(self, finite="time_s current_A voltage_min_V voltage_max_V")
        rising = self.time_s.ndim == 1 and np.all(np.diff(self.time_s) > 0)
        if (
            not rising
            or self.time_s.shape != self.current_A.shape
            or self.time_s.size == 0
            or self.time_s[0] < 0
            or self.time_s[-1] <= 0
        ):
            raise InputError(
                f"a drive profile with time of shape {self.time_s.shape} and current of shape "
                f"{self.current_A.shape}",
                "one current per instant, instants rising from 0",
                "Count the time from the profile's start, and drop repeated stamps.",
            )


Step = Rest | ConstantCurrent | ConstantVoltage | DriveProfile


def _check(step: object, *, finite: str = "", positive: str = "") -> None:
    """Refuse parameters, named in a text, that are not finite or not above zero; None is none."""
    for name in (*finite.split(), *positive.split()):
        value, above = getattr(step, name), name in positive.split()
        if value is not None and not (np.all(np.isfinite(value)) and (not above or value > 0)):
            expected = "a number above zero" if above else "a finite number"
            found = f"{type(step).__name__} with {name} = {value}"
            raise InputError(found, expected, "Correct it.")

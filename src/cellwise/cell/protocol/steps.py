"""Steps of a tester as frozen records, and the usual laboratory tests as lists of them."""

from __future__ import annotations

from collections.abc import Sequence
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
        _check_positive(self, "duration_s", "period_s")


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
    hold_at_limit : bool              go on at the limit's voltage until the duration is over: a
                                      trimmed pulse. Needs a duration, and no charge or SOC
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
    hold_at_limit: bool = False
    period_s: float | None = None

    def __post_init__(self) -> None:
        _check_finite(self, "current_A", "voltage_min_V", "voltage_max_V", "soc")
        _check_positive(self, "duration_s", "charge_Ah", "period_s")
        if self.current_A == 0.0 and self.duration_s is None:
            raise InputError(
                "a constant current of 0 A without a duration",
                "something that ends the step",
                "Use Rest(duration_s).",
            )
        if self.hold_at_limit and (
            self.duration_s is None or self.charge_Ah is not None or self.soc is not None
        ):
            raise InputError(
                "hold_at_limit with a charge or an SOC to reach, or without a duration",
                "a duration alone: a held current may never move the charge",
                "Give duration_s only, or hold the limit in a ConstantVoltage step of its own.",
            )

    @property
    def limit_V(self) -> float | None:
        """The voltage limit that lies in the current's direction."""
        return self.voltage_min_V if self.current_A > 0 else self.voltage_max_V


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
        _check_finite(self, "voltage_V")
        _check_positive(self, "until_current_A", "duration_s", "current_limit_A", "period_s")
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
        _check_finite(self, "time_s", "current_A", "voltage_min_V", "voltage_max_V")
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


def repeat(count: int, *steps: Step) -> tuple[Step, ...]:
    """The steps ``count`` times over."""
    if count < 1:
        raise InputError(f"a loop of {count} rounds", "at least one", "Correct the count.")
    return steps * count


FAST_REST_S = 30.0  # rows stay close for so long after a switch
TENTHS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)


def capacity_test(
    nominal_Ah: float,
    rate: float,
    *,
    voltage_min_V: float,
    voltage_max_V: float,
    charge_rate: float = 1 / 3,
    cutoff_rate: float = 1 / 20,
    hold_when_empty: bool = False,
    rest_s: float = 3600.0,
    period_s: float | None = None,
) -> tuple[Step, ...]:
    """CC-CV charge, rest, discharge at one rate to the lower limit, rest.

    Parameters
    ----------
    nominal_Ah : float        what rates refer to
    rate : float              of the discharge, in C (0.05 is C/20)
    cutoff_rate : float       current at which a held voltage ends, in C
    hold_when_empty : bool    hold the lower limit after the discharge: the CV part of the second
                              seed paper's capacity table
    period_s : float or None  a row every so many seconds; None: the run's own
    """
    _check_test(nominal_Ah, (rate, charge_rate, cutoff_rate), voltage_min_V, voltage_max_V)
    cutoff = cutoff_rate * nominal_Ah
    hold = ConstantVoltage(voltage_V=voltage_min_V, until_current_A=cutoff, period_s=period_s)
    return (
        ConstantCurrent(
            current_A=-charge_rate * nominal_Ah, voltage_max_V=voltage_max_V, period_s=period_s
        ),
        ConstantVoltage(voltage_V=voltage_max_V, until_current_A=cutoff, period_s=period_s),
        Rest(rest_s, period_s),
        ConstantCurrent(
            current_A=rate * nominal_Ah, voltage_min_V=voltage_min_V, period_s=period_s
        ),
        *((hold,) if hold_when_empty and rate > cutoff_rate else ()),
        Rest(rest_s, period_s),
    )


def hppc_test(
    nominal_Ah: float,
    *,
    voltage_min_V: float,
    voltage_max_V: float,
    rates: Sequence[float] = (0.5, 1.0, 2.0),
    levels: Sequence[float] = TENTHS,
    start_level: float = 1.0,
    pulse_s: float = 10.0,
    pair_rest_s: float = 40.0,
    rest_s: float = 600.0,
    level_rest_s: float = 3600.0,
    move_rate: float = 1 / 3,
    charge_first_below: float = 0.5,
    pulse_period_s: float = 0.1,
    period_s: float = 10.0,
) -> tuple[Step, ...]:
    """Pulse pairs of several rates at several levels of charge.

    A pulse that meets a limit is trimmed: the limit is held until its time is over. Below
    ``charge_first_below`` the charge pulse comes first, so that the pair leads away from the limit
    (second seed paper). Moves between levels are by charge, as a tester counts it, and end at the
    voltage limit.

    Parameters
    ----------
    nominal_Ah : float        what rates and levels refer to
    rates : sequence          of the pulses, in C
    levels : sequence         shares of the nominal charge, falling or rising
    start_level : float       where the cell is when the test begins
    pair_rest_s, rest_s, level_rest_s : float   after the first pulse of a pair, the second, a move
    pulse_period_s, period_s : float            rows in pulses and for 30 s after them; elsewhere
    """
    _check_test(nominal_Ah, (*rates, move_rate), voltage_min_V, voltage_max_V)
    course = np.diff(np.array([start_level, *levels], dtype=np.float64))
    inside = all(0.0 <= x <= 1.0 for x in (start_level, *levels))
    if not (levels and inside and (np.all(course <= 0) or np.all(course >= 0))):
        raise InputError(
            f"levels {list(levels)} from {start_level:g}",
            "levels from 0 to 1 that only fall, or only rise",
            "Sort them from the level where the cell starts.",
        )
    steps: list[Step] = []
    for level, move in zip(levels, course, strict=True):
        if move:
            steps.append(
                ConstantCurrent(
                    current_A=-float(np.sign(move)) * move_rate * nominal_Ah,
                    charge_Ah=abs(float(move)) * nominal_Ah,
                    voltage_min_V=voltage_min_V,
                    voltage_max_V=voltage_max_V,
                    period_s=period_s,
                )
            )
            steps += _relaxation(level_rest_s, pulse_period_s, period_s)
        first = -1.0 if level < charge_first_below else 1.0
        for rate in rates:
            for sign, after_s in ((first, pair_rest_s), (-first, rest_s)):
                steps.append(
                    ConstantCurrent(
                        current_A=sign * rate * nominal_Ah,
                        duration_s=pulse_s,
                        hold_at_limit=True,
                        voltage_min_V=voltage_min_V,
                        voltage_max_V=voltage_max_V,
                        period_s=pulse_period_s,
                    )
                )
                steps += _relaxation(after_s, pulse_period_s, period_s)
    return tuple(steps)


def _relaxation(rest_s: float, fast_s: float, slow_s: float) -> list[Step]:
    """A rest with close rows at first; the slow ones are never so few that they look like a gap."""
    tail = rest_s - FAST_REST_S
    if tail <= 0.0:
        return [Rest(rest_s, fast_s)] if rest_s > 0.0 else []
    return [Rest(FAST_REST_S, fast_s), Rest(tail, max(min(slow_s, tail / 5.0), fast_s))]


def _check_test(
    nominal_Ah: float, rates: Sequence[float], voltage_min_V: float, voltage_max_V: float
) -> None:
    positive = (nominal_Ah, *rates)
    if not all(np.isfinite(x) and x > 0 for x in positive) or not voltage_min_V < voltage_max_V:
        raise InputError(
            f"a test of {nominal_Ah} Ah at rates {list(rates)} from {voltage_min_V} V to "
            f"{voltage_max_V} V",
            "a capacity and rates above zero, a lower limit below the upper",
            "Correct the plan.",
        )


def _check_finite(step: object, *names: str) -> None:
    for name in names:
        value = getattr(step, name)
        if value is not None and not np.all(np.isfinite(value)):
            raise InputError(
                f"{type(step).__name__} with {name} = {value}", "a finite number", "Correct it."
            )


def _check_positive(step: object, *names: str) -> None:
    for name in names:
        value = getattr(step, name)
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(
                f"{type(step).__name__} with {name} = {value}", "a number above zero", "Correct it."
            )

"""Design a test before it is run: steps of a tester, and a virtual supply that runs them.

The supply follows a current and holds a voltage, as the second seed paper's active supply. Limits
are reached exactly: the last interval of a step ends at the instant of the limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.protocol import supply_kernels as kernel
from cellwise.cell.simulate import check_soc0, start_hysteresis
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.files.times import DAY_S
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray

LONGEST_S = 30.0 * DAY_S  # a step that has not ended by then ends, and the log says so
CHUNK_ROWS = 4096
SLIVER = 1e-9  # intervals shorter than this share of a period are rounding


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


def run_protocol(
    model: CellModel,
    steps: Iterable[Step],
    soc0: float,
    dt_s: float = 1.0,
    temperature_C: float = 25.0,
) -> CellLog:
    """Run steps on a model of a cell that begins at rest at ``soc0``.

    Rows follow each other by ``dt_s`` (or the step's own period) and carry the current of the
    interval that ends there; simulating the log again from ``soc0`` gives its voltages back. The
    counter is the true charge. A sampling delay is no property of the cell and left out.

    Parameters
    ----------
    steps : iterable of Step
    dt_s : float              seconds between rows, > 0
    temperature_C : float     of the cell, all the time [degC]

    Returns
    -------
    CellLog           ``step`` counts the steps from 1; ``notices`` names every step that did not
                      end as asked: at its limit from the start, or with no limit in reach when the
                      SOC left the model's tables by 0.05 or 30 days had passed

    Raises
    ------
    InputError        no steps, no step that lasts, soc0 outside 0..1, dt_s not positive
    """
    soc0 = check_soc0(soc0)
    if not (np.isfinite(dt_s) and dt_s > 0 and np.isfinite(temperature_C)):
        raise InputError(
            f"dt_s = {dt_s}, temperature_C = {temperature_C}",
            "seconds above zero and a finite temperature",
            "Correct them.",
        )
    run = _Run(model, empty_state(soc0, start_hysteresis(soc0)), dt_s, temperature_C)
    for step in steps:
        run.step(step)
    return run.log()


class _Run:
    """A cell on a supply, and the rows so far: time, current, voltage, step."""

    def __init__(
        self, model: CellModel, state: CellState, dt_s: float, temperature_C: float
    ) -> None:
        self.tables, self.state = model.parameters(), state
        self.limits = (
            -np.inf if model.voltage_min_V is None else model.voltage_min_V,
            np.inf if model.voltage_max_V is None else model.voltage_max_V,
        )
        self.dt_s, self.temperature_C = dt_s, temperature_C
        self.clock_s, self.number = 0.0, 0
        self.notices: list[Notice] = []
        start_V = kernel.interval(self.tables, state, 0.0, 0.0, temperature_C).voltage_V
        self.parts: list[FloatArray] = [np.array([[0.0], [0.0], [start_V], [1.0]])]

    def step(self, step: Step) -> None:
        """One step, from where the cell is."""
        self.number += 1
        parts, asked = len(self.parts), True
        match step:
            case Rest():
                done = self._even(step, 0.0, 0.0, step.duration_s, (-np.inf, np.inf))
            case ConstantCurrent():
                end_s, asked = self._end_of_current(step)
                done = self._current(step, step.current_A, end_s, self._limits(step))
            case ConstantVoltage():
                end_s, asked = step.duration_s or LONGEST_S, step.duration_s is not None
                done = self._voltage(step, end_s)
            case DriveProfile():
                # A row for each current; where a limit would be passed, it is held.
                flows = step.time_s > 0
                current_A = step.current_A[flows]
                supply = kernel.Supply(*self._limits(step), np.nan, self.temperature_C)
                low, high = np.minimum(current_A, 0.0), np.maximum(current_A, 0.0)
                done = self._supplied(supply, 0.0, step.time_s[flows], low, high)
        self.clock_s += done.elapsed_s
        said = None
        if done.reason == kernel.OUT_OF_RANGE or (done.reason == kernel.ENDED and not asked):
            said = f"ended at SOC {self.state.soc:.3f} or after {done.elapsed_s / 3600:.1f} h "
            said += "with no limit reached"
        elif len(self.parts) == parts:
            said = "at its limit from the start, so it has no row"
        if said is not None:
            self.notices.append(Notice(Code.STEP_NOT_DONE, f"step {self.number}: {said}"))

    def log(self) -> CellLog:
        """What was recorded."""
        if len(self.parts) == 1:
            raise InputError(
                f"{self.number} step(s) of which none lasts",
                "at least one step that lasts",
                "Give steps whose limits are not reached from the start.",
            )
        time, current, voltage, step = np.concatenate(self.parts, axis=1)
        charge = np.cumsum(current * np.diff(time, prepend=0.0)) / 3600.0
        return CellLog(
            time,
            current,
            voltage,
            temperature_C=np.full(time.size, self.temperature_C),
            charge_Ah=charge,
            step=step.astype(np.int32),
            notices=tuple(self.notices),
        )

    def _end_of_current(self, step: ConstantCurrent) -> tuple[float, bool]:
        """When the first limit but the voltage's is reached, and whether the step asked for it."""
        cell, current = self.tables.cell, step.current_A
        asked = [] if step.duration_s is None else [step.duration_s]
        if step.charge_Ah is not None and current:
            asked.append(3600.0 * step.charge_Ah / abs(current))
        if step.soc is not None and current:
            used = current if current > 0.0 else current * cell.charge_efficiency
            asked.append(max((self.state.soc - step.soc) * cell.charge_As / used, 0.0))
        return min([*asked, LONGEST_S]), bool(asked)

    def _limits(self, step: ConstantCurrent | DriveProfile) -> tuple[float, float]:
        """The step's voltages, else the model's, else none."""
        own = (step.voltage_min_V, step.voltage_max_V)
        low, high = (o if s is None else s for s, o in zip(own, self.limits, strict=True))
        return low, high

    def _current(
        self,
        step: ConstantCurrent | ConstantVoltage,
        current_A: float,
        end_s: float,
        limits_V: tuple[float, float],
    ) -> kernel.Progress:
        """A constant current to the instant at which the supply would have to lower it."""
        low, high = min(current_A, 0.0), max(current_A, 0.0)
        return self._even(step, low, high, end_s, limits_V, abs(current_A))

    def _voltage(self, step: ConstantVoltage, end_s: float) -> kernel.Progress:
        """A held voltage; before it, where the supply gives no more, its largest current."""
        at, most = (step.voltage_V, step.voltage_V), step.current_limit_A or np.inf
        supply = kernel.Supply(*at, np.nan, self.temperature_C)
        asked_A = kernel.held(self.tables, self.state, supply, 0.0, -np.inf, np.inf, 0.0).current_A
        elapsed_s = 0.0
        if abs(asked_A) > most:
            first = self._current(step, float(np.copysign(most, asked_A)), end_s, at)
            if first.reason != kernel.AT_LIMIT:
                return first
            elapsed_s = first.elapsed_s
        return self._even(step, -most, most, end_s, at, step.until_current_A, elapsed_s)

    def _even(
        self,
        step: Rest | ConstantCurrent | ConstantVoltage,
        low_A: float,
        high_A: float,
        end_s: float,
        limits_V: tuple[float, float],
        until_A: float | None = None,
        elapsed_s: float = 0.0,
    ) -> kernel.Progress:
        """Rows at the multiples of the step's period and at its end."""
        period = step.period_s or self.dt_s
        until = np.nan if until_A is None else until_A
        supply = kernel.Supply(*limits_V, until, self.temperature_C)
        done = kernel.Progress(self.state, elapsed_s, 0, kernel.ENDED)
        while done.reason == kernel.ENDED and done.elapsed_s < end_s:
            first = np.floor(done.elapsed_s / period + SLIVER) + 1.0
            ends = period * (first + np.arange(CHUNK_ROWS))
            ends = np.append(ends[ends <= end_s - SLIVER * period], end_s)[:CHUNK_ROWS]
            low, high = np.full((2, ends.size), [[low_A], [high_A]])
            done = self._supplied(supply, done.elapsed_s, ends, low, high)
        return done

    def _supplied(
        self,
        supply: kernel.Supply,
        elapsed_s: float,
        end_s: FloatArray,
        low_A: FloatArray,
        high_A: FloatArray,
    ) -> kernel.Progress:
        out = np.empty((kernel.ROW, end_s.size))
        done: kernel.Progress = kernel.supply_rows(
            self.tables, self.state, supply, elapsed_s, end_s, low_A, high_A, out
        )
        self.state = done.state
        if done.rows:
            made = end_s[: done.rows], out[:, : done.rows]
            number = np.full(done.rows, float(self.number))
            self.parts.append(np.vstack((self.clock_s + made[0], made[1], number)))
        return done

"""Design a test before it is run: steps of a tester, and a virtual supply that runs them.

The supply follows a current and holds a voltage, as the second seed paper's active supply. Limits
are reached exactly: the last interval of a step ends at the instant of the limit.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.protocol import supply_kernels as kernel
from cellwise.cell.protocol.steps import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    Step,
)
from cellwise.cell.simulate import check_soc0, start_hysteresis
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

LONGEST_S = 30 * 86400.0  # a step that has not ended by then ends, and the log says so
CHUNK_ROWS = 4096
MOST_ROWS = 50_000_000


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
    check_soc0(soc0)
    if not (np.isfinite(dt_s) and dt_s > 0 and np.isfinite(temperature_C)):
        raise InputError(
            f"dt_s = {dt_s}, temperature_C = {temperature_C}",
            "seconds above zero and a finite temperature",
            "Correct them.",
        )
    start = empty_state(soc0, start_hysteresis(soc0))
    supply = _Supply(model, start, dt_s, temperature_C)
    for step in steps:
        supply.run(step)
    return supply.log()


class _Supply:
    """Runs steps and keeps the rows: time, current, voltage, step."""

    def __init__(
        self, model: CellModel, state: CellState, dt_s: float, temperature_C: float
    ) -> None:
        self.tables = model.parameters()
        self.limits = (model.voltage_min_V, model.voltage_max_V)
        self.state = state
        self.dt_s = dt_s
        self.temperature_C = temperature_C
        self.clock_s = 0.0
        self.number = 0
        self.notices: list[str] = []
        _, voltage = kernel.interval(self.tables, state, 0.0, 0.0, temperature_C)
        self.parts: list[FloatArray] = [np.array([[0.0], [0.0], [voltage], [1.0]])]
        self.rows = 1

    def run(self, step: Step) -> None:
        """One step, from where the cell is."""
        self.number += 1
        rows = self.rows
        match step:
            case Rest():
                progress = self._current(0.0, step.duration_s, self._period(step), np.nan)
            case ConstantCurrent():
                progress = self._constant_current(step)
            case ConstantVoltage():
                progress = self._constant_voltage(step)
            case DriveProfile():
                progress = self._profile(step)
        self.clock_s += progress.elapsed_s
        if progress.reason == kernel.OUT_OF_RANGE:
            self._notice(
                f"ended at SOC {self.state.soc:.3f} or after {progress.elapsed_s / 3600:.1f} h "
                "with no limit reached"
            )
        elif self.rows == rows:
            self._notice("at its limit from the start, so it has no row")

    def log(self) -> CellLog:
        """What was recorded."""
        if self.number == 0 or self.rows == 1:
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

    def _constant_current(self, step: ConstantCurrent) -> kernel.Progress:
        limit = _limit(step.limit_V, self.limits[0] if step.current_A > 0 else self.limits[1])
        end_s, in_range = self._end_of_current(step)
        progress = self._current(step.current_A, end_s, self._period(step), limit)
        if progress.reason == kernel.ENDED and not in_range:
            return progress._replace(reason=kernel.OUT_OF_RANGE)
        return progress

    def _end_of_current(self, step: ConstantCurrent) -> tuple[float, bool]:
        """When the first limit but the voltage's is reached, and whether the step asked for it."""
        current = step.current_A
        asked = [] if step.duration_s is None else [step.duration_s]
        if step.charge_Ah is not None and current:
            asked.append(3600.0 * step.charge_Ah / abs(current))
        if step.soc is not None and current:
            asked.append(max(self._time_to_soc(current, step.soc), 0.0))
        end = min([*asked, self._time_in_range(current), LONGEST_S])
        return end, end in asked

    def _time_to_soc(self, current_A: float, soc: float) -> float:
        scalars = self.tables.cell
        used = current_A if current_A > 0.0 else current_A * scalars.charge_efficiency
        return (self.state.soc - soc) * scalars.charge_As / used

    def _time_in_range(self, current_A: float) -> float:
        """How long a current can flow before the tables say nothing any more [s]."""
        if current_A == 0.0:
            return np.inf
        edge = -kernel.SOC_MARGIN if current_A > 0 else 1.0 + kernel.SOC_MARGIN
        return max(self._time_to_soc(current_A, edge), 0.0)

    def _constant_voltage(self, step: ConstantVoltage) -> kernel.Progress:
        end_s = LONGEST_S if step.duration_s is None else step.duration_s
        most = np.inf if step.current_limit_A is None else step.current_limit_A
        until = np.nan if step.until_current_A is None else step.until_current_A
        period = self._period(step)
        asked = kernel.holding_current(
            self.tables, self.state, step.voltage_V, 0.0, self.temperature_C, -np.inf, np.inf, 0.0
        )
        elapsed = 0.0
        if abs(asked) > most:
            current = float(np.copysign(most, asked))
            in_range_s = self._time_in_range(current)
            first = self._current(current, min(end_s, in_range_s), period, step.voltage_V)
            if first.reason == kernel.ENDED:
                out = in_range_s < end_s
                return first._replace(reason=kernel.OUT_OF_RANGE if out else kernel.ENDED)
            elapsed = first.elapsed_s
        progress = self._voltage((step.voltage_V, -most, most, until), end_s, period, elapsed)
        if progress.reason == kernel.ENDED and step.duration_s is None:
            return progress._replace(reason=kernel.OUT_OF_RANGE)
        return progress

    def _profile(self, step: DriveProfile) -> kernel.Progress:
        flows = step.time_s > 0
        end = np.ascontiguousarray(step.time_s[flows])
        out = np.empty((kernel.ROW, end.size))
        low = _limit(step.voltage_min_V, self.limits[0])
        high = _limit(step.voltage_max_V, self.limits[1])
        current = np.ascontiguousarray(step.current_A[flows])
        progress: kernel.Progress = kernel.profile_rows(
            self.tables, self.state, end, current, low, high, self.temperature_C, out
        )
        self._keep(out, progress)
        return progress

    def _current(
        self, current_A: float, end_s: float, period_s: float, limit_V: float
    ) -> kernel.Progress:
        progress = kernel.Progress(self.state, 0.0, 0, kernel.FULL)
        while progress.reason == kernel.FULL:
            out = np.empty((kernel.ROW, CHUNK_ROWS))
            progress = kernel.constant_current_rows(
                self.tables, self.state, current_A, self.temperature_C, progress.elapsed_s, end_s,
                period_s, limit_V, out,
            )  # fmt: skip
            self._keep(out, progress)
        return progress

    def _voltage(
        self,
        bounds: tuple[float, float, float, float],
        end_s: float,
        period_s: float,
        elapsed_s: float,
    ) -> kernel.Progress:
        progress = kernel.Progress(self.state, elapsed_s, 0, kernel.FULL)
        while progress.reason == kernel.FULL:
            out = np.empty((kernel.ROW, CHUNK_ROWS))
            progress = kernel.constant_voltage_rows(
                self.tables, self.state, *bounds, self.temperature_C, progress.elapsed_s, end_s,
                period_s, out,
            )  # fmt: skip
            self._keep(out, progress)
        return progress

    def _keep(self, out: FloatArray, progress: kernel.Progress) -> None:
        self.state = progress.state
        self.rows += progress.rows
        if self.rows > MOST_ROWS:
            raise InputError(
                f"a protocol of more than {MOST_ROWS} rows",
                "fewer rows",
                "Give a longer period_s or dt_s.",
            )
        if progress.rows:
            part = np.empty((kernel.ROW + 1, progress.rows))
            part[:-1] = out[:, : progress.rows]
            part[kernel.TIME] += self.clock_s
            part[-1] = self.number
            self.parts.append(part)

    def _period(self, step: Rest | ConstantCurrent | ConstantVoltage) -> float:
        return self.dt_s if step.period_s is None else step.period_s

    def _notice(self, text: str) -> None:
        self.notices.append(f"step {self.number}: {text}")


def _limit(own: float | None, of_model: float | None) -> float:
    """The step's limit, else the model's, else none (NaN)."""
    if own is not None:
        return own
    return np.nan if of_model is None else of_model

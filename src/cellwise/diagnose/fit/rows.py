"""Logs made ready for a fit: rows that count, rows held out, blocks of time for the bootstrap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cellwise.cell.equations import empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.point_kernels import R3, TAU2, TAU3
from cellwise.cell.simulate import known_temperature_C, simulate_rows, start_hysteresis
from cellwise.diagnose.causes.coordinates import OCV_NAMES, Coordinates, KernelInputs, step_of
from cellwise.diagnose.fit.rests import NO_READING, RestReading, rest_reading
from cellwise.fit.start import InitialSoc
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IntArray


class Split(NamedTuple):
    """How rows are used.

    ``most_rows`` are compared, over all logs: evidence of more is no better, only slower.
    ``pattern``: which tenths of a log without others to test on are fitted, which are held out;
    ``start_part``: of a log that is held out, which determines its initial SOC and is not scored;
    ``least_blocks`` of time in a log, for the bootstrap. What changes within ``window_s`` is fast:
    an error of its own every so often.
    """

    most_rows: int = 24_000
    pattern: str = "FFHFHFFHFH"
    start_part: float = 0.15
    least_blocks: int = 12
    window_s: float = 100.0


SPLIT = Split()

FITTED, HELD, START = range(3)


@dataclass(frozen=True, eq=False)
class LogRows:
    """One log as the kernels take it, and what its scored rows (every ``stride``-th) are for."""

    log: CellLog
    start: InitialSoc
    dt_s: FloatArray
    current_A: FloatArray
    temperature_C: FloatArray
    stride: int
    role: IntArray
    block: IntArray
    clock_s: FloatArray

    @property
    def scored(self) -> int:
        """Number of scored rows."""
        return int(self.role.size)

    @property
    def voltage_V(self) -> FloatArray:
        """Measured voltage of the scored rows [V]."""
        return self.log.voltage_V[:: self.stride]

    def simulate(
        self, inputs: KernelInputs, soc_shift: float, scored: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Voltage [V] and SOC of its first ``scored`` rows (None: of all).

        From ``soc_shift`` away from the stated start.
        """
        rows = slice(0, None if scored is None else (scored - 1) * self.stride + 1)
        start = empty_state(self.start.soc + soc_shift, start_hysteresis(self.start.soc))
        shifted = shifted_current(self.log.time_s, self.dt_s, self.current_A, inputs.skew_s)
        flow = ((shifted - inputs.offset_A) / inputs.gain)[rows]
        voltage, soc = np.empty(flow.size), np.empty(flow.size)
        dt, warm = self.dt_s[rows], self.temperature_C[rows]
        simulate_rows(inputs.tables, start, dt, flow, warm, voltage, soc)
        return voltage[:: self.stride] + inputs.added_V, soc[:: self.stride]


@dataclass(frozen=True, eq=False)
class Evidence:
    """All logs of a diagnosis; arrays run over the scored rows of one log after the other."""

    logs: tuple[LogRows, ...]
    voltage_V: FloatArray
    known: BoolArray
    role: IntArray
    block: IntArray
    rest: RestReading = NO_READING

    @property
    def rows(self) -> int:
        """Number of scored rows."""
        return int(self.role.size)

    @cached_property
    def fitted(self) -> Evidence:
        """The logs that have rows to fit: those that are only held out are left off."""
        many = sum(bool(np.any(g.role == FITTED)) for g in self.logs)
        return self if many == len(self.logs) else _evidence(self.logs[:many], self.rest)

    def each(self) -> Iterator[tuple[LogRows, slice]]:
        """Every log and where its scored rows stand."""
        place = 0
        for log in self.logs:
            yield log, slice(place, place + log.scored)
            place += log.scored

    @cached_property
    def windows(self) -> tuple[IntArray, IntArray]:
        """First row of every window of time with one role, and the window of every row."""
        new = np.diff(self.role, prepend=-1) != 0
        for log, rows in self.each():
            place = ((log.clock_s - log.clock_s[0]) // SPLIT.window_s).astype(np.int64)
            new[rows] |= np.diff(place, prepend=-1) != 0
        return np.flatnonzero(new).astype(np.int32), (np.cumsum(new) - 1).astype(np.int32)

    def window_means(self, columns: FloatArray) -> FloatArray:
        """Of every row the mean over the known rows of its window; columns (rows, P)."""
        first, window = self.windows
        known = np.where(self.known[:, None], columns, 0.0)
        count = np.maximum(np.add.reduceat(self.known.astype(np.float64), first), 1.0)
        return np.asarray((np.add.reduceat(known, first, axis=0) / count[:, None])[window])

    def starts(self) -> list[str]:
        """Names of the coordinates of the logs' starts."""
        return [f"soc0:{k}" for k in range(len(self.logs))]

    def simulate(
        self, coordinates: Coordinates, z: Mapping[str, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Voltage [V] and SOC of every scored row."""
        inputs = coordinates.inputs(z)
        voltage, soc = zip(*(self.of_log(k, inputs, z) for k in range(len(self.logs))), strict=True)
        return np.concatenate(voltage), np.concatenate(soc)

    def of_log(
        self, k: int, inputs: KernelInputs, z: Mapping[str, float], scored: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The same of one log, or of its first ``scored`` rows: its start, its sensor's offset."""
        voltage, soc = self.logs[k].simulate(inputs, z.get(f"soc0:{k}", 0.0), scored)
        return voltage + z.get(f"offset_V:{k}", 0.0), soc

    @cached_property
    def alone(self) -> range:
        """Numbers of the fitted logs that may differ from others."""
        return range(len(self.fitted.logs)) if len(self.logs) > 1 else range(0)

    def jacobian(
        self, coordinates: Coordinates, z: Mapping[str, float], names: Sequence[str]
    ) -> FloatArray:
        """Derivatives of the simulated voltage by differences, shape (rows, names).

        What only adds to the voltage has no memory and is not simulated. A start moves its own log
        alone, and inwards: full and empty are the ends of its tables.
        """
        if not names:
            return np.empty((self.rows, 0))
        here, soc = self.simulate(coordinates, z)
        inputs = coordinates.inputs(z)
        found = np.zeros((self.rows, len(names)))
        places = {str(k): rows for k, (_, rows) in enumerate(self.each())}
        for j, name in enumerate(names):
            if name == "offset_V" or name in OCV_NAMES:
                found[:, j] = coordinates.added_V(name, soc)
                continue
            step, at = step_of(name), z.get(name, 0.0)
            what, _, log = name.partition(":")
            if not log:
                moved, _ = self.simulate(coordinates, {**z, name: at + step})
                found[:, j] = (moved - here) / step
            elif log in places:
                rows, k = places[log], int(log)
                if what == "offset_V":
                    found[rows, j] = 1.0
                    continue
                step = step if self.logs[k].start.soc + at <= 0.5 else -step
                moved, _ = self.of_log(k, inputs, {**z, name: at + step})
                found[rows, j] = (moved - here[rows]) / step
        return found


def shifted_current(
    time_s: FloatArray, dt_s: FloatArray, current_A: FloatArray, skew_s: float
) -> FloatArray:
    """Mean current over every row's interval moved back by ``skew_s`` [A].

    Row k's current flows from row k - 1 to row k; before the first row and after the last one the
    nearest current flows on. A negative skew moves forward.
    """
    if time_s.size < 2 or skew_s == 0.0:
        return current_A
    charge = np.cumsum(np.concatenate(([0.0], current_A[1:] * dt_s[1:])))
    moment = time_s - skew_s
    j = np.clip(np.searchsorted(time_s, moment), 1, time_s.size - 1)
    at_end = charge[j] - current_A[j] * (time_s[j] - moment)
    lasts = dt_s[1:] > 0.0
    shifted = np.concatenate((current_A[:1], np.diff(at_end) / np.where(lasts, dt_s[1:], 1.0)))
    # In no time flows what flowed before.
    before = np.maximum.accumulate(np.where(np.append(True, lasts), np.arange(time_s.size), 0))
    return np.asarray(shifted[before])


def gather(
    model: CellModel,
    logs: Sequence[tuple[CellLog, InitialSoc]],
    holdout: Sequence[tuple[CellLog, InitialSoc]] = (),
    whole: bool = False,
) -> Evidence:
    """Make logs ready: rows thinned evenly, fitted and held-out rows marked.

    Without ``holdout`` the later blocks of every log are held out; with it every row of ``logs`` is
    fitted, and each held-out log is scored after its first part, which determines its initial SOC.
    ``whole`` fits every row: nothing is held out.
    """
    stride = max(1, -(-sum(len(g) for g, _ in (*logs, *holdout)) // SPLIT.most_rows))
    table, _, _ = model.parameters()
    slow = [TAU2, TAU3] if np.any(table[..., R3]) else [TAU2]
    slowest_s = float(np.max(np.median(table[..., slow], axis=(0, 1))))
    made: list[LogRows] = []
    for k, (log, start) in enumerate((*logs, *holdout)):
        clock = log.time_s[::stride]
        span = max(float(clock[-1] - clock[0]), 1e-9)
        part = (clock - clock[0]) / span
        tenth = np.minimum((part * len(SPLIT.pattern)).astype(np.int64), len(SPLIT.pattern) - 1)
        if k >= len(logs):
            role = np.where(part < SPLIT.start_part, START, HELD)
        elif whole or holdout:
            role = np.full(clock.size, FITTED)
        else:
            role = np.where(np.array(list(SPLIT.pattern))[tenth] == "F", FITTED, HELD)
        # Blocks for the bootstrap: as long as the slowest memory, but enough of them to draw from.
        length = min(max(slowest_s, span / 60.0), span / SPLIT.least_blocks)
        block = (part * span / length).astype(np.int64)
        block += int(made[-1].block.max()) + 1 if made else 0
        warm, current = known_temperature_C(model, log), log.known_current_A()
        rows = LogRows(
            log, start, log.interval_s, current, warm, stride, role.astype(np.int32),
            block.astype(np.int32), clock,
        )  # fmt: skip
        made.append(rows)
    return _evidence(tuple(made), rest_reading([g.log for g in made], model.capacity_Ah))


def _evidence(logs: tuple[LogRows, ...], rest: RestReading = NO_READING) -> Evidence:
    """Evidence of logs that are ready."""
    voltage = np.concatenate([g.voltage_V for g in logs])
    return Evidence(
        logs,
        voltage,
        np.isfinite(voltage),
        np.concatenate([g.role for g in logs]),
        np.concatenate([g.block for g in logs]),
        rest,
    )

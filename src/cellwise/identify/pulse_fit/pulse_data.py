"""One pulse cut out of a log: its rows, its edges, and the charge behind every row."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import BoolArray, FloatArray


class _Rows(NamedTuple):
    """Rows of a window, settled ones of them for seven unknowns, and what a row may count.

    A relaxation row may count at most so much less or more than a pulse row.
    """

    window: int = 12
    settled: int = 10
    balance: tuple[float, float] = (0.02, 5.0)


ROWS = _Rows()


class _Settling(NamedTuple):
    """When a current switches, and when the voltage after a switch is still arriving.

    A tester that filters its voltage, or a double layer far faster than tau1, makes the voltage
    arrive some rows after the current. Such rows follow an edge one by one, each still moving the
    same way. Fitted, they take R0 of Panasonic at 25 degC down by a quarter and its residual from
    0.7 to 1.5 mV.
    """

    edge: float = 0.2  # of the pulse's current: so large a change from row to row is an edge
    still: float = 0.02  # of it: with so small a change the current stands still
    edge_rows: int = 3  # at most
    moving: float = 0.03  # of the whole step: a voltage that moves by more arrives ...
    noises: float = 6.0  # ... if it is more than so many standard deviations of the noise, too
    longest_s: float = 0.6
    early: float = 0.5  # of the step: so much before the current, and the voltage has stepped


SETTLING = _Settling()


@dataclass(frozen=True, eq=False)
class PulseData:
    """Rows of one pulse: what was before, some rest, the pulse, its relaxation up to a current.

    Parameters
    ----------
    time_s : (n,) float         [s]
    current_A : (n,) float      current during the interval that ends at each row [A], positive =
                                discharge
    voltage_V : (n,) float      [V]
    charge_Ah : (n,) float      charge discharged since the first row [Ah]
    start, stop : int           first row of the pulse; first row after it
    capacity_Ah : float         turns charge into SOC [Ah]
    soc_start : float           SOC at the first row [0..1]; NaN if unknown
    first : int                 first row that is compared; the rows before only say what the
                                branches hold, as after a short rest
    ocv_change_V : (n,) float or None   what a tabulated OCV says the OCV changed by since the
                                first row [V]; then no OCV slope is fitted
    name : str                  for people

    Raises
    ------
    InputError        too few rows

    See Also
    --------
    cellwise.identify.fitted_pulses : cuts one out of a log
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    charge_Ah: FloatArray
    start: int
    stop: int
    capacity_Ah: float
    soc_start: float = float("nan")
    first: int = 0
    ocv_change_V: FloatArray | None = None
    name: str = ""

    def __post_init__(self) -> None:
        for field in ("time_s", "current_A", "voltage_V", "charge_Ah", "ocv_change_V"):
            value = getattr(self, field)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, field, array)
        rows = len(self) - self.first
        if rows < ROWS.window:
            raise InputError(
                f"{rows} rows in pulse '{self.name}'",
                f"at least {ROWS.window}",
                "Log the pulse faster, or leave it out.",
            )

    def __len__(self) -> int:
        return self.time_s.size

    def _moved_early(self, before: int, edge: int) -> bool:
        """Whether the voltage stepped at row ``before`` already, ahead of the current.

        Switched late in that row's interval: its mean current is next to nothing, or next to all.
        """
        if before < 1:
            return False
        v = self.voltage_V
        whole = abs(v[edge] - v[before - 1])
        return bool(abs(v[before] - v[before - 1]) > SETTLING.early * whole)

    @property
    def interval_s(self) -> FloatArray:
        """Length of the interval that ends at each row [s], shape (n,); 0 for the first row."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    @property
    def charge_fraction(self) -> FloatArray:
        """Charge discharged since the first row, over capacity [-], shape (n,)."""
        fraction: FloatArray = (self.charge_Ah - self.charge_Ah[0]) / self.capacity_Ah
        return fraction

    @property
    def pulse_current_A(self) -> float:
        """Mean current of the pulse [A], positive = discharge."""
        dt = self.interval_s[self.start : self.stop]
        current = self.current_A[self.start : self.stop]
        whole = float(np.sum(dt))
        return float(np.sum(current * dt)) / whole if whole > 0.0 else float(np.mean(current))

    @property
    def pulse_duration_s(self) -> float:
        """From the pulse's first edge to its last [s]."""
        return float(self.time_s[self.stop - 1] - self.time_s[max(self.start - 1, 0)])

    @property
    def pulse_centre(self) -> float:
        """`charge_fraction` at the pulse's mean SOC [-]."""
        fraction = self.charge_fraction
        return 0.5 * float(fraction[max(self.start - 1, 0)] + fraction[self.stop - 1])

    def alone(self) -> PulseData:
        """The compared rows, for a method that knows of nothing before them."""
        rows = slice(self.first, None)
        change = self.ocv_change_V
        return replace(
            self,
            time_s=self.time_s[rows],
            current_A=self.current_A[rows],
            voltage_V=self.voltage_V[rows],
            charge_Ah=self.charge_Ah[rows] - self.charge_Ah[self.first],
            ocv_change_V=None if change is None else change[rows] - change[self.first],
            start=self.start - self.first,
            stop=self.stop - self.first,
            first=0,
            soc_start=self.soc_start - float(self.charge_fraction[self.first]),
        )

    @property
    def soc(self) -> float:
        """Mean SOC of the pulse: the middle between before and after [0..1]."""
        return float(self.soc_start - self.pulse_centre)

    @property
    def settling_rows(self) -> BoolArray:
        """Rows at an edge that no fit should see, shape (n,); none on most testers.

        Either the current is still on its way (a switch inside the row's interval: its mean
        current is not what flows when the voltage is read), or the voltage is still arriving, see
        `_Settling`. A property of the data, not of a fit.
        """
        rows = np.zeros(len(self), dtype=np.bool_)
        change = np.abs(np.diff(self.current_A, prepend=self.current_A[0]))
        peak = float(np.max(np.abs(self.current_A[self.start : self.stop])))
        noise = voltage_noise(self)
        moving = np.flatnonzero(change > SETTLING.still * peak)
        for group in np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1):
            if group.size == 0 or group.size > SETTLING.edge_rows:
                continue  # no edge, or a current that never stands still
            if np.max(change[group]) < SETTLING.edge * peak:
                continue
            before, edge = int(group[0]) - 1, int(group[-1])
            before -= self._moved_early(before, edge)
            rows[before + 1 : edge] = True
            until = self.time_s[before] + SETTLING.longest_s
            last = int(np.searchsorted(self.time_s, until, side="right"))
            moves = np.diff(self.voltage_V[before:last])
            if moves.size <= edge - before:
                continue
            step = float(np.sum(moves[: edge - before]))
            moves *= np.sign(step)
            whole = max(float(np.sum(moves)), abs(step))
            still = moves[edge - before :] > max(SETTLING.moving * whole, SETTLING.noises * noise)
            rows[edge : edge + (still.size if still.all() else int(np.argmin(still)))] = True
        in_pulse = rows[self.start : self.stop]
        if 2 * np.count_nonzero(in_pulse) > in_pulse.size:  # a pulse too short to settle
            in_pulse[:] = False
        return rows


def voltage_noise(data: PulseData) -> float:
    """Standard deviation of the voltage's row-to-row noise [V], from its second differences.

    Robust (median of magnitudes), so edges and relaxation do not count.
    """
    second = np.abs(np.diff(data.voltage_V[data.first :], 2))
    return float(np.median(second) / (0.6745 * np.sqrt(6.0)))


def row_weights(data: PulseData) -> FloatArray:
    """How much each row counts in a fit, shape (n,), mean 1 over the rows that count.

    The relaxation as a whole counts as much as the pulse as a whole, within limits per
    row. A tester may log 100 rows in a 10 s pulse and 1,700 in the rest that follows, or 600 rows
    of 0.1 s and then 20 of 60 s; as no cell is exactly a 2-RC circuit, the side with more rows
    would decide alone, and the result would depend on the tester's settings.

    Rows before `PulseData.first`, and rows at an edge that have not settled
    (`PulseData.settling_rows`), count zero.
    """
    weight = np.ones(len(data))
    pulse, relaxation = data.stop - data.start, len(data) - data.stop
    if relaxation > 0:
        weight[data.stop :] = np.clip(pulse / relaxation, *ROWS.balance)
    weight[: data.first] = 0.0
    weight[data.settling_rows] = 0.0
    return weight * (np.count_nonzero(weight) / max(float(np.sum(weight)), 1e-300))


def has_enough_rows(data: PulseData) -> bool:
    """Whether a fit finds the rows that it needs."""
    return int(np.count_nonzero(row_weights(data))) >= ROWS.settled

"""One pulse cut out of a log: the rest before, the pulse, its relaxation, and what a row counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.identify.hppc.plateaus import DRIFT, SIGMAS
from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

OcvTable = Callable[[FloatArray], FloatArray]


class _PulseWindow(NamedTuple):
    """How much of a log belongs to a pulse, and what its rows count."""

    rest_s: float = 60.0  # of rest before it that is compared, if there is as much
    rest_rows: int = 3  # at least
    before_s: float = 600.0  # shown before it: branches of minutes have forgotten what was earlier
    balance: tuple[float, float] = (0.02, 5.0)  # of a relaxation row over a pulse row


class _Settling(NamedTuple):
    """When a current switches, and when the voltage after a switch is still arriving.

    A tester that filters its voltage, or a double layer far faster than tau1, makes the voltage
    arrive some rows after the current. Such rows follow an edge one by one, each still moving the
    same way, by more than DRIFT of the step and SIGMAS of the noise. Fitted, they take R0 of
    Panasonic at 25 degC down by a quarter and its residual from 0.7 to 1.5 mV.
    """

    edge: float = 0.2  # of the pulse's current: so large a change from row to row is an edge
    still: float = 0.02  # of it: with so small a change the current stands still
    edge_rows: int = 3  # at most
    longest_s: float = 0.6
    early: float = 0.5  # of the step: so much before the current, and the voltage has stepped


WINDOW, SETTLING = _PulseWindow(), _Settling()


@dataclass(frozen=True, eq=False)
class PulseData:
    """Rows of one pulse with a voltage: what was before, some rest, the pulse, its relaxation.

    Parameters
    ----------
    time_s, voltage_V : (n,) float
    current_A : (n,) float      of the interval that ends at each row, positive = discharge
    soc : (n,) float            [0..1]
    start, stop : int           first row of the pulse; first row after it
    first : int                 first row that is compared; the rows before only say what the
                                branches hold, as after a short rest
    ocv_V : (n,) float          what a table says of each row; a constant without one
    name : str                  for people
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    soc: FloatArray
    start: int
    stop: int
    first: int
    ocv_V: FloatArray
    name: str = ""

    @property
    def interval_s(self) -> FloatArray:
        """Length of the interval that ends at each row [s], shape (n,); 0 for the first row."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    @property
    def pulse_current_A(self) -> float:
        """Mean current of the pulse [A], positive = discharge."""
        rows = slice(self.start, self.stop)
        dt = self.interval_s[rows]
        return float(np.average(self.current_A[rows], weights=dt if np.any(dt > 0.0) else None))

    @property
    def pulse_duration_s(self) -> float:
        """From the pulse's first edge to its last [s]."""
        return float(self.time_s[self.stop - 1] - self.time_s[max(self.start - 1, 0)])

    @property
    def mean_soc(self) -> float:
        """The middle between before and after the pulse [0..1]."""
        return 0.5 * float(self.soc[max(self.start - 1, 0)] + self.soc[self.stop - 1])

    @property
    def noise_V(self) -> float:
        """Row-to-row noise of the voltage [V]: median of second differences, edges do not count."""
        second = np.abs(np.diff(self.voltage_V[self.first :], 2))
        return float(np.median(second) / (0.6745 * np.sqrt(6.0))) if second.size else 0.0

    @property
    def settling_rows(self) -> BoolArray:
        """Rows at an edge that no fit should see, shape (n,); none on most testers.

        Either the current is still on its way (a switch inside the row's interval: its mean
        current is not what flows when the voltage is read), or the voltage is still arriving, see
        `_Settling`.
        """
        t, v, start = self.time_s, self.voltage_V, self.start
        rows = np.zeros(t.size, dtype=np.bool_)
        change = np.abs(np.diff(self.current_A, prepend=self.current_A[0]))
        peak = float(np.max(np.abs(self.current_A[start : self.stop])))
        moving = np.flatnonzero(change > SETTLING.still * peak)
        for group in np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1):
            # A current that never stands still has no edge.
            if not 0 < group.size <= SETTLING.edge_rows:
                continue
            if np.max(change[group]) < SETTLING.edge * peak:
                continue
            before, edge = int(group[0]) - 1, int(group[-1])
            # Switched late in a row: its mean current is next to nothing, its voltage has stepped.
            if before >= 1 and abs(v[before] - v[before - 1]) > SETTLING.early * abs(
                v[edge] - v[before - 1]
            ):
                before -= 1
            rows[before + 1 : edge] = True
            until = int(np.searchsorted(t, t[before] + SETTLING.longest_s, side="right"))
            moves = np.diff(v[before:until])
            moves *= np.sign(np.sum(moves[: edge - before]))
            least = max(DRIFT * float(np.sum(moves)), SIGMAS * self.noise_V)
            after = moves[edge - before :] > max(least, 0.0)
            rows[edge : edge + (after.size if after.all() else int(np.argmin(after)))] = True
        if 2 * np.count_nonzero(rows[start : self.stop]) > self.stop - start:
            rows[start : self.stop] = False  # a pulse too short to settle
        return rows

    @property
    def weight(self) -> FloatArray:
        """How much each row counts in a fit, shape (n,), mean 1 over those that do.

        The relaxation as a whole counts as much as the pulse as a whole, within limits per row: a
        tester may log 100 rows in a pulse and 1,700 in the rest that follows, and as no cell is
        exactly a 2-RC circuit the side with more rows would decide alone. Rows that are not
        compared, or have not settled, count zero.
        """
        weight = np.ones(self.time_s.size)
        relaxation = weight.size - self.stop
        if relaxation > 0:
            weight[self.stop :] = np.clip((self.stop - self.start) / relaxation, *WINDOW.balance)
        weight[: self.first] = 0.0
        weight[self.settling_rows] = 0.0
        return weight * (np.count_nonzero(weight) / max(float(np.sum(weight)), 1e-300))


def pulse_data(
    time_s: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    soc: FloatArray,
    start: int,
    stop: int,
    *,
    first: int = 0,
    ocv: OcvTable | None = None,
    name: str = "",
) -> PulseData:
    """One pulse from plain arrays; rows without a finite voltage are dropped.

    The charge that flowed up to a dropped row stays in the interval of the row that follows.

    Parameters
    ----------
    time_s, current_A, voltage_V, soc : (n,) float     as in `PulseData`; voltage may hold NaN
    start, stop, first : int     as in `PulseData`
    ocv : callable               tabulated OCV: SOC array -> voltage array [V]
    """
    keep = np.flatnonzero(np.isfinite(voltage_V))
    time, current, at = time_s[keep], current_A[keep], soc[keep]
    if 0 < keep.size < time_s.size:
        moved = np.cumsum(current_A * np.diff(time_s, prepend=time_s[0]))[keep]
        dt = np.diff(time, prepend=time[0])
        current = np.divide(np.diff(moved, prepend=0.0), dt, out=current.copy(), where=dt > 0.0)
    start, stop, first = (int(np.searchsorted(keep, row)) for row in (start, stop, first))
    table = np.zeros(keep.size) if ocv is None else np.asarray(ocv(at), dtype=np.float64)
    return PulseData(time, current, voltage_V[keep], at, start, stop, first, table, name)


def cut_pulse(
    log: CellLog, pulse: Pulse, soc: FloatArray, ocv: OcvTable | None = None
) -> PulseData:
    """Cut a pulse that `find_pulses` found out of its log.

    What is compared begins a minute before the pulse and ends before the next current or a gap. Ten
    minutes before the pulse are shown, too: what its branches hold comes from there.

    Parameters
    ----------
    soc : (n,) float          of every row of the log [0..1]
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]; None: it stands still
    """
    time, start, stop = log.time_s, pulse.start, pulse.stop
    # The row before the next current may hold part of its switch.
    switch = pulse.relax_stop < time.size and pulse.relax_stop > stop + 1
    end = pulse.relax_stop - switch
    gaps = np.flatnonzero(log.gap_rows)
    end = min([end, *gaps[(gaps > stop) & (gaps < end)]])
    began_s = time[max(start - 1, 0)]
    shown = int(np.searchsorted(time, began_s - WINDOW.rest_s))
    first = max(pulse.rest_before_start, min(shown, start - WINDOW.rest_rows), 0)
    before = int(np.searchsorted(time, began_s - WINDOW.before_s))
    before = min(max([before, *gaps[gaps <= first]]), first)
    rows = slice(before, end)
    return pulse_data(
        time[rows],
        log.known_current_A()[rows],
        log.voltage_V[rows],
        soc[rows],
        start - before,
        stop - before,
        first=first - before,
        ocv=ocv,
        name=f"{log.name} at {time[start]:.0f} s",
    )

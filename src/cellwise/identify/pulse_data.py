"""One pulse cut out of a log: its rows, its edges, and the charge behind every row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray

MINIMUM_ROWS = 12
MINIMUM_PULSE_ROWS = 3
REST_SHOWN_S = 60.0  # rest before the pulse that a window shows, if there is as much
EDGE_PART = 0.2  # a row-to-row change of current by this part of the pulse's current is an edge
# A tester that filters its voltage, or a double layer far faster than tau1, makes the voltage
# arrive some rows after the current. Such rows follow an edge one by one, each still moving the
# same way by more than this part of the whole step.
SETTLING_PART = 0.03
SETTLING_LIMIT_S = 0.6
# A relaxation row may count at most so much more or less than a pulse row.
BALANCE_LIMITS = (0.02, 5.0)

Weighting = Literal["balanced", "rows"]


@dataclass(frozen=True, eq=False)
class PulseData:
    """Rows of one pulse: some rest, the pulse, its relaxation up to the next current.

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
    rest_before_s : float       how long the cell had rested before the pulse [s]; may be longer
                                than the window shows
    ocv_change_V : (n,) float or None   what a tabulated OCV says the OCV changed by since the
                                first row [V]; then no OCV slope is fitted
    name : str                  for people

    Raises
    ------
    InputError        lengths that differ, values that are not finite, time running backwards, a
                      pulse without current, too few rows

    See Also
    --------
    pulse_from_arrays, cut_pulse : build one, dropping rows without a voltage
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    charge_Ah: FloatArray
    start: int
    stop: int
    capacity_Ah: float
    soc_start: float = float("nan")
    rest_before_s: float = float("inf")
    ocv_change_V: FloatArray | None = None
    name: str = ""

    def __post_init__(self) -> None:
        n = np.asarray(self.time_s).size
        for field in ("time_s", "current_A", "voltage_V", "charge_Ah", "ocv_change_V"):
            value = getattr(self, field)
            if value is None:
                continue
            array = np.ascontiguousarray(value, dtype=np.float64)
            _check_channel(array, n, f"{field} of {self._where}")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        self._check_pulse(n)

    def __len__(self) -> int:
        return self.time_s.size

    @property
    def _where(self) -> str:
        return f"pulse '{self.name}'" if self.name else "the pulse"

    def _check_pulse(self, n: int) -> None:
        if np.any(np.diff(self.time_s) < 0):
            raise InputError(
                f"time running backwards in {self._where}",
                "time that never decreases",
                "Sort the rows, or split the log where its clock was reset.",
            )
        if not 0 <= self.start < self.stop <= n:
            raise InputError(
                f"edges at rows {self.start} and {self.stop} of {n} in {self._where}",
                "0 <= start < stop <= number of rows",
                "Give the first row of the pulse and the first row after it.",
            )
        if self.stop - self.start < MINIMUM_PULSE_ROWS or n < MINIMUM_ROWS:
            raise InputError(
                f"{self.stop - self.start} rows with current of {n} in {self._where}",
                f"at least {MINIMUM_PULSE_ROWS} rows with current of at least {MINIMUM_ROWS}",
                "Log the pulse faster, or leave it out.",
            )
        if not np.any(self.current_A[self.start : self.stop] != 0.0):
            raise InputError(
                f"no current between the edges of {self._where}",
                "a current pulse",
                "Check the current column and the rows of the edges.",
            )
        if not (np.isfinite(self.capacity_Ah) and self.capacity_Ah > 0.0):
            raise InputError(
                f"capacity_Ah = {self.capacity_Ah} for {self._where}",
                "a capacity above zero [Ah]",
                "Give the capacity of the cell that was pulsed.",
            )

    @property
    def interval_s(self) -> FloatArray:
        """Length of the interval that ends at each row [s], shape (n,); 0 for the first row."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    @property
    def charge_fraction(self) -> FloatArray:
        """Charge discharged since the first row, over capacity [-], shape (n,)."""
        return (self.charge_Ah - self.charge_Ah[0]) / self.capacity_Ah

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

    @property
    def soc(self) -> float:
        """Mean SOC of the pulse: the middle between before and after [0..1]."""
        return self.soc_start - self.pulse_centre

    @property
    def settling_rows(self) -> BoolArray:
        """Rows right after an edge where the voltage is still arriving, shape (n,).

        A property of the voltage and not of a fit: see `SETTLING_PART`. None on most testers.
        """
        rows = np.zeros(len(self), dtype=np.bool_)
        jump = np.abs(np.diff(self.current_A, prepend=self.current_A[0]))
        peak = float(np.max(np.abs(self.current_A)))
        noise = voltage_noise(self)
        for edge in np.flatnonzero(jump > EDGE_PART * peak):
            if edge == 0 or (edge > 1 and jump[edge - 1] > EDGE_PART * peak):
                continue
            last = int(np.searchsorted(self.time_s, self.time_s[edge - 1] + SETTLING_LIMIT_S))
            moves = np.diff(self.voltage_V[edge - 1 : last + 1])
            if moves.size < 2:
                continue
            moves *= np.sign(moves[0])
            whole = max(float(np.sum(moves)), float(moves[0]))
            still = moves[1:] > max(SETTLING_PART * whole, 6.0 * noise)
            count = int(np.argmin(still)) if not still.all() else still.size
            rows[edge : edge + count] = True
        return rows


def voltage_noise(data: PulseData) -> float:
    """Standard deviation of the voltage's row-to-row noise [V], from its second differences.

    Robust (median of magnitudes), so edges and relaxation do not count.
    """
    second = np.abs(np.diff(data.voltage_V, 2))
    return float(np.median(second)) / (0.6745 * np.sqrt(6.0))


def row_weights(data: PulseData, weighting: Weighting = "balanced") -> FloatArray:
    """How much each row counts in a fit, shape (n,), mean 1 over the rows that count.

    ``rows``: every row is one measurement. Best when the noise is white and the model exact.

    ``balanced``: the relaxation as a whole counts as much as the pulse as a whole, within
    `BALANCE_LIMITS` per row. A tester may log 100 rows in a 10 s pulse and 1,700 in the rest that
    follows, or 600 rows of 0.1 s and then 20 of 60 s; as no cell is exactly a 2-RC circuit, the
    side with more rows would decide alone, and the result would depend on the tester's settings.
    Where both have about as many rows the two choices agree.

    Rows where the voltage is still settling (`PulseData.settling_rows`) count zero in both.

    Raises
    ------
    InputError        another name
    """
    weight = np.ones(len(data))
    if weighting == "balanced":
        pulse, relaxation = data.stop - data.start, len(data) - data.stop
        if relaxation > 0:
            weight[data.stop :] = np.clip(pulse / relaxation, *BALANCE_LIMITS)
    elif weighting != "rows":
        raise InputError(
            f"weighting = {weighting!r}", "'balanced' or 'rows'", "Choose one of the two."
        )
    settling = data.settling_rows
    weight[settling] = 0.0
    return weight * (np.count_nonzero(~settling) / float(np.sum(weight)))


def pulse_from_arrays(
    time_s: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    rest_before_s: float | None = None,
    ocv: Callable[[FloatArray], FloatArray] | None = None,
    name: str = "",
) -> PulseData:
    """One pulse from plain arrays; rows without a finite voltage are dropped.

    The charge that flowed up to a dropped row stays in the interval of the row that follows.

    Parameters
    ----------
    time_s, current_A, voltage_V : (n,) float     as in `PulseData`; voltage may hold NaN
    start, stop : int         first row of the pulse; first row after it
    capacity_Ah : float       [Ah]
    soc_start : float         SOC at the first row [0..1]; needed with ``ocv``
    rest_before_s : float     rest before the pulse [s]; by default what the rows show
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]
    name : str                for people

    Raises
    ------
    InputError        as `PulseData`; an OCV table without a SOC
    """
    time = np.asarray(time_s, dtype=np.float64)
    current = np.asarray(current_A, dtype=np.float64)
    voltage = np.asarray(voltage_V, dtype=np.float64)
    where = f"pulse '{name}'" if name else "the pulse"
    _check_channel(time, time.size, f"time_s of {where}")
    _check_channel(current, time.size, f"current_A of {where}")
    _check_channel(np.where(np.isfinite(voltage), voltage, 0.0), time.size, f"voltage_V of {where}")
    keep = np.flatnonzero(np.isfinite(voltage))
    dt = np.diff(time, prepend=time[0]) if time.size else time
    charge = np.cumsum(current * dt) / 3600.0
    if keep.size < time.size:
        current = _merged_current(time, current, charge, keep)
        start, stop = (int(np.searchsorted(keep, row)) for row in (start, stop))
        time, voltage, charge = time[keep], voltage[keep], charge[keep]
        charge = charge - charge[0] if charge.size else charge
    if rest_before_s is None:
        rest_before_s = float(time[start - 1] - time[0]) if 0 < start < time.size else 0.0
    change = None
    if ocv is not None:
        if not np.isfinite(soc_start):
            raise InputError(
                f"an OCV table but no SOC for {where}",
                "soc_start, the SOC at the window's first row",
                "Give soc_start, or leave the OCV slope to the fit.",
            )
        table = np.asarray(ocv(soc_start - charge / capacity_Ah), dtype=np.float64)
        change = table - table[0]
    return PulseData(
        time, current, voltage, charge, start, stop, capacity_Ah,
        soc_start, rest_before_s, change, name,
    )  # fmt: skip


def cut_pulse(
    log: CellLog,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    ocv: Callable[[FloatArray], FloatArray] | None = None,
    rest_shown_s: float = REST_SHOWN_S,
    relaxation_s: float = float("inf"),
    name: str = "",
) -> PulseData:
    """Cut the pulse in rows ``start`` to ``stop`` (not included) out of a log.

    The window begins up to ``rest_shown_s`` before the pulse and ends before the next current, a
    gap, or ``relaxation_s`` after the pulse. ``soc_start`` is the SOC right before the pulse.

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    current = log.known_current_A()
    if not 0 <= start < stop <= len(log):
        raise InputError(
            f"edges at rows {start} and {stop} of a log of {len(log)} rows",
            "0 <= start < stop <= number of rows",
            "Give the first row of the pulse and the first row after it.",
        )
    quiet = np.abs(current) < 0.02 * np.max(np.abs(current[start:stop]))
    broken = ~quiet | log.gap_rows
    before = np.flatnonzero(broken[:start])
    rest = int(before[-1]) if before.size else 0
    after = np.flatnonzero(broken[stop:])
    end = stop + int(after[0]) if after.size else len(log)
    shown = int(np.searchsorted(log.time_s, log.time_s[max(start - 1, 0)] - rest_shown_s))
    first = max(rest, min(shown, start - 3), 0)
    end = min(end, int(np.searchsorted(log.time_s, log.time_s[stop - 1] + relaxation_s, "right")))
    end = max(end, stop)
    return pulse_from_arrays(
        log.time_s[first:end],
        current[first:end],
        log.voltage_V[first:end],
        start - first,
        stop - first,
        capacity_Ah,
        soc_start=soc_start,
        rest_before_s=float(log.time_s[max(start - 1, 0)] - log.time_s[rest]),
        ocv=ocv,
        name=name or log.name,
    )


def _merged_current(
    time: FloatArray, current: FloatArray, charge: FloatArray, keep: np.ndarray
) -> FloatArray:
    """Interval current of the rows kept: unchanged, or the mean over the rows dropped before."""
    merged = current[keep].copy()
    late = np.flatnonzero(np.diff(keep, prepend=-1) > 1)
    for k in late:
        if k == 0:
            continue
        dt = time[keep[k]] - time[keep[k - 1]]
        if dt > 0.0:
            merged[k] = 3600.0 * (charge[keep[k]] - charge[keep[k - 1]]) / dt
    return merged


def _check_channel(array: FloatArray, rows: int, what: str) -> None:
    if array.ndim != 1 or array.size != rows:
        raise InputError(
            f"{what} of shape {array.shape}",
            f"one value per row, shape ({rows},)",
            "Give every channel the length of time_s.",
        )
    if not np.all(np.isfinite(array)):
        row = int(np.flatnonzero(~np.isfinite(array))[0])
        raise InputError(
            f"{array[row]} in row {row} of {what}",
            "finite values",
            "Drop or repair the row; pulse_from_arrays drops rows without a voltage.",
        )

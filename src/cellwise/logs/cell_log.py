"""A measured log of one cell: arrays with units, sign and meaning."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellwise.errors import InputError
from cellwise.typing import BoolArray, FloatArray, IntArray

CurrentMeaning = Literal["interval_end", "interval_start"]

# A pause counts as a gap when it is this many times longer than the logging interval on
# either side of it: testers slow down from 1 s to 60 s rows at rest without losing anything.
GAP_FACTOR = 10.0
GAP_NEIGHBOURS = 5
GAP_MINIMUM_S = 2.0


@dataclass(frozen=True)
class Gap:
    """A pause in the log, never bridged in silence.

    ``row`` is the row that ends the pause. ``charge_Ah`` is what the tester's own counter says
    flowed meanwhile (positive = discharge), None without a counter.
    """

    row: int
    start_s: float
    duration_s: float
    charge_Ah: float | None


@dataclass(frozen=True, eq=False, repr=False)
class CellLog:
    """One cell, one log.

    Parameters
    ----------
    time_s : (n,) float         seconds from the log's start, never decreasing
    current_A : (n,) float      positive = discharge; NaN where missing
    voltage_V : (n,) float      terminal voltage; NaN where missing
    temperature_C : (n,) float or None    surface temperature
    charge_Ah : (n,) float or None        the tester's own counter, discharge positive
    step : (n,) int or None               tester step
    name, source : str          for people: what it is, where it came from
    current_meaning : str       ``interval_end``: the current of row k flowed during the interval
                                that ends at row k (what testers mean); ``interval_start``: it
                                flows from row k on

    Raises
    ------
    InputError        unequal lengths, fewer than two rows, time that is not finite or runs
                      backwards, a channel without one finite value
    """

    time_s: FloatArray
    current_A: FloatArray
    voltage_V: FloatArray
    temperature_C: FloatArray | None = None
    charge_Ah: FloatArray | None = None
    step: IntArray | None = None
    name: str = ""
    source: str = ""
    current_meaning: CurrentMeaning = "interval_end"

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(np.asarray(self.time_s)))
        where = f"log '{self.name or self.source}'" if self.name or self.source else "the log"
        for field in ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah"):
            value = getattr(self, field)
            if value is None:
                continue
            array = np.ascontiguousarray(value, dtype=np.float64)
            if array.ndim != 1 or array.size != n:
                raise InputError(
                    f"{field} of shape {array.shape} in {where}",
                    f"one value per row, shape ({n},) as time_s",
                    "Give every channel the length of time_s.",
                )
            if field != "time_s":
                # An infinite reading is a missing reading: it must not reach a sum.
                array = np.where(np.isfinite(array), array, np.nan)
                if field in ("current_A", "voltage_V") and np.all(np.isnan(array)):
                    raise InputError(
                        f"no finite value of {field} in {where}",
                        "at least some measured values",
                        "Check which column was taken for it.",
                    )
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if self.step is not None:
            object.__setattr__(self, "step", np.ascontiguousarray(self.step, dtype=np.int32))
        _check_time(self.time_s, where)

    def __len__(self) -> int:
        return self.time_s.size

    def __repr__(self) -> str:
        return (
            f"CellLog({self.name or self.source or 'unnamed'}: {len(self)} rows, "
            f"{self.duration_s / 3600:.2f} h, {np.nanmin(self.current_A):.2f} to "
            f"{np.nanmax(self.current_A):.2f} A, {np.nanmin(self.voltage_V):.3f} to "
            f"{np.nanmax(self.voltage_V):.3f} V)"
        )

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def interval_s(self) -> FloatArray:
        """Length of the interval that ends at each row [s], shape (n,); 0 for the first row."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    @property
    def interval_current_A(self) -> FloatArray:
        """Current during the interval that ends at each row [A], shape (n,)."""
        if self.current_meaning == "interval_end":
            return self.current_A
        return np.concatenate(([self.current_A[0]], self.current_A[:-1]))

    @property
    def gap_rows(self) -> BoolArray:
        """True for a row that ends a gap, shape (n,)."""
        return find_gaps(self.time_s)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The log's gaps, in order."""
        rows = np.flatnonzero(self.gap_rows)
        return tuple(
            Gap(
                row=int(k),
                start_s=float(self.time_s[k - 1]),
                duration_s=float(self.time_s[k] - self.time_s[k - 1]),
                charge_Ah=None
                if self.charge_Ah is None
                else float(self.charge_Ah[k] - self.charge_Ah[k - 1]),
            )
            for k in rows
        )

    @property
    def repeated_stamps(self) -> int:
        """Number of rows that carry the same time as the row before."""
        return int(np.count_nonzero(np.diff(self.time_s) == 0.0))

    def known_current_A(self) -> FloatArray:
        """Current of each interval with gaps and missing values filled by a stated policy [A].

        Over a gap, and where the current is missing, it is what the tester's counter says flowed;
        without a counter, zero over a gap (a pause is a rest until somebody says otherwise) and
        the last known value where single samples are missing.

        Returns
        -------
        (n,) float        finite everywhere
        """
        current = self.interval_current_A.copy()
        dt = self.interval_s
        missing = np.isnan(current)
        gaps = self.gap_rows
        if not missing.any() and not gaps.any():
            return current
        if missing.any():
            index = np.where(missing, 0, np.arange(current.size))
            np.maximum.accumulate(index, out=index)
            current = current[index]
            current[np.isnan(current)] = 0.0
        current[gaps] = 0.0
        if self.charge_Ah is not None:
            moved = np.diff(self.charge_Ah, prepend=self.charge_Ah[0])
            use = (missing | gaps) & (dt > 0) & np.isfinite(moved)
            current[use] = 3600.0 * moved[use] / dt[use]
        return current

    def counted_charge_Ah(self) -> FloatArray:
        """Charge removed since the first row [Ah], shape (n,): the counter, else the current's sum.

        The counter starts at zero here whatever it read at the first row.
        """
        if self.charge_Ah is not None and np.all(np.isfinite(self.charge_Ah)):
            return self.charge_Ah - self.charge_Ah[0]
        return np.cumsum(self.known_current_A() * self.interval_s) / 3600.0

    def part(self, start: int, stop: int) -> CellLog:
        """Rows ``start`` to ``stop`` (not included) as a log of their own, time kept."""
        return self.rows(np.arange(*slice(start, stop).indices(len(self))))

    def rows(self, rows: IntArray | BoolArray | FloatArray) -> CellLog:
        """The log with the chosen rows only, time kept."""

        def take(a: FloatArray | None) -> FloatArray | None:
            return None if a is None else a[rows]

        return replace(
            self,
            time_s=self.time_s[rows],
            current_A=self.current_A[rows],
            voltage_V=self.voltage_V[rows],
            temperature_C=take(self.temperature_C),
            charge_Ah=take(self.charge_Ah),
            step=None if self.step is None else self.step[rows],
        )


def find_gaps(time_s: FloatArray) -> BoolArray:
    """Rows that end a pause far longer than the logging interval on both sides of it.

    Parameters
    ----------
    time_s : (n,) float       never decreasing [s]

    Returns
    -------
    (n,) bool
    """
    dt = np.diff(time_s)
    found = np.zeros(time_s.size, dtype=np.bool_)
    if dt.size == 0:
        return found
    suspects = np.flatnonzero(dt > GAP_MINIMUM_S)
    if suspects.size > dt.size // 4:  # a slow log: look only where the interval stands out
        suspects = suspects[dt[suspects] > GAP_FACTOR * np.median(dt)]
    for k in suspects:
        before = dt[max(0, k - GAP_NEIGHBOURS) : k]
        after = dt[k + 1 : k + 1 + GAP_NEIGHBOURS]
        usual = max(
            float(np.median(before)) if before.size else 0.0,
            float(np.median(after)) if after.size else 0.0,
        )
        found[k + 1] = usual > 0.0 and dt[k] > max(GAP_MINIMUM_S, GAP_FACTOR * usual)
    return found


def _check_time(time_s: FloatArray, where: str) -> None:
    if time_s.size < 2:
        raise InputError(
            f"{time_s.size} row(s) in {where}",
            "at least two rows",
            "Check that the file is complete.",
        )
    if not np.all(np.isfinite(time_s)):
        row = int(np.flatnonzero(~np.isfinite(time_s))[0])
        raise InputError(
            f"time_s = {time_s[row]} at row {row} of {where}",
            "a finite time in every row",
            "Drop the row or repair its stamp.",
        )
    back = np.flatnonzero(np.diff(time_s) < 0)
    if back.size:
        k = int(back[0])
        raise InputError(
            f"time running backwards in {where}: {time_s[k]:.3f} s at row {k}, then "
            f"{time_s[k + 1]:.3f} s ({back.size} such rows)",
            "time that never decreases",
            "Sort the rows, or split the file where the clock was reset.",
        )

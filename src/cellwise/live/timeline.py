"""From the stamps of a stream to intervals: late samples, gaps, clocks that were set."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from cellwise.logs.gaps import GAP

# A jump further than this is a broken stamp until more samples say the same.
JUMP_S = 3600.0
AGREEING = 5


class Interval(NamedTuple):
    """The interval that ends at a sample, and whether its current is unknown."""

    dt_s: float
    gap: bool


class Timeline:
    """Takes stamps in the order in which samples come.

    A gap is what :func:`cellwise.logs.gaps.find_gaps` calls one, detected from the past alone. A
    sample that is older than the one before comes late and is left out. A stamp that jumps back, or
    forward by more than an hour, is left out until five samples in a row go on from there: then
    the sender's clock was set, and what has passed is what this machine's clock says.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self._arrived_s = math.nan
        self._intervals: deque[float] = deque(maxlen=GAP.neighbours)
        self._strange: deque[float] = deque(maxlen=AGREEING)

    def resume(self, away_s: float) -> None:
        """Make the next sample end a gap of this length, as after a restart."""
        self._away_s: float | None = max(away_s, 0.0)

    _away_s: float | None = None

    def advance(self, time_s: float, arrived_s: float = math.nan) -> Interval | None:
        """The interval that a stamp ends, or None for a sample to leave out.

        Parameters
        ----------
        time_s : float        stamp of the sample [s]
        arrived_s : float     when it came, by this machine's clock [s]
        """
        if not math.isfinite(time_s):
            return None
        if math.isnan(self.time_s):
            away, self._away_s = self._away_s, None
            self._accept(time_s, arrived_s)
            return Interval(0.0, gap=False) if away is None else Interval(away, gap=True)
        dt = time_s - self.time_s
        if dt < 0.0 or dt > JUMP_S:
            if not self._clock_was_set(time_s):
                return None
            passed = arrived_s - self._arrived_s
            away = passed if passed > 0.0 else max(dt, 0.0)
            self._accept(time_s, arrived_s)
            self._intervals.clear()
            return Interval(away, gap=True)
        gap = self._is_gap(dt)
        self._accept(time_s, arrived_s)
        if dt > 0.0:
            self._intervals.append(dt)
        return Interval(dt, gap)

    def _accept(self, time_s: float, arrived_s: float) -> None:
        self.time_s = time_s
        self._arrived_s = arrived_s
        self._strange.clear()

    def _clock_was_set(self, time_s: float) -> bool:
        """Whether enough samples in a row go on from a strange stamp."""
        strange = self._strange
        if strange and not 0.0 < time_s - strange[-1] <= JUMP_S:
            strange.clear()
        strange.append(time_s)
        return len(strange) == AGREEING

    def _is_gap(self, dt: float) -> bool:
        if dt <= GAP.least_s or not self._intervals:
            return False
        longest = sorted(self._intervals)
        usual = longest[-2] if len(longest) >= 3 else longest[-1]
        return dt > GAP.times * usual and dt > GAP.beside * self._intervals[-1]

"""A displayed percentage beside the estimate, as products show it.

It never moves against the current, stands still at rest, is 0 where the device switches off and
100 where its charger ends, and takes a correction of the estimate in as charge flows, not at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import rows
from cellwise.cell.model import CellModel
from cellwise.errors import InputError
from cellwise.estimate.replay import Replay
from cellwise.forecast.charging import HELD_V
from cellwise.forecast.remaining import ForecastTrace
from cellwise.typing import FloatArray

CATCH_UP = 0.1
IDLE_C = 0.005  # a load of C/200 is a current sensor's offset as well
LARGEST_EMPTY = 0.5  # a load at which half of the charge cannot be had is not what a device does
LEAST_SPAN = 1e-6  # of the charge: a difference is gone at the very end


class PercentageDisplay(NamedTuple):
    """How a percentage is shown.

    Parameters
    ----------
    charge_As : float     the cell's capacity [As]
    catch_up : float      share of it over which a difference from the estimate falls to 37 %
    idle_A : float        less than this moves nothing
    cutoff_V : float      at this voltage on a load the device switches off
    limit_V : float       at this voltage a charger ends
    taper_A : float       with less than this current
    """

    charge_As: float
    catch_up: float
    idle_A: float
    cutoff_V: float
    limit_V: float
    taper_A: float


@rows
def moved_on(shown: float, target: float, moved: float, catch_up: float) -> float:
    r"""A share that goes down with a load, 0..1, towards where the estimate goes.

    .. math:: \Delta s = -q - e \left(1 - e^{-q / \min(c, t)}\right) \le 0, \qquad e = s - t - q

    with the charge counted q, the estimate t, the share shown s and ``catch_up`` c. The difference
    e is gone where the estimate is at its end, and what is shown never goes up.
    """
    span = max(min(catch_up, target), LEAST_SPAN)
    gap = shown - target - moved
    down = moved + gap * (1.0 - math.exp(-moved / span))
    return min(max(shown - max(down, 0.0), 0.0), 1.0)


@rows
def displayed(
    how: PercentageDisplay,
    ends: tuple[float, float],
    shown: float,
    soc: float,
    current_A: float,
    voltage_V: float,
    dt_s: float,
) -> float:
    """The share shown after a sample, 0..1; NaN before: it begins where the estimate is.

    ``ends``: SOC at which forecasts say that the device switches off, and that its charger ends.
    """
    empty = min(max(ends[0], 0.0), LARGEST_EMPTY)
    width = min(max(ends[1], empty + LARGEST_EMPTY), 1.0) - empty
    target = min(max((soc - empty) / width, 0.0), 1.0)
    moved = abs(current_A) * dt_s / (how.charge_As * width)
    if shown != shown:
        return target
    if current_A > how.idle_A:
        if voltage_V <= how.cutoff_V:
            return 0.0
        return moved_on(shown, target, moved, how.catch_up)
    if current_A < -how.idle_A:
        if voltage_V >= how.limit_V and -current_A <= how.taper_A:
            return 1.0
        return 1.0 - moved_on(1.0 - shown, 1.0 - target, moved, how.catch_up)
    return shown


@rows
def displayed_rows(
    how: PercentageDisplay,
    ends: tuple[FloatArray, FloatArray],
    log: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    out: FloatArray,
) -> None:
    """Every row of a log: both ``ends``, ``log`` SOC, current, voltage, interval."""
    empty, full = ends
    soc, current_A, voltage_V, dt_s = log
    shown = math.nan
    for k in range(soc.size):
        here = empty[k], full[k]
        shown = displayed(how, here, shown, soc[k], current_A[k], voltage_V[k], dt_s[k])
        out[k] = shown


def display_of(
    model: CellModel, cutoff_V: float, limit_V: float, taper_A: float, catch_up: float = CATCH_UP
) -> PercentageDisplay:
    """How a percentage of this cell is shown.

    Parameters
    ----------
    cutoff_V : float        voltage of a cell at which the device switches off
    limit_V, taper_A : float    of its charger
    catch_up : float        share of the charge over which a difference falls to 37 %, 0.001..1

    Raises
    ------
    InputError              ``catch_up`` out of range
    """
    if not 1e-3 <= catch_up <= 1.0:
        raise InputError(
            f"a display that catches up over {catch_up:g} of the charge",
            "0.001 (at once) to 1 (slowly)",
            "Give 0.1, say.",
        )
    idle_A = IDLE_C * model.capacity_Ah
    charge_As = 3600.0 * model.capacity_Ah
    return PercentageDisplay(charge_As, catch_up, idle_A, cutoff_V, limit_V - HELD_V, taper_A)


class Displayed:
    """What is shown, sample by sample."""

    def __init__(self, how: PercentageDisplay) -> None:
        self.share = math.nan
        self._how = how
        self._empty, self._full = 0.0, 1.0

    def expect(self, empty_soc: float | None = None, full_soc: float | None = None) -> None:
        """What forecasts say of the SOC at which the device switches off, its charger ends."""
        self._empty = self._empty if empty_soc is None else empty_soc
        self._full = self._full if full_soc is None else full_soc

    def take(self, soc: float, current_A: float, voltage_V: float, dt_s: float) -> float:
        """Percentage after a sample; a missing current moves nothing."""
        ends = self._empty, self._full
        amps = current_A if math.isfinite(current_A) else 0.0
        self.share = displayed(self._how, ends, self.share, soc, amps, voltage_V, dt_s)
        return 100.0 * self.share


def display_along(
    how: PercentageDisplay,
    replay: Replay,
    flight: ForecastTrace | None,
    charge: ForecastTrace | None,
) -> FloatArray:
    """Percentage at every row of a replay, shape (n,), with what its forecasts say of the ends."""
    log = replay.log
    ends = _held(log.time_s, flight, 0.0), _held(log.time_s, charge, 1.0)
    current = np.ascontiguousarray(log.known_current_A())
    soc, out = np.ascontiguousarray(replay.trace.soc), np.empty(len(log))
    displayed_rows(how, ends, (soc, current, np.array(log.voltage_V), log.interval_s), out)
    return 100.0 * out


def _held(time_s: FloatArray, forecasts: ForecastTrace | None, before: float) -> FloatArray:
    """SOC at the end by the last forecast, at every time; ``before`` the first one."""
    if forecasts is None:
        return np.full(time_s.size, before)
    place = np.searchsorted(forecasts.time_s, time_s, "right") - 1
    return np.where(place < 0, before, forecasts.end_soc[np.maximum(place, 0)])

"""A percentage for people beside an estimate: one step, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import rows
from cellwise.typing import FloatArray

LEAST_SPAN = 1e-6  # of the charge: a difference is gone at the very end


class Display(NamedTuple):
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


class Bounds(NamedTuple):
    """SOC at which the device switches off, and at which its charger ends."""

    empty: float
    full: float


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
    how: Display,
    bounds: Bounds,
    shown: float,
    soc: float,
    current_A: float,
    voltage_V: float,
    dt_s: float,
) -> float:
    """The share shown after a sample, 0..1; NaN before: it begins where the estimate is."""
    width = bounds.full - bounds.empty
    target = min(max((soc - bounds.empty) / width, 0.0), 1.0)
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
    how: Display,
    bounds: tuple[FloatArray, FloatArray],
    log: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    out: FloatArray,
) -> None:
    """Every row of a log: ``bounds`` empty and full, ``log`` SOC, current, voltage, interval."""
    empty, full = bounds
    soc, current_A, voltage_V, dt_s = log
    shown = math.nan
    for k in range(soc.size):
        here = Bounds(empty[k], full[k])
        shown = displayed(how, here, shown, soc[k], current_A[k], voltage_V[k], dt_s[k])
        out[k] = shown

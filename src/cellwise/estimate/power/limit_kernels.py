"""The largest load that stays within every limit over a horizon, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from cellwise.cell.compiled import kernel, part, rows
from cellwise.cell.equations import CellTables
from cellwise.cell.packed import record_at
from cellwise.estimate.noise import NoiseScalars
from cellwise.estimate.power.load_kernels import Held, Present, moment_of, voltage_margin
from cellwise.typing import FloatArray

# Which limit a load reaches first.
BY_VOLTAGE, BY_CURRENT, BY_SOC, BY_SUPPLY = range(4)
IMPOSSIBLE = -1.0


class Search(NamedTuple):
    """How the largest load is looked for."""

    widenings: int = 24  # doublings of the bracket at most
    trials: int = 60  # false positions at most
    tolerance: float = 1e-6  # of the load
    near: float = 0.02  # of the load: how far a neighbour's answer is tried to either side


SEARCH = Search()

SUSTAINED_SIGMAS = 1.6449  # one-sided 95 % of a normal distribution


class LimitScalars(NamedTuple):
    """Limits of a cell as the kernels see them; currents without sign, infinite where none is."""

    low_V: float
    high_V: float
    discharge_A: float
    charge_A: float
    low_soc: float
    high_soc: float


class Trial(NamedTuple):
    """A load that was tried: where it leads, its room to the nearest limit, which one that is.

    ``off_V`` is by how much the voltage may be lower or higher than it says.
    """

    load: Held
    off_V: float
    margin: float
    reason: int


class Capability(NamedTuple):
    """The largest load: power and current at the horizon's end, without sign, and what limits it.

    ``load`` is what was held, with its sign; ``voltage_V`` the terminal voltage at the end.
    """

    power_W: float
    current_A: float
    voltage_V: float
    reason: int
    load: float


@part
def trial(
    tables: CellTables,
    noise: NoiseScalars,
    limits: LimitScalars,
    now: Present,
    load: float,
    power: bool,
    horizon_s: float,
    side: float,
    sigmas: float,
) -> Trial:
    """Hold one load, with its sign; the margin to the nearest limit is above 0 within all.

    Margins are compared as shares: a volt, the largest current, all of the SOC.
    """
    there, off_V = voltage_margin(tables, noise, now, load, power, horizon_s, side, sigmas)
    if not there.possible:
        return Trial(there, 0.0, IMPOSSIBLE, BY_SUPPLY)
    off_soc = sigmas * math.sqrt(now.soc_variance)
    if side > 0.0:
        margin = there.lowest_V - off_V - limits.low_V
        most_A = limits.discharge_A
        soc = there.end.soc - off_soc - limits.low_soc
    else:
        margin = limits.high_V - there.highest_V - off_V
        most_A = limits.charge_A
        soc = limits.high_soc - there.end.soc - off_soc
    reason = BY_VOLTAGE
    if math.isfinite(most_A):
        left = (most_A - there.largest_A) / max(most_A, 1e-12)
        if left < margin:
            margin = left
            reason = BY_CURRENT
    if soc < margin:
        margin = soc
        reason = BY_SOC
    return Trial(there, off_V, margin, reason)


@kernel
def largest_load(
    tables: CellTables,
    noise: NoiseScalars,
    limits: LimitScalars,
    now: Present,
    power: bool,
    horizon_s: float,
    side: float,
    sigmas: float,
    guess: float,
) -> Capability:
    """The largest load that stays within the limits, on discharge (``side`` 1) or charge (-1).

    Bracketed, then false position (Illinois) on the margin to the nearest limit, which falls as
    the load grows. Not even no load: the power is 0.

    Source: G. Plett, High-performance battery-pack power estimation using a dynamic cell model,
    IEEE Trans. Veh. Technol. 53 (2004) 1586, 10.1109/TVT.2004.832408, section IV (bisection).

    Parameters
    ----------
    power : bool      hold a power, not a current
    sigmas : float    deviations of the voltage and of the SOC to keep from the limits
    guess : float     the answer of a neighbour, as a size; 0: none
    """
    none = moment_of(tables, now.cell, 0.0, False, now.temperature_C, now.but)
    far_V = none.voltage_V - limits.low_V if side > 0.0 else limits.high_V - none.voltage_V
    # As if R0 alone took it all: more than a cell gives, for most.
    b = max(far_V, 1e-3) / max(none.point.r0_ohm, 1e-9)
    most_A = limits.discharge_A if side > 0.0 else limits.charge_A
    b = min(b, 1.001 * most_A + 1e-9)
    if power:
        b *= max(limits.low_V if side > 0.0 else limits.high_V, 1e-3)
    start = 0.0
    if guess > 0.0:
        start = (1.0 - SEARCH.near) * guess
    best = trial(tables, noise, limits, now, side * start, power, horizon_s, side, sigmas)
    if start > 0.0 and best.margin > 0.0:
        b = (1.0 + SEARCH.near) * guess
    elif start > 0.0:
        b = start
        start = 0.0
        best = trial(tables, noise, limits, now, 0.0, power, horizon_s, side, sigmas)
    a = start
    fa = best.margin
    if not fa > 0.0:
        return Capability(0.0, 0.0, best.load.voltage_V, best.reason, 0.0)
    worst = best
    for _ in range(SEARCH.widenings):
        worst = trial(tables, noise, limits, now, side * b, power, horizon_s, side, sigmas)
        if not worst.margin > 0.0:
            break
        a, fa, best = b, worst.margin, worst
        b *= 2.0
    fb = worst.margin
    reason = worst.reason
    last = 0
    for k in range(SEARCH.trials):
        if fb > 0.0 or b - a <= SEARCH.tolerance * b:
            break
        c = (a * fb - b * fa) / (fb - fa)
        # A jump (a power that no current gives) or a kink: halve now and then.
        if k % 4 == 3 or not (a < c < b):
            c = 0.5 * (a + b)
        there = trial(tables, noise, limits, now, side * c, power, horizon_s, side, sigmas)
        if there.margin > 0.0:
            a, fa, best = c, there.margin, there
            if last == 1:
                fb *= 0.5
            last = 1
            if there.margin < SEARCH.tolerance:
                reason = there.reason
                break
        else:
            b, fb, reason = c, there.margin, there.reason
            if last == -1:
                fa *= 0.5
            last = -1
    end_A = abs(best.load.current_A)
    end_W = a if power else end_A * (best.load.voltage_V - best.off_V)
    return Capability(end_W, end_A, best.load.voltage_V, reason, side * a)


@kernel
def present_at(values: FloatArray, k: int) -> Present:
    """One row as it was put."""
    now: Present = record_at(Present, values[k], 0, 1)
    return now


@rows
def power_rows(
    tables: CellTables,
    noise: NoiseScalars,
    limits: LimitScalars,
    power: bool,
    horizons_s: FloatArray,
    present: FloatArray,
    guess: FloatArray,
    out: FloatArray,
) -> None:
    """Power of every row, shape (rows, horizons, ways, 5), from rows that hold a `Present` each.

    On discharge and on charge the power, its lower bound, current and voltage at the horizon's end
    and what limits it. ``guess``, of the shape of a row, holds loads to begin at; it is written.
    """
    for k in range(present.shape[0]):
        now = present_at(present, k)
        for j in range(horizons_s.size):
            for way in range(2):
                side = 1.0 - 2.0 * way
                found = largest_load(
                    tables, noise, limits, now, power, horizons_s[j], side, 0.0, guess[j, way, 0]
                )
                low = largest_load(
                    tables, noise, limits, now, power, horizons_s[j], side, SUSTAINED_SIGMAS,
                    guess[j, way, 1],
                )  # fmt: skip
                guess[j, way, 0], guess[j, way, 1] = abs(found.load), abs(low.load)
                out[k, j, way, 0] = found.power_W
                out[k, j, way, 1] = min(low.power_W, found.power_W)
                out[k, j, way, 2] = found.current_A
                out[k, j, way, 3] = found.voltage_V
                out[k, j, way, 4] = found.reason

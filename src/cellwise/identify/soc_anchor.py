"""Where on the SOC axis a log begins: by its rests on the OCV, full or empty where it says so."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellwise.cell.initial_soc.initial_soc import STATED_STD, InitialSoc
from cellwise.cell.initial_soc.rest import Branches, rested_ocv, usual_load
from cellwise.errors import InputError
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.ocv.ocv_rests import find_ocv_rests
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray


class Anchor(NamedTuple):
    """What shows where a log begins, and how far it may be off.

    Parameters
    ----------
    rest_rate, rest_s : float   rests: below a rate [1/h], of a length [s]
    first_s : float             without one the first rows [s]
    past_s : float              load that an unknown past is taken to be like [s]
    ocv_V : float               error of a finished rest [V]
    capacity : float            of the charge between a rest and the start: another age, temperature
    later_rests : float         later rests share one capacity and one OCV, and are wrong together:
                                all of them count as so many
    r, tau_s : tuple            branches before any is fitted: parts of the rough resistance, [s]
    white_V : float             noise of a voltage [V]
    """

    rest_rate: float = 0.01
    rest_s: float = 600.0
    first_s: float = 60.0
    past_s: float = 600.0
    ocv_V: float = 0.005
    capacity: float = 0.03
    later_rests: float = 2.0
    r: tuple[float, ...] = (0.4, 0.5, 0.5)
    tau_s: tuple[float, ...] = (3.0, 60.0, 1200.0)
    white_V: float = 0.001


class FullTest(NamedTuple):
    """When a log began full.

    Every second one does, to ``std``, and any other SOC is as likely as the next: by ``odds``. A
    test of the capacity that does not seem below ``likely``, and has ``moved`` no more before its
    discharge.
    """

    odds: float = 2.0
    likely: float = 0.8
    moved: float = 0.01
    std: float = 0.01


ANCHOR, FULL_TEST = Anchor(), FullTest()
Evidence = list[tuple[float, float, float]]


def anchor_soc(
    log: CellLog, ocv: OcvCurve, capacity_Ah: float, resistance_ohm: float
) -> InitialSoc:
    """SOC at the first row: as stated of the log, else what fits the rests of the whole log best.

    Every rest says where the log stood on the OCV, the counter says how far that is from the
    start; on a steep OCV a rest counts more than on a flat one. Without a rest, the first minute
    under load counts with its ohmic drop taken out.

    Parameters
    ----------
    ocv : OcvCurve            a gap between its branches widens what a rest may read
    capacity_Ah : float       that SOC refers to
    resistance_ohm : float    rough resistance of the cell, for a start under load

    Raises
    ------
    InputError        a log without a single voltage
    """
    if log.soc0 is not None:
        return InitialSoc(log.soc0, STATED_STD, "stated")
    grid = np.linspace(0.0, 1.0, 1001)
    level = np.maximum.accumulate(ocv.function.evaluate(grid))
    half = np.zeros(grid.size)  # of the gap between the low-rate branches, where both are known
    if ocv.gap_V is not None and np.any(there := np.isfinite(ocv.gap_V)):
        half = 0.5 * np.abs(np.interp(grid, ocv.soc[there], ocv.gap_V[there]))
    slope = np.gradient(level, grid)
    seen, how = _evidence(log, capacity_Ah, resistance_ohm)
    later = [abs(q) > 1e-3 * capacity_Ah for q, _, _ in seen]
    shared = min(1.0, ANCHOR.later_rests / max(sum(later), 1))
    cost = np.zeros(grid.size)
    for (q, v, e), is_later in zip(seen, later, strict=True):
        at = grid - q / capacity_Ah
        # The further from the start, the more a capacity of another temperature or age matters.
        scale = np.interp(at, grid, slope) * ANCHOR.capacity * abs(q) / capacity_Ah
        wide = np.sqrt(e**2 + np.interp(at, grid, half) ** 2 + scale**2)
        # Beyond an end of the curve that end is meant.
        away = np.clip(v, level[0], level[-1]) - np.interp(at, grid, level)
        outside = np.maximum(0.0, np.maximum(at - 1.0, -at))  # beyond full or empty is unlikely
        weight = shared if is_later else 1.0
        cost += weight * np.minimum((away / wide) ** 2, 25.0) + (outside / 0.01) ** 2
    likely = np.exp(-0.5 * (cost - cost.min()))
    mean = float(np.average(grid, weights=likely))
    std = float(np.sqrt(np.average((grid - mean) ** 2, weights=likely)))
    before = float(np.min(log.counted_charge_Ah())) / capacity_Ah
    for charged, said in ((0.0, "full"), (before, "charged full later")):
        if likely_full(mean - charged, std):
            known = min(max(std, 0.005), FULL_TEST.std)
            return InitialSoc(max(1.0 + charged, 0.0), known, f"{how}: {said}")
    return InitialSoc(mean, max(std, 0.002), how)


def likely_full(soc: float, std: float) -> bool:
    """Whether a log that seems to begin at ``soc`` +- ``std`` began full, surely enough."""
    wide = max(std, FULL_TEST.std)
    density = math.exp(-0.5 * ((1.0 - soc) / wide) ** 2) / (math.sqrt(2.0 * math.pi) * wide)
    return density > FULL_TEST.odds


def full_before(
    log: CellLog, discharge: BoolArray, capacity_Ah: float, anchor: InitialSoc
) -> InitialSoc:
    """The start of a test that begins full: what SOC means is that its discharge begins at 1.

    Parameters
    ----------
    discharge : (n,) bool     rows of its discharge
    anchor : InitialSoc        where it would begin by its voltages
    """
    before = float(log.counted_charge_Ah()[int(np.argmax(discharge))]) / capacity_Ah
    if anchor.soc < FULL_TEST.likely or abs(before) > FULL_TEST.moved:
        return anchor
    return InitialSoc(1.0, min(anchor.std, FULL_TEST.std), "a test of the capacity: full")


def mean_current_A(log: CellLog) -> float:
    """Of the log's first minutes, which a past that nobody saw is taken to be like [A]."""
    early = log.time_s <= log.time_s[0] + ANCHOR.past_s
    return float(np.mean(log.known_current_A()[early]))


def _evidence(log: CellLog, capacity_Ah: float, resistance_ohm: float) -> tuple[Evidence, str]:
    """Charge since the start, voltage at rest and its error, of every rest worth using."""
    current = log.known_current_A()
    charge = log.counted_charge_Ah()
    finite = np.isfinite(log.voltage_V)
    if not finite.any():
        raise InputError(
            f"no voltage in log '{log.name}'", "measured voltages", "Check the column."
        )
    found = [
        (r.charge_Ah, r.final_V, ANCHOR.ocv_V + 0.5 * abs(r.remaining_V))
        for r in find_ocv_rests(log, min_rest_s=ANCHOR.rest_s)
        if r.duration_s >= ANCHOR.rest_s
    ]
    loaded = np.abs(current) >= ANCHOR.rest_rate * capacity_Ah
    resting = finite[: int(np.argmax(loaded)) if loaded.any() else len(log)]
    last = int(np.flatnonzero(resting)[-1]) if resting.any() else 0
    # One row without current is no rest, and a car at a light has come from a load.
    if log.time_s[last] > log.time_s[0]:
        rows, use = np.flatnonzero(resting), slice(last + 1, None)
        tau_s = np.array(ANCHOR.tau_s)
        load = usual_load(log.interval_s[use], current[use], tau_s, capacity_Ah)
        branches = Branches(resistance_ohm * np.array(ANCHOR.r), tau_s)
        rest = rested_ocv(log.time_s[rows], log.voltage_V[rows], ANCHOR.white_V, branches, load)
        found.append((float(charge[last]), rest.ocv_V, float(np.hypot(ANCHOR.ocv_V, rest.std_V))))
    if found:
        return found, f"{len(found)} rest(s) on the OCV"
    head = finite & (log.time_s <= log.time_s[0] + ANCHOR.first_s)
    # What builds up over minutes is as much again, if the load has lasted; half of that is likely.
    slow = resistance_ohm * mean_current_A(log)
    lifted = float(np.mean(log.voltage_V[head] + resistance_ohm * current[head])) + slow
    # In the cold the drop after seconds is several times the one after milliseconds.
    error = 2 * ANCHOR.ocv_V + 1.5 * resistance_ohm * float(np.mean(np.abs(current[head])))
    return [(float(np.mean(charge[head])), lifted, error)], "first minute under load"

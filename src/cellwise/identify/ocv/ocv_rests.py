"""Open-circuit voltage from the rests of a log: before every pulse, after every move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.hppc.phases import Phase, find_phases
from cellwise.identify.ocv.curve import OUTSIDE, POINTS, OcvCurve, curve_from_points
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray
from cellwise.wording import arg


class _RestLimits(NamedTuple):
    """Which rests say something of OCV, and how much."""

    # Shorter rests show relaxation more than OCV, unless there are not as many longer ones.
    rest_s: float = 300.0
    average_s: float = 10.0  # at a rest's end, as in the LFP paper
    current: float = 0.01  # of the largest: a phase called rest that moved more was none
    unrelaxed_V: float = 5e-3  # a rest that is this far from its end counts half
    # A log whose charge never goes further above its start, as a share of the capacity, begins at
    # its fullest.
    begins_full: float = 0.02


LIMITS = _RestLimits()
# Time constants tried for the end of a relaxation, in lengths of the part that is fitted.
RELAXATION_OF_LENGTH = np.geomspace(0.3, 1.8, 5)


class OcvRest(NamedTuple):
    """What one rest says about the open-circuit voltage.

    charge_Ah : removed since the log's first row [Ah]
    voltage_V : mean over the last 10 s without current [V], as the LFP paper has it
    final_V : where the second half of the rest tends to [V]
    duration_s : length [s]; for a log that begins at rest what is seen of it
    start, stop : rows whose intervals belong to it
    """

    charge_Ah: float
    voltage_V: float
    final_V: float
    duration_s: float
    start: int
    stop: int

    @property
    def remaining_V(self) -> float:
        """What the voltage had still to go [V]."""
        return self.final_V - self.voltage_V


def find_ocv_rests(log: CellLog, *, min_rest_s: float | None = None) -> tuple[OcvRest, ...]:
    """Rests of a log that are long enough to say something about OCV, in order of time.

    Parameters
    ----------
    log : CellLog
    min_rest_s : float      shortest rest taken [s]; default 300, or half the longest rest where
                            fewer than four are that long. A rest at the log's start always counts:
                            files are cut where a test begins.
    """
    limit_A = LIMITS.current * float(np.nanmax(np.abs(log.current_A)))
    rests = [p for p in find_phases(log) if p.kind == "rest" and abs(p.current_A) <= limit_A]
    if min_rest_s is None:
        long = [p.duration_s for p in rests if p.duration_s >= LIMITS.rest_s]
        longest = max((p.duration_s for p in rests), default=0.0)
        min_rest_s = LIMITS.rest_s if len(long) >= POINTS.fewest else 0.5 * longest
    charge = log.counted_charge_Ah()
    chosen = [p for p in rests if p.duration_s >= min_rest_s or p.start == 0]
    return tuple(r for p in chosen if (r := _rest(log, p, charge)) is not None)


def ocv_from_rests(log: CellLog, capacity_Ah: float) -> OcvCurve:
    """OCV curve through the rests of an HPPC or similar log, each where it tends to.

    SOC is counted by the tester's counter where there is one. It is known at one moment: at the
    first row, where the log states it; else the fullest rest of the log is full (a log may begin
    empty and be charged first), save for a log that climbs and was not held at the limit until the
    current had fallen: it ends short of full, and where it began the OCV is steep.

    Parameters
    ----------
    log : CellLog
    capacity_Ah : float     that SOC refers to [Ah]

    Raises
    ------
    InputError              no rest, too few rests, all at one SOC
    """
    rests = find_ocv_rests(log)
    if not rests:
        raise InputError(
            f"no rest in log '{log.name or log.source}'",
            "stretches without current, best of half an hour and more",
            "Use an HPPC log with rests, or a low-rate log (" + arg("ocv", letter="LOG") + ").",
        )
    charge = np.array([r.charge_Ah for r in rests])
    # The first row counts as well: a log may begin full and under load.
    full_at = min(0.0, float(np.min(charge)))
    if log.soc0 is not None:
        full_at = -(1.0 - log.soc0) * capacity_Ah
    elif _climbs_short_of_full(log, log.counted_charge_Ah(), capacity_Ah):
        full_at = max(0.0, float(np.max(charge))) - capacity_Ah
    soc = 1.0 - (charge - full_at) / capacity_Ah
    inside = (soc >= -OUTSIDE) & (soc <= 1.0 + OUTSIDE)
    remaining = np.array([r.remaining_V for r in rests])
    weight = 1.0 / (1.0 + (remaining / LIMITS.unrelaxed_V) ** 2)
    used = soc[inside] if inside.any() else soc
    left_mV = 1e3 * np.abs(remaining)
    notes = [
        f"{np.count_nonzero(inside)} rests from SOC {used.min():.3f} to {used.max():.3f}",
        f"still to relax: {np.median(left_mV):.1f} mV median, {np.max(left_mV):.1f} mV at most",
    ]
    if not inside.all():
        span = f"SOC {soc.min():.3f} to {soc.max():.3f}"
        outside = np.count_nonzero(~inside)
        notes.append(f"{outside} rests left out: {span} with this capacity")
    return curve_from_points(
        soc[inside],
        np.array([r.final_V for r in rests])[inside],
        capacity_Ah=capacity_Ah,
        weight=weight[inside],
        source=f"rests of {log.name or log.source or 'a log'}",
        notes=tuple(Notice(Code.OCV_SOURCE, text) for text in notes),
    )


def _climbs_short_of_full(log: CellLog, charge_Ah: FloatArray, capacity_Ah: float) -> bool:
    """Whether a log ends its way up without the constant voltage that makes a cell full."""
    fullest = int(np.argmin(charge_Ah))
    if charge_Ah[0] - charge_Ah[fullest] <= LIMITS.begins_full * capacity_Ah:
        return False
    charging = [p for p in find_phases(log) if p.charging and p.start <= fullest]
    return not charging or charging[-1].kind != "cv"


def _rest(log: CellLog, phase: Phase, charge: FloatArray) -> OcvRest | None:
    """None without a single voltage."""
    t, v = log.time_s[phase.start : phase.stop], log.voltage_V[phase.start : phase.stop]
    t, v = t[np.isfinite(v)], v[np.isfinite(v)]
    if t.size == 0:
        return None
    last = t >= t[-1] - LIMITS.average_s
    charge_Ah, mean_V = float(charge[phase.stop - 1]), float(np.mean(v[last]))
    return OcvRest(charge_Ah, mean_V, _relaxed_V(t, v), phase.duration_s, phase.start, phase.stop)


def _relaxed_V(t: FloatArray, v: FloatArray) -> float:
    """Final voltage of a rest, from an exponential through its second half.

    The time constant comes from a few values; the amplitude may not exceed what the rest has
    already gone through, so a short or noisy rest stays near its last voltage.
    """
    length = float(t[-1] - t[0])
    half = t >= t[-1] - 0.5 * length
    if np.count_nonzero(half) < 4 or length <= 0.0:
        return float(v[-1])
    x, y = (t[half] - t[-1]) / (0.5 * length), v[half]
    fits = []
    for tau in RELAXATION_OF_LENGTH.tolist():
        columns = np.column_stack((np.ones(x.size), np.exp(-x / tau)))
        found = np.linalg.lstsq(columns, y, rcond=None)[0]
        fits.append((float(np.sum((columns @ found - y) ** 2)), float(found[1])))
    moved = abs(float(v[-1] - v[0]))
    return float(np.mean(y[-max(1, y.size // 20) :]) - np.clip(min(fits)[1], -moved, moved))

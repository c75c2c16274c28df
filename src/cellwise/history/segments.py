"""Stretches of constant current: what two of them at one load say of capacity and resistance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cellwise.fit.model_error import LEAST_LOG, SUSTAINED_S
from cellwise.history.log_health import AGED
from cellwise.history.trend import FADE
from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import runs_of
from cellwise.notices import Code, Notice
from cellwise.typing import FloatArray


class UsableSegment(NamedTuple):
    """A stretch has a load of ``rate_C`` at least; ``points`` are kept of it."""

    rate_C: float = 0.02
    points: int = 200


class SameLoad(NamedTuple):
    """Within what a current is constant, and two stretches have one load (shares, kelvin)."""

    constant: float = 0.05
    current: float = 0.10
    temperature_K: float = 8.0


class Complete(NamedTuple):
    """Within what two complete stretches begin and end alike [V].

    A charged cell under load begins as it did, but for what it drops more over the middle of a
    cycle; both end at the limit, to what one row may step beyond it.
    """

    start_V: float = 0.12
    end_V: float = 0.02


class Ageing(NamedTuple):
    """How a curve of voltage over charge changes in a life: standard deviations.

    ``added_V``: of the drop that a life adds, and ``gained_V`` where it falls (a sensor's, or
    warmer); ``uneven``: share of an added resistance that is not the same at every SOC; ``length``:
    of the SOC range, over which a change of shape stays alike; ``least_V`` of that change.
    """

    added_V: float = 0.15
    gained_V: float = 0.01
    uneven: float = 0.2
    length: float = 0.3
    least_V: float = 0.002


USABLE, SAME, COMPLETE, AGEING = UsableSegment(), SameLoad(), Complete(), Ageing()
SHARES = np.linspace(0.5, 1.15, 131)
BEGINS = np.linspace(0.0, 1.0, 81)  # of the reference's range


@dataclass(frozen=True, eq=False)
class CurrentSegment:
    """A stretch of a log at one current.

    ``charge_Ah`` (n,) moved since its beginning, ``voltage_V`` (n,), thinned; ``temperature_C``
    at its beginning, None where nobody measured.
    """

    charge_Ah: FloatArray
    voltage_V: FloatArray
    current_A: float
    temperature_C: float | None

    @property
    def moved_Ah(self) -> float:
        """Charge from the first row to the last."""
        return float(self.charge_Ah[-1])

    def alike(self, other: CurrentSegment) -> bool:
        """The same load: direction, current, temperature."""
        if abs(self.current_A / other.current_A - 1.0) > SAME.current:
            return False
        a, b = self.temperature_C, other.temperature_C
        return a is None or b is None or abs(a - b) < SAME.temperature_K

    def as_complete_as(self, other: CurrentSegment) -> bool:
        """It begins charged and ends at the limit as the other does."""
        end = abs(self.voltage_V[-1] - other.voltage_V[-1]) < COMPLETE.end_V
        drop = _resistance_at_same_share(self, other) * self.current_A
        start = abs(self.voltage_V[0] - other.voltage_V[0] + drop) < COMPLETE.start_V
        return bool(start and end)


@dataclass(frozen=True)
class ComparedSegments:
    """One stretch against another: shares of capacity and their deviations, added resistance."""

    capacity: float
    capacity_std: float
    added_ohm: float
    added_std_ohm: float
    counted: bool


class _SegmentRows(NamedTuple):
    """Rows at one current, and the stretch that they are."""

    first: int
    stop: int
    stretch: CurrentSegment


def _usable(log: CellLog, capacity_Ah: float) -> list[_SegmentRows]:
    """The stretches of constant current, discharges before charges; none to use: none."""
    current, interval = log.known_current_A(), log.interval_s
    for sign in (1.0, -1.0):
        loaded = (sign * current > USABLE.rate_C * capacity_Ah) & np.isfinite(log.voltage_V)
        if np.count_nonzero(loaded) < LEAST_LOG:
            continue
        usual = float(np.median(current[loaded]))
        inside = loaded & (np.abs(current - usual) < SAME.constant * abs(usual))
        inside &= ~log.gap_rows
        found = []
        for first, last in runs_of(inside):
            a, b = first, last + 1
            charge = np.cumsum(np.abs(current[a:b]) * interval[a:b]) / 3600.0
            long = log.time_s[b - 1] - log.time_s[a] >= SUSTAINED_S
            much = charge[-1] - charge[0] >= 0.5 * AGEING.length * capacity_Ah
            if b - a < LEAST_LOG or not long or not much:
                continue
            warm = None if log.temperature_C is None else float(log.temperature_C[a])
            warm = None if warm is None or not np.isfinite(warm) else warm
            found.append(_SegmentRows(a, b, _thinned(charge, log.voltage_V[a:b], usual, warm)))
        if found:
            return found
    return []


def longest_stretch(log: CellLog, capacity_Ah: float) -> CurrentSegment | None:
    """The longest stretch of constant current, a discharge before a charge; None: none to use."""
    found = _usable(log, capacity_Ah)
    return max(found, key=lambda one: one.stop - one.first).stretch if found else None


def cut_at_cycles(log: CellLog, capacity_Ah: float) -> tuple[CellLog, ...]:
    """Of a log of several complete half cycles at one current, one for each; else the log."""
    found = _usable(log, capacity_Ah)
    if len(found) < 2:
        return (log,)
    most = max(found, key=lambda one: one.stop - one.first).stretch
    stops = [one.stop for one in found if one.stretch.as_complete_as(most)]
    if len(stops) < 2:
        return (log,)
    stops[-1] = len(log)
    parts = [
        replace(log.part(first, stop), name=f"{log.name}, cycle {k + 1}", notices=())
        for k, (first, stop) in enumerate(pairwise((0, *stops)))
    ]
    text = f" holds {len(stops)} complete half cycles, each followed by itself"
    said = Notice(Code.HALF_CYCLES, text, log=log.name)
    return (replace(parts[0], notices=(*log.notices, said)), *parts[1:])


def compare(one: CurrentSegment, reference: CurrentSegment) -> ComparedSegments:
    """A later stretch against an earlier one at the same load.

    Both complete: the charges are counted. Else the earlier curve over charge is stretched by the
    share of capacity, moved along and lowered by a resistance until it is the later one. Ageing
    changes the shape, too: within the window that error is taken to stay alike over 0.3 of the
    range, beyond it the cell may have aged by as much as a life brings.
    """
    if one.as_complete_as(reference):
        share = one.moved_Ah / reference.moved_Ah
        added = _resistance_at_same_share(one, reference)
        return ComparedSegments(
            share, FADE.start_std * np.sqrt(2.0), added, AGEING.uneven * abs(added) + 1e-4, True
        )

    return _marginal(one, reference)


def _marginal(one: CurrentSegment, reference: CurrentSegment) -> ComparedSegments:
    """Mean and spread of all shares and beginnings that explain a window, by their likelihood.

    Curves resemble themselves elsewhere, so that one best fit says little. The error's size is
    integrated out: as many of its values are independent as lengths of 0.3 fit into the window.
    """
    share = SHARES[:, None, None]
    begin = BEGINS[None, :, None] * reference.moved_Ah
    at = begin + one.charge_Ah / share
    left = one.voltage_V - _extended(at, reference)
    added = -left.mean(axis=2) / one.current_A  # the resistance that fits each best
    drop = added * abs(one.current_A)
    spread = np.hypot(AGEING.uneven * drop, AGEING.least_V)
    size = left.var(axis=2) + spread**2
    covered = min(one.moved_Ah / reference.moved_Ah, 1.0)
    freedom = 1.0 + covered / AGEING.length
    likely = -0.5 * freedom * np.log(size)
    likely -= 0.5 * (drop / np.where(drop > 0.0, AGEING.added_V, AGEING.gained_V)) ** 2
    likely -= 0.5 * ((SHARES[:, None] - 1.0) / AGED.ln_capacity) ** 2
    end = (begin[..., 0] + one.moved_Ah / share[..., 0]) / reference.moved_Ah
    likely -= 0.5 * (np.maximum(end - 1.0, 0.0) / FADE.start_std) ** 2
    weight = np.exp(likely - likely.max())
    weight /= weight.sum()
    capacity = float((weight * SHARES[:, None]).sum())
    variance = float((weight * (SHARES[:, None] - capacity) ** 2).sum())
    mean = float((weight * added).sum())
    variance_ohm = float((weight * (added - mean) ** 2).sum())
    # What was not seen may have aged by itself: lithium that is lost moves the ends of the range
    # and stretches nothing between them.
    unseen = (1.0 - min(covered / capacity, 1.0)) * AGED.ln_capacity
    std = float(np.sqrt(variance + unseen**2 + FADE.start_std**2))
    return ComparedSegments(capacity, std, mean, float(np.sqrt(variance_ohm)), False)


def _thinned(
    charge: FloatArray, voltage: FloatArray, current: float, warm: float | None
) -> CurrentSegment:
    moved = charge - charge[0]
    width = max(voltage.size // USABLE.points, 1)
    smooth = voltage
    if width > 2:
        kernel = np.ones(width) / width
        half = width // 2
        smooth = voltage.copy()
        middle = np.convolve(voltage, kernel, "valid")
        smooth[half : half + middle.size] = middle
    at = np.unique(np.linspace(0, voltage.size - 1, USABLE.points).astype(np.int64))
    return CurrentSegment(moved[at], smooth[at], current, warm)


def _extended(at: FloatArray, reference: CurrentSegment) -> FloatArray:
    """The reference curve, straight on beyond its ends."""
    x, y = reference.charge_Ah, reference.voltage_V
    inside = np.interp(at, x, y)
    k = max(x.size // 20, 1)
    first, last = (y[k] - y[0]) / (x[k] - x[0]), (y[-1] - y[-1 - k]) / (x[-1] - x[-1 - k])
    below = np.minimum(at - x[0], 0.0) * first
    above = np.maximum(at - x[-1], 0.0) * last
    return np.asarray(inside + below + above)


def _resistance_at_same_share(one: CurrentSegment, reference: CurrentSegment) -> float:
    """By how much more the voltage drops over the middle half of the charge [ohm]."""
    share = np.linspace(0.25, 0.75, 51)
    a = np.interp(share * one.moved_Ah, one.charge_Ah, one.voltage_V)
    b = np.interp(share * reference.moved_Ah, reference.charge_Ah, reference.voltage_V)
    return float(np.mean(b - a) / one.current_A)

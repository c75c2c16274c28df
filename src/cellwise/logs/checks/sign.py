"""Does the current's sign fit the voltage? Verified from the data, or left undetermined."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.cell_log import CellLog
from cellwise.logs.gaps import run_edges
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import Option

Verdict = Literal["verified", "contradicted", "undetermined"]

WINDOWS_S = (1.0, 1000.0)  # from a step of the load to minutes of diffusion
LARGEST_SERIES = 100_000  # rows; a longer log is first averaged down to this

# What a log must show before it says anything of its sign.
VARIANCE_RATIO = 20.0  # an F statistic: white noise reaches it less than once in a thousand windows
LEAST_SCORE = 0.7  # lead of one sign over the other, weighed over all windows
LEAST_CURRENT_A = 0.02  # less is a sensor's zero
LEAST_MOVE_V = 0.005  # by less a voltage has not moved
# Of its range, root mean square from row to row: a small cell's current, which holds its levels,
# has less.
FLICKER = 0.15
SMALL_CELL_V = 0.2  # by which its voltage moves meanwhile
STEADY_STEPS = 10.0  # usual ones of a current, within which it is steady
LATE_DRIFT = 0.3  # of its way that a voltage under load does in the second half of the log
HELD_SHARE = 1e-3  # of its limit: a voltage that a tester holds is so near
HELD_SIGMAS = 4.0  # of its usual steps, or within these
HELD_ROWS = 4  # for more than these
HELD_FALLS = 0.9  # share to which the current falls meanwhile


class Contrast(NamedTuple):
    """How much of the voltage's movement a passive cell explains under either sign.

    ``window_s`` is 0 for the whole log's levels; ``discharge`` and ``charge`` are shares of the sum
    of squares, 0..1, with positive current read as discharge or as charge.
    """

    window_s: float
    pairs: int
    causes: int
    discharge: float
    charge: float

    @property
    def lead(self) -> float:
        """Lead of discharge-positive over charge-positive, -1..1; 0 where noise would do."""
        best = max(self.discharge, self.charge)
        freedom = max(self.pairs - 1 - self.causes, 0)
        ratio = best / max(1.0 - best, 1e-9) * freedom
        return self.discharge - self.charge if ratio >= VARIANCE_RATIO else 0.0

    def text(self) -> str:
        """The contrast as text."""
        where = (
            "voltage level against charge and current over the whole log"
            if self.window_s == 0
            else f"voltage changes between windows of {self.window_s:.3g} s"
        )
        return (
            f"{where}: discharge-positive explains {100 * self.discharge:.0f} %, "
            f"charge-positive {100 * self.charge:.0f} % ({self.pairs} pairs)"
        )


@dataclass(frozen=True)
class SignCheck:
    """Verdict on the sign of a log's current.

    ``verified``: positive current discharges the cell. ``contradicted``: it charges it.
    ``undetermined``: the windows disagree, or there is nothing to see. ``score`` runs from -1
    (contradicted) to +1 (verified): the windows' leads, each weighed by its own size. ``follows``
    is False where the voltage does not follow the current in any window.
    """

    verdict: Verdict
    evidence: tuple[str, ...]
    score: float = 0.0
    follows: bool = True


def verify_sign(log: CellLog) -> SignCheck:
    """Determine from voltage and current whether positive current discharges the cell.

    A cell is passive: after a step of discharge current its voltage falls, and does not come back
    while the current lasts. Every such answer is a sum, with positive weights, of running means of
    the current and of the charge drawn. That sum is fitted to the voltage changes between averaging
    windows of a second to minutes, once for either sign; each window votes with the lead of one
    sign over the other. A single correlation of dV with dI would not do: loggers that read V and I
    one after the other make it positive at the full rate, and a tester that holds the voltage
    reverses cause and effect.

    Parameters
    ----------
    log : CellLog

    Returns
    -------
    SignCheck

    Notes
    -----
    The tester's counter has no vote: a file with the wrong sign usually has it wrong in both.
    """
    drawn = np.cumsum(log.known_current_A() * log.interval_s)
    series: tuple[FloatArray, ...] = log.time_s, log.current_A, log.voltage_V, drawn
    usable = np.isfinite(log.current_A) & np.isfinite(log.voltage_V)
    usable &= ~_held(log.known_current_A(), log.voltage_V)
    if not usable.all():
        series = tuple(x[usable] for x in series)
    reason = _nothing_to_see(*series[:3])
    if reason:
        return SignCheck("undetermined", (reason,))
    votes = [c for c in _contrasts(*_reduced(series)) if c.lead != 0.0]
    if not votes:
        none = "the voltage does not follow the current in any window"
        return SignCheck("undetermined", (none,), follows=False)
    score = sum(c.lead * abs(c.lead) for c in votes) / sum(c.lead**2 for c in votes)
    verdict: Verdict = "undetermined"
    if abs(score) >= LEAST_SCORE:
        verdict = "verified" if score > 0 else "contradicted"
    return SignCheck(verdict, tuple(c.text() for c in votes), float(score))


def contradiction(way_out: str) -> Notice:
    """Notice of a sign that looks wrong, and with which ``sign`` to read the log."""
    text = (
        "THE SIGN OF THE CURRENT LOOKS WRONG: the voltage rises when the stated current discharges "
        "the cell. Nothing was inverted; read the log with "
    )
    return Notice(Code.SIGN_CONTRADICTED, (text, Option("sign", way_out)))


def _held(current: FloatArray, voltage: FloatArray) -> BoolArray:
    """Rows in which a tester holds a limit of the voltage while the current dies away."""
    held = np.zeros(voltage.size, dtype=np.bool_)
    known = voltage[np.isfinite(voltage)]
    # The size of a step does not need millions of them.
    steps = np.abs(np.diff(known))[:: max(known.size // LARGEST_SERIES, 1)]
    noise = HELD_SIGMAS * float(np.median(steps)) if steps.size else 0.0
    for limit in (np.fmin.reduce(voltage), np.fmax.reduce(voltage)):
        near = np.abs(voltage - limit) <= max(HELD_SHARE * abs(limit), noise)
        first, last = run_edges(near)
        long = last - first >= HELD_ROWS
        for a, b in zip(first[long], last[long], strict=True):
            held[a : b + 1] |= abs(current[b]) < HELD_FALLS * abs(current[a])
    return held


def _contrasts(
    time: FloatArray, current: FloatArray, voltage: FloatArray, charge: FloatArray
) -> list[Contrast]:
    """The levels' contrast, and one for each window that the log has several of."""
    duration = float(time[-1] - time[0])
    # Coulomb balance: the level against charge drawn and current, in blocks of the log.
    starts = _block_starts(time, duration / 100.0 * (1 + 1e-9))
    causes = np.column_stack([_means(current, starts), _means(charge, starts)])
    level = _means(voltage, starts)
    # No cell drops by more than its voltage: not by its largest current, nor by all of its charge.
    most_A, most_V = np.max(np.abs(current)), np.max(np.abs(voltage))
    most = most_V / np.array([most_A, max(np.ptp(charge), most_A)])
    found = [_contrast(0.0, causes - causes.mean(axis=0), level - level.mean(), most)]
    steps = np.diff(time)
    window = max(float(np.median(steps[steps > 0])), WINDOWS_S[0])
    largest = min(max(window, WINDOWS_S[1]), duration / 6.0)
    while window <= largest:
        causes, changes = _changes(time, current, voltage, charge, window)
        found.append(_contrast(window, causes, changes, np.full(3, most_V / most_A)))
        window *= 10.0**0.5
    return found


def _changes(
    time: FloatArray, current: FloatArray, voltage: FloatArray, charge: FloatArray, window: float
) -> tuple[FloatArray, FloatArray]:
    """Causes and changes from one averaging window to the next; ``charge`` in A s.

    A cell answers within the window (resistance), over some windows (diffusion), and for good
    (OCV).
    """
    starts = _block_starts(time, window)
    ends = np.append(starts[1:], time.size) - 1
    at, drawn = time[ends], charge[ends]
    past = at - 10.0 * window
    before = np.interp(past, time, charge)
    early = past < time[0]  # the current before the log's start is taken as its first
    before[early] = charge[0] + current[0] * (past[early] - time[0])
    columns = _means(current, starts), (drawn - before) / (10.0 * window), drawn / window
    causes = np.diff(np.column_stack(columns), axis=0)
    changes = np.diff(_means(voltage, starts))
    joined = np.diff(at) <= 2.0 * window
    return causes[joined], changes[joined]


def _contrast(window: float, causes: FloatArray, changes: FloatArray, most: FloatArray) -> Contrast:
    """Shares of sum(changes^2) that -causes and +causes explain with weights from 0 to ``most``.

    Least squares with weights >= 0 are those of the causes that get one, so of all choices of
    causes whose plain weights are >= 0 the best: no library for three causes. A choice with a
    weight that no cell has is none: it is noise in a steady current.
    """
    total = float(changes @ changes)
    shares = [0.0, 0.0]
    if total > 0.0:
        scale = np.sqrt(np.sum(causes**2, axis=0))
        scaled = causes / np.where(scale > 0.0, scale, 1.0)
        products, moments = scaled.T @ scaled, scaled.T @ changes
        for size in range(1, causes.shape[1] + 1):
            for some in combinations(range(causes.shape[1]), size):
                of = list(some)
                weights = np.linalg.pinv(products[np.ix_(of, of)], hermitian=True) @ moments[of]
                if np.any(np.abs(weights) > most[of] * scale[of]):
                    continue
                share = min(float(moments[of] @ weights) / total, 1.0)
                for k, sign in enumerate((-1, 1)):
                    if np.all(sign * weights >= 0.0):
                        shares[k] = max(shares[k], share)
    return Contrast(window, changes.size, causes.shape[1], *shares)


def is_at_rest(current_A: FloatArray, voltage_V: FloatArray) -> bool:
    """Whether a current is no more than a sensor's zero."""
    if float(np.nanmax(np.abs(current_A), initial=0.0)) >= LEAST_CURRENT_A:
        return False
    flicker = float(np.sqrt(np.nanmean(np.diff(current_A) ** 2))) if current_A.size > 1 else 0.0
    holds = flicker <= FLICKER * float(np.ptp(current_A)) and bool(np.any(current_A))
    return not (holds and float(np.nanmax(voltage_V) - np.nanmin(voltage_V)) > SMALL_CELL_V)


def _nothing_to_see(time: FloatArray, current: FloatArray, voltage: FloatArray) -> str:
    """Reason why a log cannot show the sign; empty where it may."""
    if time.size < 4 or time[-1] <= time[0]:
        return "too few rows with both voltage and current"
    if is_at_rest(current, voltage):
        return f"at rest: the current stays within {1000 * np.max(np.abs(current)):.3g} mA"
    move = float(np.ptp(voltage))
    if move < LEAST_MOVE_V:
        return f"the voltage moves by {1000 * move:.1f} mV only"
    # A sensor's zero on a resting cell is a steady current, and the resting voltage drifts either
    # way; unlike the voltage of a cell under load it soon stops drifting.
    noise = float(np.median(np.abs(np.diff(current))))
    drift, late = (abs(float(voltage[-1] - voltage[k])) for k in (0, voltage.size // 2))
    if np.ptp(current) <= STEADY_STEPS * noise and late < LATE_DRIFT * drift:
        return "one steady current, and the voltage drifts as a resting cell's might"
    return ""


def _reduced(series: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    """The channels averaged over neighbouring rows where there are very many."""
    rows = series[0].size
    group = -(-rows // LARGEST_SERIES)
    if group == 1:
        return series
    starts = np.arange(0, rows, group)
    return tuple(_means(x, starts) for x in series)


def _block_starts(time: FloatArray, window: float) -> NDArray[np.intp]:
    """First row of every non-empty window."""
    block = np.floor((time - time[0]) / window)
    return np.flatnonzero(np.concatenate(([True], np.diff(block) > 0)))


def _means(x: FloatArray, starts: NDArray[np.intp]) -> FloatArray:
    """Mean of x over the rows of each block."""
    counts = np.diff(np.append(starts, x.size))
    return np.add.reduceat(x, starts) / counts

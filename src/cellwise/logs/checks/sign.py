"""Does the current's sign fit the voltage? Verified from the data, or left undetermined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

Verdict = Literal["verified", "contradicted", "undetermined"]

# A cell answers within the window (resistance), over a few windows (diffusion), and for good (OCV).
MEMORY_WINDOWS = (3.0, 10.0, 30.0)
WINDOWS_S = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
WINDOW_LAGS = (0, 1)  # a cell answers after its current, never before
FAST_LAGS = (-2, -1, 0, 1, 2)  # but a fast logger may read voltage and current one after the other
FAST_S = 0.5
LEVEL_BLOCKS = 100
LARGEST_SERIES = 100_000  # rows; a longer log is first averaged down to this
BUSY_ROWS = 20_000  # the row-to-row changes are looked at where the current moves most

# Evidence below these says nothing. The variance ratio is an F statistic with few degrees of
# freedom: white noise reaches 20 less than once in a thousand windows.
LEAST_VARIANCE_RATIO = 20.0
LEAST_LEAD = 0.05
# Below these a current is a sensor's zero, and a drifting voltage is a relaxation.
LEAST_CURRENT_A = 0.02
LEAST_VOLTAGE_MOVE_V = 0.005
STEADY_SPREAD = 0.05
LEAST_STEADY_DRIFT_V = 0.02
LEAST_LATE_DRIFT = 0.3
DECISION = 0.5


class Contrast(NamedTuple):
    """How much of the voltage's movement a passive cell explains under either sign.

    ``window_s`` is 0 for the whole log's levels; ``lag`` counts windows (rows at the sampling
    interval), positive when voltage is late; ``discharge`` and ``charge`` are shares of the sum of
    squares, 0..1, with positive current read as discharge or as charge.
    """

    window_s: float
    lag: int
    pairs: int
    discharge: float
    charge: float

    @property
    def lead(self) -> float:
        """Lead of discharge-positive over charge-positive, -1..1; 0 where noise would do as well.

        Where both readings explain much the window cannot separate them: it has no lead either.
        """
        best = max(self.discharge, self.charge)
        freedom = max(self.pairs - 1 - len(MEMORY_WINDOWS) - 1, 0)
        ratio = best / max(1.0 - best, 1e-9) * freedom
        lead = self.discharge - self.charge
        return lead if abs(lead) >= LEAST_LEAD and ratio >= LEAST_VARIANCE_RATIO else 0.0

    def text(self) -> str:
        """The contrast as text."""
        where = (
            "voltage level against charge and current over the whole log"
            if self.window_s == 0
            else f"voltage changes between windows of {self.window_s:.3g} s"
        )
        if self.lag:
            where += f", voltage {abs(self.lag)} {'late' if self.lag > 0 else 'early'}"
        return (
            f"{where}: discharge-positive explains {100 * self.discharge:.0f} %, "
            f"charge-positive {100 * self.charge:.0f} % ({self.pairs} pairs)"
        )


@dataclass(frozen=True)
class SignCheck:
    """Verdict on the sign of a log's current.

    ``verified``: positive current discharges the cell. ``contradicted``: it charges it.
    ``undetermined``: the windows disagree, or there is nothing to see. ``score`` runs from -1
    (contradicted) to +1 (verified): the windows' leads, each weighed by its own size.
    """

    verdict: Verdict
    evidence: tuple[str, ...]
    score: float = 0.0


def verify_sign(log: MeasuredLog) -> SignCheck:
    """Determine from voltage and current whether positive current discharges the cell.

    A cell is passive: after a step of discharge current its voltage falls, and does not come back
    while the current lasts. Every such answer is a sum, with positive weights, of running means of
    the current and of the charge drawn. That sum is fitted to the voltage changes between averaging
    windows from the sampling interval to minutes, at several lags, once for either sign; each
    window votes with the lead of one sign over the other. A single correlation of dV with dI would
    not do: loggers that read V and I one after the other make it positive at the full rate, and a
    tester that holds the voltage reverses cause and effect.

    Parameters
    ----------
    log : MeasuredLog

    Returns
    -------
    SignCheck

    Notes
    -----
    The tester's counter is compared with the current and is evidence without a vote: a file
    with the wrong sign usually has it wrong in both.
    """
    drawn = log.known_current_A() * log.interval_s
    counter = _counter_text(log, drawn)
    time, current, voltage = log.time_s, log.current_A, log.voltage_V
    charge = np.cumsum(drawn, out=drawn)
    usable = np.isfinite(current) & np.isfinite(voltage)
    if not usable.all():
        time, current, voltage = time[usable], current[usable], voltage[usable]
        charge = charge[usable]
    if time.size < 4 or time[-1] <= time[0]:
        return SignCheck("undetermined", ("too few rows with both voltage and current", *counter))
    reason = _nothing_to_see(current, voltage)
    if reason:
        return SignCheck("undetermined", (reason, *counter))

    contrasts = [_row_to_row(time, current, voltage, charge)]
    contrasts += _all_windows(*_reduced(time, current, voltage, charge))
    votes = [c for c in contrasts if c.lead != 0.0]
    if not votes:
        return SignCheck(
            "undetermined", ("the voltage does not follow the current in any window", *counter)
        )
    score = sum(c.lead * abs(c.lead) for c in votes) / sum(c.lead**2 for c in votes)
    verdict: Verdict = "undetermined"
    if abs(score) >= DECISION:
        verdict = "verified" if score > 0 else "contradicted"
    return SignCheck(verdict, (*(c.text() for c in votes), *counter), float(score))


CONTRADICTED = "THE SIGN OF THE CURRENT LOOKS WRONG"  # begins the notice


def contradiction(way_out: str) -> str:
    """Notice of a sign that looks wrong, and with which ``sign`` to read the log."""
    return (
        f"{CONTRADICTED}: the voltage rises when the stated current discharges "
        f"the cell. Nothing was inverted; read the log with `sign='{way_out}'`"
    )


def _row_to_row(
    time: FloatArray, current: FloatArray, voltage: FloatArray, charge: FloatArray
) -> Contrast:
    """Contrast at the sampling interval, where the current moves most, at the clearest lag."""
    if time.size > BUSY_ROWS:
        starts = np.arange(0, time.size - BUSY_ROWS // 2, BUSY_ROWS)
        activity = np.add.reduceat(np.abs(np.diff(current, prepend=current[0])), starts)
        first = int(starts[np.argmax(activity)])
        part = slice(first, first + BUSY_ROWS)
        time, current, voltage, charge = time[part], current[part], voltage[part], charge[part]
    steps = np.diff(time)
    interval = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    lags = FAST_LAGS if interval <= FAST_S else WINDOW_LAGS
    rows = np.arange(time.size)
    found = [_changes(time, current, voltage, charge, rows, interval, lag) for lag in lags]
    return max(found, key=lambda c: max(c.discharge, c.charge))


def _all_windows(
    time: FloatArray, current: FloatArray, voltage: FloatArray, charge: FloatArray
) -> list[Contrast]:
    """The levels' contrast, and one for each window at its clearer lag."""
    found = [_levels(time, current, voltage, charge)]
    steps = np.diff(time)
    interval = float(np.median(steps[steps > 0]))
    for window in WINDOWS_S:
        if not 2.0 * interval < window < (time[-1] - time[0]) / 6.0:
            continue
        starts = _block_starts(time, window)
        lagged = [_changes(time, current, voltage, charge, starts, window, k) for k in WINDOW_LAGS]
        found.append(max(lagged, key=lambda c: max(c.discharge, c.charge)))
    return found


def _changes(
    time: FloatArray,
    current: FloatArray,
    voltage: FloatArray,
    charge: FloatArray,
    starts: NDArray[np.intp],
    window: float,
    lag: int,
) -> Contrast:
    """Contrast of the changes from one averaging window to the next.

    ``starts`` (m,) holds the first row of each window; ``charge`` is in ampere seconds.
    """
    ends = np.append(starts[1:], time.size) - 1
    at = time[ends]
    drawn = charge[ends]
    columns = [_means(current, starts)]
    for windows in MEMORY_WINDOWS:
        past = at - windows * window
        before = np.interp(past, time, charge)
        early = past < time[0]  # the current before the log's start is taken as its first
        before[early] = charge[0] + current[0] * (past[early] - time[0])
        columns.append((drawn - before) / (windows * window))
    columns.append(drawn / window)
    causes = np.diff(np.column_stack(columns), axis=0)
    changes = np.diff(_means(voltage, starts))
    joined = np.diff(at) <= 2.0 * window
    if lag > 0:
        causes, changes, joined = causes[:-lag], changes[lag:], joined[:-lag] & joined[lag:]
    elif lag < 0:
        causes, changes, joined = causes[-lag:], changes[:lag], joined[-lag:] & joined[:lag]
    discharge, charging = _explained(causes[joined], changes[joined])
    return Contrast(window, lag, int(np.count_nonzero(joined)), discharge, charging)


def _levels(
    time: FloatArray, current: FloatArray, voltage: FloatArray, charge: FloatArray
) -> Contrast:
    """Coulomb balance: voltage level against charge drawn and current, in blocks of the log."""
    starts = _block_starts(time, float(time[-1] - time[0]) / LEVEL_BLOCKS * (1 + 1e-9))
    causes = np.column_stack([_means(current, starts), _means(charge, starts)])
    causes -= causes.mean(axis=0)
    level = _means(voltage, starts)
    discharge, charging = _explained(causes, level - level.mean())
    return Contrast(0.0, 0, starts.size, discharge, charging)


def _explained(causes: FloatArray, changes: FloatArray) -> tuple[float, float]:
    """Shares of sum(changes^2) that -causes and +causes explain with weights >= 0."""
    total = float(changes @ changes)
    if total == 0.0 or changes.size == 0:
        return 0.0, 0.0
    scale = np.sqrt(np.sum(causes**2, axis=0))
    scaled = causes / np.where(scale > 0, scale, 1.0)
    gram = scaled.T @ scaled
    aim = -(scaled.T @ changes)
    return _share(gram, aim, total), _share(gram, -aim, total)


def _share(gram: FloatArray, aim: FloatArray, total: float) -> float:
    """Share explained by the non-negative least squares fit, by coordinate descent."""
    x = np.zeros(aim.size)
    for _ in range(500):
        before = x.copy()
        for j in range(x.size):
            if gram[j, j] > 0:
                x[j] = max(0.0, x[j] + (aim[j] - gram[j] @ x) / gram[j, j])
        if np.max(np.abs(x - before)) <= 1e-9 * max(np.max(x), 1e-300):
            break
    return float(np.clip((2.0 * aim @ x - x @ gram @ x) / total, 0.0, 1.0))


def _nothing_to_see(current: FloatArray, voltage: FloatArray) -> str:
    """Reason why a log cannot show the sign; empty where it may.

    A sensor's zero on a resting cell is a steady current, and the resting voltage drifts either
    way; unlike the voltage of a cell under load it soon stops drifting.
    """
    largest = float(np.max(np.abs(current)))
    if largest < LEAST_CURRENT_A:
        return f"at rest: the current stays within {1000 * largest:.1f} mA"
    move = float(np.ptp(voltage))
    if move < LEAST_VOLTAGE_MOVE_V:
        return f"the voltage moves by {1000 * move:.1f} mV only"
    if np.ptp(current) > max(STEADY_SPREAD * largest, 8.0 * _row_noise(current)):
        return ""
    drift = abs(float(voltage[-1] - voltage[0]))
    late = abs(float(voltage[-1] - voltage[voltage.size // 2]))
    if drift < LEAST_STEADY_DRIFT_V or late < LEAST_LATE_DRIFT * drift:
        return "one steady current, and the voltage drifts as a resting cell's might"
    return ""


def _row_noise(x: FloatArray) -> float:
    """Spread of one row about its neighbours."""
    return 1.05 * float(np.median(np.abs(np.diff(x))))  # 1.48 of a median, sqrt(2) of a difference


def _counter_text(log: MeasuredLog, drawn: FloatArray) -> tuple[str, ...]:
    """What the tester's counter says of the sign of the charge drawn in each interval."""
    if log.charge_Ah is None:
        return ()
    moved = np.diff(log.charge_Ah)
    drawn = drawn[1:] / 3600.0
    usable = np.isfinite(moved) & ~log.gap_rows[1:] & np.isfinite(log.interval_current_A[1:])
    size = float(np.sqrt(np.sum(moved[usable] ** 2) * np.sum(drawn[usable] ** 2)))
    if size == 0.0:
        return ()
    agreement = float(moved[usable] @ drawn[usable]) / size
    direction = "with" if agreement > 0 else "against"
    return (f"the tester's counter runs {direction} the current (correlation {agreement:+.2f})",)


def _reduced(*series: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Time, current, voltage, charge; averaged over neighbouring rows when there are very many."""
    rows = series[0].size
    group = -(-rows // LARGEST_SERIES)
    if group > 1:
        starts = np.arange(0, rows, group)
        series = tuple(_means(x, starts) for x in series)
    time, current, voltage, charge = series
    return time, current, voltage, charge


def _block_starts(time: FloatArray, window: float) -> NDArray[np.intp]:
    """First row of every non-empty window."""
    block = np.floor((time - time[0]) / window)
    return np.flatnonzero(np.concatenate(([True], np.diff(block) > 0)))


def _means(x: FloatArray, starts: NDArray[np.intp]) -> FloatArray:
    """Mean of x over the rows of each block."""
    counts = np.diff(np.append(starts, x.size))
    return np.add.reduceat(x, starts) / counts

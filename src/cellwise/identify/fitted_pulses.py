"""Station: the pulses of every temperature, their fits, and tables of these over SOC."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellwise.cell.plausibility.notice import Notice
from cellwise.errors import InputError
from cellwise.identify.checked_logs import VOLT_PER_KELVIN, CheckedLogs, grouped_by_temperature
from cellwise.identify.hppc.pulses import Pulse, find_pulses, pulses_to_fit
from cellwise.identify.identification import IdentifySettings, PulseSet, TestLogs
from cellwise.identify.measured_ocv import pulse_counts
from cellwise.identify.ocv.curve import OcvCurve
from cellwise.identify.pulse_fit.fit_pulse import fit_pulses
from cellwise.identify.pulse_fit.pulse_data import PulseData, has_enough_rows
from cellwise.identify.soc_anchor import anchor_soc
from cellwise.identify.tables import GRID_POINTS, PulseTables, pulse_tables
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

LARGEST_PULSE = 1.0 / 3.0  # of the capacity: a discharge beyond it has no parameters of one SOC
COLDER_K = 15.0  # from so much on a cold cell resists more, whatever pulses and samples do


@dataclass(frozen=True, eq=False)
class Group:
    """The tests of one temperature and what their pulses gave."""

    temperature_C: float
    tests: TestLogs
    pulse_sets: tuple[PulseSet, ...]
    tables: PulseTables | None


@dataclass(frozen=True, eq=False)
class FittedPulses:
    """The groups, coldest first, and what was found on the way."""

    groups: tuple[Group, ...]
    contradictions: tuple[Notice, ...]
    notices: tuple[str, ...]


def fit_all_pulses(
    checked: CheckedLogs, ocv: OcvCurve, capacity_Ah: float, settings: IdentifySettings
) -> FittedPulses:
    """Fit the healthy pulses of every HPPC log.

    Raises
    ------
    InputError        HPPC logs of a temperature without a pulse to fit, and no drive of it
    """
    parts = grouped_by_temperature(checked.tests, checked.low_rate, checked.default_C)
    groups = tuple(
        _group(temperature, part, ocv, capacity_Ah, settings) for temperature, part in parts.items()
    )
    slow = (slow_rows_notice(p.log, p.fitted) for g in groups for p in g.pulse_sets)
    return FittedPulses(groups, _exchanged(groups), tuple(n for n in slow if n))


def _group(
    temperature_C: float,
    part: TestLogs,
    ocv: OcvCurve,
    capacity_Ah: float,
    settings: IdentifySettings,
) -> Group:
    sets = tuple(_pulse_set(log, ocv, capacity_Ah, settings) for log, _ in part.hppc)
    fits = [f for s in sets for f in s.fits]
    if part.hppc and not fits and not part.drive:
        raise InputError(
            pulse_counts(part)[0],
            "a healthy pulse after a rest that moves less than a third of the charge",
            "Give an HPPC log whose pulses stay within the voltage limits, or a drive.",
        )
    tables = pulse_tables(fits, GRID_POINTS, settings.tables) if fits else None
    return Group(temperature_C, part, sets, tables)


def _pulse_set(
    log: CellLog, ocv: OcvCurve, capacity_Ah: float, settings: IdentifySettings
) -> PulseSet:
    pulses = find_pulses(log)
    anchor = anchor_soc(log, ocv, capacity_Ah, 0.0)
    soc = anchor.soc - log.counted_charge_Ah() / capacity_Ah
    table = ocv.function.evaluate
    cut = []
    for p in pulses_to_fit(pulses):
        inside = -0.02 <= soc[p.start] <= 1.02
        if not inside or abs(p.charge_Ah) > LARGEST_PULSE * capacity_Ah:
            continue
        # A paper's method takes the OCV of a pulse from the rest before it.
        own = table if settings.method == "varpro" or p.role == "move" else None
        with suppress(InputError):  # too few rows
            cut += [
                (p, d) for d in cut_pulses(log, [p], capacity_Ah, soc, own) if has_enough_rows(d)
            ]
    fits = fit_pulses([d for _, d in cut], settings.method)
    return PulseSet(log, anchor, pulses, tuple(p for p, _ in cut), tuple(fits))


def _exchanged(groups: Sequence[Group]) -> tuple[Notice, ...]:
    """Temperatures of which the colder one resists less: a cold cell has more."""
    known = [(g, _resistance(g.tables)) for g in groups if g.tables is not None]
    found = []
    for pair in combinations(known, 2):
        (cold, at_cold), (warm, at_warm) = sorted(pair, key=lambda x: x[0].temperature_C)
        colder_K = warm.temperature_C - cold.temperature_C
        if colder_K >= COLDER_K and at_cold < at_warm:
            names = [g.pulse_sets[0].log.name for g in (cold, warm)]
            text = (
                f"'{names[0]}' at {cold.temperature_C:.0f} degC has {1e3 * at_cold:.3g} mohm, "
                f"'{names[1]}' at {warm.temperature_C:.0f} degC {1e3 * at_warm:.3g} mohm: a cold "
                "cell has more, are they exchanged?"
            )
            found.append(Notice(VOLT_PER_KELVIN * colder_K, text))
    return tuple(found)


def _resistance(tables: PulseTables) -> float:
    """R0 + R1 in the middle of the SOC range [ohm]."""
    return float(np.median(tables.values["r0_ohm"] + tables.values["r1_ohm"]))


class _Window(NamedTuple):
    """How much of a log belongs to a pulse."""

    rest_s: float = 60.0  # of rest before it that is compared, if there is as much
    rest_rows: int = 3  # at least
    before_s: float = 600.0  # shown before it: branches of minutes have forgotten the rest
    quiet: float = 0.02  # less than this part of the pulse's current is no current
    switch_rows: int = 2  # on either side that may hold part of a switch
    # Of a long step the first minutes are a pulse: over hours two branches go to what is slow, and
    # R0 takes in all that is fast. What is slow is for the refinement on the whole log.
    step_s: float = 300.0
    step_rows: int = 25
    late_row_s: float = 2.5  # a drive changes its current every second or two


WINDOW = _Window()
OcvTable = Callable[[FloatArray], FloatArray]


def pulse_from_arrays(
    time_s: FloatArray,
    current_A: FloatArray,
    voltage_V: FloatArray,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    first: int = 0,
    soc_start: float = float("nan"),
    ocv: OcvTable | None = None,
    name: str = "",
) -> PulseData:
    """One pulse from plain arrays; rows without a finite voltage are dropped.

    The charge that flowed up to a dropped row stays in the interval of the row that follows.

    Parameters
    ----------
    time_s, current_A, voltage_V : (n,) float     as in `PulseData`; voltage may hold NaN
    start, stop : int         first row of the pulse; first row after it
    capacity_Ah : float       [Ah]
    first : int               first row that is compared
    soc_start : float         SOC at the first row of all [0..1]; needed with ``ocv``
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]
    name : str                for people

    Raises
    ------
    InputError        too few rows
    """
    time, current, voltage = time_s, current_A, voltage_V
    keep = np.flatnonzero(np.isfinite(voltage))
    dt = np.diff(time, prepend=time[0])
    charge = np.cumsum(current * dt) / 3600.0
    if keep.size < time.size:
        current = _merged_current(time, current, charge, keep)
        first, start, stop = (int(np.searchsorted(keep, row)) for row in (first, start, stop))
        time, voltage, charge = time[keep], voltage[keep], charge[keep]
        charge = charge - charge[0] if charge.size else charge
    change = None
    if ocv is not None:
        table = np.asarray(ocv(soc_start - charge / capacity_Ah), dtype=np.float64)
        change = table - table[0]
    return PulseData(
        time, current, voltage, charge, start, stop, capacity_Ah, soc_start, first, change, name
    )


def cut_pulse(
    log: CellLog,
    start: int,
    stop: int,
    capacity_Ah: float,
    *,
    soc_start: float = float("nan"),
    ocv: OcvTable | None = None,
) -> PulseData:
    """Cut the pulse in rows ``start`` to ``stop`` (not included) out of a log.

    What is compared begins a minute before the pulse and ends before the next current or a gap. Ten
    minutes before the pulse are shown, too: what its branches hold comes from there.

    Parameters
    ----------
    log : CellLog
    start, stop : int         first row whose interval carries the pulse; first row after it
    capacity_Ah : float       [Ah]
    soc_start : float         SOC right before the pulse [0..1]
    ocv : callable            tabulated OCV: SOC array -> voltage array [V]

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    time, current, voltage = log.time_s, log.known_current_A(), log.voltage_V
    gaps = log.gap_rows
    limit = WINDOW.quiet * float(np.max(np.abs(current[start:stop])))
    begin = start
    while begin > max(start - WINDOW.switch_rows, 1) and abs(current[begin - 1]) > limit:
        begin -= 1
    after = stop
    while after < min(stop + WINDOW.switch_rows, time.size) and abs(current[after]) > limit:
        after += 1
    # The row that ends a current, or a gap, is the rest's first: its voltage is read after it.
    busy = np.flatnonzero((np.abs(current) > limit) | gaps)
    earlier, later = busy[busy < begin], busy[busy >= after]
    rest = int(earlier[-1]) if earlier.size else 0
    end = max(int(later[0]) if later.size else time.size, stop)
    if end < time.size and not gaps[end] and end > after + 1:
        end -= 1  # the row before the next current may hold its switch
    if end == after:  # what looked like the tail of the switch was the next current
        end = stop
    at_s = float(time[max(begin - 1, 0)])
    shown = int(np.searchsorted(time, at_s - WINDOW.rest_s))
    first = max(rest, min(shown, begin - WINDOW.rest_rows), 0)
    before = int(np.searchsorted(time, at_s - WINDOW.before_s))
    gap = np.flatnonzero(gaps[: first + 1])
    before = min(max(before, int(gap[-1]) if gap.size else 0), first)
    rows = slice(before, end)
    moved_Ah = float(log.counted_charge_Ah()[max(begin - 1, 0)] - log.counted_charge_Ah()[before])
    return pulse_from_arrays(
        time[rows], current[rows], voltage[rows], begin - before, stop - before, capacity_Ah,
        first=first - before,
        soc_start=soc_start + moved_Ah / capacity_Ah,
        ocv=ocv,
        name=f"{log.name} at {time[start]:.0f} s",
    )  # fmt: skip


def cut_pulses(
    log: CellLog,
    pulses: Sequence[Pulse],
    capacity_Ah: float,
    soc: FloatArray | None = None,
    ocv: OcvTable | None = None,
) -> list[PulseData]:
    """Cut all pulses that `find_pulses` found out of their log; of a move, its first minutes.

    Parameters
    ----------
    log : CellLog
    pulses : sequence of Pulse        of this log
    capacity_Ah : float               [Ah]
    soc : (n,) float                  SOC of every row of the log [0..1]; None if unknown
    ocv : callable                    tabulated OCV: SOC array -> voltage array [V]

    Returns
    -------
    list of PulseData         in the order given

    Raises
    ------
    InputError        as `pulse_from_arrays`
    """
    return [
        cut_pulse(
            log, p.start, fitted_stop(log, p), capacity_Ah,
            soc_start=float("nan") if soc is None else float(soc[max(p.start - 1, 0)]),
            ocv=ocv,
        )
        for p in pulses
    ]  # fmt: skip


def fitted_stop(log: CellLog, pulse: Pulse) -> int:
    """Row after the last one that a fit sees as the pulse: of a long move, some minutes."""
    if pulse.role != "move":
        return pulse.stop
    begin = float(log.time_s[max(pulse.start - 1, 0)])
    shown = int(np.searchsorted(log.time_s, begin + WINDOW.step_s, "right"))
    return min(max(shown, pulse.start + WINDOW.step_rows), pulse.stop)


def slow_rows_notice(log: CellLog, pulses: Sequence[Pulse]) -> str | None:
    """What a person should know of a log whose first row after a switch comes late."""
    if not pulses:
        return None
    first_s = float(np.median([log.interval_s[p.start] for p in pulses]))
    if first_s <= WINDOW.late_row_s:
        return None
    return (
        f"'{log.name}' has its first row {first_s:.3g} s after a switch: what its R0 says is the "
        "resistance after that time; for a drive log pulses every second or faster"
    )


def _merged_current(
    time: FloatArray, current: FloatArray, charge: FloatArray, keep: NDArray[np.intp]
) -> FloatArray:
    """Interval current of the rows kept: unchanged, or the mean over the rows dropped before."""
    merged: FloatArray = current[keep].copy()
    late = np.flatnonzero(np.diff(keep, prepend=-1) > 1)
    for k in late:
        if k == 0:
            continue
        dt = time[keep[k]] - time[keep[k - 1]]
        if dt > 0.0:
            merged[k] = 3600.0 * (charge[keep[k]] - charge[keep[k - 1]]) / dt
    return merged

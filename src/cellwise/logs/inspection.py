"""What is in a log: counts, ranges, sign, gaps, rests, and everything odd about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks import critical, faults, units
from cellwise.logs.checks.sign import SignCheck, Verdict, contradiction, verify_sign
from cellwise.logs.checks.units import check_is_log
from cellwise.logs.files.times import DAY_S
from cellwise.logs.gaps import Gap, run_edges
from cellwise.notices import Code, Notice, coded, critical_first
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import RowPlace

MOST_GAPS = 5  # noted one by one
QUIET = 0.005  # share of the largest current up to which one is none
REST_S = 60.0  # without current after which a voltage is an OCV


class RestPeriod(NamedTuple):
    """A time without current: where it starts, its length, the voltage at its end."""

    start_s: float
    duration_s: float
    voltage_V: float


class ValueRange(NamedTuple):
    """Smallest and largest value of a channel."""

    min: float
    max: float


class Sampling(NamedTuple):
    """Logging intervals [s]."""

    median_s: float
    min_s: float
    max_s: float


@dataclass(frozen=True)
class Inspection:
    """Everything `inspect_log` finds; `to_dict` gives the keys of ``cellwise inspect --json``.

    ``charge_Ah`` is the net charge drawn, by the tester's counter where there is one;
    ``counter_mismatch_percent`` how far the summed current ends from the counter, in percent of the
    charge moved; ``missing`` the rows without a
    value, by channel; ``soc0`` the stated SOC at the first row.
    """

    name: str
    format: str
    samples: int
    duration_s: float
    sign: Verdict
    sign_evidence: tuple[str, ...]
    gaps: tuple[Gap, ...]
    duplicates: int
    current_A: ValueRange
    voltage_V: ValueRange
    temperature_C: ValueRange | None
    charge_Ah: float
    sampling: Sampling
    counter_mismatch_percent: float | None
    rests: tuple[RestPeriod, ...]
    stuck: dict[str, faults.FaultSegment]
    missing: dict[str, int]
    notices: tuple[Notice, ...]
    soc0: float | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain lists, dicts and numbers for JSON."""
        gap = ("start_s", "duration_s", "charge_Ah")
        gaps = [{name: getattr(g, name) for name in gap} for g in self.gaps]
        return {**{name: _plain(value) for name, value in vars(self).items()}, "gaps": gaps}


def _plain(value: object) -> object:
    if isinstance(value, Notice):
        return value.text
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return value._asdict() if hasattr(value, "_asdict") else [_plain(item) for item in value]
    return value


def inspect_log(log: CellLog) -> Inspection:
    """Look a log over.

    Parameters
    ----------
    log : CellLog

    Returns
    -------
    Inspection        its ``notices``: those of reading, and one for every oddity
    """
    check_is_log(log)
    possible = faults.possible_part(log)
    check = verify_sign(possible)
    counter = units.compare_counter(log)
    mismatch = None if counter is None else counter.mismatch_percent
    rests = tuple(find_rests(log))
    stuck = {
        name: stretch
        for name, runs in faults.stuck_runs(possible).items()
        if (stretch := faults.longest(log, runs)) is not None
    }
    missing = {
        field: int(np.count_nonzero(np.isnan(values)))
        for field in ("current_A", "voltage_V", "temperature_C", "charge_Ah")
        if (values := getattr(log, field)) is not None
    }
    notices = [
        *critical_first([*log.notices, *critical.critical_notices(log)]),
        *_sign_notices(log, check),
        *_time_notices(log),
        *_channel_notices(log, missing, stuck, faults.find_spikes(possible).size, mismatch),
    ]
    if not rests:
        text = "no rest of a minute or more anywhere: no open-circuit voltage can be read"
        notices.append(Notice(Code.NO_REST, text))
    if not _is_quiet(log)[0]:
        text = (
            f"the first row is under load ({log.interval_current_A[0]:.3g} A): its voltage is no "
            "open-circuit voltage"
        )
        notices.append(Notice(Code.FIRST_ROW_LOADED, text, rows=range(1)))
    return Inspection(
        name=log.name,
        format=log.format or "memory",
        samples=len(log),
        duration_s=log.duration_s,
        sign=check.verdict,
        sign_evidence=check.evidence,
        gaps=log.gaps,
        duplicates=log.repeated_stamps,
        current_A=_range(log.current_A),
        voltage_V=_range(log.voltage_V),
        temperature_C=None if log.temperature_C is None else _range(log.temperature_C),
        charge_Ah=float(log.counted_charge_Ah()[-1]),
        sampling=_sampling(log),
        counter_mismatch_percent=mismatch,
        rests=rests,
        stuck=stuck,
        missing=missing,
        notices=tuple(notices),
        soc0=log.soc0,
    )


def _range(values: FloatArray) -> ValueRange:
    return ValueRange(float(np.nanmin(values)), float(np.nanmax(values)))


def _sampling(log: CellLog) -> Sampling:
    interval = np.diff(log.time_s)
    moving = interval[interval > 0]
    if moving.size == 0:
        return Sampling(0.0, 0.0, 0.0)
    return Sampling(float(np.median(moving)), float(np.min(interval)), float(np.max(interval)))


def _sign_notices(log: CellLog, check: SignCheck) -> list[Notice]:
    if check.verdict == "undetermined":
        first = check.evidence[0]
        text = f"the sign of the current could not be determined from the data: {first}"
        return [Notice(Code.SIGN_UNDETERMINED, text)]
    known = coded(log.notices, Code.SIGN_CONTRADICTED)
    if check.verdict == "contradicted" and not known:
        return [contradiction("charge-positive")]
    return []


def _time_notices(log: CellLog) -> list[Notice]:
    notices = []
    gaps = log.gaps
    for gap in gaps[:MOST_GAPS]:
        counted = (
            "no counter shows what flowed"
            if gap.charge_Ah is None
            else f"the counter moved by {gap.charge_Ah:.4f} Ah"
        )
        at = RowPlace(f"at {gap.start_s:.1f} s", range(max(gap.row - 1, 0), gap.row + 1))
        said = (f"a gap of {_duration(gap.duration_s)} without rows ", at, f": {counted}")
        notices.append(Notice(Code.GAP, said))
    if len(gaps) > MOST_GAPS:
        notices.append(Notice(Code.MORE_GAPS, f"{len(gaps) - MOST_GAPS} more gaps"))
    if log.repeated_stamps:
        text = f"{log.repeated_stamps} row(s) repeat the time of the row before"
        notices.append(Notice(Code.STAMPS_REPEAT, text))
    return notices


def _channel_notices(
    log: CellLog,
    missing: dict[str, int],
    stuck: dict[str, faults.FaultSegment],
    spikes: int,
    mismatch: float | None,
) -> list[Notice]:
    notices = [
        Notice(Code.ROWS_MISSING, f"{count} of {len(log)} rows without {field}")
        for field, count in missing.items()
        if count
    ]
    for field, stretch in stuck.items():
        other = "current" if field == "voltage_V" else "voltage"
        since = RowPlace(f"from {stretch.start_s:.1f} s", stretch.rows_of(log))
        text = f"{field} stands still for {_duration(stretch.duration_s)} "
        said = (text, since, f" on while the {other} moves: a stuck channel?")
        notices.append(Notice(Code.CHANNEL_STUCK, said))
    noted = coded(log.notices, Code.COUNTER_DIFFERS)
    if spikes:
        text = f"{spikes} row(s) whose voltage jumps away and back without the current"
        notices.append(Notice(Code.SPIKES, text))
    if mismatch is not None and mismatch > units.INSPECTED_PERCENT and not noted:
        notices.append(units.differing(mismatch))
    return notices


def _duration(seconds: float) -> str:
    """A time in the unit a person would use."""
    for unit, length in (("d", DAY_S), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.3g} s"


def _is_quiet(log: CellLog) -> BoolArray:
    """Rows whose interval is without current, shape (n,)."""
    current = np.abs(log.known_current_A())
    return np.asarray(current <= QUIET * np.max(current))


def find_rests(log: CellLog) -> list[RestPeriod]:
    """Times of at least a minute without current; a gap ends a rest."""
    first, last = run_edges(_is_quiet(log) & ~log.gap_rows)
    begins = np.maximum(first - 1, 0)  # the interval that ends at the first quiet row is at rest
    duration_s = log.time_s[last] - log.time_s[begins]
    return [
        RestPeriod(float(log.time_s[a]), float(seconds), float(log.voltage_V[b]))
        for a, b, seconds in zip(begins, last, duration_s, strict=True)
        if seconds >= REST_S
    ]

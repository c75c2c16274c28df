"""Are the units what the names say? By the voltage's answer and the tester's counter."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellwise.arguments import check_kind
from cellwise.errors import InputError
from cellwise.logs.cell_log import WAY_TO_A_LOG, CellLog, typical
from cellwise.logs.files.columns import KELVIN_OFFSET
from cellwise.notices import Code, Notice
from cellwise.typing import BoolArray, FloatArray
from cellwise.wording import Option, place

# From where on a counter has restarted, is in another unit, or is another quantity.
RESTART_SHARE = 0.1  # of its jump, below which it reads after a restart
RESTART_STEPS = 5.0  # of its own, which that jump is above
RESTART_OF_RANGE = 1e-3  # which that jump is above, too
JOINED = 0.5  # of its deviation from the summed current, at most, that it leaves joined up
UNIT_CORRELATION = 0.95  # with the summed current, from which on their ratio is a slip of a unit
SAME_RATIO = 0.1  # of a factor, within which it is that slip
ANOTHER = 0.9  # correlation below which it counts something else
OPPOSITE = 0.5  # correlation against the current, beyond which it counts the other way
NOTED_PERCENT = 2.0  # of the charge moved: a mismatch of the net charges is noted
INSPECTED_PERCENT = 0.5  # and noted by an inspection


class CounterCheck(NamedTuple):
    """Counter and summed current compared, gaps left out.

    ``factor`` is the counter per ampere hour of summed current (least squares), ``agreement``
    their correlation over the log, ``mismatch_percent`` the difference of the net charges in
    percent of the charge moved; ``drawn_Ah`` the charge of each interval by the current, (n,).
    """

    factor: float
    agreement: float
    mismatch_percent: float
    drawn_Ah: FloatArray


def compare_counter(log: CellLog) -> CounterCheck | None:
    """Compare the tester's counter with the sum of the current.

    The current of a row is held over the interval it belongs to; the trapezoid would be wrong
    wherever a tester logs a step late. Where the counter is missing its steps are gathered in the
    next row that has one.

    Returns
    -------
    CounterCheck, or None without a counter, without current or with a counter that stands still
    """
    if log.charge_Ah is None or np.count_nonzero(read := np.isfinite(log.charge_Ah)) < 2:
        return None
    drawn = replace(log, charge_Ah=None).known_current_A() * log.interval_s / 3600.0
    last = np.maximum.accumulate(np.where(read, np.arange(read.size), 0))
    held = log.charge_Ah[last]
    held[np.isnan(held)] = log.charge_Ah[read][0]
    counted = np.diff(held, prepend=held[0])
    drawn[log.gap_rows] = counted[log.gap_rows] = 0.0
    summed, counter = np.cumsum(drawn), np.cumsum(counted)
    difference = float(summed[-1] - counter[-1])
    summed -= summed.mean()
    counter -= counter.mean()
    moved, both = float(summed @ summed), float(summed @ counter)
    seen = float(counter @ counter)
    if moved == 0.0 or seen == 0.0:
        return None
    mismatch = 100.0 * abs(difference) / float(np.sum(np.abs(drawn)))
    return CounterCheck(both / moved, both / np.sqrt(moved * seen), mismatch, drawn)


def checked_counter(log: CellLog, where: str) -> tuple[CellLog, CounterCheck | None, list[Notice]]:
    """Counter in ampere hours, joined up over restarts; left out where it is of no use.

    Raises
    ------
    InputError        its ratio to the current says that current or time are in another unit
    """
    if log.charge_Ah is None:
        return log, None, []
    if not np.any(np.isfinite(log.charge_Ah)):
        empty = Notice(Code.COUNTER_EMPTY, "the counter ampere_hours holds no value")
        return replace(log, charge_Ah=None), None, [empty]
    check = compare_counter(log)
    if check is None:
        return log, None, []
    factor, notices = counter_factor(log, check, where)
    counter = log.charge_Ah * factor if factor != 1.0 else log.charge_Ah
    joined = joined_counter(counter, check.drawn_Ah, log.gap_rows)
    if joined is not None:
        counter, restarts = joined
        text = f"the counter ampere_hours restarts {restarts} time(s) and was joined up"
        notices.append(Notice(Code.COUNTER_JOINED, text))
    if counter is not log.charge_Ah:
        log = replace(log, charge_Ah=counter)
        check = compare_counter(log) or check
    if abs(check.agreement) < ANOTHER:
        text = "the counter ampere_hours does not follow the current and was left out"
        return replace(log, charge_Ah=None), None, [Notice(Code.COUNTER_LEFT_OUT, text)]
    if check.mismatch_percent > NOTED_PERCENT and check.agreement > 0:
        notices.append(differing(check.mismatch_percent))
    return log, check, notices


def differing(percent: float) -> Notice:
    """That counter and summed current differ, in per cent of the charge moved."""
    text = "the counter ampere_hours differs from the summed current by "
    return Notice(Code.COUNTER_DIFFERS, f"{text}{percent:.1f} % of the charge moved")


def joined_counter(
    counter: FloatArray, drawn: FloatArray, gap_rows: BoolArray
) -> tuple[FloatArray, int] | None:
    """The counter with its restarts joined up, and how many there were; None where none was seen.

    A counter has restarted at a row where it reads what flowed during this one interval, and not
    that plus what it read before. The current carries it over that interval. One with missing
    values is left as it is.

    Parameters
    ----------
    counter : (n,) float        [Ah]
    drawn : (n,) float          charge of each interval by the current [Ah]
    gap_rows : (n,) bool        intervals of which the current knows nothing
    """
    if not np.all(np.isfinite(counter)):
        return None
    moves = np.diff(counter)
    jump = moves - drawn[1:]
    fresh = np.abs(counter[1:] - drawn[1:])
    np.abs(moves, out=moves)
    step = float(np.min(moves[moves > 1e-9], initial=np.inf))
    if not np.isfinite(step):
        return None
    least = max(RESTART_STEPS * step, RESTART_OF_RANGE * float(np.ptp(counter)))
    restarts = (np.abs(jump) > least) & (fresh < RESTART_SHARE * np.abs(jump)) & ~gap_rows[1:]
    if not restarts.any():
        return None
    joined = counter - np.concatenate(([0.0], np.cumsum(np.where(restarts, jump, 0.0))))
    summed = np.cumsum(drawn)
    if np.std(joined - summed) > JOINED * np.std(counter - summed):
        return None  # a counter and a current that merely differ
    return joined, int(np.count_nonzero(restarts))


# What one cell, and one string of cells, can have.
IMPOSSIBLE_A = 3000.0
LARGEST_AH = 1000.0  # more is one in another unit
LARGEST_V = 6.0  # a battery of more is a string
TYPICAL_V = 3.7
STRING_V = 1500.0  # more is a number of millivolts
POSSIBLE_C = (-100.0, 200.0)
KELVIN_FROM = 200.0  # a temperature is in that unit

# What a time in seconds cannot be.
EPOCH_S = 1e8  # three years: one that begins later is counted from 1970 or so
FAST_S = 0.02  # no tester logs as fast: the time is in hours

# A counter over the summed current: what it counts, or in which unit something else is.
COUNTERS = {1e3: "milliampere hours", 3600.0: "ampere seconds"}
SLIPS = {
    1e-3: "current in milliampere: name it current_mA; or time in milliseconds: name it time_ms",
    1e-6: "time in microseconds: name its column time_us",
    60.0: "time in minutes: name its column time_min",
    3600.0: "time in hours: name its column time_h",
}


def check_is_log(log: object) -> None:
    """Refuse what is no log of a cell, and one in memory whose numbers are in another unit.

    Raises
    ------
    InputError        another type; millivolts, kelvin, mAh, with the line that converts them
    """
    log = check_kind("log", log, CellLog, WAY_TO_A_LOG)
    for channel, found, largest, unit, slip, undo in (
        ("voltage_V", abs(log.typical_voltage_V), STRING_V, "V", "Millivolts", "/ 1000"),
        ("temperature_C", _lowest(log.temperature_C), KELVIN_FROM, "degC", "Kelvin", "- 273.15"),
        ("charge_Ah", _span(log.charge_Ah), LARGEST_AH, "Ah", "Milliampere hours", "/ 1000"),
    ):
        if found > largest:
            raise InputError(
                f"{channel} of {found:.0f} {unit} in log '{log.name}'",
                f"at most {largest:g} {unit}",
                f"{slip}? Write dataclasses.replace(log, {channel}=log.{channel} {undo}).",
            )


def _lowest(values: FloatArray | None) -> float:
    """The lowest value of a channel; NaN without one."""
    return np.nan if values is None or not np.isfinite(values).any() else float(np.nanmin(values))


def _span(values: FloatArray | None) -> float:
    """From the lowest value of a channel to the highest; NaN without one."""
    if values is None or not np.isfinite(values).any():
        return np.nan
    return float(np.nanmax(values) - np.nanmin(values))


def check_voltage(log: CellLog, where: str, *, of_pack: bool = False) -> list[Notice]:
    """Refuse millivolts; note when the voltage is that of a string, or of another unit.

    ``of_pack``: it was divided by a number of cells in series.

    Raises
    ------
    InputError        the median voltage is above 1500
    """
    usual = typical(np.abs(log.voltage_V))
    if usual > STRING_V:
        raise InputError(
            f"a voltage of typically {usual:.0f} under the name voltage_V in {where}",
            "volts",
            "It looks like millivolts: name the column voltage_mV (if it is, voltage_uV)."
            if usual < 1e3 * STRING_V
            else "It looks like microvolts: name the column voltage_uV.",
        )
    if usual > LARGEST_V and of_pack:
        text = (
            f"the voltage LOOKS WRONG for a cell of the pack: it is typically {usual:.1f} V; check "
            "the number of cells in series, and the unit (`voltage_mV`; `voltage_cV` for 0.01 V)"
        )
        return [Notice(Code.VOLTAGE_UNIT, text)]
    if usual > LARGEST_V:
        text = (
            f"the voltage LOOKS WRONG for one cell: it is typically {usual:.1f} V, a pack of some "
            f"{usual / TYPICAL_V:.0f} cells in series, read as one cell; state their number ("
        )
        said = (text, Option("series", letter="N"), "), or the unit, where it is not volts")
        return [Notice(Code.VOLTAGE_OF_PACK, said)]
    if np.nanmin(log.voltage_V) < 0:
        text = f"the voltage goes down to {np.nanmin(log.voltage_V):.3f} V, below zero"
        return [Notice(Code.VOLTAGE_NEGATIVE, text)]
    return []


def volts_of_millivolts(channels: dict[str, FloatArray]) -> list[Notice]:
    """Turn a tester's millivolts under a name of volts into volts; what was done.

    No tester of cells reaches the voltage that one cell's millivolts would be in volts.
    """
    usual = typical(np.abs(channels["voltage_V"]))
    if not STRING_V < usual < 1e3 * LARGEST_V:
        return []
    channels["voltage_V"] = channels["voltage_V"] / 1e3
    text = f"the voltage, typically {usual:.0f}, is in millivolts and was divided by 1000"
    return [Notice(Code.VOLTAGE_CONVERTED, text)]


def check_charge(log: CellLog) -> list[Notice]:
    """Note a charge that no cell holds: milliamperes, or milliseconds, under a plain name."""
    swing = float(np.ptp(np.cumsum(log.known_current_A() * log.interval_s))) / 3600.0
    if swing <= LARGEST_AH:
        return []
    text = (
        f"the current LOOKS WRONG: it moves {swing:.0f} Ah, more than a cell holds; check the "
        "units of current and time (`current_mA`, `time_ms`)"
    )
    return [Notice(Code.CURRENT_UNIT, text)]


def counter_factor(log: CellLog, check: CounterCheck, where: str) -> tuple[float, list[Notice]]:
    """Factor that turns the counter into ampere hours, from its ratio to the summed current.

    Raises
    ------
    InputError        the ratio says that current or time are in another unit
    """
    ratio = abs(check.factor)
    if abs(check.agreement) < UNIT_CORRELATION:
        return 1.0, []
    fast = float(np.median(log.interval_s[1:])) < FAST_S
    for times, unit in COUNTERS.items():
        if _near(ratio, times) and not (fast and times in SLIPS):
            text = f"the counter ampere_hours is in {unit} and was converted"
            return 1.0 / times, [Notice(Code.COUNTER_CONVERTED, text)]
    slip = next((text for times, text in SLIPS.items() if _near(ratio, times)), None)
    if slip is not None:
        raise InputError(
            f"a counter ampere_hours that is {ratio:.3g} times the summed current in {where}",
            "amperes and seconds",
            f"It looks like {slip}.",
        )
    return 1.0, []


def plausible_temperature(values: FloatArray) -> tuple[FloatArray | None, list[Notice]]:
    """Temperature in degC: kelvin converted, impossible readings taken as missing ones."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return None, [Notice(Code.TEMPERATURE_EMPTY, "the temperature column holds no value")]
    notices = []
    if float(np.median(finite)) > KELVIN_FROM:
        values = values + KELVIN_OFFSET
        text = "the temperature is in kelvin and was converted to degC"
        notices.append(Notice(Code.TEMPERATURE_CONVERTED, text))
    low, high = POSSIBLE_C
    impossible = (values < low) | (values > high)
    if np.any(impossible):
        values = np.where(impossible, np.nan, values)
        count = int(np.count_nonzero(impossible))
        row = int(np.argmax(impossible))
        text = f"{count} temperature(s) outside {low:.0f} to {high:.0f} degC left out, "
        said = (text, place(range(row, row + 1)), " first")
        notices.append(Notice(Code.TEMPERATURE_IMPOSSIBLE, said))
    return (None if np.all(np.isnan(values)) else values), notices


def time_from_start(time_s: FloatArray) -> tuple[FloatArray, list[Notice]]:
    """Seconds from the log's start where the file counts from 1970 or so."""
    if time_s.size == 0 or not abs(time_s[0]) > EPOCH_S:
        return time_s, []
    start = float(time_s[0])
    text = f"the time begins at {start:.0f} s; it is counted from there"
    return time_s - start, [Notice(Code.TIME_FROM_START, text)]


def _near(ratio: float, target: float) -> bool:
    return abs(ratio / target - 1.0) < SAME_RATIO

"""Are the units what the column names say? Checked on the data; definite mistakes are refused."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.checks.counter import CounterCheck
from cellwise.logs.files.columns import KELVIN_OFFSET
from cellwise.logs.measured_log import MeasuredLog, typical
from cellwise.typing import FloatArray


class Cell(NamedTuple):
    """What one cell, and one string of cells, can have.

    A log beyond both current and resistance is in milliampere. Resistance times capacity is the
    drop at a 1C load: tens to hundreds of millivolts. A battery of more volts than ``largest_V`` is
    a string; than ``string_V``, a number of millivolts.
    """

    large_A: float = 1000.0
    impossible_A: float = 3000.0
    smallest_ohm: float = 1e-4
    largest_Ah: float = 1000.0
    largest_V: float = 6.0
    typical_V: float = 3.7
    string_V: float = 1500.0
    large_drop_V: float = 5.0
    impossible_drop_V: float = 25.0
    temperature_C: tuple[float, float] = (-100.0, 200.0)


CELL = Cell()
EPOCH_S = 1e8  # a time that begins later than three years is counted from 1970 or so
LOWEST_KELVIN = 200.0
EDGE = 0.2  # of the largest current: a step that shows the resistance
SAME = 0.1  # of a factor between two units
LEAST_AGREEMENT = 0.95  # of counter and current, to speak of a factor between them


def check_voltage(log: MeasuredLog, where: str) -> list[str]:
    """Refuse millivolts; note when the voltage is that of a string.

    Raises
    ------
    InputError        the median voltage is above 1500
    """
    usual = typical(np.abs(log.voltage_V))
    if usual > CELL.string_V:
        raise InputError(
            f"a voltage of typically {usual:.0f} under the name voltage_V in {where}",
            "volts",
            "It looks like millivolts: name the column voltage_mV.",
        )
    if usual > CELL.largest_V:
        return [
            f"the voltage LOOKS WRONG for one cell: it is typically {usual:.1f} V, a pack of some "
            f"{usual / CELL.typical_V:.0f} cells in series, read as one cell; state their number "
            "(`series=N`), or the unit, where it is not volts"
        ]
    if np.nanmin(log.voltage_V) < 0:
        return [f"the voltage goes down to {np.nanmin(log.voltage_V):.3f} V, below zero"]
    if usual < 0.5:
        return [f"the voltage is typically {usual:.3f} V: too low for a lithium-ion cell"]
    return []


def volts_of_millivolts(channels: dict[str, FloatArray]) -> list[str]:
    """Turn a tester's millivolts under a name of volts into volts; what was done.

    No tester of cells reaches the voltage that one cell's millivolts would be in volts.
    """
    usual = typical(np.abs(channels["voltage_V"]))
    if not CELL.string_V < usual < 1e3 * CELL.largest_V:
        return []
    channels["voltage_V"] = channels["voltage_V"] / 1e3
    return [f"the voltage, typically {usual:.0f}, is in millivolts and was divided by 1000"]


def check_current_and_time(log: MeasuredLog, where: str) -> list[str]:
    """Refuse milliampere and milliseconds, or note them, from the voltage's answer alone.

    Raises
    ------
    InputError        above 3000 A through less than 0.1 mOhm; a cell that would drop by more than
                      25 V under a load of 1C
    """
    largest = float(np.nanmax(np.abs(log.current_A)))
    cells = max(1.0, log.typical_voltage_V / CELL.typical_V)
    resistance = _edge_resistance(log)
    if resistance is not None:
        resistance /= cells
    drawn = np.cumsum(log.known_current_A() * log.interval_s) / 3600.0
    swing = float(np.ptp(drawn))
    if largest > CELL.large_A and (
        swing > CELL.largest_Ah if resistance is None else resistance < CELL.smallest_ohm
    ):
        seen = f"a current of up to {largest:.0f} under the name current_A in {where}"
        if resistance is not None:
            seen += f", through {1e6 * resistance:.1f} microohm"
        if largest > CELL.impossible_A:
            raise InputError(
                seen, "amperes through one cell", "If it is milliampere, name it current_mA."
            )
        return [f"{seen}: it looks like milliampere; if so, name the column current_mA"]
    if resistance is not None and resistance * swing > CELL.large_drop_V:
        seen = (
            f"a current that moves {swing:.0f} Ah through {1000 * resistance:.1f} mOhm in {where}"
        )
        if resistance * swing > CELL.impossible_drop_V:
            raise InputError(
                seen,
                "a capacity and a resistance that a cell can have together",
                "If the time is in milliseconds, name its column time_ms.",
            )
        return [f"{seen}: if the time is in milliseconds, name its column time_ms"]
    if swing > CELL.largest_Ah:
        return [
            f"the current moves {swing:.0f} Ah, more than a cell holds: check the units of "
            "current and time (current_mA, time_ms)"
        ]
    return []


def counter_factor(log: MeasuredLog, check: CounterCheck, where: str) -> tuple[float, list[str]]:
    """Factor that turns the counter into ampere hours, from its ratio to the summed current.

    Raises
    ------
    InputError        the ratio says that current or time are in another unit
    """
    ratio = abs(check.factor)
    if abs(check.agreement) < LEAST_AGREEMENT:
        return 1.0, []
    interval = float(np.median(log.interval_s[1:]))
    if _near(ratio, 1e-3):
        mA = float(np.nanmax(np.abs(log.current_A))) > 200.0 or interval < 20.0
        raise InputError(
            f"a current that sums up to {1 / ratio:.0f} times the counter ampere_hours in {where}",
            "amperes and seconds",
            "The current looks like milliampere: name its column current_mA."
            if mA
            else "Either the current is in milliampere or the time in milliseconds: name the "
            "column current_mA or time_ms.",
        )
    if _near(ratio, 1e-6):
        raise InputError(
            f"a current that sums up to a million times the counter ampere_hours in {where}",
            "amperes and seconds",
            "If the time is in microseconds, name its column time_us.",
        )
    if _near(ratio, 1e3):
        return 1e-3, ["the counter ampere_hours is in milliampere hours and was divided by 1000"]
    if _near(ratio, 60.0) or (_near(ratio, 3600.0) and interval < 0.02):
        unit = "minutes" if ratio < 100 else "hours"
        raise InputError(
            f"a counter ampere_hours that counts {ratio:.0f} times the summed current in {where}",
            "time in seconds",
            f"The time looks like {unit}: name its column time_{'min' if ratio < 100 else 'h'}.",
        )
    if _near(ratio, 3600.0):
        return 1.0 / 3600.0, ["the counter ampere_hours is in ampere seconds and was converted"]
    return 1.0, []


def plausible_temperature(values: FloatArray) -> tuple[FloatArray | None, list[str]]:
    """Temperature in degC: kelvin converted, impossible readings taken as missing ones."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return None, ["the temperature column holds no value"]
    notices = []
    if float(np.median(finite)) > LOWEST_KELVIN:
        values = values + KELVIN_OFFSET
        notices.append("the temperature is in kelvin and was converted to degC")
    low, high = CELL.temperature_C
    impossible = (values < low) | (values > high)
    if np.any(impossible):
        values = np.where(impossible, np.nan, values)
        count = int(np.count_nonzero(impossible))
        row = int(np.argmax(impossible)) + 1  # people count from 1
        notices.append(
            f"{count} temperature(s) outside {low:.0f} to {high:.0f} degC left out, row {row} first"
        )
    return (None if np.all(np.isnan(values)) else values), notices


def time_from_start(time_s: FloatArray) -> tuple[FloatArray, list[str]]:
    """Seconds from the log's start where the file counts from 1970 or so."""
    if time_s.size == 0 or not abs(time_s[0]) > EPOCH_S:
        return time_s, []
    start = float(time_s[0])
    return time_s - start, [f"the time begins at {start:.0f} s; it is counted from there"]


def _edge_resistance(log: MeasuredLog) -> float | None:
    """Median |dV/dI| over the log's largest current steps [ohm]; None without a clear one."""
    change = np.diff(log.current_A)
    answer = np.abs(np.diff(log.voltage_V))
    usable = np.isfinite(change) & np.isfinite(answer)
    if not usable.any():
        return None
    size = np.abs(change)
    edges = usable & (size > EDGE * float(np.nanmax(np.abs(log.current_A))))
    if not edges.any():
        return None
    return float(np.median(answer[edges] / size[edges]))


def _near(ratio: float, target: float) -> bool:
    return abs(ratio / target - 1.0) < SAME

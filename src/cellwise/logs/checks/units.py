"""Are the units what the column names say? Checked on the data; definite mistakes are refused."""

from __future__ import annotations

import math

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.checks.counter import CounterCheck
from cellwise.logs.files.columns import KELVIN_OFFSET
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

# No laboratory carries one cell beyond these; a log beyond both is in milliampere.
LARGEST_CELL_CURRENT_A = 1000.0
IMPOSSIBLE_CELL_CURRENT_A = 3000.0
SMALLEST_RESISTANCE_OHM = 1e-4
LARGEST_CELL_AH = 1000.0
# A battery of more volts than the first is a string, than the second a number of millivolts.
LARGEST_CELL_V = 6.0
LARGEST_STRING_V = 1500.0
SUSPECT_STRING_V = 100.0
# Resistance times capacity is the drop at a 1C load: tens to hundreds of millivolts.
LARGEST_DROP_AT_1C_V = 5.0
IMPOSSIBLE_DROP_AT_1C_V = 25.0
TYPICAL_CELL_V = 3.7
LOWEST_KELVIN = 200.0
POSSIBLE_C = (-100.0, 200.0)
EDGE_OF_LARGEST = 0.05
EPOCH_S = 1e8
TYPICAL_OF = 4000  # values show the unit as well as a million
FACTOR_TOLERANCE = 0.1
LEAST_AGREEMENT = 0.95


def check_voltage(log: MeasuredLog, where: str) -> list[str]:
    """Refuse millivolts; note when the voltage is that of a string.

    Raises
    ------
    InputError        the median voltage is above 1500
    """
    typical = _typical(np.abs(log.voltage_V))
    if typical > LARGEST_STRING_V:
        raise InputError(
            f"a voltage of typically {typical:.0f} under the name voltage_V in {where}",
            "volts",
            "It looks like millivolts: name the column voltage_mV.",
        )
    cells = f"some {typical / TYPICAL_CELL_V:.0f} cells in series"
    if typical > SUSPECT_STRING_V:
        return [
            f"the voltage LOOKS WRONG for one cell: it is typically {typical:.0f} V, a pack of "
            f"{cells}, or a cell logged in another unit than volts"
        ]
    if typical > LARGEST_CELL_V:
        return [
            f"the voltage LOOKS WRONG for one cell: it is typically {typical:.1f} V, {cells}, read "
            "as one cell; state their number (`series=N`)"
        ]
    if np.nanmin(log.voltage_V) < 0:
        return [f"the voltage goes down to {np.nanmin(log.voltage_V):.3f} V, below zero"]
    if typical < 0.5:
        return [f"the voltage is typically {typical:.3f} V: too low for a lithium-ion cell"]
    return []


def volts_of_millivolts(channels: dict[str, FloatArray]) -> list[str]:
    """Turn a tester's millivolts under a name of volts into volts; what was done.

    No tester of cells reaches the voltage that one cell's millivolts would be in volts.
    """
    typical = _typical(np.abs(channels["voltage_V"]))
    if not LARGEST_STRING_V < typical < 1e3 * LARGEST_CELL_V:
        return []
    channels["voltage_V"] = channels["voltage_V"] / 1e3
    return [f"the voltage, typically {typical:.0f}, is in millivolts and was divided by 1000"]


def check_current_and_time(log: MeasuredLog, where: str) -> list[str]:
    """Refuse milliampere and milliseconds, or note them, from the voltage's answer alone.

    Raises
    ------
    InputError        above 3000 A through less than 0.1 mOhm; a cell that would drop by more than
                      25 V under a load of 1C
    """
    largest = float(np.nanmax(np.abs(log.current_A)))
    cells = max(1.0, _typical(log.voltage_V) / TYPICAL_CELL_V)
    resistance = _edge_resistance(log)
    if resistance is not None:
        resistance /= cells
    drawn = np.cumsum(log.known_current_A() * log.interval_s) / 3600.0
    swing = float(np.ptp(drawn))
    if largest > LARGEST_CELL_CURRENT_A and (
        swing > LARGEST_CELL_AH if resistance is None else resistance < SMALLEST_RESISTANCE_OHM
    ):
        seen = f"a current of up to {largest:.0f} under the name current_A in {where}"
        if resistance is not None:
            seen += f", through {1e6 * resistance:.1f} microohm"
        if largest > IMPOSSIBLE_CELL_CURRENT_A:
            raise InputError(
                seen, "amperes through one cell", "If it is milliampere, name it current_mA."
            )
        return [f"{seen}: it looks like milliampere; if so, name the column current_mA"]
    if resistance is not None and resistance * swing > LARGEST_DROP_AT_1C_V:
        seen = (
            f"a current that moves {swing:.0f} Ah through {1000 * resistance:.1f} mOhm in {where}"
        )
        if resistance * swing > IMPOSSIBLE_DROP_AT_1C_V:
            raise InputError(
                seen,
                "a capacity and a resistance that a cell can have together",
                "If the time is in milliseconds, name its column time_ms.",
            )
        return [f"{seen}: if the time is in milliseconds, name its column time_ms"]
    if swing > LARGEST_CELL_AH:
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
    low, high = POSSIBLE_C
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


def _typical(values: FloatArray) -> float:
    """Median of the values; of very many, of every so manyth one."""
    some = values[:: max(values.size // TYPICAL_OF, 1)]
    found = float(np.nanmedian(some)) if np.isfinite(some).any() else math.nan
    return found if math.isfinite(found) else float(np.nanmedian(values))


def _edge_resistance(log: MeasuredLog) -> float | None:
    """Median |dV/dI| over the log's largest current steps [ohm]; None without a clear one."""
    change = np.diff(log.current_A)
    answer = np.abs(np.diff(log.voltage_V))
    usable = np.isfinite(change) & np.isfinite(answer)
    if not usable.any():
        return None
    size = np.abs(change)
    largest = float(np.nanmax(np.abs(log.current_A)))
    edges = usable & (size > 0.2 * float(np.nanmax(log.current_A) - np.nanmin(log.current_A)))
    edges &= size > EDGE_OF_LARGEST * largest
    if not edges.any():
        return None
    return float(np.median(answer[edges] / size[edges]))


def _near(ratio: float, target: float) -> bool:
    return abs(ratio / target - 1.0) < FACTOR_TOLERANCE

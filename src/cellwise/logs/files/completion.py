"""What testers write in pieces: unsigned currents with a state, counters in two halves, step times.

A reader may give, beside the fields of `CellLog`:

``direction``      +1 discharge, -1 charge, 0 rest, NaN unknown; signs a current without sign
``moved_Ah``       a counter without sign that restarts with every step; needs ``direction``
``charged_Ah``, ``discharged_Ah``    two counters that only rise, until they restart
``working_V``, ``counter_V``     two electrodes against a reference: the cell is their difference
``step_time_s``    time since the tester's step began, where there is no time of the test
"""

from __future__ import annotations

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.files.format import SignConvention
from cellwise.logs.files.source import RawLog
from cellwise.typing import BoolArray, FloatArray

SIGNED_SHARE = 1e-3  # of the rows under load; fewer negative ones are a sensor's zero
LOAD_OF_LARGEST = 0.01
LEAST_AGREEING = 0.9  # of the rows whose sign and state can be compared
RESTART_BELOW = 0.5  # of what a counter read before: less is a restart, more is its last digit


def complete(raw: RawLog, sign: SignConvention, where: str) -> RawLog:
    """A reader's channels with time, signed current and one counter.

    Raises
    ------
    InputError        a current without sign in a state that the format does not know
    """
    channels = dict(raw.channels)
    notices = list(raw.notices)
    step_time = channels.pop("step_time_s", None)
    if "time_s" not in channels and step_time is not None:
        channels["time_s"] = accumulated(step_time)
        notices.append("the time of the steps was joined up")
    working, counter = channels.pop("working_V", None), channels.pop("counter_V", None)
    if "voltage_V" not in channels and working is not None:
        channels["voltage_V"] = working if counter is None else working - counter
        if counter is not None:
            notices.append("the voltage is Ewe less Ece: both electrodes are logged")
    direction = channels.pop("direction", None)
    if direction is None:
        direction = _counted_direction(channels)
    if direction is not None and "current_A" in channels:
        channels["current_A"], noted = _signed(channels["current_A"], direction, sign, where)
        notices += noted
    moved = channels.pop("moved_Ah", None)
    charged = channels.pop("charged_Ah", None)
    discharged = channels.pop("discharged_Ah", None)
    if charged is not None and discharged is not None:
        channels.setdefault("charge_Ah", accumulated(discharged) - accumulated(charged))
    elif moved is not None and direction is not None:
        steps = np.nan_to_num(np.diff(accumulated(moved), prepend=0.0) * direction)
        steps[0] = 0.0
        channels.setdefault("charge_Ah", np.cumsum(steps))
    if "current_A" not in channels:
        channels["current_A"] = _counted_current(channels, sign, where)
        notices.append("there is no current; it was taken from the counter's steps")
    return RawLog(channels, tuple(notices), raw.cells)


def accumulated(counter: FloatArray) -> FloatArray:
    """A rising counter without its restarts; missing values are held."""
    known = np.isfinite(counter)
    if not known.any():
        return counter
    held = counter
    if not known.all():
        last = np.maximum.accumulate(np.where(known, np.arange(counter.size), -1))
        held = np.where(last >= 0, counter[last], counter[known][0])
    steps = np.diff(held, prepend=0.0)
    restarts = np.flatnonzero((steps[1:] < 0) & (held[1:] < RESTART_BELOW * held[:-1])) + 1
    if restarts.size == 0:
        return held
    steps[restarts] = held[restarts]
    return np.cumsum(steps)


def _signed(
    current: FloatArray, direction: FloatArray, sign: SignConvention, where: str
) -> tuple[FloatArray, list[str]]:
    """Current in the format's sign, by the tester's state where the file has none."""
    size = np.abs(current)
    largest = float(np.nanmax(size, initial=0.0))
    load = size > LOAD_OF_LARGEST * largest
    negative = load & (current < 0)
    if np.count_nonzero(negative) > SIGNED_SHARE * np.count_nonzero(load):
        return _sign_by_state(current, direction, load, sign, where)
    unknown = load & np.isnan(direction)
    if unknown.any():
        row = int(np.flatnonzero(unknown)[0])
        raise InputError(
            f"a current without sign in {np.count_nonzero(unknown)} row(s) of {where} whose state "
            f"is not known (row {row + 1} first)",
            "a state that separates charge from discharge",
            "Export the current with its sign.",
        )
    positive = 1.0 if sign == "discharge-positive" else -1.0
    if not np.any(positive * direction[load] < 0):
        return current, []  # charge alone, or discharge alone, in the format's sign
    at_rest = np.where(np.nan_to_num(direction) == 0.0, 1.0, np.nan_to_num(direction))
    return positive * size * at_rest, ["the current has no sign; the tester's state gave it one"]


def _sign_by_state(
    current: FloatArray, direction: FloatArray, load: BoolArray, sign: SignConvention, where: str
) -> tuple[FloatArray, list[str]]:
    """A current that has a sign, in the format's, by what the tester's state says of it."""
    stated = load & (np.nan_to_num(direction) != 0.0)
    count = int(np.count_nonzero(stated))
    if count == 0:
        return current, []
    agreeing = np.count_nonzero(np.sign(current[stated]) == direction[stated]) / count
    discharge_positive = agreeing >= 0.5
    if LEAST_AGREEING > agreeing > 1.0 - LEAST_AGREEING:
        raise InputError(
            f"a current of {where} whose sign agrees with the tester's state in "
            f"{100 * agreeing:.0f} % of the rows under load",
            "one meaning of the sign",
            "Export the file again, or name the right columns with `channels={...}`.",
        )
    if discharge_positive == (sign == "discharge-positive"):
        return current, []
    found = "discharge" if discharge_positive else "charge"
    return -current, [f"positive current is {found}, as the tester's state says"]


def _counted_direction(channels: dict[str, FloatArray]) -> FloatArray | None:
    """The direction by counters of charge and discharge, of a current without any sign."""
    current = channels.get("current_A")
    charged, discharged = channels.get("charged_Ah"), channels.get("discharged_Ah")
    if current is None or charged is None or discharged is None or np.any(current < 0):
        return None
    steps = [np.nan_to_num(np.diff(accumulated(c), prepend=c[0])) for c in (charged, discharged)]
    if not np.any(steps[1] > 0):
        return None  # charge alone, which is what the sign says
    # Both counters may tick where a step begins: less than half of what flowed says nothing.
    flowed = np.nan_to_num(current * np.diff(channels["time_s"], prepend=np.nan)) / 3600.0
    difference = steps[1] - steps[0]
    direction = np.where(np.abs(difference) >= 0.5 * flowed, np.sign(difference), 0.0)
    # A counter's last digit does not move in every row of a load, and not in its first.
    known = (direction != 0.0) | (current <= LOAD_OF_LARGEST * np.nanmax(current))
    rows = np.arange(current.size)
    following = np.minimum.accumulate(np.where(known, rows, rows[-1])[::-1])[::-1]
    before = np.maximum.accumulate(np.where(known, rows, 0))
    filled = np.where(direction[following] != 0.0, direction[following], direction[before])
    return np.where(filled == 0.0, np.nan, filled)


def _counted_current(
    channels: dict[str, FloatArray], sign: SignConvention, where: str
) -> FloatArray:
    """Mean current of every interval from the counter, in the format's sign."""
    if "charge_Ah" not in channels:
        raise InputError(
            f"neither a current nor a counter in {where}",
            "a current",
            "Export the current with the log.",
        )
    interval = np.diff(channels["time_s"], prepend=np.nan)
    drawn = np.diff(channels["charge_Ah"], prepend=np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        current = np.where(interval > 0, 3600.0 * drawn / interval, np.nan)
    current[0] = 0.0
    return current if sign == "discharge-positive" else -current

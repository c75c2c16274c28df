"""From a reader's channels to a log: time, signed current, one counter, units, sign, notices.

A reader may give, beside the fields of `CellLog`, what testers write in pieces:

``direction``      +1 discharge, -1 charge, 0 rest, NaN unknown; signs a current without sign
``moved_Ah``       a counter without sign that restarts with every step; needs ``direction``
``charged_Ah``, ``discharged_Ah``    two counters that only rise, until they restart
``working_V``, ``counter_V``     two electrodes against a reference: the cell is their difference
``step_time_s``    time since the tester's step began, where there is no time of the test

and what a table of no program's form may have in its place: ``state``, a direction that nobody
vouches for; ``charging_A`` and ``discharging_A``; ``day_s``, to which ``time_s`` is the clock.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from cellwise.arguments import shown
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks import critical, units
from cellwise.logs.checks.faults import possible_part
from cellwise.logs.checks.sign import contradiction, verify_sign
from cellwise.logs.checks.unsigned import emptied_too_fast, signed_by_loads
from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.format import Format, SignConvention
from cellwise.logs.files.source import FROM_FILE, RawLog
from cellwise.logs.files.tables import table_channels
from cellwise.logs.files.times import DAY_S
from cellwise.notices import Code, Notice, coded, critical_first
from cellwise.typing import BoolArray, FloatArray, IntArray, NamedColumns
from cellwise.wording import Option, arg

# When a tester's state gives a current its sign, as shares.
UNDER_LOAD = 0.01  # of the largest current: rows of more are under load
SIGNED = 1e-3  # of these are negative where a current has a sign: fewer are a sensor's zero
AGREEING = 0.9  # of the rows agree, or disagree, with the state where its meaning is the sign's
RESTARTED = 0.5  # of what a counter read before: more is its last digit
UNTIMED = 0.01  # of the rows may lack a time
STATED = 0.98  # of the rows under load that a column nobody vouches for must say

BY_STATE = Notice(Code.SIGN_BY_STATE, "the current has no sign; the tester's state gave it one")


def complete(raw: RawLog, sign: SignConvention, where: str, stated: str = FROM_FILE) -> RawLog:
    """A reader's channels with time, signed current and one counter.

    ``stated`` is what the user says of the sign: a current that has one keeps it.

    Raises
    ------
    InputError        a current without sign in a state that the format does not know
    """
    channels = dict(raw.channels)
    notices = list(raw.notices)
    convention = cast("SignConvention", sign if stated == FROM_FILE else stated)
    if (day := channels.pop("day_s", None)) is not None:
        clock = channels["time_s"]  # one of more than a day is the time since the start
        channels["time_s"] = day + clock if np.nanmax(clock, initial=0.0) < DAY_S else clock
    charging, discharging = channels.pop("charging_A", None), channels.pop("discharging_A", None)
    if charging is not None and discharging is not None and "current_A" not in channels:
        out, back = (np.abs(np.nan_to_num(x)) for x in (discharging, charging))
        difference = np.where(np.isnan(discharging) & np.isnan(charging), np.nan, out - back)
        channels["current_A"] = difference if convention == "discharge-positive" else -difference
        raw = replace(raw, signed=True)
    step_time = channels.pop("step_time_s", None)
    if "time_s" not in channels and step_time is not None:
        channels["time_s"] = accumulated(step_time)
        notices.append(Notice(Code.TIME_OF_STEPS, "the time of the steps was joined up"))
    working, counter = channels.pop("working_V", None), channels.pop("counter_V", None)
    if "voltage_V" not in channels and working is not None:
        channels["voltage_V"] = working if counter is None else working - counter
        if counter is not None:
            text = "the voltage is Ewe less Ece: both electrodes are logged"
            notices.append(Notice(Code.VOLTAGE_OF_ELECTRODES, text))
    direction = channels.pop("direction", None)
    if direction is None:
        direction = _counted_direction(channels)
    state = channels.pop("state", None)
    if direction is not None and "current_A" in channels:
        current = channels["current_A"]
        if stated == FROM_FILE or not _has_sign(current)[0]:
            channels["current_A"], noted = _signed(current, direction, convention, where)
            notices += noted
    elif state is not None and "current_A" in channels:
        trusted = raw.signed or stated != FROM_FILE
        current, signed, noted = _signed_by_label(
            channels["current_A"], state, convention, where, trusted=trusted
        )
        channels["current_A"], direction = current, state if signed else None
        raw = replace(raw, signed=raw.signed or signed)
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
        channels["current_A"] = _counted_current(channels, sign)
        text = "there is no current; it was taken from the counter's steps"
        notices.append(Notice(Code.CURRENT_OF_COUNTER, text))
    notices += _drop_rows_without_time(channels, where)
    return replace(raw, channels=channels, notices=tuple(notices))


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
    restarts = np.flatnonzero((steps[1:] < 0) & (held[1:] < RESTARTED * held[:-1])) + 1
    if restarts.size == 0:
        return held
    steps[restarts] = held[restarts]
    return np.cumsum(steps)


def _signed(
    current: FloatArray, direction: FloatArray, sign: SignConvention, where: str
) -> tuple[FloatArray, list[Notice]]:
    """Current in the format's sign, by the tester's state where the file has none."""
    size = np.abs(current)
    has_sign, load = _has_sign(current)
    if has_sign:
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
    return positive * size * at_rest, [BY_STATE]


def _has_sign(current: FloatArray) -> tuple[bool, BoolArray]:
    """Some of the rows under load are negative, others than a sensor's zero; rows under load."""
    size = np.abs(current)
    load = size > UNDER_LOAD * float(np.nanmax(size, initial=0.0))
    negative = np.count_nonzero(load & (current < 0))
    return bool(negative > SIGNED * np.count_nonzero(load)), load


def _signed_by_label(
    current: FloatArray, state: FloatArray, sign: SignConvention, where: str, *, trusted: bool
) -> tuple[FloatArray, bool, list[Notice]]:
    """A current, whether a column of states has given it its sign, and what is to be said.

    Nobody vouches for such a column: it is used where it fits the current throughout, and does not
    change a sign that is ``trusted``.
    """
    has_sign, load = _has_sign(current)
    known = np.nan_to_num(state)
    stated = load & (known != 0.0)
    if np.count_nonzero(stated) < max(STATED * np.count_nonzero(load), 1.0):
        return current, False, []
    agreeing = np.mean(np.sign(current[stated]) == known[stated])
    if has_sign and (trusted or AGREEING > agreeing > 1.0 - AGREEING):
        return current, False, []
    current, noted = _signed(current, known, sign, where)
    return current, True, noted


def _sign_by_state(
    current: FloatArray, direction: FloatArray, load: BoolArray, sign: SignConvention, where: str
) -> tuple[FloatArray, list[Notice]]:
    """A current that has a sign, in the format's, by what the tester's state says of it."""
    stated = load & (np.nan_to_num(direction) != 0.0)
    count = int(np.count_nonzero(stated))
    if count == 0:
        return current, []
    agreeing = np.count_nonzero(np.sign(current[stated]) == direction[stated]) / count
    discharge_positive = agreeing >= 0.5
    if AGREEING > agreeing > 1.0 - AGREEING:
        raise InputError(
            f"a current of {where} whose sign agrees with the tester's state in "
            f"{100 * agreeing:.0f} % of the rows under load",
            "one meaning of the sign",
            "Export the file again, or name the right columns with "
            + arg("channels", letter="{...}")
            + ".",
        )
    if discharge_positive == (sign == "discharge-positive"):
        return current, []
    found = "discharge" if discharge_positive else "charge"
    text = f"positive current is {found}, as the tester's state says"
    return -current, [Notice(Code.SIGN_BY_STATE, text)]


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
    known = (direction != 0.0) | (current <= UNDER_LOAD * np.nanmax(current))
    rows = np.arange(current.size)
    following = np.minimum.accumulate(np.where(known, rows, rows[-1])[::-1])[::-1]
    before = np.maximum.accumulate(np.where(known, rows, 0))
    filled = np.where(direction[following] != 0.0, direction[following], direction[before])
    return np.where(filled == 0.0, np.nan, filled)


def _counted_current(channels: dict[str, FloatArray], sign: SignConvention) -> FloatArray:
    """Mean current of every interval from the counter, in the format's sign."""
    interval = np.diff(channels["time_s"], prepend=np.nan)
    drawn = np.diff(channels["charge_Ah"], prepend=np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        current = np.where(interval > 0, 3600.0 * drawn / interval, np.nan)
    current[0] = 0.0
    return current if sign == "discharge-positive" else -current


SignOption = Literal["auto", "discharge-positive", "charge-positive"]


NO_STEP = -1


def assemble(
    raw: RawLog,
    known: Format | None,
    path: str | Path = "",
    name: str = "",
    sign: str = "auto",
    *,
    check_sign: bool = True,
) -> CellLog:
    """Make a log of a reader's channels.

    Parameters
    ----------
    raw : RawLog          channels with the format's sign
    known : Format        of the file; None: a table in memory, tidy
    path : str or Path    of the file
    name : str            for people
    sign : str            ``auto`` trusts the format, verifies, and notes; the other two override it
    check_sign : bool     verify the sign also where nothing but the data speaks against it

    Raises
    ------
    InputError            units that cannot be, time running backwards, no rows; an unknown ``sign``
    """
    if sign not in get_args(SignOption):
        raise InputError(
            f"sign '{sign}'", f"one of {', '.join(get_args(SignOption))}", "Choose one of them."
        )
    where = f"'{path or name}'" if path or name else "the table"
    of_tester = known is not None and not known.name.startswith("tidy")
    own_sign = known.sign if known is not None and raw.signed else "discharge-positive"
    channels = dict(raw.channels)
    notices = list(raw.notices)
    critical.check_time_moves(channels["time_s"], where)
    channels["time_s"], noted = units.time_from_start(channels["time_s"])
    notices += noted
    critical.check_time_possible(channels["time_s"], where)
    if of_tester:
        notices += units.volts_of_millivolts(channels)
    temperature = channels.get("temperature_C")
    if temperature is not None:
        temperature, noted = units.plausible_temperature(temperature)
        notices += noted
    read_as = own_sign if sign == "auto" else sign
    if read_as == "charge-positive":
        channels["current_A"] = -channels["current_A"]
        text = "positive current was read as charge and inverted"
        notices.append(Notice(Code.SIGN_INVERTED, text))
    log = CellLog(
        time_s=channels["time_s"],
        current_A=channels["current_A"],
        voltage_V=channels["voltage_V"],
        temperature_C=temperature,
        charge_Ah=channels.get("charge_Ah"),
        step=_steps(channels.get("step")),
        name=name,
        source=str(path),
        current_meaning="interval_end" if known is None else known.current_meaning,
        format="table" if known is None else known.name,
        series=raw.series,
        parallel=raw.parallel,
    )
    log, noted = critical.without_impossible(log)
    notices += noted
    current, no_sign = signed_by_loads(log) if BY_STATE not in notices else (None, None)
    if current is not None:
        log = replace(log, current_A=current)
    if no_sign is not None:
        notices.insert(0, no_sign)
    elif sign == "auto" and not raw.signed:
        log, noted = _signed_by_voltage(log)
        notices += noted
    notices += emptied_too_fast(log)
    notices += critical.critical_notices(log)
    of_pack = bool(coded(raw.notices, Code.PACK_DIVIDED))
    notices += units.check_voltage(log, where, of_pack=of_pack)
    log, counter, noted = units.checked_counter(log, where)
    notices += noted
    notices += units.check_charge(possible_part(log))
    opposite = counter is not None and counter.agreement < -units.OPPOSITE
    if not (check_sign or opposite):
        return log.with_notices(critical_first(notices))
    way_out = "charge-positive" if read_as != "charge-positive" else "discharge-positive"
    log, noted = _with_checked_sign(log, sign, way_out, opposite=opposite)
    return log.with_notices(critical_first([*noted, *notices]))


def log_of_table(table: NamedColumns, sign: str, name: str, source: str) -> CellLog:
    """`CellLog.from_table`."""
    where = f"'{source or name}'" if source or name else "the table"
    if isinstance(table, (str, bytes, list, tuple)) or not hasattr(table, "__getitem__"):
        raise InputError(
            f"table = {shown(table)}",
            "a data frame, or a dict of arrays",
            "Pass one of them; a file is read with read_log('a.csv').",
        )
    raw = table_channels(table, TIDY_CHANNELS, where)
    raw = complete(raw, "discharge-positive", where, sign)
    return assemble(raw, None, source, name, sign)


def _drop_rows_without_time(channels: dict[str, FloatArray], where: str) -> list[Notice]:
    """Leave out the few rows whose time is missing: they cannot be placed."""
    missing = ~np.isfinite(channels["time_s"])
    count = int(np.count_nonzero(missing))
    if count == 0:
        return []
    held = np.any([np.isfinite(x) for f, x in channels.items() if f != "time_s"], axis=0)
    if np.count_nonzero(missing & held) > max(1.0, UNTIMED * missing.size):
        row = int(np.flatnonzero(missing)[0])
        raise InputError(
            f"{count} of {missing.size} rows without a time in {where} (row {row + 1} first)",
            "a time in every row",
            "Check the time column, or remove these rows.",
        )
    for field in channels:
        channels[field] = channels[field][~missing]
    return [Notice(Code.ROWS_WITHOUT_TIME, f"{count} row(s) without a time left out")]


def _steps(step: FloatArray | None) -> IntArray | None:
    """Tester steps as integers, missing ones as -1."""
    if step is None:
        return None
    known = np.isfinite(step) & (np.abs(step) < 2**31)
    return np.where(known, step, NO_STEP).astype(np.int32)


def _signed_by_voltage(log: CellLog) -> tuple[CellLog, list[Notice]]:
    """A current whose sign nobody states, by what the voltage does under it."""
    said = "nothing says what the sign of the current means"
    verdict = verify_sign(possible_part(log)).verdict
    if verdict == "contradicted":
        log = replace(log, current_A=-log.current_A)
        text = f"{said}; positive is charge, by the voltage, and was inverted"
        return log, [Notice(Code.SIGN_BY_VOLTAGE, text)]
    if verdict == "verified":
        text = f"{said}; positive is discharge, by the voltage"
        return log, [Notice(Code.SIGN_BY_VOLTAGE, text)]
    text = f"{said}, nor does the voltage: positive was read as discharge; else "
    return log, [Notice(Code.SIGN_ASSUMED, (text, Option("sign", "charge-positive")))]


def _with_checked_sign(
    log: CellLog, sign: str, way_out: str, *, opposite: bool
) -> tuple[CellLog, list[Notice]]:
    """Verify the sign and bring the counter in line with a current that is right."""
    notices: list[Notice] = []
    check = verify_sign(possible_part(log))
    if opposite and log.charge_Ah is not None:
        if check.verdict == "verified" or sign != "auto":
            log = replace(log, charge_Ah=-log.charge_Ah)
            text = "the counter ampere_hours runs against the current and was inverted"
            notices.append(Notice(Code.COUNTER_INVERTED, text))
        else:
            text = (
                "the sign of the current LOOKS WRONG: the counter ampere_hours runs against it, "
                "and the voltage does not confirm it"
            )
            notices.append(Notice(Code.SIGN_UNCONFIRMED, text))
    if check.verdict == "contradicted":
        notices.append(contradiction(way_out))
    return log, notices

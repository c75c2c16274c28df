"""From channels to a `CellLog`: rows without time, units, sign, counter, and notices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeVar, get_args

import numpy as np

from cellwise.errors import InputError
from cellwise.logs.checks.counter import (
    CounterCheck,
    charge_steps,
    compare_counter,
    compare_steps,
    counts_throughput,
    joined_counter,
)
from cellwise.logs.checks.faults import possible_part
from cellwise.logs.checks.grave import (
    MARK,
    check_time_moves,
    check_time_possible,
    grave_notices,
    graves_first,
    without_impossible,
)
from cellwise.logs.checks.sign import contradiction, verify_sign
from cellwise.logs.checks.units import (
    check_current_and_time,
    check_voltage,
    counter_factor,
    plausible_temperature,
    time_from_start,
    volts_of_millivolts,
)
from cellwise.logs.files.columns import TIDY_CHANNELS
from cellwise.logs.files.format import SignConvention
from cellwise.logs.files.named_columns import NamedColumns, table_channels
from cellwise.logs.files.source import RawLog
from cellwise.logs.measured_log import CurrentMeaning, MeasuredLog
from cellwise.typing import FloatArray, IntArray

SignOption = Literal["auto", "discharge-positive", "charge-positive"]
Log = TypeVar("Log", bound=MeasuredLog)


MOST_ROWS_WITHOUT_TIME = 0.01
LEAST_AGREEMENT = 0.9  # below this correlation a counter may count something else
SAME_QUANTITY = 0.5
NOTED_MISMATCH_PERCENT = 2.0
NO_STEP = -1


@dataclass(frozen=True)
class Origin:
    """Where channels come from and what their format says of them."""

    name: str = ""
    source: str = ""
    format: str = ""
    sign: SignConvention = "discharge-positive"
    current_meaning: CurrentMeaning = "interval_end"

    @property
    def where(self) -> str:
        """For messages."""
        return f"'{self.source or self.name}'" if self.source or self.name else "the table"


def assemble(
    kind: type[Log], raw: RawLog, origin: Origin, sign: str = "auto", *, check_sign: bool = True
) -> Log:
    """Make a log of a reader's channels.

    Parameters
    ----------
    kind : type           the class of the log, `CellLog`
    raw : RawLog          channels with the format's sign
    origin : Origin       where they come from
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
    channels = dict(raw.channels)
    notices = list(raw.notices)
    notices += _drop_rows_without_time(channels, origin.where)
    check_time_moves(channels["time_s"], origin.where)
    channels["time_s"], noted = time_from_start(channels["time_s"])
    notices += noted
    check_time_possible(channels["time_s"], origin.where)
    notices += without_impossible(channels, origin.where)
    if origin.format and not origin.format.startswith(("tidy", "table")):
        notices += volts_of_millivolts(channels)
    temperature = channels.get("temperature_C")
    if temperature is not None:
        temperature, noted = plausible_temperature(temperature)
        notices += noted
    if (origin.sign if sign == "auto" else sign) == "charge-positive":
        channels["current_A"] = -channels["current_A"]
        notices.append("positive current was read as charge and inverted")
    log = kind(
        time_s=channels["time_s"],
        current_A=channels["current_A"],
        voltage_V=channels["voltage_V"],
        temperature_C=temperature,
        charge_Ah=channels.get("charge_Ah"),
        step=_steps(channels.get("step")),
        name=origin.name,
        source=origin.source,
        current_meaning=origin.current_meaning,
        format=origin.format,
    )
    notices += grave_notices(log)
    notices += check_voltage(log, origin.where)
    log, counter, noted = _with_checked_counter(log, origin.where)
    notices += noted
    notices += check_current_and_time(possible_part(log), origin.where)
    opposite = counter is not None and counter.agreement < -SAME_QUANTITY
    if not (check_sign or opposite):
        return log.with_notices(graves_first(notices))
    log, noted = _with_checked_sign(log, sign, opposite=opposite)
    return log.with_notices(graves_first([*noted, *notices]))


def log_from_table(
    kind: type[Log], table: NamedColumns, *, sign: str, name: str, source: str
) -> Log:
    """`CellLog.from_table`: a log from named columns in memory."""
    origin = Origin(name=name, source=source, format="table")
    return assemble(kind, table_channels(table, TIDY_CHANNELS, origin.where), origin, sign)


def _drop_rows_without_time(channels: dict[str, FloatArray], where: str) -> list[str]:
    """Leave out the few rows whose time is missing: they cannot be placed."""
    missing = ~np.isfinite(channels["time_s"])
    count = int(np.count_nonzero(missing))
    if count == 0:
        return []
    if count > max(1.0, MOST_ROWS_WITHOUT_TIME * missing.size):
        row = int(np.flatnonzero(missing)[0])
        raise InputError(
            f"{count} of {missing.size} rows without a time in {where} (row {row + 1} first)",
            "a time in every row",
            "Check the time column, or remove these rows.",
        )
    for field in channels:
        channels[field] = channels[field][~missing]
    return [f"{count} row(s) without a time left out"]


def _steps(step: FloatArray | None) -> IntArray | None:
    """Tester steps as integers, missing ones as -1."""
    if step is None:
        return None
    known = np.isfinite(step) & (np.abs(step) < 2**31)
    return np.where(known, step, NO_STEP).astype(np.int32)


def _with_checked_counter(log: Log, where: str) -> tuple[Log, CounterCheck | None, list[str]]:
    """Counter in ampere hours, joined up over restarts; left out where it is of no use."""
    if log.charge_Ah is None:
        return log, None, []
    if not np.any(np.isfinite(log.charge_Ah)):
        return replace(log, charge_Ah=None), None, ["the counter ampere_hours holds no value"]
    notices: list[str] = []
    drawn, counted = charge_steps(log)
    check = compare_steps(drawn, counted)
    if check is None:
        return log, None, []
    if abs(check.agreement) < LEAST_AGREEMENT and counts_throughput(drawn, counted):
        noted = "the counter ampere_hours adds up charge and discharge alike and was left out"
        return replace(log, charge_Ah=None), None, [noted]
    factor, more = counter_factor(log, check, where)
    notices += more
    counter = log.charge_Ah * factor if factor != 1.0 else log.charge_Ah
    joined = None
    if np.all(np.isfinite(counter)):
        joined = joined_counter(counter, drawn, log.gap_rows)
    if joined is not None:
        counter, restarts = joined
        notices.append(f"the counter ampere_hours restarts {restarts} time(s) and was joined up")
    if counter is not log.charge_Ah:
        log = replace(log, charge_Ah=counter)
        check = compare_counter(log) or check
    if check.mismatch_percent > NOTED_MISMATCH_PERCENT and check.agreement > 0:
        notices.append(
            f"the counter ampere_hours differs from the summed current by "
            f"{check.mismatch_percent:.1f} % of the charge moved"
        )
    return log, check, notices


def _with_checked_sign(log: Log, sign: str, *, opposite: bool) -> tuple[Log, list[str]]:
    """Verify the sign and bring the counter in line with a current that is right."""
    notices: list[str] = []
    check = verify_sign(possible_part(log))
    if opposite and log.charge_Ah is not None:
        if check.verdict == "verified" or sign != "auto":
            log = replace(log, charge_Ah=-log.charge_Ah)
            notices.append("the counter ampere_hours runs against the current and was inverted")
        else:
            notices.append(
                f"the sign of the current {MARK}: the counter ampere_hours runs against it, and "
                "the voltage does not confirm it"
            )
    if check.verdict == "contradicted":
        way_out = "charge-positive" if sign != "charge-positive" else "discharge-positive"
        notices.append(contradiction(way_out))
    return log, notices

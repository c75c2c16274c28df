"""Station "logs": those that no cell can have are refused, the others sorted by what they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cellwise.cell.plausibility.validity import check_one_cell
from cellwise.errors import InputError
from cellwise.fit.model_error import SAME_TEMPERATURE_K
from cellwise.identify.capacity.half_cycles import LIMITS as HALF_CYCLES
from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.identify.identification import (
    REFERENCE_C,
    CellTests,
    IdentifySettings,
    log_temperature_C,
)
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.sign import verify_sign
from cellwise.logs.checks.unsigned import signed_by_loads
from cellwise.logs.gaps import cut_at_pauses
from cellwise.logs.stated import other_temperature
from cellwise.notices import Code, Notice
from cellwise.wording import arg

# The highest voltages of a log of an empty cell and one of a full differ by less (LTO: 1.87); those
# of one cell and two in series by 2.
OTHER_VOLTAGE = 1.9
OWN_TABLES_LOADS = 2  # that a temperature without pulses needs for tables of its own
LowRateTest = tuple[CellLog, ...]


class CheckedLogs(NamedTuple):
    """The tests, and what was found.

    ``low_rate`` has the logs of a low-rate test together; ``default_C`` is the temperature of a log
    that measured none.
    """

    tests: CellTests
    low_rate: tuple[LowRateTest, ...]
    default_C: float
    contradictions: tuple[Notice, ...]
    notices: tuple[Notice, ...]


def check_logs(tests: CellTests, settings: IdentifySettings) -> CheckedLogs:
    """Refuse what no later step could make sense of.

    Raises
    ------
    InputError        no usable log; a log whose current has the wrong sign; a pack beside or
                      instead of a cell; a nominal capacity that is none
    """
    tests, left_out = _without_wrong_drives(tests)
    logs, nominal = tests.logs(), settings.nominal_Ah
    if not logs:
        raise InputError(
            "no test",
            "at least one",
            "Give " + arg("hppc", letter="LOG") + " or " + arg("drive", letter="LOG") + ".",
        )
    if nominal is not None and not (np.isfinite(nominal) and nominal > 0.0):
        raise InputError(
            f"a nominal capacity of {nominal:g} Ah", "a number above zero", "Give it in Ah."
        )
    for log in logs:
        _check_log(log)
    _check_voltages(logs)
    default = REFERENCE_C if settings.temperature_C is None else settings.temperature_C
    contradictions = []
    for log, stated in (*tests.hppc, *tests.drive):
        other = None if stated is None else other_temperature(log, stated)
        if other is not None:
            contradictions.append(other)
    # After a pause that nobody counted a drive is another drive.
    drives = tuple((part, warm) for log, warm in tests.drive for part in cut_at_pauses(log))
    tests = replace(tests, drive=drives)
    # What reading the logs has noted, each with the name of its log.
    read = [n.of_log(log.name) for log in tests.logs() for n in log.notices]
    low_rate = tuple(low_rate_tests(tests.ocv, default))
    return CheckedLogs(tests, low_rate, default, tuple(contradictions), (*left_out, *read))


def _check_log(log: CellLog) -> None:
    """Refuse a current without a sign or with a wrong one, and a pack."""
    if no_sign := signed_by_loads(log)[1]:
        raise InputError(
            f"log '{log.name}' whose current has no sign ({no_sign})",
            "positive current on discharge, negative on charge",
            "Export it with its sign, or with a column of the tester's states.",
        )
    found = verify_sign(log)
    if found.verdict == "contradicted":
        raise InputError(
            f"log '{log.name}' whose voltage rises with its discharge current "
            f"({'; '.join(found.evidence[:2])})",
            "positive current on discharge",
            "Give " + arg("sign", "charge-positive") + ", or swap the sign in the file.",
        )
    check_one_cell(log)


def _without_wrong_drives(tests: CellTests) -> tuple[CellTests, tuple[Notice, ...]]:
    """The tests without drives that are refused, where half of the drives or more are right."""
    wrong = {}
    for log, _ in tests.drive:
        try:
            _check_log(log)
        except InputError as error:
            wrong[id(log)] = Notice(Code.LOG_LEFT_OUT, "left out: " + error.found)
    if 2 * len(wrong) > len(tests.drive) - 1:
        return tests, ()
    kept = tuple(one for one in tests.drive if id(one[0]) not in wrong)
    return replace(tests, drive=kept), tuple(wrong.values())


def _check_voltages(logs: tuple[CellLog, ...]) -> None:
    """Refuse a pack beside a cell."""
    highest = [float(np.nanmax(log.voltage_V)) for log in logs]
    for low, high in combinations(np.argsort(highest), 2):
        if highest[high] > OTHER_VOLTAGE * highest[low]:
            raise InputError(
                f"up to {highest[high]:.3g} V in '{logs[high].name}' beside "
                f"{highest[low]:.3g} V in '{logs[low].name}'",
                "logs of one cell",
                "Other cells in series? Read that log alone with its own "
                + arg("series", letter="N")
                + ", and write it "
                "as a log of one cell (write_log, cellwise convert).",
            )


def low_rate_tests(logs: Sequence[CellLog], default_C: float = REFERENCE_C) -> list[LowRateTest]:
    """Low-rate logs by test, in the order given.

    A test may come in parts (discharge, its last per cent at another temperature, charge). The next
    one begins where a whole discharge at another temperature does.
    """
    sizes = [_discharged_Ah(log) for log in logs]
    most = max(sizes, default=0.0)
    found: list[list[CellLog]] = []
    head_C = default_C
    for log, size in zip(logs, sizes, strict=True):
        at = log_temperature_C(log, None, default_C)
        whole = most > 0.0 and size >= HALF_CYCLES.whole * most
        if not found or (whole and abs(at - head_C) > SAME_TEMPERATURE_K):
            found.append([log])
            head_C = at
        else:
            found[-1].append(log)
    return [tuple(test) for test in found]


def nearest_test(tests: Sequence[LowRateTest], temperature_C: float) -> LowRateTest:
    """The low-rate test whose temperature is nearest; nothing without one."""
    return min(
        tests,
        key=lambda t: abs(log_temperature_C(t[0], None, temperature_C) - temperature_C),
        default=(),
    )


def grouped_by_temperature(
    tests: CellTests, low_rate: Sequence[LowRateTest], default: float
) -> dict[float, CellTests]:
    """The logs by temperature: those given one, else by what they measured.

    HPPC logs say at which temperatures tables are made; without one the low-rate tests, drives and
    capacity tests do, where a temperature has two of them.
    """
    merged = _of_pulses(tests, default) if tests.hppc else _of_all(tests, low_rate, default)
    home = min(merged, key=lambda x: abs(x - REFERENCE_C))

    def nearest(log: CellLog, stated: float | None) -> float:
        at = log_temperature_C(log, stated, default)
        return min(merged, key=lambda t: abs(t - at))

    warm = {id(log): nearest(log, stated) for log, stated in (*tests.hppc, *tests.drive)}
    # Beside pulses the low-rate and capacity tests are those of the reference temperature.
    for test in (*low_rate, *((log,) for log in tests.capacity)):
        at = home if tests.hppc else nearest(test[0], None)
        warm |= {id(log): at for log in test}

    def of(temperature_C: float) -> CellTests:
        return tests.only(lambda log: warm[id(log)] == temperature_C)

    return {t: of(t) for t in merged}


def _of_pulses(tests: CellTests, default_C: float) -> list[float]:
    """Temperatures of the HPPC logs; measured ones that are alike are one."""
    stated = {t for _, t in tests.hppc if t is not None}
    measured = {
        float(round(log_temperature_C(log, t, default_C))) for log, t in tests.hppc if t is None
    }
    merged: list[float] = []
    for t in sorted(stated | measured):
        if not merged or t - merged[-1] > SAME_TEMPERATURE_K or t in stated:
            merged.append(t)
    return merged


def _of_all(tests: CellTests, low_rate: Sequence[LowRateTest], default_C: float) -> list[float]:
    """Temperatures of the low-rate tests, and of the drives and capacity tests between them.

    Tables of its own has a temperature with several loads. Where fewer than two have, all logs
    share those of the first drive's, with an activation energy.
    """
    known: list[tuple[CellLog, float | None]] = [
        *((test[0], None) for test in low_rate),
        *tests.drive,
        *((log, None) for log in tests.capacity),
    ]
    found: dict[float, int] = {}
    for log, stated in known:
        if stated is None and log.temperature_C is None:
            continue  # nothing is known of it
        at = log_temperature_C(log, stated, default_C)
        near = min(found, key=lambda t: abs(t - at), default=at)
        if abs(at - near) > SAME_TEMPERATURE_K or not found:
            near = float(round(at))
        found[near] = found.get(near, 0) + 1
    several = sorted(t for t, loads in found.items() if loads >= OWN_TABLES_LOADS)
    if len(several) > 1:
        return several
    first = [log_temperature_C(log, t, default_C) for log, t in tests.drive[:1]]
    return [float(round(t)) for t in first] or [default_C]


def _discharged_Ah(log: CellLog) -> float:
    """The largest discharge of a log [Ah]."""
    halves = find_half_cycles(join_logs(log))
    return max((h.charge_Ah for h in halves), default=0.0)

"""Which tests belong together: low-rate tests of one temperature, and all tests by temperature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cellwise.errors import InputError
from cellwise.identify.capacity.half_cycles import find_half_cycles, join_logs
from cellwise.identify.identification import (
    REFERENCE_C,
    TestLogs,
    log_temperature_C,
)
from cellwise.logs.cell_log import CellLog


class _Together(NamedTuple):
    """Which logs are of one test, or of one temperature."""

    same_C: float = 3.0  # what a chamber and a measured median differ by
    own_tables_C: float = 5.0  # without pulses: logs nearer than this share their tables
    loads: int = 2  # that a temperature without pulses needs for tables of its own
    whole: float = 0.5  # of the largest discharge: a test's last per cent is no test of its own


LIMITS = _Together()
LowRateTest = tuple[CellLog, ...]


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
        whole = most > 0.0 and size >= LIMITS.whole * most
        if not found or (whole and abs(at - head_C) > LIMITS.same_C):
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
    tests: TestLogs, low_rate: Sequence[LowRateTest], default: float
) -> dict[float, TestLogs]:
    """The logs by temperature: those given one, else by what they measured.

    HPPC logs say at which temperatures tables are made; without one the low-rate tests, drives and
    capacity tests do, where a temperature has two of them.
    """
    merged = _of_pulses(tests, default) if tests.hppc else _of_all(tests, low_rate, default)
    home = min(merged, key=lambda x: abs(x - REFERENCE_C))

    def nearest(at: float) -> float:
        return min(merged, key=lambda t: abs(t - at))

    def steady(log: CellLog) -> float:
        # Beside pulses the low-rate and capacity tests are those of the reference temperature.
        return home if tests.hppc else nearest(log_temperature_C(log, None, default))

    slow = {id(log): steady(test[0]) for test in low_rate for log in test}
    return {
        t: TestLogs(
            hppc=tuple(
                (log, at)
                for log, at in tests.hppc
                if nearest(log_temperature_C(log, at, default)) == t
            ),
            drive=tuple(
                (log, at)
                for log, at in tests.drive
                if nearest(log_temperature_C(log, at, default)) == t
            ),
            capacity=tuple(log for log in tests.capacity if steady(log) == t),
            ocv=tuple(log for log in tests.ocv if slow[id(log)] == t),
        )
        for t in merged
    }


def _of_pulses(tests: TestLogs, default_C: float) -> list[float]:
    """Temperatures of the HPPC logs; measured ones that are alike are one."""
    stated = {t for _, t in tests.hppc if t is not None}
    measured = {
        float(round(log_temperature_C(log, t, default_C))) for log, t in tests.hppc if t is None
    }
    merged: list[float] = []
    for t in sorted(stated | measured):
        if not merged or t - merged[-1] > LIMITS.same_C or t in stated:
            merged.append(t)
    return merged


def _of_all(tests: TestLogs, low_rate: Sequence[LowRateTest], default_C: float) -> list[float]:
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
        if abs(at - near) > LIMITS.own_tables_C or not found:
            near = float(round(at))
        found[near] = found.get(near, 0) + 1
    several = sorted(t for t, loads in found.items() if loads >= LIMITS.loads)
    if len(several) > 1:
        return several
    first = [log_temperature_C(log, t, default_C) for log, t in tests.drive[:1]]
    return [float(round(t)) for t in first] or [default_C]


def _discharged_Ah(log: CellLog) -> float:
    """The largest discharge of a log [Ah]."""
    try:
        halves = find_half_cycles(join_logs(log))
    except InputError:
        return 0.0
    return max((h.charge_Ah for h in halves), default=0.0)

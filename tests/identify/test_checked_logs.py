"""Tests that belong together: low-rate tests apart by temperature, parts of one test together."""

from __future__ import annotations

import numpy as np

from cellwise.identify.checked_logs import (
    grouped_by_temperature,
    low_rate_tests,
    nearest_test,
)
from cellwise.identify.identification import CellTests
from cellwise.logs.cell_log import CellLog


def log(name, temperature_C, *amperes, hours=20.0):
    """A log that flows each current for so many hours, with a voltage that follows the charge."""
    current = np.repeat(np.array([0.0, *amperes]), int(hours * 60))
    time_s = 60.0 * np.arange(current.size)
    used = np.cumsum(current) / 60.0
    measured = None if temperature_C is None else np.full(current.size, float(temperature_C))
    return CellLog(time_s, current, 4.2 - 0.4 * used - 0.05 * current,
                   temperature_C=measured, name=name)  # fmt: skip


WARM = log("warm", 25.0, 0.15, -0.15)
COLD = log("cold", -20.0, 0.12, -0.12)


def names(logs):
    return [one.name for one in logs]


def test_low_rate_tests_of_two_temperatures_are_two():
    found = low_rate_tests((WARM, COLD))
    assert [names(test) for test in found] == [["warm"], ["cold"]]
    assert names(nearest_test(found, 25.0)) == ["warm"]
    assert names(nearest_test(found, -10.0)) == ["cold"]


def test_parts_of_one_test_stay_together():
    # Discharged in the cold, its last per cent at 25 degC, charged in the cold.
    parts = (
        log("down", -20.0, 0.15), log("rest of it", 25.0, 0.15, hours=1.0), log("up", -20.0, -0.15)
    )  # fmt: skip
    assert len(low_rate_tests(parts)) == 1
    assert [names(t) for t in low_rate_tests((*parts, WARM))] == [names(parts), ["warm"]]


def test_without_pulses_a_temperature_with_several_tests_has_tables():
    def capacity(at):
        return (log("0.5C", at, 1.4, hours=2.0), log("1C", at, 2.8, hours=1.0))

    stated = (log("stated", None, 1.5, hours=0.2), -18.0)
    tests = CellTests(
        ocv=(WARM, COLD),
        capacity=(*capacity(25.0), *capacity(-21.0), log("hot", 40.0, 1.4, hours=2.0)),
        drive=((log("drive", 11.0, 1.5, hours=0.2), None), stated),
    )
    found = grouped_by_temperature(tests, low_rate_tests(tests.ocv), 25.0)
    assert list(found) == [-20.0, 25.0]
    assert names(found[-20.0].ocv) == ["cold"]
    assert names(found[-20.0].capacity) == ["0.5C", "1C"]
    assert names(d for d, _ in found[-20.0].drive) == ["stated"]
    assert names(found[25.0].ocv) == ["warm"]
    assert names(found[25.0].capacity) == ["0.5C", "1C", "hot"]
    assert names(d for d, _ in found[25.0].drive) == ["drive"]


def test_one_drive_a_temperature_shares_its_tables():
    drives = ((log("a", 35.0, 1.5, hours=0.2), None), (log("b", 5.0, 1.5, hours=0.2), None))
    found = grouped_by_temperature(CellTests(ocv=(WARM,), drive=drives), [(WARM,)], 25.0)
    assert list(found) == [35.0]
    assert names(found[35.0].ocv) == ["warm"]


def test_beside_pulses_steady_tests_are_those_of_the_reference():
    pulses = ((log("p25", 25.0, 1.5, hours=0.2), None), (log("p0", 0.0, 1.5, hours=0.2), None))
    found = grouped_by_temperature(
        CellTests(hppc=pulses, ocv=(WARM, COLD)), [(WARM,), (COLD,)], 25.0
    )
    assert list(found) == [0.0, 25.0]
    assert names(found[25.0].ocv) == ["warm", "cold"]
    assert found[0.0].ocv == ()

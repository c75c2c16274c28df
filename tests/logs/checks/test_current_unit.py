"""Milliamperes for amperes are refused beside a capacity; a sensor's fault is another thing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import CellLog, read_log
from cellwise.logs.checks.charge import check_current
from log_files import CAPACITY_AH

HOURS = 3


def discharge(rate: float = 0.3) -> CellLog:
    """At a steady rate [1/h], once a second."""
    time_s = np.arange(3600.0 * HOURS)
    current = np.full(time_s.size, rate * CAPACITY_AH)
    return CellLog(time_s, current, np.full(time_s.size, 3.7), name="discharge")


@pytest.mark.parametrize("rate", [1 / 30, 0.3, -0.3])
def test_milliamperes_are_refused_with_the_line_that_mends_them(rate):
    log = discharge(rate)
    check_current(log, CAPACITY_AH)
    with pytest.raises(InputError, match=r"log\.current_A / 1000"):
        check_current(replace(log, current_A=1000.0 * log.current_A), CAPACITY_AH)


def stuck(current: np.ndarray) -> None:
    current[3000:5000] = 500.0


def spiked(current: np.ndarray) -> None:
    current[::100] = 500.0


def off(current: np.ndarray) -> None:
    current += CAPACITY_AH / 2


@pytest.mark.parametrize("fault", [stuck, spiked, off])
def test_a_faulty_sensor_is_no_other_unit(fault):
    log = discharge()
    current = log.current_A.copy()
    fault(current)
    check_current(replace(log, current_A=current), CAPACITY_AH)


def test_an_offset_of_months_is_no_other_unit():
    """Half of 1C for 2000 hours: a thousand capacities, and no cell's current is at fault."""
    time_s = np.arange(0.0, 2000 * 3600.0, 60.0)
    current = np.full(time_s.size, CAPACITY_AH / 2)
    check_current(CellLog(time_s, current, np.full(time_s.size, 3.7)), CAPACITY_AH)


def test_many_discharges_without_their_recharges_are_no_other_unit():
    """Twelve flights of a drone at 20C on fresh packs, in one log."""
    time_s = np.arange(12 * 180.0)
    current = np.full(time_s.size, 20.0 * CAPACITY_AH)
    check_current(CellLog(time_s, current, np.full(time_s.size, 3.7)), CAPACITY_AH)


@pytest.mark.parametrize(
    ("name", "capacity_Ah"),
    [("panasonic_18650pf/hppc_p25", 2.9), ("panasonic_18650pf/drive_p25_us06", 2.9),
     ("plett_a123/dyn_n25_s1", 2.07), ("lipo_5450/c4_cycle01", 5.45)],
)  # fmt: skip
def test_measured_logs_pass_and_are_refused_in_milliamperes(real_data, name, capacity_Ah):
    log = read_log(real_data / f"{name}.csv.gz")
    check_current(log, capacity_Ah / 3)  # an aged cell's model, or that of a smaller one
    with pytest.raises(InputError, match="Milliamperes"):
        check_current(replace(log, current_A=1000.0 * log.current_A), capacity_Ah)

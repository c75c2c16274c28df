"""What an identification says of its data: the range that its logs are known to have covered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.identify.own_logs import log_validity
from cellwise.logs.cell_log import CellLog

QUICK = IdentifySettings(nominal_Ah=5.0, refine=False)


def laboratory(hppc, stated) -> CellTests:
    return CellTests(hppc=((hppc, stated),), ocv=(load_dataset("nmc_ocv_c20"),))


@pytest.fixture(scope="module")
def hppc() -> CellLog:
    return load_dataset("nmc_hppc")


@pytest.fixture(scope="module")
def found(hppc):
    return identify_cell(laboratory(hppc, None), QUICK)


def test_a_whole_range_of_soc_and_the_pulses_currents(found, hppc):
    valid = found.model.validity
    assert valid.soc[0] < 0.02
    assert valid.soc[1] > 0.99
    # The largest pulses are held for seconds: they count, whatever share of the rows they are.
    assert valid.current_A[1] == pytest.approx(float(np.nanmax(hppc.current_A)), rel=0.02)
    assert valid.current_A[0] == pytest.approx(float(np.nanmin(hppc.current_A)), rel=0.02)


def without_temperature(log: CellLog) -> CellLog:
    return replace(log, temperature_C=None)


def test_a_temperature_that_nobody_knows_is_not_made_up(hppc):
    tests = laboratory(without_temperature(hppc), None)
    tests = replace(tests, ocv=tuple(without_temperature(log) for log in tests.ocv))
    assert identify_cell(tests, QUICK).model.validity.temperature_C is None


def test_a_stated_temperature_counts(hppc):
    tests = laboratory(without_temperature(hppc), 10.0)
    tests = replace(tests, ocv=tuple(without_temperature(log) for log in tests.ocv))
    assert identify_cell(tests, QUICK).model.validity.temperature_C == (10.0, 10.0)
    default = replace(QUICK, temperature_C=-5.0)
    tests = replace(tests, hppc=((without_temperature(hppc), None),))
    assert identify_cell(tests, default).model.validity.temperature_C == (-5.0, -5.0)


def test_a_low_rate_test_covers_no_temperature_for_loads(hppc):
    tests = laboratory(without_temperature(hppc), 25.0)
    (slow,) = tests.ocv
    cold = replace(slow, temperature_C=np.full(len(slow), -25.0))
    found = identify_cell(replace(tests, ocv=(cold,)), QUICK)
    assert found.model.validity.temperature_C == (25.0, 25.0)


def log_of(current, temperature=None) -> CellLog:
    time = np.arange(current.size, dtype=np.float64)
    return CellLog(time, current, np.full(current.size, 3.7), temperature_C=temperature)


def test_a_pulse_counts_and_a_spike_does_not():
    current = np.zeros(100_000)
    current[500:510] = 9.0
    current[7_000] = 400.0
    temperature = np.full(current.size, 21.0)
    temperature[90_000] = -40.0
    valid = log_validity(log_of(current, temperature), np.linspace(1.0, 0.4, current.size))
    assert valid.current_A == (0.0, 9.0)
    assert valid.temperature_C == (21.0, 21.0)
    assert valid.soc == pytest.approx((0.4, 1.0), abs=1e-3)

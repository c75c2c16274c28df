"""Two samples of a cell: their capacities come back from the same two voltages."""

import re

import pytest

from cellwise.data import load_dataset
from cellwise.identify.ocv.curve import sample_notice
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.logs import read_log
from rich_cell import Logger, hppc, low_rate, rich_nmc, run


@pytest.fixture(scope="module")
def slow():
    cell = rich_nmc(3.0)
    return run(cell, low_rate(cell), 1.0, Logger(10.0), seed=1, name="one").log


def compared(slow_log, pulse_log):
    curve = ocv_from_low_rate(slow_log)
    rests = ocv_from_rests(pulse_log, capacity_Ah=curve.capacity_Ah)
    return sample_notice(rests, curve, curve.capacity_Ah)


@pytest.mark.parametrize("share", [0.88, 0.93, 0.955, 1.05])
def test_the_ratio_of_the_capacities_comes_back(slow, share):
    other = rich_nmc(3.0 * share)
    log = run(other, hppc(other), 1.0, Logger(1.0), seed=2, name="two").log
    notice = compared(slow, log)
    said = float(re.search(r"\(([+-][0-9.]+) %\)", notice.text)[1])
    assert said == pytest.approx(100.0 * (share - 1.0), abs=0.5)
    assert "one" in notice.text
    assert "two" in notice.text


@pytest.mark.parametrize("share", [1.0, 0.99])
def test_one_cell_is_one_cell(slow, share):
    same = rich_nmc(3.0 * share)
    assert compared(slow, run(same, hppc(same), 1.0, Logger(1.0), seed=2).log) is None


@pytest.mark.parametrize("name", ["nmc_hppc", "nmc_hppc_c3", "lfp_hppc"])
def test_the_embedded_tests_are_of_one_cell(name):
    cell = name.split("_")[0]
    assert compared(load_dataset(f"{cell}_ocv_c20"), load_dataset(name)) is None


def test_another_make_is_told_by_the_shape(real_data):
    curve = read_log(real_data / "lg_18650hg2/ocv_c20_p25_549.csv.gz")
    pulses = read_log(real_data / "panasonic_18650pf/hppc_p25.csv.gz")
    assert "do not look like one cell" in compared(curve, pulses).text


def test_a_low_rate_sensor_with_an_offset_is_no_sample_of_this_cell(slow):
    """16 mA of 150: the counter makes 3.36 of 3.02 Ah, and the rests of the pulses say so."""
    cell = rich_nmc(3.0)
    off = run(cell, low_rate(cell), 1.0, Logger(10.0, offset_A=0.016), seed=1, name="off").log
    notice = compared(off, run(cell, hppc(cell), 1.0, Logger(1.0), seed=2).log)
    assert "a current sensor that is off" in notice.text

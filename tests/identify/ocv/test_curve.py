"""The OCV's curve: strictly rising, exact slopes, robust; of two sources, of two samples."""

import re

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.errors import InputError
from cellwise.identify.ocv.curve import (
    fit_monotone_spline,
    sample_notice,
)
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.logs import read_log
from rich_cell import Logger, hppc, low_rate, rich_nmc, run


def lfp(s):
    """Two flat steps and two steep ends, 2.6 to 3.5 V."""
    steps = 0.02 * np.tanh((s - 0.68) / 0.03) + 0.03 * np.tanh((s - 0.3) / 0.05)
    return 3.29 + steps - 0.6 * np.exp(-s / 0.025) + 0.2 * np.exp((s - 1.0) / 0.015)


def narrow(s):
    """A cell used between 2.9 and 4.1 V."""
    return 2.9 + 0.45 * (1 - np.exp(-s / 0.04)) + 0.75 * s


def stepped(s):
    """A step between two rests of every 5 %."""
    ends = 0.1 * np.exp((s - 1.0) / 0.03) - 0.5 * np.exp(-s / 0.04)
    return 3.4 + 0.5 * s + 0.04 * np.tanh((s - 0.6) / 0.04) + ends


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


# --- the spline


@pytest.mark.parametrize("curve", [lfp, narrow])
def test_it_rises_strictly_everywhere_with_exact_slopes(curve):
    rng = np.random.default_rng(3)
    s = np.sort(rng.uniform(0.02, 0.99, 40))
    f = fit_monotone_spline(s, curve(s) + rng.normal(0.0, 4e-3, s.size))
    assert np.all(np.diff(f.evaluate(np.linspace(-0.1, 1.1, 2401))) > 0.0)
    at, h = np.arange(-0.0953, 1.1, 0.005), 1e-6
    numeric = (f.evaluate(at + h) - f.evaluate(at - h)) / (2 * h)
    assert f.slope(at) == pytest.approx(numeric, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("curve", [lfp, narrow])
def test_spline_averages_noise_out(curve):
    rng = np.random.default_rng(5)
    s = np.linspace(0.0, 1.0, 2000)
    f = fit_monotone_spline(s, curve(s) + rng.normal(0.0, 5e-3, s.size))
    middle = (s > 0.05) & (s < 0.95)
    assert rms((f.evaluate(s) - curve(s))[middle]) < 0.4 * 5e-3


@pytest.mark.parametrize(
    ("soc", "voltage", "said"),
    [
        ([0.1, 0.5, 0.7, 0.9], [3.1, np.nan, 3.7, 3.9], "3 usable"),
        ([0.5] * 6, [3.5] * 6, "does not rise"),
        ([0.1, 0.3, 0.6, 0.9], [3.9, 3.7, 3.4, 3.1], "does not rise"),
        ([10.0, 30.0, 60.0, 90.0], [3.1, 3.3, 3.6, 3.9], "percent"),
    ],
)
def test_bad_points_are_refused(soc, voltage, said):
    with pytest.raises(InputError, match=said):
        fit_monotone_spline(np.array(soc), np.array(voltage))


@pytest.mark.parametrize(
    ("path", "limit_V"),
    [
        ("panasonic_18650pf/ocv_c20_p25", 4e-3),
        ("plett_a123/ocv_p25_s1", 7e-3),
        ("plett_a123/ocv_n25_s1", 6e-3),
        ("lg_18650hg2/ocv_c20_p25_549", 4e-3),
    ],
)
def test_spline_through_every_twentieth_predicts_the_rest_of_a_real_curve(real_data, path, limit_V):
    log = read_log(real_data / f"{path}.csv.gz")
    charge = log.counted_charge_Ah()
    rows = (log.current_A > 0.0) & (charge < 0.999 * charge.max())
    s, v = 1.0 - charge[rows] / charge.max(), log.voltage_V[rows]
    levels, order = np.arange(0.05, 1.0, 0.05), np.argsort(s)
    f = fit_monotone_spline(levels, np.interp(levels, s[order], v[order]))
    between = (s > 0.05) & (s < 0.95)
    assert rms(f.evaluate(s[between]) - v[between]) < limit_V


# --- two samples of a cell: their capacities come back from the same two voltages


@pytest.fixture(scope="module")
def slow():
    cell = rich_nmc(3.0)
    return run(cell, low_rate(cell), 1.0, Logger(10.0), seed=1, name="one").log


def compared(slow_log, pulse_log):
    curve = ocv_from_low_rate(slow_log)
    rests = ocv_from_rests(pulse_log, capacity_Ah=curve.capacity_Ah)
    return sample_notice(rests, curve, curve.capacity_Ah)


@pytest.mark.parametrize("share", [0.88, 0.955, 0.99, 1.0, 1.05])
def test_the_ratio_of_the_capacities_comes_back(slow, share):
    other = rich_nmc(3.0 * share)
    notice = compared(slow, run(other, hppc(other), 1.0, Logger(1.0), seed=2, name="two").log)
    if abs(share - 1.0) < 0.03:
        assert notice is None
        return
    said = float(re.search(r"\(([+-][0-9.]+) %\)", notice.text)[1])
    assert said == pytest.approx(100.0 * (share - 1.0), abs=0.5)
    assert "one" in notice.text
    assert "two" in notice.text


@pytest.mark.parametrize("name", ["nmc_hppc", "nmc_hppc_c3", "lfp_hppc"])
def test_the_embedded_tests_are_of_one_cell(name):
    cell = name.split("_")[0]
    assert compared(load_dataset(f"{cell}_ocv_c20"), load_dataset(name)) is None


def test_another_make_is_known_by_the_shape(real_data):
    curve = read_log(real_data / "lg_18650hg2/ocv_c20_p25_549.csv.gz")
    pulses = read_log(real_data / "panasonic_18650pf/hppc_p25.csv.gz")
    assert "do not look like one cell" in compared(curve, pulses).text


def test_a_low_rate_sensor_with_an_offset_is_no_sample_of_this_cell():
    """16 mA of 150: the counter makes 3.36 of 3.02 Ah, and the rests of the pulses say so."""
    cell = rich_nmc(3.0)
    off = run(cell, low_rate(cell), 1.0, Logger(10.0, offset_A=0.016), seed=1, name="off").log
    notice = compared(off, run(cell, hppc(cell), 1.0, Logger(1.0), seed=2).log)
    assert "a current sensor that is off" in notice.text

"""Rests and low-rate branches together: the shape of one, the level of the other."""

import numpy as np
import pytest

from cellwise.identify.ocv.curve import combine_ocv, curve_from_points
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.ocv.ocv_rests import ocv_from_rests
from cellwise.logs import read_log


def ocv(s):
    return (
        3.4
        + 0.5 * s
        + 0.04 * np.tanh((s - 0.6) / 0.04)
        - 0.5 * np.exp(-s / 0.04)
        + 0.1 * np.exp((s - 1.0) / 0.03)
    )


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


DENSE = np.linspace(0.0, 1.0, 800)
LOW_RATE = curve_from_points(DENSE, ocv(DENSE) - 0.03, capacity_Ah=3.0, source="low rate")
LEVELS = np.arange(0.05, 1.001, 0.05)


def test_rests_set_the_level_of_the_low_rate_shape():
    rests = curve_from_points(LEVELS, ocv(LEVELS), capacity_Ah=3.0, source="rests")
    both = combine_ocv(rests, LOW_RATE)
    s = np.linspace(0.05, 1.0, 300)
    assert both.function.evaluate(s) == pytest.approx(ocv(s), abs=1.5e-3)
    # The rests alone miss the step between them.
    assert rms(both.function.evaluate(s) - ocv(s)) < 0.5 * rms(rests.function.evaluate(s) - ocv(s))
    assert "low rate" in both.source
    assert "rests" in both.source


def test_panasonic_low_rate_curve_is_moved_onto_the_rests(real_data):
    folder = real_data / "panasonic_18650pf"
    low = ocv_from_low_rate(read_log(folder / "ocv_c20_p25.csv.gz"))
    rests = ocv_from_rests(read_log(folder / "hppc_p25.csv.gz"), capacity_Ah=low.capacity_Ah)
    both = combine_ocv(rests, low)
    left = both.function.evaluate(rests.points_soc) - rests.points_V
    # It stays on the counter's scale, and is moved onto the rests as well as that allows.
    assert rms(left) < 0.5 * rms(low.function.evaluate(rests.points_soc) - rests.points_V)


@pytest.mark.parametrize("tag", ["p10", "p25", "p40"])
def test_leaf_low_rate_shape_fits_rests_a_quarter_volt_away(real_data, tag):
    folder = real_data / "nissan_leaf"
    low = ocv_from_low_rate(read_log(folder / "cycling_c15_10c_24c_40c.csv.gz"))
    log = read_log(folder / f"hppc_{tag}.csv.gz")
    rests = ocv_from_rests(log, capacity_Ah=low.capacity_Ah)
    both = combine_ocv(rests, low)
    middle = (rests.points_soc > 0.1) & (rests.points_soc < 0.99)
    left = (both.function.evaluate(rests.points_soc) - rests.points_V)[middle]
    assert rms(left) < 6e-3

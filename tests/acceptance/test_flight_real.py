"""Forecasts of a measured cell's discharges, from half way, against when they did end."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.estimate.replay import replay
from cellwise.forecast.remaining import forecast
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from measured_models import identified_samsung, identify_once, samsung_log

CUTOFF_V = 3.0


@pytest.fixture(scope="module")
def leaf(real_data):
    """A model from the pulse test and the 1C rounds; the 2C and 3C rounds it has not seen."""
    folder = real_data / "nissan_leaf"
    tests = CellTests(
        hppc=((read_log(folder / "hppc_p25.csv.gz"), None),),
        capacity=(read_log(folder / "cap_1c_p23.csv.gz"),),
    )
    return identify_once(tests, IdentifySettings()).model


@pytest.mark.slow
@pytest.mark.parametrize(("name", "within"), [("cap_2c_p23", 0.03), ("cap_3c_p23", 0.08)])
@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_measured_discharge_ends_when_it_was_foretold(name, within, share, leaf, real_data):
    log = read_log(real_data / "nissan_leaf" / f"{name}.csv.gz")
    current = log.known_current_A()
    loaded = current > 0.9 * current.max()
    begins = np.flatnonzero(loaded & ~np.concatenate(([False], loaded[:-1])))[1]
    ends = begins + int(np.argmin(loaded[begins:]))
    at_s = log.time_s[begins] + share * (log.time_s[ends - 1] - log.time_s[begins])
    seen = log.part(max(0, begins - 60), int(np.searchsorted(log.time_s, at_s)))
    left = forecast(leaf, replay(leaf, seen), cutoff_V=CUTOFF_V, hold="current").last
    truly_s = float(log.time_s[ends - 1] - left.time_s)
    assert left.by == "voltage"
    assert left.remaining_s == pytest.approx(truly_s, rel=within)


@pytest.mark.slow
def test_the_band_covers_a_cell_that_warms_by_forty_kelvin(real_data):
    """Samsung 30Q at 1C to 4C, 11 to 41 K warmer at the end; another sample than the pulses'."""
    model = identified_samsung(real_data)
    inside, missed, sigma = [], [], []
    for rate in ("1c", "2c", "3c", "4c"):
        log = samsung_log(real_data, f"fresh_s001_discharge_{rate}")
        loaded = np.flatnonzero(log.known_current_A() > 0.9 * log.known_current_A().max())
        log = log.part(0, int(loaded[-1]) + 1)
        found = forecast(model, replay(model, log, soc0=1.0), cutoff_V=2.5, hold="current")
        truth = log.time_s[-1] - found.time_s
        later = (found.time_s > 120.0) & (truth > 60.0)
        low, high = found.remaining_s_band[later].T
        sample_s = 0.01 * truth[later]  # by what one sample of a type holds more than another
        inside += list((low - sample_s <= truth[later]) & (truth[later] <= high + sample_s))
        missed += list((found.remaining_s - truth)[later] / truth[later])
        sigma += list((high - low) / 4 / truth[later])
    assert np.mean(inside) >= 0.93
    assert np.sqrt(np.mean(np.square(sigma))) <= 2 * np.sqrt(np.mean(np.square(missed)))

"""Fits of long steps: the first minutes say what is fast, hours say what is slow."""

import numpy as np
import pytest

from cellwise.identify.fitted_pulses import cut_pulses, fitted_stop
from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.pulse_fit.fit_pulse import fit_pulses
from rich_cell import Logger, gitt, rich_nmc, run

CELL = rich_nmc(3.0)


@pytest.mark.parametrize("rate", [1.0, 0.5, 0.2, 0.1])
@pytest.mark.parametrize("period_s", [1.0, 10.0])
def test_r0_of_a_step_is_not_that_of_minutes(rate, period_s):
    """Over hours two branches went to 100 and 1500 s, and R0 was 50 % too high."""
    log = run(CELL, gitt(CELL, rate=rate, rest_s=3600.0), 1.0, Logger(period_s), seed=3).log
    chosen = pulses_to_fit(find_pulses(log))
    soc = 1.0 - log.counted_charge_Ah() / 3.0
    fits = fit_pulses(cut_pulses(log, chosen, 3.0, soc, CELL.ocv_V))
    at = np.array([f.soc for f in fits])
    after = CELL.r0_ohm(at)
    for r, tau in CELL.branches:
        after = after - r(at) * np.expm1(-period_s / tau(at))
    r0 = np.array([f.r0_ohm for f in fits])
    assert float(np.median(r0 / CELL.r0_ohm(at))) > 0.95
    assert float(np.median(r0 / after)) < 1.05


def test_the_point_of_a_step_is_where_its_window_lies():
    log = run(CELL, gitt(CELL), 1.0, Logger(1.0), seed=3).log
    chosen = pulses_to_fit(find_pulses(log))
    soc = 1.0 - log.counted_charge_Ah() / 3.0
    data = cut_pulses(log, chosen, 3.0, soc)
    for one, pulse in zip(data, chosen, strict=True):
        stop = fitted_stop(log, pulse)
        assert log.time_s[stop - 1] - log.time_s[pulse.start - 1] == pytest.approx(300.0, abs=1.5)
        assert one.soc == pytest.approx(0.5 * (soc[pulse.start - 1] + soc[stop - 1]), abs=1e-4)

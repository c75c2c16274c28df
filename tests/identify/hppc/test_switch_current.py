"""A logger on its own clock: the counter says what flowed in the row of a switch."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.identify.hppc.switch_current import with_switch_current
from cellwise.identify.pulse_fit.fit_pulse import fit_pulses
from cellwise.identify.pulse_fit.pulse_window import cut_pulses
from rich_cell import Logger, gitt, rich_nmc, run

CELL = rich_nmc(3.0)


def own_clock_log(period_s, late_s=3.7):
    """Switches fall somewhere between two rows; no row is written for them."""
    steps = [(0.0, 1800.0 + late_s), *gitt(CELL, rest_s=3600.0 + 0.37 * period_s)[1:]]
    return run(CELL, steps, 1.0, Logger(period_s, switches=False), seed=3).log


@pytest.mark.parametrize("period_s", [2.0, 5.0, 10.0])
def test_the_charge_of_every_row_is_what_the_counter_says(period_s):
    log = own_clock_log(period_s)
    summed = np.cumsum(with_switch_current(log).current_A * log.interval_s) / 3600.0
    raw = np.cumsum(log.current_A * log.interval_s) / 3600.0
    counted = log.charge_Ah - log.charge_Ah[0]
    # What is left is the noise of the current itself.
    assert np.max(np.abs(summed - counted)) < 0.3 * np.max(np.abs(raw - counted))


@pytest.mark.parametrize("period_s", [5.0, 10.0])
def test_r0_no_longer_hangs_on_where_in_a_row_the_switch_fell(period_s):
    spread = []
    for late_s in (0.1, 0.5, 0.9):
        log = own_clock_log(period_s, late_s * period_s)
        fits = []
        for one in (log, with_switch_current(log)):
            chosen = pulses_to_fit(find_pulses(log))
            fits.append([f.r0_ohm for f in fit_pulses(cut_pulses(one, chosen, 3.0))])
        spread.append([float(np.std(f) / np.mean(f)) for f in fits])
    before, after = np.mean(spread, axis=0)
    assert after < 0.6 * before


def test_what_agrees_with_its_counter_stays_as_it_is():
    aligned = run(CELL, gitt(CELL), 1.0, Logger(10.0), seed=3).log
    assert with_switch_current(aligned) is aligned
    bare = replace(own_clock_log(10.0), charge_Ah=None)
    assert with_switch_current(bare) is bare


def test_a_coarse_counter_is_not_believed():
    log = own_clock_log(2.0)
    coarse = replace(log, charge_Ah=np.round(log.charge_Ah, 2))
    assert with_switch_current(coarse) is coarse

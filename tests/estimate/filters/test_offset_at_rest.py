"""What a rest tells the EKF of its current sensor, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.protocol import ConstantCurrent, Rest, run_protocol
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.noise import Noise
from example_cells import lfp_cell

CELL = lfp_cell()
HOURS = 3600.0


def pulses(rests: int = 8):
    """Loads with rests between, over the plateau."""
    load = ConstantCurrent(current_A=1.0, duration_s=1200.0)
    return run_protocol(CELL, [Rest(600.0), *([load, Rest(600.0)] * rests)], 0.95)


def lost(kind, log, **noise):
    """RMSE of the SOC from its true start [-]."""
    truth = 0.95 - np.cumsum(log.interval_s * TRUE_A) / HOURS / CELL.capacity_Ah
    of = replace(Noise.of_model(CELL), **noise)
    return float(np.sqrt(np.mean((kind(CELL, of).run(log, 0.95, 0.005).soc - truth) ** 2)))


LOG = pulses()
TRUE_A = np.asarray(LOG.current_A)


@pytest.mark.parametrize("kind", [Ekf, Ukf])
def test_a_sensor_that_reads_zero_at_rest_is_right_whatever_the_voltages_say(kind):
    """A voltage that is 20 mV off reads as many points of SOC on a plateau."""
    off = replace(LOG, voltage_V=LOG.voltage_V + 0.02)
    assert lost(kind, off) < lost(kind, off, offset_share=0.0) + 0.002


@pytest.mark.parametrize("kind", [Ekf, Ukf])
@pytest.mark.parametrize("share", [0.03, -0.03])
def test_rests_show_an_offset(kind, share):
    off = replace(LOG, current_A=LOG.current_A + share * CELL.capacity_Ah)
    assert lost(kind, off) < 0.6 * lost(kind, off, offset_share=0.0)


def test_one_constant_load_is_no_offset():
    """C/30 for hours, as in an OCV test."""
    load = ConstantCurrent(current_A=CELL.capacity_Ah / 30.0, duration_s=10 * HOURS)
    log = run_protocol(CELL, [load], 0.95)
    truth = 0.95 - np.cumsum(log.interval_s * log.current_A) / HOURS / CELL.capacity_Ah
    found = Ekf(CELL).run(log, 0.95, 0.005).soc
    assert np.max(np.abs(found - truth)) < 0.03

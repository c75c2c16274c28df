"""State of power on a page: the plot shows limits and measured power, the table the end."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import power_settings
from cellwise.estimate.replay import replay
from cellwise.report.replay.page import power_content, power_plot, usual
from report_cases import drive, model


@pytest.mark.slow
def test_limits_stand_beside_the_measured_power():
    limits = OperatingLimits(2.8, 4.25)
    settings = power_settings(model(), horizons_s=(2.0, 12.0), limits=limits)
    run = replay(model(), drive(), "ekf", soc0=0.8, power=settings)
    assert usual(run.power) == 1
    (panel,) = power_plot(run, run.power, "power").panels
    measured, out, into = panel.lines
    np.testing.assert_array_equal(out.y, run.power.discharge_W[1])
    np.testing.assert_array_equal(out.edges[0], run.power.discharge_low_W[1])
    np.testing.assert_array_equal(into.y, -run.power.charge_W[1])
    np.testing.assert_array_equal(measured.y, run.log.interval_current_A * run.log.voltage_V)
    assert "12 s" in panel.y_label
    text = power_content(run, run.power, several=False)
    assert "voltage" in text
    assert "at least (95 %)" in text

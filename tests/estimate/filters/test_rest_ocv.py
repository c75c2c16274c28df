"""The gauge that reads the OCV at rest: exact where the OCV is, silent on a plateau."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.coulomb import REST_S, Coulomb, RestOcv
from cellwise.estimate.replay import replay
from cellwise.logs.cell_log import CellLog
from example_cells import lfp_cell, linear_cell

REST_ROWS = 7200


def load_then_rest(model, load_s=1800, soc0=0.9, begins_at_rest=False):
    """One C of load, two hours of rest."""
    current = np.concatenate((np.full(load_s, model.capacity_Ah), np.zeros(REST_ROWS)))
    if begins_at_rest:
        current[:5] = 0.0
    log = CellLog(np.arange(float(current.size)), current, np.full(current.size, 3.7), name="rest")
    told = simulate(model, log, soc0)
    return replace(log, voltage_V=told.voltage_V), told.soc


def test_after_a_rest_the_start_is_forgotten():
    model = linear_cell()
    log, truth = load_then_rest(model)
    trace = RestOcv(model).run(log, 0.5)
    assert trace.soc[1799] - truth[1799] == pytest.approx(-0.4)
    first = 1799 + int(REST_S)
    assert abs(trace.soc[first - 1] - truth[first - 1]) > 0.3
    assert abs(trace.soc[first + 1] - truth[first + 1]) < 0.01
    # What is left of the branches has gone after two hours.
    assert trace.soc[-1] == pytest.approx(truth[-1], abs=1e-4)
    assert trace.soc_std[-1] < 0.05


def test_a_cell_that_is_switched_on_at_rest_is_read_at_once():
    model = linear_cell()
    log, truth = load_then_rest(model, begins_at_rest=True)
    trace = RestOcv(model).run(log, 0.5)
    assert trace.soc[0] == pytest.approx(truth[0], abs=1e-6)
    counted = Coulomb(model).run(log, float(trace.soc[0]))
    np.testing.assert_allclose(trace.soc[:1800], counted.soc[:1800], atol=1e-12)


def test_on_a_plateau_it_keeps_what_it_counted():
    model = lfp_cell()
    log, truth = load_then_rest(model, load_s=1260)  # to 55 %
    known = RestOcv(model).run(log, 0.9, 0.02)
    assert np.max(np.abs(known.soc - truth)) < 0.005
    unsure = RestOcv(model).run(log, 0.6, 0.3)
    assert unsure.soc_std[-1] > 0.03


def test_a_replay_of_it_has_no_voltage_and_says_so():
    model = linear_cell()
    log, _ = load_then_rest(model)
    found = replay(model, log, "rest-ocv", soc0=0.5)
    assert np.isnan(found.voltage_rmse_V)
    assert found.nis_mean is None
    with pytest.raises(InputError, match="rest_s"):
        RestOcv(model, rest_s=-1.0)

"""Beyond the model's data the target says so by the same bit and widens as the float64 EKF does."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.plausibility.validity import UNKNOWN, Validity
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.status import OUTSIDE
from cellwise.export.firmware import Firmware
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from virtual_tester import logged

COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
VALID = Validity(soc=(0.6, 0.95), temperature_C=(10.0, 30.0), current_A=(-2.0, 4.0))
MODEL = curved_cell(validity=VALID)
ROWS = 6000


def drive(temperature_C) -> CellLog:
    """Down to SOC 0.3, with currents to both sides of the data's."""
    current = np.repeat(np.random.default_rng(2).gamma(1.2, 1.1, ROWS // 20) - 0.5, 20)
    warm = np.broadcast_to(temperature_C, ROWS).astype(np.float64)
    log = CellLog(np.arange(float(ROWS)), current, np.full(ROWS, 3.7), temperature_C=warm)
    noise = 1e-3 * np.random.default_rng(3).normal(size=ROWS)
    return logged(MODEL, log, 0.85, noise)


@COMPILED
@pytest.mark.slow
def test_the_bit_is_the_same_in_python_c_and_the_float64_filter():
    log = drive(np.linspace(-10.0, 45.0, ROWS))
    ours, target, ekf = (
        filter_.run(log, 0.85, 0.02)
        for filter_ in (FixedStep(MODEL, dt_s=1.0), Firmware(MODEL, dt_s=1.0), Ekf(MODEL))
    )
    np.testing.assert_array_equal(ours.status, target.status)
    np.testing.assert_array_equal(ours.soc_std, target.soc_std)
    beyond = ekf.status & OUTSIDE != 0
    assert 0.2 < np.mean(beyond) < 0.99
    # Where the two filters' SOC lie to both sides of the bound they may differ.
    near = np.abs(ekf.soc - VALID.bounds().soc_low) < 1e-3
    np.testing.assert_array_equal((ours.status & OUTSIDE != 0)[~near], beyond[~near])


@pytest.mark.parametrize(
    ("target", "valid", "warm"),
    [
        pytest.param(FixedStep, replace(VALID, temperature_C=None), 25.0, marks=pytest.mark.slow),
        pytest.param(Firmware, Validity(temperature_C=(10.0, 30.0)), -10.0, marks=COMPILED),
        pytest.param(FixedStep, Validity(current_A=(-0.2, 0.4)), 25.0, marks=pytest.mark.slow),
    ],
    ids=["SOC", "temperature", "current"],
)
def test_every_quantity_widens_as_in_the_float64_filter(target, valid, warm):
    model, plain = replace(MODEL, validity=valid), replace(MODEL, validity=UNKNOWN)
    log = drive(warm)

    def spread(kind, m):
        """Of the innovations: a persistent error in the SOC is the float64 filters' own."""
        return kind(m).run(log, 0.85, 0.05).innovation_variance_V2[3 * ROWS // 4 :]

    ours, ekf = (np.mean(spread(kind, model)) for kind in (target, Ekf))
    assert ours == pytest.approx(ekf, rel=0.02)
    assert ours > 1.1 * np.mean(spread(target, plain))


def test_temperature_is_read_only_where_the_data_s_is_known():
    known = fixed_step_tables(MODEL, 1.0).options
    unknown = fixed_step_tables(replace(MODEL, validity=Validity(soc=(0.1, 1.0))), 1.0).options
    assert known.needs_temperature
    assert not unknown.needs_temperature

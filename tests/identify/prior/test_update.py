"""The update: what the data determine is found, what they do not stays at the prior."""

from __future__ import annotations

import numpy as np
import pytest
from prior_cells import CAPACITY_AH, drive_of, other_cell

from cellwise.cell.stock import named_model, stock_model
from cellwise.identify.prior.corrections import Corrections
from cellwise.identify.prior.update import PriorLog, update

WINDOW = np.array([1.5, 4.5])


@pytest.fixture(scope="module")
def corrections():
    return Corrections(stock_model("nmc-18650"), CAPACITY_AH, 0.05, WINDOW)


def test_the_priors_own_drive_moves_nothing(corrections):
    log = drive_of(named_model("nmc-18650", CAPACITY_AH), 0.8, 0.5)
    found = update(corrections, [PriorLog(log, 0.8, 0.005)])
    assert np.linalg.norm(found.z) < 0.5
    assert found.misfit < 0.0  # residuals of millivolts


def test_data_narrow_what_they_show_and_nothing_widens(corrections, cell, flight):
    found = update(corrections, [PriorLog(flight, 0.65, 0.005)])
    deviations = np.sqrt(np.diag(found.covariance))
    assert np.all(deviations <= 1.0 + 1e-9)
    shape = corrections.ocv_map
    ocv = np.sqrt(np.einsum("ij,jk,ik->i", shape, found.covariance, shape))
    before = np.sqrt(np.einsum("ij,ij->i", shape, shape))
    assert ocv[55] < 0.5 * before[55]
    assert ocv[5] > 0.6 * before[5]


def test_an_unknown_start_is_found_from_a_wrong_guess(corrections):
    log = drive_of(other_cell(shift=0.0, factor=1.0), 0.8, 0.5)
    found = update(corrections, [PriorLog(log, 0.65, 0.5)])
    assert found.soc0[0] == pytest.approx(0.8, abs=2.5 * float(found.soc0_std[0]))
    assert found.soc0_std[0] < 0.15

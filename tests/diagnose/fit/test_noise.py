"""How wrong a model may be: how much rows count, and what is known of its statement."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import invgamma, norm

from cellwise.cell.model_error import ModelError
from cellwise.diagnose.fit.noise import (
    STATED,
    KnownScale,
    Objective,
    independent_errors,
    share_claimed,
)
from cellwise.fit.model_error import charged_for_minutes
from cellwise.logs.cell_log import CellLog

ROWS = 4001


def test_a_log_holds_as_many_errors_as_its_time_and_soc():
    error = ModelError.of_white_and_slow(correlation_s=200.0)
    assert independent_errors(error, 4000.0, 0.8) == pytest.approx(1.0 + 4000.0 / 400.0)
    along = replace(error, correlation_soc=0.04)
    of_both = 1.0 + 4000.0 / 400.0 + 0.8 / 0.08
    assert independent_errors(along, 4000.0, 0.8) == pytest.approx(of_both)


def test_a_shape_that_is_not_natures_is_few_errors_in_however_many_rows():
    log = SimpleNamespace(each=lambda: [(None, slice(0, ROWS))], known=np.ones(ROWS, dtype=bool))
    size, weight = np.full(ROWS, 2e-3), np.full(ROWS, 200.0 / ROWS)
    stated = Objective(log, size, weight, size, weight)
    np.testing.assert_allclose(stated.with_shape(0.0).weight, weight)
    large = stated.with_shape(0.2)
    np.testing.assert_allclose(large.size_V, np.hypot(2e-3, 0.2))
    assert np.sum(large.weight) == pytest.approx(STATED.shape_errors, rel=0.01)
    # A mean over all rows is as uncertain as the two errors together.
    both = stated.with_shape(2e-3)
    assert np.mean(both.size_V) ** 2 / np.sum(both.weight) == pytest.approx(
        4e-6 / 200.0 + 4e-6 / STATED.shape_errors
    )


def test_what_no_test_could_show_of_charges_is_not_held_against_a_model():
    """A load that lasts is for the diagnosis to find; a charge that lasts has no cause's shape."""
    error = ModelError.of_white_and_slow(
        resistance_share=0.03, unseen_share=0.2, unseen_charge_share=0.1
    )
    polarisation_V = np.array([0.2, -0.2, -0.2, 0.2])
    charged = np.array([False, False, True, True])
    shares = share_claimed(error, polarisation_V, charged)
    np.testing.assert_allclose(shares, [0.03, 0.03, np.hypot(0.03, 0.1), 0.03])
    shown = replace(error, unseen_share=0.0, unseen_charge_share=None)
    np.testing.assert_allclose(share_claimed(shown, polarisation_V, charged), 0.03)


def test_a_charge_lasts_once_more_went_in_than_out_for_minutes():
    """Pulses into the cell between loads are no charge that lasts."""
    time_s = np.arange(0.0, 2401.0)
    current_A = np.where(time_s % 60.0 < 20.0, -1.0, 1.0)
    current_A[time_s > 1200.0] = -1.0
    log = CellLog(time_s, current_A, np.full(time_s.size, 3.7))
    charged = charged_for_minutes(log)
    assert not charged[time_s <= 1200.0].any()
    assert charged[time_s > 1200.0 + 250.0].all()
    assert not charged_for_minutes(log.part(1300, 1500)).any()  # too short to say


def test_the_scale_is_the_most_likely_one_under_its_prior():
    known = KnownScale(10.0, 10.0)
    left = np.full(8, 3.0)
    scale = np.linspace(1.0, 5.0, 4001)
    # With ln scale flat, square / scale^2 of an inverse gamma is its prior.
    density = known.errors * -np.log(scale) - 0.5 * known.square / scale**2
    density += norm.logpdf(left[:, None], 0.0, scale).sum(axis=0)
    assert known.scale(float(left @ left), 8.0) == pytest.approx(
        scale[np.argmax(density)], abs=2e-3
    )
    assert known.ln_density(2.0) - known.ln_density(3.0) == pytest.approx(
        float(np.diff(invgamma.logpdf([9.0, 4.0], 5.0 - 1.0, scale=5.0))[0]), rel=1e-6
    )

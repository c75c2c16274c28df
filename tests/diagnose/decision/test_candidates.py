"""What decides between explanations: each log's own noise, and who predicts held-out rows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cellwise.diagnose.decision.candidates import clearly_ahead
from cellwise.diagnose.fit.gain import gain_of
from cellwise.diagnose.fit.noise import log_scales
from cellwise.diagnose.fit.rows import HELD

ROWS, BLOCKS = 2400, 24


@pytest.fixture
def held():
    """Held-out rows in blocks, measured at zero volts."""
    return SimpleNamespace(
        voltage_V=np.zeros(ROWS),
        role=np.full(ROWS, HELD, dtype=np.int32),
        known=np.ones(ROWS, dtype=np.bool_),
        block=np.repeat(np.arange(BLOCKS), ROWS // BLOCKS),
    )


def wrong_by(size_V, seed):
    return np.random.default_rng(seed).normal(0.0, size_V, ROWS)


def test_each_log_has_its_own_scale_and_outliers_do_not_rule_it():
    rng = np.random.default_rng(1)
    quiet, loud = rng.normal(0.0, 0.5, 3000), rng.normal(0.0, 2.0, 3000)
    quiet[:3] = 1e4
    found = log_scales(np.concatenate((quiet, loud)), np.ones(6000, dtype=np.bool_), [3000, 3000])
    assert found == pytest.approx((0.5, 2.0), rel=0.1)


def test_rows_that_are_not_used_do_not_count():
    white = np.concatenate((np.ones(100), np.full(100, 3.0)))
    assert log_scales(white, np.arange(200) < 100, [200]) == pytest.approx((1.0,))


def test_the_nearer_one_is_ahead_wherever_it_stands(held):
    near, far, farther = wrong_by(1e-3, 1), wrong_by(2e-3, 2), wrong_by(4e-3, 3)
    size = np.ones(ROWS)
    assert clearly_ahead(held, [far, near, farther], size, 0) == 1
    assert clearly_ahead(held, [near, far], size, 0) == 0


def test_none_is_ahead_of_its_equal(held):
    assert clearly_ahead(held, [wrong_by(1e-3, 1), wrong_by(1e-3, 2)], np.ones(ROWS), 0) is None


def test_none_is_ahead_where_the_two_measures_disagree(held):
    end = np.arange(ROWS) >= ROWS - 100
    one = np.where(end, 0.1, 1e-3)
    other = np.where(end, 0.05, 4e-3)
    assert clearly_ahead(held, [one, other], np.where(end, 100.0, 1.0), 0) is None


def test_rows_where_the_model_may_be_far_off_do_not_hide_a_gain(held):
    end = np.arange(ROWS) >= ROWS - 100
    noise = wrong_by(0.2, 4)
    before, after = np.where(end, noise, 4e-3), np.where(end, noise, 1e-3)
    gain = gain_of(held, before, after, np.where(end, 1000.0, 1.0), np.random.default_rng(0))
    assert gain.gain < 0.01
    assert gain.gain_in_size == pytest.approx(0.75, abs=0.01)
    assert gain.low_in_size > 0.7

"""How wrong a model may be: how much rows count, and what is known of its statement."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import invgamma, norm

from cellwise.diagnose.fit.noise import KnownScale, row_weights
from cellwise.diagnose.fit.rows import FITTED, IGNORED

ROWS = 4001


def evidence(rows=ROWS, unused=0):
    log = SimpleNamespace(clock_s=np.arange(float(rows)), scored=rows)
    role = np.full(rows, FITTED)
    role[:unused] = IGNORED
    return SimpleNamespace(
        each=lambda: [(log, slice(0, rows))], known=np.ones(rows, dtype=bool), role=role
    )


def test_rows_count_as_many_errors_as_their_time_holds():
    weights = row_weights(evidence(), memory_s=200.0)
    assert np.sum(weights) == pytest.approx(1.0 + 4000.0 / 400.0)
    some = row_weights(evidence(unused=1000), memory_s=200.0)
    assert np.sum(some[1000:]) == pytest.approx(1.0 + 4000.0 / 400.0)


def test_a_row_is_one_error_at_most():
    assert np.all(row_weights(evidence(), memory_s=1e-3) <= 1.0)


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


def test_the_scale_is_never_below_what_is_stated_unless_good_rows_say_so():
    assert KnownScale().scale(0.0, 50.0) == 1.0
    better = KnownScale().with_more(0.0, 10.0)
    assert better.scale(0.0, 50.0) == pytest.approx(np.sqrt(0.5))

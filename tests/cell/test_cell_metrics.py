"""Error figures: their plain definitions and the first seed paper's tables."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellwise.cell.metrics import band_metrics, error_metrics, metrics_to_dict

errors = arrays(np.float64, st.integers(1, 60), elements=st.floats(-2.0, 2.0))


@given(errors)
def test_figures_are_their_definitions(e):
    m = error_metrics(e)
    assert m.samples == e.size
    assert m.rmse_V == pytest.approx(np.sqrt(np.mean(e**2)), abs=1e-15)
    assert m.mae_V == pytest.approx(np.mean(np.abs(e)), abs=1e-15)
    assert m.max_error_V == np.max(np.abs(e))
    assert m.mean_error_V == pytest.approx(np.mean(e), abs=1e-15)
    assert m.std_error_V == pytest.approx(np.sqrt(np.mean((e - e.mean()) ** 2)), abs=1e-15)
    assert m.rmse_V**2 == pytest.approx(m.mean_error_V**2 + m.std_error_V**2, abs=1e-12)
    assert m.mae_V <= m.rmse_V + 1e-15
    assert m.rmse_V <= m.max_error_V + 1e-15


def test_missing_measurements_do_not_count():
    e = np.array([0.1, np.nan, -0.3, np.inf])
    assert error_metrics(e) == error_metrics(np.array([0.1, -0.3]))
    nothing = error_metrics(np.array([np.nan]))
    assert nothing.samples == 0
    assert np.isnan(nothing.rmse_V)
    assert metrics_to_dict(nothing)["rmse_V"] is None
    assert metrics_to_dict(nothing)["ci95_V"] == [None, None]


@given(st.data())
def test_bands_are_a_partition(data):
    e = data.draw(errors)
    soc = data.draw(
        arrays(np.float64, e.size, elements=st.floats(-0.2, 1.2) | st.sampled_from([0.0, 0.1, 1.0]))
    )
    bands = band_metrics(e, soc)
    assert sum(b.metrics.samples for b in bands) == e.size
    squares = sum(b.metrics.samples * b.rmse_V**2 for b in bands)
    assert squares == pytest.approx(np.sum(e**2), abs=1e-12)
    for b in bands:
        inside = (soc >= b.soc_low) & (soc < b.soc_high)
        if b.soc_low > 0 and b.soc_high < 1:
            assert b.metrics.samples == np.count_nonzero(inside)
        else:
            assert b.metrics.samples >= np.count_nonzero(inside)

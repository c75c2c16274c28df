"""Error figures: their plain definitions and the first seed paper's tables."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellwise.cell.metrics import BANDS, band_metrics, error_metrics, metrics_to_dict

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


# NCR18650B paper: mean, standard deviation, RMSE and 95 % interval of the residual [mV].
@pytest.mark.parametrize(
    ("mean", "std", "rmse", "low", "high"),
    [
        (-10.2, 18.7, 21.3, -46.8, 26.4),
        (2.1, 25.7, 25.8, -48.2, 52.5),
        (-2.0, 21.3, 21.4, -43.7, 39.7),
    ],
    ids=["C/20", "C/5", "C/3"],
)
def test_relations_of_the_papers_residual_table(mean, std, rmse, low, high):
    # Errors with exactly this mean and standard deviation, printed to 0.1 mV as the paper does.
    m = error_metrics(1e-3 * np.array([mean - std, mean + std]))
    assert 1e3 * m.rmse_V == pytest.approx(rmse, abs=0.06)
    assert 1e3 * np.array(m.ci95_V) == pytest.approx([low, high], abs=0.16)


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
    squares = sum(b.metrics.samples * b.metrics.rmse_V**2 for b in bands)
    assert squares == pytest.approx(np.sum(e**2), abs=1e-12)
    for b in bands:
        inside = (soc >= b.soc_low) & (soc < b.soc_high)
        if b.soc_low > 0 and b.soc_high < 1:
            assert b.metrics.samples == np.count_nonzero(inside)
        else:
            assert b.metrics.samples >= np.count_nonzero(inside)


def test_bands_join_up_from_0_to_1():
    assert BANDS[0][0] == 0.0
    assert BANDS[-1][1] == 1.0
    assert all(a[1] == b[0] for a, b in pairwise(BANDS))
    # Rows exactly at a border belong to the upper band, rows beyond the ends to the end bands.
    at = {0.1: 0.1, 0.3: 0.3, 0.7: 0.7, 1.0: 0.9, 1.3: 0.9, -0.1: 0.0}
    for soc, low in at.items():
        (band,) = band_metrics(np.array([0.01]), np.array([soc]))
        assert band.soc_low == low

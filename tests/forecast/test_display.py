"""A displayed percentage: what it must never do, whatever current and estimate do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.forecast.display import Displayed, display_of
from example_cells import curved_cell

ROUNDING = 1e-12  # points
CUTOFF_V, LIMIT_V, TAPER_A = 3.0, 4.2, 0.15
MODEL = curved_cell()


def shown(catch_up=0.1):
    return Displayed(display_of(MODEL, CUTOFF_V, LIMIT_V, TAPER_A, catch_up))


ROW = st.tuples(
    st.floats(-6.0, 6.0), st.floats(-0.1, 1.1), st.floats(2.5, 4.3), st.floats(0.0, 600.0)
)


@given(rows=st.lists(ROW, min_size=2, max_size=60), catch_up=st.floats(1e-3, 1.0),
       ends=st.tuples(st.floats(0.0, 0.4), st.floats(0.9, 1.0)))  # fmt: skip
@settings(max_examples=150, deadline=None)
def test_it_never_moves_against_the_current(rows, catch_up, ends):
    display = shown(catch_up)
    display.expect(*ends)
    before = None
    for current_A, soc, voltage_V, dt_s in rows:
        now = display.take(soc, current_A, voltage_V, dt_s)
        assert 0.0 <= now <= 100.0
        if before is not None:
            if current_A > 0.0:
                assert now <= before + ROUNDING
            elif current_A < 0.0:
                assert now >= before - ROUNDING
            else:
                assert now == before
        before = now


@given(begin=st.floats(0.05, 1.0), wrong=st.floats(-0.3, 0.3), catch_up=st.floats(0.01, 1.0),
       empty=st.floats(0.0, 0.2))  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_it_is_empty_when_the_estimate_is_and_not_before(begin, wrong, catch_up, empty):
    """An estimate that was off and is corrected: at its end nothing is left of the difference."""
    display = shown(catch_up)
    display.expect(empty)
    begin = max(begin, empty + 0.05)
    display.take(min(max(begin + wrong, 0.0), 1.0), 0.0, 3.7, 0.0)
    step = (begin - empty) / 400
    dt_s = step * 3600.0 * MODEL.capacity_Ah / 3.0
    seen = [display.take(begin - k * step, 3.0, 3.7, dt_s) for k in range(1, 401)]
    assert seen[-1] == pytest.approx(0.0, abs=0.5)
    falls = -np.diff(seen)
    assert falls.min() >= 0.0
    # No jump: a step is what was counted, and the difference over what is left to take it in.
    left = np.minimum(catch_up, (begin - empty - step * np.arange(2, 401)) / (1 - empty))
    allowed = 100 * step * (1.0 + 1.05 * (abs(wrong) / (1 - empty) + empty) / left.clip(step))
    assert np.all(falls[:-2] <= allowed[:-2] / (1 - empty) + 0.1)


@given(begin=st.floats(0.0, 0.9), wrong=st.floats(-0.3, 0.3))
@settings(max_examples=40, deadline=None)
def test_it_is_full_when_the_estimate_is(begin, wrong):
    display = shown()
    display.take(min(max(begin + wrong, 0.0), 1.0), 0.0, 3.7, 0.0)
    step = (1.0 - begin) / 400
    dt_s = step * 3600.0 * MODEL.capacity_Ah / 2.0
    for k in range(1, 401):
        last = display.take(begin + k * step, -2.0, 4.0, dt_s)
    assert last == pytest.approx(100.0, abs=0.5)


def test_the_device_s_own_ends_are_0_and_100():
    display = shown()
    assert display.take(0.3, 2.0, 3.5, 1.0) == pytest.approx(30.0)
    assert display.take(0.3, 2.0, 2.99, 1.0) == 0.0
    assert display.take(0.9, -0.1, 4.2, 1.0) == 100.0


def test_without_a_current_a_correction_waits():
    display = shown()
    display.take(0.5, 0.0, 3.7, 1.0)
    assert display.take(0.8, 0.0, 3.9, 3600.0) == 50.0
    assert display.take(0.8, math.nan, 3.9, 3600.0) == 50.0


@pytest.mark.parametrize("catch_up", [0.0, 2.0, math.nan])
def test_a_parameter_out_of_range_is_refused(catch_up):
    with pytest.raises(InputError, match="catches up"):
        shown(catch_up)

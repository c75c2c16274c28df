"""Where a model is valid: kept by every copy, written, read, checked; a hair outside is inside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwise.cell.model_file import (
    model_from_dict,
    model_to_dict,
    read_model,
    write_model,
)
from cellwise.cell.plausibility.validity import (
    TOLERANCE_CURRENT,
    TOLERANCE_K,
    TOLERANCE_SOC,
    Validity,
    beyond_soc,
    covered,
)
from cellwise.errors import InputError
from example_cells import linear_cell

VALID = Validity(soc=(0.2, 0.9), temperature_C=(-5.0, 31.5), current_A=(-3.0, 12.0))

finite = st.floats(-1e3, 1e3)
ranges = st.none() | st.tuples(finite, finite).map(lambda p: (min(p), max(p)))
validities = st.builds(Validity, ranges, ranges, ranges)


def test_a_file_keeps_it_and_a_file_of_before_has_none(tmp_path):
    path = tmp_path / "model.json"
    write_model(linear_cell(validity=VALID), path)
    assert read_model(path).validity == VALID
    old = model_to_dict(linear_cell())
    assert "validity" not in old
    assert model_from_dict(old).validity == Validity()


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"soc": [0.9, 0.2]}, "from 0.9 to 0.2"),
        ({"soc": [10.0, 90.0]}, "per cent"),
        ({"temperature_C": [263.0, 300.0]}, "kelvin"),
        ({"current_A": [-5000.0, 9000.0]}, "not mA"),
        ({"temperature_C": [0.0]}, "wrong entry"),
        ({"temperature_C": [0.0, "warm"]}, "wrong entry"),
        ({"temperature": [0.0, 25.0]}, "'temperature_C'"),
        ([0.0, 1.0], "entry"),
    ],
)
def test_bounds_that_no_cell_has_are_refused(entry, message):
    data = model_to_dict(linear_cell()) | {"validity": entry}
    with pytest.raises(InputError) as refused:
        model_from_dict(data)
    assert message in str(refused.value)


@pytest.mark.parametrize("soc", [(np.nan, 1.0), (0.0, np.inf), (1.0, 0.0)])
def test_bounds_are_two_finite_numbers_in_order(soc):
    with pytest.raises(InputError, match="validity of soc"):
        Validity(soc=soc)


@given(validities, validities)
def test_what_two_cover_covers_both_and_is_the_same_either_way(a, b):
    both = a.joined(b)
    assert both == b.joined(a)
    for one in (a, b):
        assert one.joined(both) == both


@given(validities, validities)
def test_further_data_never_narrow_and_never_invent(a, b):
    more = a.extended(b)
    assert more.joined(a) == more
    for name in ("soc", "temperature_C", "current_A"):
        assert (getattr(more, name) is None) == (getattr(a, name) is None)


@given(validities, st.floats(-2.0, 3.0))
def test_a_hair_outside_is_inside(validity, soc):
    far = float(beyond_soc(validity, soc))
    if validity.soc is None:
        assert far == 0.0
    else:
        low, high = validity.soc
        assert far == pytest.approx(max(low - soc, soc - high, TOLERANCE_SOC) - TOLERANCE_SOC)


def test_bounds_carry_the_tolerance_and_are_infinite_where_nothing_is_known():
    bounds = VALID.bounds()
    assert bounds.cold_C == -5.0 - TOLERANCE_K
    assert bounds.discharge_A == pytest.approx(12.0 * (1.0 + TOLERANCE_CURRENT))
    assert bounds.charge_A == pytest.approx(-3.0 - 12.0 * TOLERANCE_CURRENT)
    assert np.all(np.isinf(Validity().bounds()))


def test_covered_is_the_range_of_finite_rows_less_outliers():
    rows = np.array([3.0, np.nan, -1.0, 2.0, 50.0])
    assert covered(rows) == (-1.0, 50.0)
    assert covered(rows, 1) == (2.0, 3.0)
    assert covered(np.full(3, np.nan)) is None


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_stated_error_grows_with_the_distance_from_the_data(a, b):
    model = linear_cell(validity=Validity(soc=(0.4, 0.6)))
    near, far = sorted((abs(a - 0.5), abs(b - 0.5)))
    assert model.slow_error_V(0.5 - near) <= model.slow_error_V(0.5 - far)
    plain = linear_cell()
    assert plain.slow_error_V(a) == plain.error.at(a)
    # A straight OCV of 0.9 V: at half its slope, 0.45 V for the whole range.
    edge = 0.6 + TOLERANCE_SOC
    expected = np.hypot(float(plain.error.at(1.0)), 0.45 * (1.0 - edge))
    assert float(model.slow_error_V(1.0)) == pytest.approx(expected)

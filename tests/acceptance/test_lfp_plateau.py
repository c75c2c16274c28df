"""A123 (LFP with hysteresis): on the plateau a filter says that it does not know.

C/30 branches at 25 degC and drives of five temperatures, the sixth held out; four of the six in
turn (`python -m benchmarks.accuracy --only lfp` has all). The tester's counter is the reference;
the log's own current drifts from it by up to 1.2 %.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.accuracy.lfp import (
    LOST,
    PASSED,
    UNVOUCHED_STD,
    WORSE,
    drive,
    from_known,
    from_plateau,
    model_without,
    with_offset,
)

from measured_models import AT_ITS_BOUND, missed, rmse

HELD_OUT = ("n25", "n15", "p25", "p45")
PLATEAU_END = 0.2
BEYOND = "10 K colder than its data the model is 64 mV off: {}"
BETWEEN = "resistances of -25 and 5 degC are not those of -15: {}"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def held_out(real_data):
    """The model that has not seen a temperature, and the drive there, by its tag."""
    known = {}

    def one(tag):
        if tag not in known:
            known[tag] = model_without(real_data, tag), drive(real_data, tag)
        return known[tag]

    return one


def loss(model, log, name, *std):
    """SOC RMSE of a filter from the true start less that of counting, in points."""
    ours = from_known(model, log, name, *std).rmse
    return 100.0 * (ours - from_known(model, log, "coulomb").rmse)


@pytest.mark.parametrize("name", ["ekf", "ukf", "adaptive"])
@pytest.mark.parametrize("tag", HELD_OUT)
def test_wrong_on_the_plateau_the_band_holds_the_truth(held_out, tag, name):
    if tag == "n25" and name != "ukf":
        pytest.xfail("85 % of the rows: " + BEYOND.format("taken for an offset of the current"))
    inside = [run.inside for run, _ in from_plateau(*held_out(tag), name)]
    assert np.mean(inside) > 0.95


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize(
    "tag",
    missed(
        HELD_OUT, n25=BEYOND.format("8.4 % (EKF), 6.0 % (UKF)"), n15=BETWEEN.format("3.5 %, 3.9 %")
    ),
)
def test_wrong_on_the_plateau_it_is_within_two_points_past_its_end(held_out, tag, name):
    runs = from_plateau(*held_out(tag), name)
    assert max(rmse(run.error[truth < PLATEAU_END]) for run, truth in runs) < 0.02


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize(
    "tag",
    missed(
        HELD_OUT,
        n25=BEYOND.format("11.9 % (EKF), 10.5 % (UKF)"),
        n15=BETWEEN.format("3.6 %, 4.1 %"),
        p45=f"2.0 %: {AT_ITS_BOUND}",
    ),
)
def test_wrong_on_the_plateau_it_is_within_two_points_after_a_fifth(held_out, tag, name):
    runs = from_plateau(*held_out(tag), name)
    assert max(rmse(run.error[truth < truth[0] - PASSED]) for run, truth in runs) < 0.02


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("tag", HELD_OUT)
def test_a_true_start_is_not_pulled_away(held_out, tag, name):
    assert loss(*held_out(tag), name) < LOST


@pytest.mark.parametrize("tag", HELD_OUT)
def test_a_true_start_that_nobody_vouches_for_is_not_pulled_away(held_out, tag):
    assert loss(*held_out(tag), "ekf", UNVOUCHED_STD) < LOST


@pytest.mark.parametrize("tag", HELD_OUT)
def test_adaptive_is_hardly_worse_than_the_ekf(held_out, tag):
    model, log = held_out(tag)
    assert loss(model, log, "adaptive") < loss(model, log, "ekf") + WORSE


@pytest.mark.parametrize(
    "tag",
    missed(
        HELD_OUT,
        n25=BEYOND.format("1.6 %"),
        n15=f"1.01 %: {AT_ITS_BOUND}",
        p45=f"1.00 %: {AT_ITS_BOUND}",
        p25="a rest above C/100 may be a load: 3.0 %",
    ),
)
def test_adaptive_finds_a_current_that_is_off(held_out, tag):
    assert max(run.rmse for run in with_offset(*held_out(tag), "adaptive")) < 0.01

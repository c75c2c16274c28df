"""What a load does for minutes is known up to the current that lasted as long in the tests."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.fit.model_error import slow_part, sustained_A, unseen_shares
from cellwise.logs.cell_log import CellLog

CAPACITY_AH = 3.0


def log_of(current_A, step_s=1.0):
    """Rows every ``step_s``; a row's current flows in the interval that ends there."""
    current = np.asarray(current_A, dtype=float)
    return CellLog(
        time_s=step_s * np.arange(current.size),
        current_A=current,
        voltage_V=np.full(current.size, 3.7),
    )


def pulses(high_A, between_A):
    """Ten seconds of ``high_A``, rest, ten minutes of ``between_A``, ten times."""
    one = [high_A] * 10 + [0.0] * 300 + [between_A] * 600 + [0.0] * 300
    return log_of(one * 10)


def model(r0=0.02, r1=0.01, r2=0.02, r3=0.01):
    grid = np.ones(11)
    found = CellModel(
        capacity_Ah=CAPACITY_AH,
        ocv_V=np.linspace(3.0, 4.2, 11),
        r0_ohm=r0 * grid,
        r1_ohm=r1 * grid,
        tau1_s=3.0 * grid,
        r2_ohm=r2 * grid,
        tau2_s=60.0 * grid,
    )
    return found.with_effect(SlowDiffusion(r3, 1000.0)) if r3 else found


def test_a_pulse_does_not_last_and_what_lasts_has_a_direction():
    assert sustained_A(pulses(6.0, 1.0), 1.0) == pytest.approx(1.0, rel=0.05)
    assert sustained_A(pulses(6.0, 1.0), -1.0) == 0.0
    assert sustained_A(pulses(6.0, -1.0), -1.0) == pytest.approx(1.0, rel=0.05)
    assert sustained_A(log_of([6.0] * 60), 1.0) == 0.0
    assert sustained_A(log_of([2.0] * 100, step_s=60.0), 1.0) == pytest.approx(2.0)


def test_a_load_that_changes_counts_with_its_mean():
    assert sustained_A(log_of([4.0, 0.0] * 600), 1.0) == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("r3", [0.0, 0.01])
def test_what_takes_minutes_is_beyond_r0_and_r1(r3):
    assert slow_part(model(r3=r3)) == pytest.approx((0.02 + r3) / (0.05 + r3))


def test_from_two_doublings_on_each_may_be_off_by_a_quarter_of_what_takes_minutes():
    slow = slow_part(model())
    both = [1.6] * 1000 + [-1.6] * 1000
    assert unseen_shares(model(), [log_of([6.0] * 60), log_of(both)]) == (0.0, 0.0)
    for lasted_A, share in ((0.75, 0.50), (0.375, 0.75)):
        logs = [log_of([6.0] * 60), log_of([lasted_A] * 1000)]
        assert unseen_shares(model(), logs) == pytest.approx((share * slow, share * slow))


def test_a_direction_that_nothing_sustained_is_a_doubling():
    slow = slow_part(model())
    for sign, shares in ((1.0, (0.0, 0.25)), (-1.0, (0.25, 0.0))):
        load = [sign * 3.1] * 1000
        found = unseen_shares(model(), [log_of(load)])
        assert found == pytest.approx((shares[0] * slow, shares[1] * slow))
        slowly = [-sign * 0.1] * 10_000  # C/30 the other way shows a thirtieth of it
        assert unseen_shares(model(), [log_of(load), log_of(slowly)]) == pytest.approx(found)
        other = [-sign * 1.6] * 1000
        assert unseen_shares(model(), [log_of(load), log_of(other)]) == (0.0, 0.0)


def test_one_test_that_lasts_is_enough():
    found = unseen_shares(model(), [pulses(6.0, 0.75), log_of([3.1] * 1000)])
    assert found[0] == 0.0


def test_no_more_is_asked_than_the_tests_reached():
    # A log of small currents says nothing of 1C, and the filters widen beyond its current anyway.
    assert unseen_shares(model(), [log_of([0.5] * 1000)])[0] == 0.0


def test_pulses_alone_leave_most_of_it_open():
    only = unseen_shares(model(), [pulses(6.0, 0.0)])
    assert 0.5 * slow_part(model()) < only[0] < slow_part(model())
    assert only[0] <= only[1] < slow_part(model())

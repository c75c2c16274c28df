"""Equations (6) to (9) read on the relaxation, against a relaxation in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.logs.cell_log import CellLog
from cellwise.studies.papers import relaxation_segments

R0, R1, TAU1, R2, TAU2 = 0.03, 0.02, 20.0, 0.01, 400.0
OCV, SLOPE, CURRENT = 3.7, 0.0, 2.0


def pulse_and_rest(rest_s=3600.0):
    """A pulse so long that both branches are full, then a rest, 1 s rows."""
    time = np.arange(-10.0, rest_s + 1.0)
    current = np.where(time <= 0.0, CURRENT, 0.0)
    after = np.maximum(time, 0.0)
    branches = R1 * np.exp(-after / TAU1) + R2 * np.exp(-after / TAU2)
    voltage = OCV - CURRENT * branches - R0 * current
    stop = int(np.argmax(time > 0.0))
    return CellLog(time - time[0], current, voltage), stop, time.size


def test_first_step_is_r0_and_a_second_of_relaxation():
    log, stop, end = pulse_and_rest()
    (found,) = relaxation_segments(log, [(stop, end, CURRENT, 0.5)])
    second = R1 * (1 - np.exp(-1 / TAU1)) + R2 * (1 - np.exp(-1 / TAU2))
    assert found.r0_ohm == pytest.approx(R0 + second, rel=1e-6)
    assert found.soc == 0.5


def test_long_segment_holds_the_whole_relaxation():
    log, stop, end = pulse_and_rest()
    (found,) = relaxation_segments(log, [(stop, end, CURRENT, 0.5)])
    left = R1 * np.exp(-1 / TAU1) + R2 * np.exp(-1 / TAU2) - R2 * np.exp(-3600 / TAU2)
    assert found.r2_ohm == pytest.approx(left, rel=1e-3)
    assert found.tau2_s == pytest.approx(3599.0 / 5.0)


def test_fast_segment_ends_where_it_is_stated():
    log, stop, end = pulse_and_rest()
    (found,) = relaxation_segments(log, [(stop, end, CURRENT, 0.5)])
    assert found.tau1_s == pytest.approx(0.1 * 3599.0 / 5.0, abs=0.2)
    assert 0.0 < found.r1_ohm < found.r2_ohm


def test_direction_does_not_matter():
    log, stop, end = pulse_and_rest()
    mirrored = CellLog(log.time_s, -log.current_A, 2 * OCV - log.voltage_V)
    (down,) = relaxation_segments(log, [(stop, end, CURRENT, 0.5)])
    (up,) = relaxation_segments(mirrored, [(stop, end, -CURRENT, 0.5)])
    assert up.value[:5] == pytest.approx(down.value[:5])


def test_pulse_without_a_relaxation_is_left_out():
    log, stop, _ = pulse_and_rest()
    assert relaxation_segments(log, [(stop, stop + 5, CURRENT, 0.5)]) == []

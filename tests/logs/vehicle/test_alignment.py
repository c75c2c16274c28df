"""Channels of different clocks on one, signals of frames: nothing is bridged or invented."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs.formats.vehicle_signals import (
    Series,
    aligned,
    frame_values,
    physical_values,
)


def at(step, until=100.0, start=0.0):
    return np.arange(start, until + 1e-9, step)


def test_a_common_clock_changes_nothing():
    t = at(1.0)
    channels, notices = aligned(
        {"current_A": Series(t, np.sin(t)), "voltage_V": Series(t, np.cos(t))}, "x"
    )
    np.testing.assert_array_equal(channels["current_A"], np.sin(t))
    assert not notices


def test_a_faster_current_loses_no_charge():
    fast, slow = at(0.01), at(1.0)
    current = 5 + 3 * np.sin(7.3 * fast)
    channels, notices = aligned(
        {"current_A": Series(fast, current), "voltage_V": Series(slow, np.ones(slow.size))}, "x"
    )
    charge = np.sum(channels["current_A"][1:] * np.diff(channels["time_s"]))
    assert charge == pytest.approx(np.trapezoid(current, fast), rel=1e-12)
    assert "averaged" in notices[0]


def test_the_mean_is_exact_where_rows_fall_between_samples():
    """A current that grows linearly: its mean over a row is that of the row's middle."""
    fast = at(0.3)
    rows = at(1.0, until=90.0, start=0.7)
    channels, _ = aligned(
        {"current_A": Series(fast, 2 * fast), "voltage_V": Series(rows, rows)}, "x"
    )
    middle = 0.5 * (rows[1:] + rows[:-1])
    np.testing.assert_allclose(channels["current_A"][1:], 2 * middle, rtol=1e-12)


def test_a_current_between_the_voltages_rows_is_interpolated():
    t = at(1.0)
    channels, notices = aligned(
        {"current_A": Series(t, 3 * t), "voltage_V": Series(t[:-1] + 0.25, t[:-1])}, "x"
    )
    np.testing.assert_allclose(channels["current_A"], 3 * (t[:-1] + 0.25))
    assert "interpolated" in notices[0]


def test_a_pause_of_the_current_is_missing_not_bridged():
    t = at(1.0)
    kept = (t <= 30) | (t >= 60)
    channels, _ = aligned(
        {"current_A": Series(t[kept], np.ones(kept.sum())), "voltage_V": Series(t + 0.5, t)}, "x"
    )
    paused = (channels["time_s"] > 30) & (channels["time_s"] < 60)
    assert np.array_equal(np.isnan(channels["current_A"]), paused)


def test_rows_outside_the_current_are_left_out_and_told():
    t = at(1.0)
    channels, notices = aligned(
        {"current_A": Series(t[20:81], t[20:81]), "voltage_V": Series(t, t)}, "x"
    )
    assert channels["time_s"][0] == 20
    assert channels["time_s"][-1] == 80
    assert any("40 row(s)" in n for n in notices)


def test_stamps_out_of_order_and_repeated():
    t = np.array([0.0, 2.0, 1.0, 3.0, 3.0])
    channels, _ = aligned(
        {
            "current_A": Series(t, np.array([0.0, 2.0, 1.0, 9.0, 3.0])),
            "voltage_V": Series(at(0.5, 3.0), at(0.5, 3.0)),
        },
        "x",
    )
    np.testing.assert_allclose(channels["current_A"], at(0.5, 3.0))


def test_channels_without_a_common_time_are_refused():
    with pytest.raises(InputError, match="voltage from 200"):
        aligned(
            {
                "current_A": Series(at(1.0), at(1.0)),
                "voltage_V": Series(at(1.0, 300.0, 200.0), at(1.0, 300.0, 200.0)),
            },
            "x",
        )


def decoded(message, frames):
    found = [frame_values(message, data) for data in frames]
    return physical_values(message.get_signal_by_name("X"), found)


def test_of_a_multiplexed_message_only_the_frames_that_hold_the_signal():
    text = (
        'VERSION ""\n\nBU_: A\n\nBO_ 1 M: 3 A\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ X m1 : 8|16@1+ (0.1,0) [0|0] "V" A\n SG_ Y m2 : 8|16@1+ (1,0) [0|0] "A" A\n'
    )
    cantools = pytest.importorskip("cantools")
    message = cantools.database.load_string(text).messages[0]
    frames = [
        message.encode({"Which": 1, "X": 4.1}),
        message.encode({"Which": 2, "Y": 7}),
        message.encode({"Which": 1, "X": 4.2}),
    ]
    values, whole = decoded(message, frames)
    np.testing.assert_allclose(values, [4.1, 4.2])
    assert whole.tolist() == [True, False, True]


def test_frames_that_are_too_short_are_left_out():
    text = 'VERSION ""\n\nBU_: A\n\nBO_ 1 M: 2 A\n SG_ X : 0|16@1+ (1,0) [0|0] "V" A\n'
    cantools = pytest.importorskip("cantools")
    message = cantools.database.load_string(text).messages[0]
    values, whole = decoded(message, [b"\x01\x00", b"\x01", b"\x02\x00\x00"])
    assert values.tolist() == [1.0, 2.0]
    assert whole.tolist() == [True, False, True]

"""Channels of different clocks on one, signals of frames: nothing is bridged or invented."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs.formats.can import FrameDecoder
from cellwise.logs.formats.vehicle_signals import Series, aligned
from cellwise.notices import Code, coded


def at(step, until=100.0, start=0.0):
    return np.arange(start, until + 1e-9, step)


def brought(current, voltage):
    """Both as (times, values), on one clock."""
    return aligned({"current_A": Series(*current), "voltage_V": Series(*voltage)}, "x")


T = at(1.0)


def test_a_common_clock_changes_nothing():
    channels, notices = brought((T, np.sin(T)), (T, np.cos(T)))
    np.testing.assert_array_equal(channels["current_A"], np.sin(T))
    assert not notices


def test_a_faster_current_loses_no_charge():
    fast = at(0.01)
    current = 5 + 3 * np.sin(7.3 * fast)
    channels, notices = brought((fast, current), (T, np.ones(T.size)))
    charge = np.sum(channels["current_A"][1:] * np.diff(channels["time_s"]))
    assert charge == pytest.approx(np.trapezoid(current, fast), rel=1e-12)
    assert "averaged" in notices[0].text


def test_a_current_between_the_voltages_rows_is_interpolated():
    channels, notices = brought((T, 3 * T), (T[:-1] + 0.25, T[:-1]))
    np.testing.assert_allclose(channels["current_A"], 3 * (T[:-1] + 0.25))
    assert "interpolated" in notices[0].text


def test_a_pause_of_the_current_is_missing_not_bridged():
    kept = T[(T <= 30) | (T >= 60)]
    channels, _ = brought((kept, np.ones(kept.size)), (T + 0.5, T))
    paused = (channels["time_s"] > 30) & (channels["time_s"] < 60)
    assert np.array_equal(np.isnan(channels["current_A"]), paused)


def test_rows_outside_the_current_are_left_out_and_told():
    channels, notices = brought((T[20:81], T[20:81]), (T, T))
    assert channels["time_s"][[0, -1]].tolist() == [20, 80]
    (said,) = coded(notices, Code.ROWS_WITHOUT_CURRENT)
    assert "40 row(s)" in said.text


def test_stamps_out_of_order_and_repeated():
    disordered = [0.0, 2.0, 1.0, 3.0, 3.0], [0.0, 2.0, 1.0, 9.0, 3.0]
    channels, _ = brought(map(np.array, disordered), (at(0.5, 3.0), at(0.5, 3.0)))
    np.testing.assert_allclose(channels["current_A"], at(0.5, 3.0))


def test_channels_without_a_common_time_are_refused():
    with pytest.raises(InputError, match="voltage from 200"):
        brought((T, T), (T + 200.0, T))


def decoded(text, *frames):
    database = pytest.importorskip("cantools").database.load_string(text)
    frames = [
        data if isinstance(data, bytes) else database.messages[0].encode(data) for data in frames
    ]
    decoder = FrameDecoder(database, "x", {})
    return [[value for _, value in decoder.values((1, False), data)] for data in frames]


HEAD = 'VERSION ""\n\nBU_: A\n\n'


def test_of_a_multiplexed_message_only_the_frames_that_hold_the_signal():
    text = (
        HEAD + 'BO_ 1 M: 3 A\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ Pack_V m1 : 8|16@1+ (0.1,0) [0|0] "V" A\n SG_ Pack_A m2 : 8|16@1+ (1,0) [0|0] "A" A\n'
    )
    found = decoded(text, {"Which": 1, "Pack_V": 4.1}, {"Which": 2, "Pack_A": 7})
    assert found == [[pytest.approx(4.1)], [7.0]]


def test_frames_that_are_too_short_say_nothing():
    text = HEAD + (
        'BO_ 1 M: 4 A\n SG_ Pack_V : 0|16@1+ (1,0) [0|0] "V" A\n'
        ' SG_ Pack_A : 16|16@1+ (1,0) [0|0] "A" A\n'
    )
    assert decoded(text, b"\x01\x00\x02\x00", b"\x01", b"\2\0\3\0\0") == [[2, 1], [], [3, 2]]

"""Signals of many frames at once, against cantools frame by frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwise.logs.formats.vehicle_signals import physical_values

cantools = pytest.importorskip("cantools")


def database(signal: str, length: int = 8):
    return cantools.database.load_string(
        f'VERSION ""\n\nBU_: A\n\nBO_ 1 M: {length} A\n SG_ X : {signal} "V" A\n'
    ).messages[0]


def motorola_start(msb: int) -> int:
    """Start bit in DBC numbering of the bit that is ``msb`` places after the frame's first."""
    return 8 * (msb // 8) + 7 - msb % 8


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 63),
    st.integers(1, 64),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_every_signal_that_fits_is_decoded_as_by_cantools(first, length, intel, signed, seed):
    length = min(length, 64 - first)
    start = first if intel else motorola_start(first)
    message = database(f"{start}|{length}@{int(intel)}{'-' if signed else '+'} (0.5,-3) [0|0]")
    frames = [bytes(f) for f in np.random.default_rng(seed).integers(0, 256, (5, 8), np.uint8)]
    values, whole = physical_values(message, "X", frames)
    expected = [message.decode(f, decode_choices=False)["X"] for f in frames]
    assert whole.all()
    np.testing.assert_allclose(values, np.array(expected, dtype=float), rtol=1e-12)


@pytest.mark.parametrize("intel", [True, False])
@pytest.mark.parametrize(("length", "kind"), [(32, 1), (64, 2)])
def test_signals_of_floating_point(intel, length, kind):
    start = 0 if intel else 7
    text = 'VERSION ""\n\nBU_: A\n\nBO_ 1 M: 8 A\n'
    text += f' SG_ X : {start}|{length}@{int(intel)}- (1,0) [0|0] "V" A\n'
    message = cantools.database.load_string(text + f"\nSIG_VALTYPE_ 1 X : {kind};\n").messages[0]
    frames = [message.encode({"X": x}) for x in (0.0, -3.25, 4.125e3)]
    np.testing.assert_array_equal(physical_values(message, "X", frames)[0], [0.0, -3.25, 4.125e3])


def test_of_a_multiplexed_message_only_the_frames_that_hold_the_signal():
    text = (
        'VERSION ""\n\nBU_: A\n\nBO_ 1 M: 3 A\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ X m1 : 8|16@1+ (0.1,0) [0|0] "V" A\n SG_ Y m2 : 8|16@1+ (1,0) [0|0] "A" A\n'
    )
    message = cantools.database.load_string(text).messages[0]
    frames = [
        message.encode({"Which": 1, "X": 4.1}),
        message.encode({"Which": 2, "Y": 7}),
        message.encode({"Which": 1, "X": 4.2}),
    ]
    values, whole = physical_values(message, "X", frames)
    np.testing.assert_allclose(values, [4.1, 4.2])
    assert whole.tolist() == [True, False, True]


def test_frames_that_are_too_short_are_left_out():
    message = database("0|16@1+ (1,0) [0|0]", length=2)
    values, whole = physical_values(message, "X", [b"\x01\x00", b"\x01", b"\x02\x00\x00"])
    assert values.tolist() == [1.0, 2.0]
    assert whole.tolist() == [True, False, True]

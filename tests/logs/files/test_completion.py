"""Pieces put together: restarts, unsigned currents, times of steps, packs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwise.errors import InputError
from cellwise.logs.files.assembly import accumulated, complete
from cellwise.logs.files.source import RawLog, ReadOptions
from cellwise.logs.packs.cells import to_cell
from log_files import pulse_channels

TRUTH = pulse_channels()


@given(st.lists(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8), min_size=1, max_size=6))
def test_a_counter_with_restarts_adds_up_to_what_moved(parts):
    """Whatever the parts: the joined counter ends at the sum of all that moved."""
    counter = np.concatenate([np.cumsum(part) for part in parts])
    total = sum(sum(part) for part in parts)
    # A part that begins where the one before ended is no restart that anybody could see.
    seen = all(b[0] < 0.5 * sum(a) for a, b in itertools.pairwise(parts))
    if seen:
        assert accumulated(counter)[-1] == pytest.approx(total)


def raw(**channels):
    return RawLog({name: np.asarray(values, dtype=float) for name, values in channels.items()})


@pytest.mark.parametrize("sign", ["charge-positive", "discharge-positive"])
def test_the_state_signs_a_current_in_the_formats_own_sign(sign):
    direction = np.sign(TRUTH["current_A"])
    done = complete(
        raw(
            time_s=TRUTH["time_s"],
            current_A=np.abs(TRUTH["current_A"]),
            voltage_V=TRUTH["voltage_V"],
            direction=direction,
        ),
        sign,
        "x",
    )
    factor = 1 if sign == "discharge-positive" else -1
    np.testing.assert_array_equal(done.channels["current_A"], factor * TRUTH["current_A"])


def test_a_sensors_zero_does_not_pass_for_a_sign():
    """A few negative milliamperes at rest leave a current unsigned."""
    current = np.abs(TRUTH["current_A"])
    rest = current == 0
    current[rest] = np.where(np.arange(rest.sum()) % 2, 1e-3, -1e-3)
    done = complete(
        raw(time_s=TRUTH["time_s"], current_A=current, direction=np.sign(TRUTH["current_A"])),
        "discharge-positive",
        "x",
    )
    loaded = TRUTH["current_A"] != 0
    np.testing.assert_array_equal(done.channels["current_A"][loaded], TRUTH["current_A"][loaded])


def test_neither_current_nor_counter_is_refused():
    with pytest.raises(InputError, match="neither a current nor a counter"):
        complete(raw(time_s=[0, 1], voltage_V=[3, 3]), "charge-positive", "x")


def test_a_pack_keeps_its_power_per_cell():
    """Power and energy of the pack are those of all its cells together."""
    pack = raw(current_A=[10.0], voltage_V=[40.0], charge_Ah=[3.0], temperature_C=[20.0])
    cell = to_cell(pack, ReadOptions(series=10, parallel=5), "x").channels
    power = cell["current_A"] * cell["voltage_V"]
    assert power[0] * 10 * 5 == pytest.approx(400.0)
    assert cell["charge_Ah"][0] * 5 == pytest.approx(3.0)
    assert cell["temperature_C"][0] == 20.0

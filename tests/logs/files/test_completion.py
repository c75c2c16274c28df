"""Pieces put together: restarts, unsigned currents, times of steps, packs."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs.files.assembly import complete
from cellwise.logs.files.source import RawLog
from log_files import pulse_channels

TRUTH = pulse_channels()


def raw(**channels):
    return RawLog({name: np.asarray(values, dtype=float) for name, values in channels.items()})


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

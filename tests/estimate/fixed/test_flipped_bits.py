"""Memory that lost a bit: whatever stands in the state, the SOC's variance is one."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.estimate.fixed.layout import INPUT
from cellwise.estimate.fixed.stepper import numba_stepper, start_state
from cellwise.export.firmware import HostLibrary
from firmware_cases import tables_of

CASES = ("lean", "full")


def samples(first, count):
    """A load with rests that goes on from one sample to the next."""
    k = np.arange(first, first + count)
    found = np.zeros(count, dtype=INPUT)
    found["current_A"] = np.where(k % 20 < 12, 3.0, 0.0)
    found["voltage_V"] = 3.7 - 0.05 * np.where(k % 20 < 12, 1.0, 0.0) + 0.001 * (k % 3)
    found["temperature_C"] = 25.0
    found["sequence"] = k
    return found


def compiled_c(tables):
    """The C of this machine's compiler; None without one."""
    try:
        return HostLibrary(tables)
    except Exception:
        return None


def flipped(state):
    """The state with each of its bits flipped, and with pairs of bits of different words."""
    words = state.view(np.uint32)
    for word in range(words.size):
        for bit in range(32):
            changed = words.copy()
            changed[word] ^= np.uint32(1 << bit)
            yield changed.view(state.dtype)
    rng = np.random.default_rng(16)
    for _ in range(500):
        changed = words.copy()
        for word in rng.choice(words.size, 3, replace=False):
            changed[word] ^= np.uint32(1 << int(rng.integers(32)))
        yield changed.view(state.dtype)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("ran", [7, 400], ids=["early", "settled"])
def test_soc_variance_is_never_negative_after_flipped_bits(case, ran):
    """Whatever bit a stored state has lost; Python and C give the same bits."""
    tables = tables_of(case)
    python, c = numba_stepper(tables), compiled_c(tables)
    state = start_state(python, 0.6, 0.1)
    python.rows(state, samples(0, ran))
    after = samples(ran, 6)
    for one in flipped(state):
        twin = one.copy()
        out = python.rows(one, after)
        assert np.all(np.isfinite(out["soc_variance"]))
        assert np.all(out["soc_variance"] >= 0.0)
        assert np.all((out["soc"] >= 0.0) & (out["soc"] <= 1.0))
        if c is not None:
            assert c.rows(twin, after).tobytes() == out.tobytes()
            assert twin.tobytes() == one.tobytes()

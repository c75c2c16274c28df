"""A rest whose past nobody saw: the stated deviation holds the truth, whatever the past was."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.initial_soc.rest import (
    RELAXED_S,
    Branches,
    PastLoad,
    rested_ocv,
    usual_load,
)

BRANCHES = Branches(np.array([0.010, 0.015, 0.015]), np.array([2.0, 60.0, 1500.0]))
OCV_V, NOISE_V = 3.7, 0.001


def rest(lasted_s, branch_A, rng):
    """Readings every second of a rest that begins with what these currents have left."""
    t = np.arange(lasted_s + 1.0)
    held = BRANCHES.r_ohm * branch_A
    v = OCV_V - np.exp(-t[:, None] / BRANCHES.tau_s) @ held
    return t, v + NOISE_V * rng.standard_normal(t.size)


@pytest.mark.parametrize("lasted_s", [1, 10, 100, 1000])
def test_pasts_like_the_log_are_inside_two_deviations(lasted_s):
    rng = np.random.default_rng(lasted_s)
    load = PastLoad(1.5, np.array([4.0, 2.5, 1.5]))
    sizes = []
    for _ in range(150):
        past = np.zeros(3)
        if rng.random() < 0.5:  # else it has rested
            past = rng.normal(0.75, 1.5) + rng.normal(0.0, [3.7, 2.0, 1.5])
        found = rested_ocv(*rest(lasted_s, past, rng), NOISE_V, BRANCHES, load)
        sizes.append((found.ocv_V - OCV_V) / found.std_V)
    assert np.mean(np.abs(sizes) < 2.0) > 0.9
    if lasted_s < RELAXED_S / 4.0:  # later it is what no branch of a model knows
        assert np.sqrt(np.mean(np.square(sizes))) > 0.4, "wider than the pasts are"


def test_a_moment_without_current_is_as_unsure_as_what_a_load_leaves():
    rng = np.random.default_rng(1)
    load = PastLoad(3.0, np.full(3, 3.0))
    moment = rested_ocv(*rest(1, np.full(3, 3.0), rng), NOISE_V, BRANCHES, load)
    assert moment.std_V > 0.3 * float(np.sum(BRANCHES.r_ohm)) * 3.0
    hours = rested_ocv(*rest(10_000, np.full(3, 3.0), rng), NOISE_V, BRANCHES, load)
    assert hours.std_V < 0.003
    assert hours.ocv_V == pytest.approx(OCV_V, abs=0.003)


def test_a_usual_load_is_what_each_branch_sees_of_it():
    n = 7200
    current = np.where(np.arange(n) // 10 % 2 == 0, 4.0, 0.0)  # 10 s on, 10 s off
    load = usual_load(np.ones(n), current, BRANCHES.tau_s, 1.0)
    assert load.mean_A == pytest.approx(2.0, rel=0.01)
    assert load.rms_A[0] == pytest.approx(np.sqrt(8.0), rel=0.1)
    assert load.rms_A[2] == pytest.approx(2.0, rel=0.05)

"""The peers of the speed tables do the same job as ours: then only is their time a comparison."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.example_cell import START_SOC, load_log, two_branches
from benchmarks.speed import simulation_references as peers

from cellwise.cell.simulate import simulate


@pytest.fixture(scope="module")
def log():
    return load_log(300)


@pytest.fixture(scope="module")
def ours(log):
    return simulate(two_branches(), log, START_SOC).voltage_V


def test_load_stays_within_the_cell():
    log = load_log()
    soc = START_SOC - np.cumsum(log.current_A) / 3600.0 / two_branches().capacity_Ah
    assert soc.min() > 0.05
    assert soc[-1] < 0.3


def test_plain_loop_is_ours_to_rounding(log, ours):
    theirs, _ = peers.plain_loop(two_branches(), log, START_SOC)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-12)


def test_thevenin_package_agrees(log, ours):
    pytest.importorskip("thevenin", reason="pip install thevenin")
    theirs, seconds = peers.thevenin_prediction(two_branches(), log, START_SOC)
    np.testing.assert_allclose(theirs[1:], ours[1:], rtol=0, atol=2e-5)
    assert seconds > 0.0


@pytest.mark.slow
def test_pybamm_agrees_within_its_linear_current(log, ours):
    pytest.importorskip("pybamm", reason="pip install pybamm")
    theirs, _ = peers.pybamm_thevenin(two_branches(), log, START_SOC)
    assert np.sqrt(np.mean((theirs - ours)[1:] ** 2)) < 3e-3

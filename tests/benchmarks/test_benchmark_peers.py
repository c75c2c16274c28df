"""The peers of the speed tables do the same job as ours: then only is their time a comparison."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.example_cell import START_SOC, load_log, two_branches
from benchmarks.speed import simulation_references as peers
from benchmarks.speed.pulse_references import ScipyPulse
from benchmarks.speed.synthetic_truth import relative_error

from cellwise.cell.simulate import simulate
from cellwise.identify.pulse_fit.fit_pulse import fit_pulse
from cellwise.identify.pulse_fit.pulse_data import PulseData


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


TRUE = {"r0": 0.02, "r1": 0.01, "tau1": 3.0, "r2": 0.015, "tau2": 50.0}


def one_pulse():
    """A 60 s pulse at 10 Hz and its relaxation, in closed form, 0.2 mV noise."""
    time = np.arange(0.0, 600.0, 0.1)
    start, stop = 101, 701
    current = np.zeros(time.size)
    current[start:stop] = 3.0
    on = np.clip(time - time[start - 1], 0.0, time[stop - 1] - time[start - 1])
    off = np.clip(time - time[stop - 1], 0.0, None)
    charge = 3.0 * on / 3600.0
    v1 = TRUE["r1"] * (1 - np.exp(-on / TRUE["tau1"])) * np.exp(-off / TRUE["tau1"])
    v2 = TRUE["r2"] * (1 - np.exp(-on / TRUE["tau2"])) * np.exp(-off / TRUE["tau2"])
    voltage = 3.7 - 0.6 * charge / 3.0 - TRUE["r0"] * current - 3.0 * (v1 + v2)
    noise = 2e-4 * np.random.default_rng(3).standard_normal(time.size)
    return PulseData(time, current, voltage + noise, charge, start, stop, 3.0, 0.6)


@pytest.mark.parametrize("optimiser", ["lm", "trf", "curve_fit"])
def test_scipy_finds_the_truth(optimiser):
    found = ScipyPulse(one_pulse()).fit(optimiser)
    np.testing.assert_allclose(found[2:], list(TRUE.values()), rtol=0.05)


@pytest.mark.slow
def test_scipy_and_varpro_share_the_optimum():
    pulse = one_pulse()
    peer = ScipyPulse(pulse)
    assert fit_pulse(pulse).rmse_V == pytest.approx(peer.rmse_V(peer.fit("trf")), rel=0.005)


def test_relative_error_is_signed():
    class Cell:
        @staticmethod
        def r0_ohm(soc):
            return 0.02 + 0.01 * soc

    assert relative_error(Cell, "r0_ohm", 1.0, 0.033) == pytest.approx(0.1)

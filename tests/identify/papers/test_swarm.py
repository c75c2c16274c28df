"""Swarm: the paper's settings, found to work where they can, and measured against varpro."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.papers.swarm import BOX, SWARM, fit_swarm
from cellwise.identify.pulse_fit.fit_pulse import fit_varpro
from closed_form import Circuit, closed_pulse, random_circuit, stamps


def test_defaults_are_the_papers():
    assert tuple(SWARM) == (64, 8, 180, 4.1)
    assert BOX.slowest_s == 120.0


def test_comes_close_to_the_optimum_with_five_free_parameters():
    """Residual within 10 % of the noise on half of the pulses: a random search, not a minimiser."""
    rng = np.random.default_rng(1)
    ratio = []
    for seed in range(15):
        tau1, tau2 = rng.uniform(3.0, 8.0), rng.uniform(50.0, 100.0)
        circuit = replace(random_circuit(rng), slope=0.0, tau1=tau1, tau2=tau2)
        t = stamps(pulse_hz=5.0, rest_s=300.0)
        # Quiet before the pulse: the OCV is not free, its error would be no fault of the swarm.
        noise = np.where(t > 0.0, 1e-3 * rng.standard_normal(t.size), 0.0)
        data = closed_pulse(circuit, t, 40.0, noise=noise)
        fit = fit_swarm(data, rng=np.random.default_rng(seed))
        ratio.append(fit.rmse_V / 1e-3)
        assert fit.r0_ohm == pytest.approx(circuit.r0, rel=0.5)
    assert np.median(ratio) < 1.1


@pytest.mark.slow
def test_never_a_better_fit_than_varpro():
    rng = np.random.default_rng(6)
    for _ in range(6):
        t = stamps(rng, jitter=0.3, pulse_hz=4.0)
        current = float(rng.choice([-60.0, 60.0]))
        data = closed_pulse(
            random_circuit(rng), t, current, noise=5e-4 * rng.standard_normal(t.size)
        )
        swarm = fit_swarm(data, 120, rng)
        assert fit_varpro(data).rmse_V <= swarm.rmse_V


def test_bounds_and_the_ocv_before_the_pulse():
    data = closed_pulse(Circuit(slope=0.0), stamps(pulse_hz=5.0), 40.0)
    fit = fit_swarm(data)
    assert 0.5 <= fit.tau1_s <= 15.0
    assert 15.0 <= fit.tau2_s <= 120.0 + 1e-9
    assert fit.ocv_V == pytest.approx(data.voltage_V[data.start - 1], abs=1e-9)

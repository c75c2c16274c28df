"""Steps of incremental OCV tests and noisy chargers: found whole, in the right role."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.logs import read_log
from rich_cell import Logger, gitt, rich_nmc, run

CELL = rich_nmc(3.0)


@pytest.mark.parametrize("period_s", [1.0, 10.0])
@pytest.mark.parametrize("seed", range(6))
def test_every_step_of_an_incremental_test_is_one_load(seed, period_s):
    # Noise of the size of the resolution once cut a step in two, and one half was "the" pulse.
    steps = gitt(CELL, rest_s=1800.0)
    log = run(CELL, steps, 1.0, Logger(period_s), seed=seed).log
    found = find_pulses(log)
    assert len(found) == 10
    assert {p.role for p in found} == {"move"}
    np.testing.assert_allclose([p.duration_s for p in found], 720.0, atol=period_s)
    assert len(pulses_to_fit(found)) >= 7


@pytest.mark.parametrize("soc0", [0.98, 0.96])
def test_a_last_step_that_the_limit_cut_is_no_short_pulse(soc0):
    log = run(CELL, gitt(CELL, rest_s=3600.0), soc0, Logger(1.0), seed=3).log
    found = find_pulses(log)
    assert found[-1].duration_s < 700.0
    assert found[-1].role == "move"
    assert found[-1].quality != "healthy"
    assert len(pulses_to_fit(found)) >= 7


def test_a_single_pulse_among_steps_does_not_stand_for_all():
    steps = [(0.0, 1800.0), (3.0, 10.0), (0.0, 600.0), *gitt(CELL)[1:]]
    found = find_pulses(run(CELL, steps, 1.0, Logger(1.0)).log)
    assert [p.role for p in found].count("pulse") == 1
    assert len(pulses_to_fit(found)) >= 7


def noisy_charger_log(seed, noise_A=0.02):
    """1C out by a quiet load, a tenth of it back by a noisy charger, 5 % at C/3; 1 Hz."""
    one = [(3.0, 10.0), (0.0, 180.0), (-0.3, 100.0), (0.0, 180.0), (1.0, 540.0), (0.0, 1800.0)]
    log = run(CELL, [(0.0, 600.0), *(one * 8)], 0.9, Logger(1.0), seed=seed).log
    rng = np.random.default_rng(100 + seed)
    charging = log.current_A < -0.1
    current = log.current_A + noise_A * charging * rng.standard_normal(len(log))
    return replace(log, current_A=np.round(current, 3))


@pytest.mark.parametrize("seed", range(4))
def test_a_charger_may_be_noisier_than_the_load(seed):
    found = find_pulses(noisy_charger_log(seed))
    short = [p for p in found if p.role == "pulse"]
    assert len(short) == 16, "what a weak current gives back is a pulse, too"
    assert {p.quality for p in short} == {"healthy"}
    assert [p.current_A > 0.0 for p in short] == [True, False] * 8
    charges = [p.duration_s for p in short if p.current_A < 0.0]
    np.testing.assert_allclose(charges, 100.0, atol=2.0)


@pytest.mark.parametrize("name", ["1c_p20", "1c_p30", "1c_p40", "2c_p20", "2c_p30", "2c_p40"])
def test_measured_pulses_at_1_hz(real_data, name):
    """19 or 20 levels, each a pulse and what gives it back; the emptiest ones bend."""
    log = read_log(real_data / f"samsung_30q_ageing/hppc_dnn01_{name}_time_rebuilt.csv.gz")
    short = [p for p in find_pulses(log) if p.role == "pulse"]
    assert 32 <= len(short) <= 40
    healthy = [p for p in short if p.quality == "healthy"]
    assert len(healthy) >= 30
    for sign, seconds in ((1.0, 10.0), (-1.0, 101.0)):
        chosen = [p.duration_s for p in healthy if sign * p.current_A > 0.0]
        assert len(chosen) >= 14
        assert np.median(chosen) == pytest.approx(seconds, abs=1.0)

"""The paper's edge detector against switches whose row is known; the noise of a current."""

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.hppc.plateaus import current_scale, find_plateaus
from cellwise.identify.papers.signals import (
    EMA_FAST_S,
    EMA_SLOW_S,
    ema_edges,
)
from synthetic import HppcPlan, hppc_log, nmc_cell

ONE_C = 3.0
PLANS = {
    "10 Hz": {},
    "1 Hz": {"pulse_hz": 1.0},
    "135 Hz": {"pulse_hz": 135.0, "noise_A": 0.001 * ONE_C},
    "135 Hz throughout": {
        "pulse_hz": 135.0, "rest_hz": 135.0, "move_hz": 135.0, "rest_s": 20.0,
        "level_rest_s": 20.0, "move_rate_c": 3.0, "noise_A": 0.002 * ONE_C, "levels": (0.9, 0.8),
    },
    "60 s rows between": {"rest_hz": 1 / 60, "move_hz": 1 / 60, "level_rest_s": 3600.0},
    "jitter": {"jitter": 0.4, "noise_A": 0.001 * ONE_C},
    "first row an average": {"aligned": False, "rest_hz": 10.0, "move_hz": 10.0, "jitter": 0.2},
    "first row an average, 1 Hz": {"aligned": False, "pulse_hz": 1.0, "noise_A": 0.001 * ONE_C},
    "ramp of five rows": {"ramp_s": 0.5, "jitter": 0.3, "noise_A": 0.001 * ONE_C},
    "ramp of 27 rows": {"ramp_s": 0.2, "pulse_hz": 135.0},
    "noise of 1 %": {"noise_A": 0.01 * ONE_C},
    "noise of 5 %": {"noise_A": 0.05 * ONE_C},
    "resolution of 0.5 %": {"resolution_A": 0.03, "noise_A": 0.01},
    "charge first": {"order": "charge"},
    "from empty": {"levels": (0.1, 0.5, 0.9)},
}  # fmt: skip


def made(**changes):
    return hppc_log(nmc_cell(ONE_C), HppcPlan(**{"limit": "none", **changes}))


def switches(log):
    rows = sorted({row for p in log.pulses for row in (p.start, p.stop)})
    return [row for row in rows if 1 < row < len(log.log) - 1]


@pytest.mark.parametrize("name", ["10 Hz", "1 Hz", "60 s rows between", "jitter"])
def test_the_papers_detector_finds_the_same_steps_at_any_rate(name):
    log = made(**PLANS[name])
    found = [e.row for e in ema_edges(log.log.current_A, log.log.time_s)]
    assert found == switches(log)


def test_the_weights_are_the_papers_at_135_hz():
    assert -np.expm1(-1.0 / 135.0 / EMA_FAST_S) == pytest.approx(0.1, rel=1e-12)
    assert -np.expm1(-1.0 / 135.0 / EMA_SLOW_S) == pytest.approx(0.02, rel=1e-12)


def test_the_papers_detector_is_the_papers_recursion():
    rng = np.random.default_rng(3)
    current = np.repeat(rng.choice([0.0, 20.0, -40.0, 80.0, -120.0], 40), 1350)
    current = current + rng.normal(0.0, 0.02, current.size)
    t = np.arange(current.size) / 135.0
    fast = slow = current[0]
    above = []
    for i in current:
        fast += 0.1 * (i - fast)
        slow += 0.02 * (i - slow)
        above.append(abs(fast - slow) > 0.5 and np.sign(fast - slow))
    expected = [k for k in range(1, len(above)) if above[k] and above[k] != above[k - 1]]
    assert [e.row for e in ema_edges(current, t, threshold_A=0.5)] == expected


@pytest.mark.parametrize("sigma", [0.0, 0.01, 1.0])
def test_noise_alone_has_no_edges(sigma):
    x = np.random.default_rng(4).normal(0.0, sigma, 100_000)
    t = np.arange(x.size) * 0.1
    assert ema_edges(x, t) == ()


@pytest.mark.parametrize("sigma", [0.003, 0.03, 0.3])
def test_the_noise_is_measured_through_steps_and_rests(sigma):
    log = made(noise_A=sigma)
    assert current_scale(log.log.current_A).noise_A == pytest.approx(sigma, rel=0.15)


def test_an_offset_of_the_sensor_is_a_rest():
    log = made()
    plateaus = find_plateaus(log.log.current_A + 0.01)
    truth = [p.current_A != 0.0 for p in log.pulses]
    assert np.count_nonzero(~plateaus.rest) == len(truth)


def test_refuses_what_is_not_finite_or_not_of_one_length():
    with pytest.raises(InputError):
        ema_edges(np.array([0.0, np.nan, 1.0]), np.arange(3.0))
    with pytest.raises(InputError):
        ema_edges(np.zeros(3), np.arange(4.0))

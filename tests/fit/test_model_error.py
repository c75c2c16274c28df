"""Model error from residuals: each part comes back from a residual that is made of it."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.model_error import SCALES_S, ModelError, in_bands, moved_part
from cellwise.fit.model_error import (
    ResidualLog,
    estimate_model_error,
)

R0_OHM = 0.025
SOC = np.linspace(0.1, 0.9, 9)


def ornstein_uhlenbeck(time_s, memory_s, std, rng):
    """Exact samples of an Ornstein-Uhlenbeck process at any times."""
    x = np.empty(time_s.size)
    x[0] = std * rng.standard_normal()
    for k, a in enumerate(np.exp(-np.diff(time_s) / memory_s), start=1):
        x[k] = a * x[k - 1] + std * np.sqrt(1.0 - a * a) * rng.standard_normal()
    return x


def residual_log(
    rng,
    seconds=40_000,
    *,
    slow_V=0.0,
    memory_s=300.0,
    white_V=0.0,
    share=0.0,
    charge=None,
    warm=25.0,
    step_s=1.0,
):
    time = np.arange(0.0, seconds, step_s)
    current = 4.0 * np.sign(np.sin(time / 30.0)) * (np.sin(time / 700.0) > 0.0)
    residual = white_V * rng.standard_normal(time.size)
    if slow_V:
        residual = residual + ornstein_uhlenbeck(time, memory_s, slow_V, rng)
    wrong = np.where(current < 0.0, share if charge is None else charge, share)
    residual = residual + wrong * R0_OHM * current
    return ResidualLog(time, np.linspace(1.0, 0.0, time.size), R0_OHM * current, residual, warm)


def total_V(error, soc=SOC, temperature_C=None):
    return float(
        np.sqrt(
            np.mean(sum(error.variance_V2(k, soc, temperature_C) for k in range(len(SCALES_S))))
        )
    )


def test_the_bands_sum_up_and_each_holds_its_own():
    time = np.cumsum(np.random.default_rng(3).uniform(0.05, 0.15, 200_000))
    slow, fast = np.sin(2.0 * np.pi * time / 8000.0), np.sin(2.0 * np.pi * time / 30.0)
    bands = in_bands(time, slow + fast)
    np.testing.assert_allclose(bands.sum(axis=0), slow + fast, atol=1e-12)
    inner = slice(20_000, -20_000)
    size = np.sqrt(np.mean(bands[:, inner] ** 2, axis=1))
    assert size[4] == pytest.approx(np.sqrt(0.5), rel=0.15)
    assert size[2] == pytest.approx(np.sqrt(0.5), rel=0.25)
    assert size[0] < 0.05


@pytest.mark.parametrize(("memory_s", "band"), [(1.0, 1), (10.0, 2), (100.0, 3), (2000.0, 4)])
def test_a_process_lies_in_the_band_of_its_memory(memory_s, band):
    rng = np.random.default_rng(11)
    step_s = min(0.1 * memory_s, 2.0)
    logs = [
        residual_log(rng, 20_000, slow_V=0.006, memory_s=memory_s, step_s=step_s) for _ in range(4)
    ]
    found = estimate_model_error(logs)
    size = [float(np.sqrt(np.mean(found.variance_V2(k, SOC)))) for k in range(5)]
    assert int(np.argmax(size)) == band
    assert total_V(found) == pytest.approx(0.006, rel=0.35)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_what_follows_the_polarisation_is_a_share_of_it(share):
    rng = np.random.default_rng(5)
    logs = [residual_log(rng, slow_V=0.002, white_V=0.0005, share=share) for _ in range(3)]
    found = estimate_model_error(logs)
    assert found.shown_share() == pytest.approx(share, rel=0.35)
    assert total_V(found) < 0.5 * share * R0_OHM * 4.0


def test_charge_has_a_share_of_its_own():
    rng = np.random.default_rng(6)
    logs = []
    for share, sign in ((0.05, 1.0), (0.25, -1.0)):
        for log in (residual_log(rng, slow_V=0.001) for _ in range(2)):
            drop = sign * np.abs(
                log.polarisation_V
            )  # one direction: a band longer than a pulse sees both
            logs.append(ResidualLog(log.time_s, log.soc, drop, log.residual_V + share * drop))
    found = estimate_model_error(logs)
    assert found.shown_share(-1.0) > 2.0 * found.shown_share(1.0)


def test_each_temperature_has_its_size():
    rng = np.random.default_rng(7)
    warm = [residual_log(rng, slow_V=0.004, warm=25.0 + 0.3 * k) for k in range(6)]
    cold = [residual_log(rng, slow_V=0.012, warm=-10.0 + 0.3 * k) for k in range(6)]
    found = estimate_model_error([*warm, *cold])
    assert found.temperature_C == pytest.approx((-9.25, 25.75))
    ratio = total_V(found, temperature_C=-10.0) / total_V(found, temperature_C=25.0)
    assert ratio == pytest.approx(3.0, rel=0.3)


def test_where_no_load_has_been_other_tests_count():
    rng = np.random.default_rng(8)
    log = residual_log(rng, slow_V=0.003)
    half = log.soc > 0.5
    upper = ResidualLog(
        *(getattr(log, n)[half] for n in ("time_s", "soc", "polarisation_V", "residual_V"))
    )
    other = residual_log(rng, slow_V=0.030)
    alone, both = estimate_model_error([upper]), estimate_model_error([upper], [other])
    assert total_V(both, 0.9) < 2.0 * total_V(alone, 0.9)
    assert total_V(both, 0.2) > 3.0 * total_V(alone, 0.2)


def test_rows_far_apart_resolve_no_fast_band():
    """A band that no log resolves is stated as large as the first that one does."""
    rng = np.random.default_rng(9)
    log = residual_log(rng, 200_000, slow_V=0.004, memory_s=1000.0, step_s=10.0)
    found = estimate_model_error([log])
    sizes = [float(found.variance_V2(k, 0.5)) for k in range(3)]
    assert sizes[0] == sizes[1] == sizes[2]


def test_a_few_wild_rows_do_not_matter():
    rng = np.random.default_rng(10)
    log = residual_log(rng, slow_V=0.003)
    calm = total_V(estimate_model_error([log]))
    log.residual_V[5000:5020] = 1.0
    assert total_V(estimate_model_error([log])) < 1.5 * calm


def test_what_persists_is_what_the_logs_cannot_have_shown():
    rng = np.random.default_rng(12)
    logs = [residual_log(rng, 4000, slow_V=0.003) for _ in range(3)]
    assert estimate_model_error(logs).persistent_share == pytest.approx(0.25)
    assert estimate_model_error(logs[:1]).persistent_share == pytest.approx(0.5)


def test_the_length_along_the_soc_is_found():
    rng = np.random.default_rng(13)
    time = np.arange(0.0, 20_000.0, 2.0)
    soc = np.linspace(1.0, 0.0, time.size)
    found = []
    for length in (0.02, 0.1):
        logs = [
            ResidualLog(time, soc, 0.0 * time, ornstein_uhlenbeck(-soc, length, 0.01, rng))
            for _ in range(12)
        ]
        found.append(estimate_model_error(logs).correlation_soc)
        assert found[-1] == pytest.approx(length, rel=0.5)
    assert estimate_model_error(logs[:1]).correlation_soc is None


def test_too_little_says_what_a_model_says_that_nobody_has_validated():
    few = ResidualLog(np.arange(5.0), np.full(5, 0.5), np.zeros(5), np.full(5, 0.01))
    assert estimate_model_error([]) == ModelError()
    assert estimate_model_error([few]) == ModelError()


def test_a_perfect_model_still_states_an_error():
    time = np.arange(0.0, 8000.0)
    perfect = ResidualLog(time, np.linspace(1, 0, 8000), np.zeros(8000), np.zeros(8000))
    found = estimate_model_error([perfect])
    assert 0.0 < total_V(found) < 1e-3


def test_unseen_shares_are_handed_on():
    log = residual_log(np.random.default_rng(14), slow_V=0.002, share=0.05)
    found = estimate_model_error([log], unseen=(0.2, 0.3))
    assert (found.unseen_share, found.unseen_charge_share) == (0.2, 0.3)
    assert found.whole_share() == pytest.approx(np.hypot(found.shown_share(), 0.2))


@pytest.mark.parametrize("memory_s", [1.0, 30.0, 300.0])
def test_what_is_new_of_an_error_after_its_mean_is_taken_off(memory_s):
    """Drawn by the second: a first-order process 10 s after a mean over 30 s of it."""
    rng = np.random.default_rng(5)
    keep = np.exp(-0.1 / memory_s)
    value = rng.normal(size=20_000)
    seen = np.zeros(20_000)
    for _ in range(300):
        seen += value / 300.0
        value = keep * value + np.sqrt(1.0 - keep * keep) * rng.normal(size=value.size)
    later_keep = np.exp(-10.0 / memory_s)
    later = later_keep * value + np.sqrt(1.0 - later_keep**2) * rng.normal(size=value.size)
    (part,) = moved_part(np.array([memory_s]), 10.0, 30.0)
    assert float(np.std(later - seen)) == pytest.approx(part, rel=0.03)


def test_each_process_of_an_error_moves_by_its_own_memory():
    error = ModelError(
        scales_s=(1.0, 1000.0), std_V=(((0.004,),), ((0.010,),)), share=(0.01, 0.05),
        charge_share=(0.02, 0.06), unseen_share=0.2, unseen_charge_share=0.3,
    )  # fmt: skip
    quick, slow = moved_part(np.array([1.0, 1000.0]), 10.0, 30.0)
    moved = error.moved(10.0, 30.0)
    np.testing.assert_allclose(np.ravel(moved.std_V), [quick * 0.004, slow * 0.010])
    np.testing.assert_allclose(moved.shares(), [quick * 0.01, slow * 0.05])
    np.testing.assert_allclose(moved.shares(-1.0), [quick * 0.02, slow * 0.06])
    assert moved.hidden_share() == pytest.approx(slow * 0.2)
    assert moved.hidden_share(-1.0) == pytest.approx(slow * 0.3)

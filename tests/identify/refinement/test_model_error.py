"""Model error from residuals: each part comes back from a residual that is made of it."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.model import ModelError
from cellwise.identify.refinement.model_error import (
    OPTIMISM,
    ResidualLog,
    correlation_time,
    estimate_model_error,
)

R0_OHM = 0.025


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
):
    time = np.arange(0.0, seconds, 2.0)
    current = 4.0 * np.sign(np.sin(time / 30.0)) * (np.sin(time / 700.0) > 0.0)
    residual = white_V * rng.standard_normal(time.size)
    if slow_V:
        residual = residual + ornstein_uhlenbeck(time, memory_s, slow_V, rng)
    wrong = np.where(current < 0.0, share if charge is None else charge, share)
    residual = residual + wrong * R0_OHM * current
    return ResidualLog(time, np.linspace(1.0, 0.0, time.size), R0_OHM * current, residual, warm)


@pytest.mark.parametrize("memory_s", [60.0, 300.0, 900.0])
def test_correlation_time_of_an_ornstein_uhlenbeck_process(memory_s):
    # The area under exp(-t / tau) is tau.
    rng = np.random.default_rng(int(memory_s))
    time = np.arange(0.0, 1500.0 * memory_s, memory_s / 15.0)
    found = correlation_time(time, ornstein_uhlenbeck(time, memory_s, 0.01, rng))
    assert found == pytest.approx(memory_s, rel=0.25)


def test_correlation_time_does_not_depend_on_scale_or_on_the_rows():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 200_000.0, 10.0)
    x = ornstein_uhlenbeck(time, 300.0, 1.0, rng)
    whole = correlation_time(time, x)
    assert correlation_time(time, 1e-3 * x) == pytest.approx(whole, rel=1e-9)
    some = np.sort(rng.choice(time.size, time.size // 2, replace=False))
    assert correlation_time(time[some], x[some]) == pytest.approx(whole, rel=0.15)


def test_what_stays_for_ever_is_remembered_longer_than_anything_else():
    time = np.arange(0.0, 20_000.0, 5.0)
    bias = correlation_time(time, np.full(time.size, 0.01))
    rng = np.random.default_rng(2)
    assert bias > 3.0 * correlation_time(time, ornstein_uhlenbeck(time, 100.0, 0.01, rng))


def test_correlation_time_of_little_or_nothing():
    assert correlation_time(np.arange(5.0), np.ones(5)) > 0.0
    assert correlation_time(np.arange(0.0, 9000.0, 5.0), np.zeros(1800)) > 0.0


def test_slow_error_memory_and_white_noise_come_back():
    rng = np.random.default_rng(3)
    logs = [residual_log(rng, slow_V=0.008, white_V=0.001) for _ in range(8)]
    found = estimate_model_error(logs)
    inner = np.array(found.slow_V)[3:-3]
    # A fit sees its own residuals too small: what is told is larger by the stated factor.
    assert np.sqrt(np.mean(inner**2)) == pytest.approx(OPTIMISM * 0.008, rel=0.1)
    assert found.white_V == pytest.approx(0.001, rel=0.35)
    assert found.correlation_s == pytest.approx(300.0, rel=0.3)
    assert found.resistance_share < 0.05


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_resistance_that_is_wrong_is_given_as_its_share(share):
    rng = np.random.default_rng(4)
    log = residual_log(rng, slow_V=0.002, white_V=0.0005, share=share)
    found = estimate_model_error([log])
    assert found.resistance_share == pytest.approx(share, rel=0.25)
    # What follows the current must not be counted again as slow error.
    followed = share * np.sqrt(np.mean(log.drop_V**2))
    assert np.median(found.slow_V) < 1.5 * OPTIMISM * np.hypot(0.002, 0.3 * followed)


def test_charge_and_discharge_may_be_wrong_by_different_shares():
    rng = np.random.default_rng(14)
    log = residual_log(rng, slow_V=0.002, white_V=0.0005, share=0.05, charge=0.2)
    found = estimate_model_error([log])
    assert found.share() == pytest.approx(0.05, rel=0.4)
    assert found.share(-1.0) == pytest.approx(0.2, rel=0.25)


def test_a_direction_that_no_log_has_is_as_the_other():
    rng = np.random.default_rng(15)
    log = residual_log(rng, slow_V=0.002, share=0.1)
    out = log.drop_V >= 0.0
    only = ResidualLog(log.time_s[out], log.soc[out], log.drop_V[out], log.residual_V[out])
    found = estimate_model_error([only])
    assert found.share(-1.0) == found.share() > 0.05


def test_a_temperature_at_which_the_model_is_worse_is_told_apart():
    rng = np.random.default_rng(16)
    warm = [residual_log(rng, slow_V=0.004, warm=25.0 + 0.3 * k) for k in range(8)]
    cold = [residual_log(rng, slow_V=0.012, warm=-10.0 + 0.3 * k) for k in range(8)]
    found = estimate_model_error([*warm, *cold])
    assert found.at(0.5, -10.0) > 2.0 * found.at(0.5, 25.0)
    assert np.sqrt(np.mean(found.at(np.linspace(0.1, 0.9, 9), -9.0) ** 2)) == pytest.approx(
        OPTIMISM * 0.012, rel=0.25
    )


def test_what_follows_a_large_polarisation_is_no_error_at_rest():
    # In the cold the polarisation is ten times as large, and its share the same.
    rng = np.random.default_rng(17)
    log = residual_log(rng, slow_V=0.004, share=0.05)
    cold = residual_log(rng, slow_V=0.004, share=0.5, warm=-20.0)
    cold.drop_V[:] *= 10.0
    found = estimate_model_error([log, cold])
    assert found.share() == pytest.approx(0.05, rel=0.3)
    assert found.at(0.5, -20.0) < 2.0 * found.at(0.5, 25.0)


def test_what_a_steep_ocv_does_towards_empty_is_no_share_of_a_polarisation_that_grows_there():
    rng = np.random.default_rng(18)
    log = residual_log(rng, slow_V=0.003, share=0.05)
    empty = log.soc < 0.1
    log.drop_V[empty] *= 4.0
    log.residual_V[empty] *= 20.0  # a SOC scale that is off by a point
    found = estimate_model_error([log])
    assert found.share() == pytest.approx(0.05, rel=0.4)
    assert found.at(0.5) < 2.0 * OPTIMISM * 0.003


def test_the_error_knows_where_on_the_soc_axis_it_is():
    rng = np.random.default_rng(5)
    log = residual_log(rng, slow_V=0.003)
    low = log.soc < 0.1
    log.residual_V[low] *= 10.0
    found = estimate_model_error([log])
    assert found.at(0.03) > 3.0 * found.at(0.5)


def test_where_no_log_has_been_the_error_is_larger_not_smaller():
    rng = np.random.default_rng(6)
    log = residual_log(rng, slow_V=0.005)
    upper = ResidualLog(log.time_s, 0.6 + 0.4 * log.soc, log.drop_V, log.residual_V)
    found = estimate_model_error([upper])
    assert found.at(0.0) > 1.3 * found.at(0.5)


def test_where_no_load_has_been_tests_of_another_kind_count():
    rng = np.random.default_rng(8)
    log = residual_log(rng, slow_V=0.005)
    upper = ResidualLog(log.time_s, 0.6 + 0.4 * log.soc, log.drop_V, log.residual_V)
    slow = residual_log(rng, slow_V=0.040)
    alone, both = estimate_model_error([upper]), estimate_model_error([upper], [slow])
    low = np.linspace(0.1, 0.5, 9)
    assert np.sqrt(np.mean(both.at(low) ** 2)) == pytest.approx(OPTIMISM * 0.040, rel=0.3)
    assert both.at(0.8) == pytest.approx(alone.at(0.8))
    assert both.correlation_s == alone.correlation_s


def test_what_no_load_has_shown_joins_the_share_that_is_seen():
    rng = np.random.default_rng(9)
    log = residual_log(rng, slow_V=0.002, white_V=0.0005, share=0.05)
    seen, joined = estimate_model_error([log]), estimate_model_error([log], unseen=(0.2, 0.3))
    assert joined.share() == pytest.approx(np.hypot(seen.share(), 0.2))
    assert joined.share(-1.0) == pytest.approx(np.hypot(seen.share(-1.0), 0.3))
    assert joined.slow_V == seen.slow_V


def test_a_few_wild_rows_do_not_make_noise_of_everything():
    rng = np.random.default_rng(7)
    calm = estimate_model_error([residual_log(np.random.default_rng(7), white_V=0.001)])
    log = residual_log(rng, white_V=0.001)
    log.residual_V[rng.choice(log.residual_V.size, 20, replace=False)] += 0.5
    wild = estimate_model_error([log])
    assert wild.white_V == pytest.approx(calm.white_V, rel=0.05)
    assert wild.resistance_share < 0.2


def test_a_long_log_counts_more_than_a_short_one():
    rng = np.random.default_rng(8)
    long = residual_log(rng, 80_000, slow_V=0.002, memory_s=200.0)
    short = residual_log(rng, 2_000, slow_V=0.002, memory_s=5.0)
    both = estimate_model_error([long, short]).correlation_s
    assert both == pytest.approx(estimate_model_error([long]).correlation_s, rel=0.1)


def test_without_residuals_the_default_holds():
    few = ResidualLog(np.arange(5.0), np.ones(5), np.zeros(5), np.zeros(5))
    assert estimate_model_error([]) == ModelError()
    assert estimate_model_error([few]) == ModelError()


def test_a_perfect_fit_still_claims_some_error():
    # A filter with no noise at all would trust a model without limit.
    time = np.arange(0.0, 4000.0)
    zero = np.zeros(time.size)
    perfect = ResidualLog(time, np.linspace(1.0, 0.0, time.size), zero, zero)
    found = estimate_model_error([perfect])
    assert found.white_V > 0.0
    assert min(found.slow_V) > 0.0
    assert found.correlation_s > 0.0


def along_soc(rng, length, warm=25.0, hours=1.0):
    """A residual that is an Ornstein-Uhlenbeck process of SOC, discharged within some hours."""
    time = np.linspace(0.0, 3600.0 * hours, 4000)
    soc = np.linspace(1.0, 0.0, time.size)
    residual = ornstein_uhlenbeck(1.0 - soc, length, 0.01, rng)
    return ResidualLog(time, soc, np.zeros(time.size), residual, warm)


def test_the_length_along_the_soc_does_not_depend_on_the_pace():
    rng = np.random.default_rng(19)
    fast = [along_soc(rng, 0.01) for _ in range(40)]
    slow = [along_soc(rng, 0.01, hours=20.0) for _ in range(40)]
    lengths = [estimate_model_error(logs).correlation_soc for logs in (fast, slow)]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.25)
    assert 0.01 / 1.5 < lengths[0] < 0.01 * 1.5
    quick, long = (estimate_model_error(logs).correlation_s for logs in (fast, slow))
    assert long > 5.0 * quick


def test_few_logs_of_a_temperature_hide_the_long_part_from_a_fit():
    rng = np.random.default_rng(20)
    many = [along_soc(rng, 0.01) for _ in range(12)]
    spread = [log.__class__(log.time_s, log.soc, log.drop_V, log.residual_V, 10.0 * (k % 6))
              for k, log in enumerate(many)]  # fmt: skip
    one, each = (estimate_model_error(logs).correlation_soc for logs in (many, spread))
    assert each == pytest.approx(3.0 * 11.0 / 13.0 * one, rel=0.1)
    assert estimate_model_error(many[:1]).correlation_soc is None

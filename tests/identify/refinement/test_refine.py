"""Refinement: a known truth comes back, bounds hold, standard errors say what scatter shows.

The truth is simulated here in plain NumPy and Python, row by row: nothing of the package's kernels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.fitted_pulses import Group
from cellwise.identify.identification import TestLogs
from cellwise.identify.refinement.joint_fit import rough_resistance
from cellwise.identify.refinement.layout import LEAST_RATIO, RefineSettings
from cellwise.identify.refinement.problem import independent_samples
from cellwise.identify.refinement.refine import RefineResult, refine
from cellwise.identify.refinement.refine_data import RefineLog
from cellwise.identify.refinement.splines import (
    OCV_KNOTS,
    TABLE_KNOTS,
    spline_rows,
    spline_values,
)
from cellwise.logs.cell_log import CellLog
from refine_cases import (
    CAPACITY_AH,
    CURVED,
    KNOTS,
    Truth,
    _branch,
    constant,
    log_of,
    ocv,
    pulse_current,
    start_tables,
    two_logs,
)
from synthetic import drive_current


def table(result: RefineResult, at: int, soc) -> np.ndarray:
    rows = spline_rows(np.asarray(soc, dtype=float), TABLE_KNOTS)
    return np.exp(spline_values(rows, result.theta[at : at + result.layout.knots]))


def errors(result: RefineResult, truth: Truth, soc) -> dict[str, float]:
    """Largest relative error of each table over the given SOC."""
    lay = result.layout
    found = {"r0": np.abs(table(result, lay.r0, soc) / truth.r0(soc) - 1.0).max()}
    for j, (r, tau) in enumerate(truth.pairs):
        found[f"r{j + 1}"] = np.abs(table(result, lay.r(j), soc) / r(soc) - 1.0).max()
        found[f"tau{j + 1}"] = np.abs(table(result, lay.tau(j), soc) / tau(soc) - 1.0).max()
    return found


INSIDE = np.linspace(0.2, 0.95, 40)


def fit(truth, *, noise=0.0, branches=2, factor=1.0, warm=False, **settings):
    hysteresis = bool(truth.m_V)
    return refine(
        two_logs(truth, noise=noise, warm=warm),
        start_tables(branches, factor, 0.005 if hysteresis else None),
        settings=RefineSettings(branches=branches, hysteresis=hysteresis, **settings),
        capacity_Ah=CAPACITY_AH,
    )


def test_the_truth_is_a_fixed_point():
    # Start at the truth, no noise: smoothing, holding and the OCV's leash must not move it.
    result = fit(Truth())
    assert max(errors(result, Truth(), INSIDE).values()) < 1e-5
    assert np.abs(result.theta[: result.layout.knots_ocv]).max() < 1e-6
    assert max(result.rmse_V) < 1e-6


@pytest.mark.parametrize("away", [0.2, -0.3])
def test_an_unknown_start_is_found_with_the_tables(away):
    # Pulses from full hold the OCV; where the drive begins is an unknown beside all tables.
    pulses, _ = two_logs(Truth())
    drive, soc = log_of(drive_current(3000, 1.0, 9.0, np.random.default_rng(77)), Truth(), soc0=0.8)
    taken = RefineLog(drive, soc + away, skewed=False, start_std=0.25)
    result = refine([pulses, taken], start_tables(2, 1.5), settings=RefineSettings(branches=2),
                    capacity_Ah=CAPACITY_AH)  # fmt: skip
    (found,), (std,) = result.moved_starts
    assert found == pytest.approx(-away, abs=2e-3)
    assert std < 0.02
    assert max(errors(result, Truth(), INSIDE).values()) < 0.05


def test_a_lagging_voltage_still_shows_the_resistance():
    # Half a second late at rows of 0.1 s: from row to row it answers with a hundredth.
    current = np.repeat(np.random.default_rng(3).uniform(0.0, 6.0, 60), 200)
    late = np.concatenate((np.zeros(5), current[:-5]))
    log = CellLog(0.1 * np.arange(current.size), current, 3.7 - 0.05 * late)
    group = Group(25.0, TestLogs(drive=log), (), None)
    assert rough_resistance([group]) == pytest.approx(0.05, rel=0.1)


def test_three_branches_come_back():
    truth = replace(CURVED, pairs=(*CURVED.pairs, (constant(0.015), constant(1500.0))))
    result = fit(truth, noise=5e-4, branches=3, factor=1.4)
    found = errors(result, truth, INSIDE)
    assert found["r0"] < 0.02
    assert found["r1"] < 0.08
    assert found["r2"] < 0.15
    assert found["r3"] < 0.30
    assert max(result.rmse_V) < 7e-4


def test_hysteresis_comes_back():
    truth = Truth(m_V=0.025, gamma=120.0)
    result = fit(truth, noise=5e-4)
    lay = result.layout
    m = spline_values(spline_rows(INSIDE, TABLE_KNOTS), result.theta[lay.m : lay.m + lay.knots])
    np.testing.assert_allclose(m, 0.025, rtol=0.15)
    assert np.exp(result.theta[lay.gamma]) == pytest.approx(120.0, rel=0.2)
    assert errors(result, truth, INSIDE)["r0"] < 0.02


@pytest.mark.parametrize("held", [0.87, 0.95, 0.98, 1.0, 1.08])
def test_a_discharge_of_another_cell_keeps_its_capacity_and_bends_no_table(held):
    logs = two_logs(CURVED, noise=1e-3)
    log, counted = log_of(np.full(3200, CAPACITY_AH), CURVED)
    true = 1.0 - (1.0 - counted) / held
    noise_V = 1e-3 * np.random.default_rng(8).standard_normal(len(log))
    log = replace(log, voltage_V=CURVED.voltage(log, true) + noise_V)
    other = RefineLog(log, counted, sample=0)
    settings = RefineSettings(branches=2, samples=1)
    result = refine([*logs, other], start_tables(), settings=settings, capacity_Ah=CAPACITY_AH)
    # What a batch differs by is held back by a fifth of it, more is not.
    assert result.capacity_scale(0) == pytest.approx(held, abs=0.005)
    assert result.capacity_scale(None) == 1.0
    rows = spline_rows(INSIDE, OCV_KNOTS)
    correction = spline_values(rows, result.theta[: result.layout.knots_ocv])
    np.testing.assert_allclose(correction, 0.0, atol=2e-3)
    assert errors(result, CURVED, INSIDE)["r0"] < 0.03


def test_activation_comes_back_from_a_log_that_warms_and_cools():
    result = fit(replace(Truth(), activation_K=3500.0), noise=5e-4, warm=True)
    assert result.activation_K == pytest.approx(3500.0, rel=0.05)


def test_activation_stays_at_its_prior_without_temperature():
    assert fit(Truth(), noise=1e-3).activation_K == pytest.approx(2000.0, abs=1.0)
    assert fit(Truth(), warm=True, activation_std_K=0.0).activation_K == pytest.approx(
        2000.0, abs=10.0
    )


def test_skew_comes_back_and_is_never_negative():
    result = fit(Truth(skew_s=0.35), noise=1e-3)
    assert result.skew_s == pytest.approx(0.35, abs=0.02)
    for shift, most in ((0, 0.01), (1, 0.05)):  # a voltage ahead of its current is no lag
        logs = two_logs(Truth(), noise=1e-3)
        log = logs[1].log
        early = np.append(log.voltage_V[shift:], log.voltage_V[:shift])
        logs[1] = RefineLog(replace(log, voltage_V=early), logs[1].soc, skewed=True)
        found = refine(logs, start_tables(), settings=RefineSettings(branches=2),
                       capacity_Ah=CAPACITY_AH)  # fmt: skip
        assert 0.0 <= found.skew_s < most


def test_a_wrong_ocv_is_corrected():
    # The start curve is 20 mV low and tilted; the logs' rests say so.
    logs = two_logs(Truth(), noise=5e-4)
    start = replace(start_tables(), ocv=lambda s: ocv(s) - 0.02 + 0.015 * s)
    result = refine(logs, start, settings=RefineSettings(branches=2), capacity_Ah=CAPACITY_AH)
    rows = spline_rows(INSIDE, OCV_KNOTS)
    correction = spline_values(rows, result.theta[: result.layout.knots_ocv])
    np.testing.assert_allclose(correction, 0.02 - 0.015 * INSIDE, atol=1.5e-3)


def test_time_constants_keep_their_order_whatever_the_start():
    # Both branches start at the same time constant, the truth's are swapped in the start.
    start = replace(start_tables(2), tau_s=(np.full(KNOTS.size, 90.0), np.full(KNOTS.size, 6.0)))
    result = refine(two_logs(Truth(), noise=1e-3), start, settings=RefineSettings(branches=2),
                    capacity_Ah=CAPACITY_AH)  # fmt: skip
    soc = np.linspace(0.0, 1.0, 201)
    fast, slow = (table(result, result.layout.tau(j), soc) for j in (0, 1))
    assert np.all(slow >= LEAST_RATIO * fast * (1.0 - 1e-9))


def test_wild_rows_do_not_move_the_tables():
    # One row in fifty is half a volt off: a loose wire, not a cell.
    rng = np.random.default_rng(5)
    clean = two_logs(CURVED, noise=1e-3)
    wild = []
    for item in clean:
        v = item.log.voltage_V.copy()
        at = rng.choice(v.size, v.size // 50, replace=False)
        v[at] += rng.choice([-0.5, 0.5], at.size)
        wild.append(replace(item, log=replace(item.log, voltage_V=v)))
    result = refine(wild, start_tables(2, 1.3), settings=RefineSettings(branches=2),
                    capacity_Ah=CAPACITY_AH)  # fmt: skip
    found = errors(result, CURVED, INSIDE)
    assert found["r0"] < 0.03
    assert found["r2"] < 0.10
    assert result.sigma_V == pytest.approx(1e-3, rel=0.2), "robust against the wild rows"


def test_a_log_without_a_voltage_in_range_is_refused():
    log, soc = log_of(pulse_current(1), Truth())
    with pytest.raises(InputError, match="voltage"):
        refine([RefineLog(log, soc - 5.0)], start_tables(), capacity_Ah=CAPACITY_AH)


def unequal_logs(seed):
    """From full one pulse and ten per cent (a short log), and a drive of 50 minutes."""
    long = drive_current(3000, 1.0, 7.0, np.random.default_rng(77))
    rng = np.random.default_rng(seed)
    return [
        RefineLog(*log_of(current, Truth(), noise=1e-3, rng=rng))
        for current in (pulse_current(1, rest=600), long)
    ]


@pytest.mark.slow
def test_standard_errors_are_the_scatter_over_noise():
    # A short log has the weight of a long one, so what only it says (the top) scatters more.
    thetas, claims = [], []
    for seed in range(14):
        result = refine(unequal_logs(seed), start_tables(2, 1.2), capacity_Ah=CAPACITY_AH,
                        settings=RefineSettings(branches=2))  # fmt: skip
        thetas.append(result.theta)
        claims.append(result.theta_std)
    scatter, claim = np.std(thetas, axis=0, ddof=1), np.mean(claims, axis=0)
    lay = result.layout
    short, long = np.flatnonzero(KNOTS > 0.95), np.flatnonzero((KNOTS > 0.6) & (KNOTS < 0.9))
    for name, at in (("r0", lay.r0), ("r1", lay.r(0)), ("tau1", lay.tau(0)), ("r2", lay.r(1))):
        for where, knots in (("short", short), ("long", long)):
            claimed, seen = (np.sqrt(np.mean(x[at + knots] ** 2)) for x in (claim, scatter))
            assert 0.5 < claimed / seen < 2.0, f"{name}, {where} log: {claimed:.4f}, {seen:.4f}"


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9, 0.98])
def test_independent_samples_of_an_autoregressive_series(memory):
    # n (1 - phi) / (1 + phi) independent values in an AR(1) series.
    rng = np.random.default_rng(0)
    n = 200_000
    series = _branch(np.full(n, memory), rng.standard_normal(n))
    expected = n * (1.0 - memory) / (1.0 + memory)
    assert independent_samples(series) == pytest.approx(expected, rel=0.15)

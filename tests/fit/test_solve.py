"""The fit: a known truth comes back and bounds hold.

The truth is simulated here in plain NumPy and Python, row by row: nothing of the package's kernels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.fit.population import SOC, prior_of
from cellwise.fit.problem import independent_samples
from cellwise.fit.rows import FitLog
from cellwise.fit.solve import FitResult, fit_logs
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, spline_rows, spline_values
from cellwise.fit.unknowns import LEAST_RATIO, FitSettings, layout_of
from fit_cases import (
    CAPACITY_AH,
    CURVE_V,
    CURVED,
    Truth,
    _branch,
    cells_like,
    constant,
    fit_of,
    log_of,
    pulse_current,
    two_logs,
)
from synthetic import drive_current

HOME = np.array([25.0])


def table(result: FitResult, at: int, soc) -> np.ndarray:
    rows = spline_rows(np.asarray(soc, dtype=float), TABLE_KNOTS)
    return np.exp(spline_values(rows, result.theta[at : at + result.layout.knots]))


def errors(result: FitResult, truth: Truth, soc) -> dict[str, float]:
    """Largest relative error of each table over the given SOC."""
    layout = result.layout
    found = {"r0": np.abs(table(result, layout.r0, soc) / truth.r0(soc) - 1.0).max()}
    for j, (r, tau) in enumerate(truth.pairs):
        found[f"r{j + 1}"] = np.abs(table(result, layout.r(j), soc) / r(soc) - 1.0).max()
        found[f"tau{j + 1}"] = np.abs(table(result, layout.tau(j), soc) / tau(soc) - 1.0).max()
    return found


INSIDE = np.linspace(0.2, 0.95, 40)


def fit(truth, *, noise=0.0, branches=2, factor=1.0, warm=False):
    hysteresis = bool(truth.m_V)
    return fit_of(
        two_logs(truth, noise=noise, warm=warm),
        cells_like(factor, 0.02 if hysteresis else 0.0),
        FitSettings(branches=branches, hysteresis=hysteresis, skew=bool(truth.skew_s)),
    )


def test_the_truth_is_a_fixed_point():
    # Begun at the truth, no noise: nothing may move it.
    result = fit(Truth())
    assert max(errors(result, Truth(), INSIDE).values()) < 1e-5
    assert np.abs(result.theta[: result.layout.knots_ocv]).max() < 1e-6
    assert max(result.rmse_V) < 1e-6


@pytest.mark.parametrize("away", [0.2, -0.3])
def test_an_unknown_start_is_found_with_the_tables(away):
    # Pulses from full hold the OCV; where the drive begins is an unknown beside all tables.
    pulses, _ = two_logs(Truth())
    current = drive_current(3000, 1.0, 9.0, np.random.default_rng(77))
    drive, _ = log_of(current, Truth(), soc0=0.8)
    taken = FitLog(drive, min(0.8 + away, 1.0), soc0_std=0.25)
    result = fit_of([pulses, taken], cells_like(1.5))
    found, std = result.start(1)
    assert found == pytest.approx(0.8, abs=2.0 * std)
    assert std < 0.02
    assert max(errors(result, Truth(), INSIDE).values()) < 0.08


def test_a_capacity_is_found_beside_the_tables():
    # The cell holds 3 Ah, its SOC was counted over 3.3: rests from full to empty say so.
    pulses, drive = two_logs(CURVED, noise=5e-4)
    cells = cells_like(1.2)
    settings = FitSettings(branches=2, ln_capacity_std=0.2)
    layout = layout_of(2, False, 1, 2)
    prior = prior_of(cells, layout, (pulses, drive), 1.1 * CAPACITY_AH, HOME, 25.0, settings)
    result = fit_logs([pulses, drive], cells.base(), prior, layout, capacity_Ah=1.1 * CAPACITY_AH)
    std = float(result.theta_std[layout.capacity])
    assert np.log(result.fitted_Ah / CAPACITY_AH) == pytest.approx(0.0, abs=2.5 * std)
    assert std < 0.05


def test_three_branches_come_back():
    truth = replace(CURVED, pairs=(*CURVED.pairs, (constant(0.015), constant(1500.0))))
    result = fit(truth, noise=5e-4, branches=3, factor=1.4)
    found = errors(result, truth, INSIDE)
    assert found["r0"] < 0.02
    assert found["r1"] < 0.08
    assert found["r2"] < 0.15
    assert found["r3"] < 0.30
    assert max(result.rmse_V) < 1e-3


def test_hysteresis_comes_back():
    truth = Truth(m_V=0.025, gamma=120.0)
    result = fit(truth, noise=5e-4)
    layout = result.layout
    m = spline_values(
        spline_rows(INSIDE, TABLE_KNOTS), result.theta[layout.m : layout.m + layout.knots]
    )
    np.testing.assert_allclose(m, 0.025, rtol=0.15)
    assert np.exp(result.theta[layout.gamma]) == pytest.approx(120.0, rel=0.2)
    assert errors(result, truth, INSIDE)["r0"] < 0.02


@pytest.mark.parametrize("held", [0.87, 0.95, 0.98, 1.0, 1.08])
def test_a_discharge_of_another_cell_keeps_its_capacity_and_bends_no_table(held):
    logs = two_logs(CURVED, noise=1e-3)
    log, counted = log_of(np.full(3200, CAPACITY_AH), CURVED)
    true = 1.0 - (1.0 - counted) / held
    noise_V = 1e-3 * np.random.default_rng(8).standard_normal(len(log))
    log = replace(log, voltage_V=CURVED.voltage(log, true) + noise_V)
    result = fit_of([*logs, FitLog(log, 1.0, sample_std=0.1)])
    assert result.capacity_scale(2) == pytest.approx(held, abs=0.01)
    assert result.capacity_scale(0) == result.capacity_scale(1) == 1.0
    rows = spline_rows(INSIDE, OCV_KNOTS)
    correction = spline_values(rows, result.theta[: result.layout.knots_ocv])
    np.testing.assert_allclose(correction, 0.0, atol=2e-3)
    assert errors(result, CURVED, INSIDE)["r0"] < 0.03


def test_activation_comes_back_from_a_log_that_warms_and_cools():
    result = fit(replace(Truth(), activation_K=3500.0), noise=5e-4, warm=True)
    assert result.activation_K == pytest.approx(3500.0, rel=0.05)


def test_activation_stays_at_its_prior_without_temperature():
    assert fit(Truth(), noise=1e-3).activation_K == pytest.approx(3000.0, abs=1.0)


def test_skew_comes_back_and_is_never_negative():
    result = fit(Truth(skew_s=0.35), noise=1e-3)
    assert result.skew_s == pytest.approx(0.35, abs=0.05)
    for shift, most in ((0, 0.02), (1, 0.05)):  # a voltage ahead of its current is no lag
        pulses, drive = two_logs(Truth(), noise=1e-3)
        voltage = drive.log.voltage_V
        early = replace(drive.log, voltage_V=np.append(voltage[shift:], voltage[:shift]))
        settings = FitSettings(branches=2, skew=True)
        found = fit_of([pulses, FitLog(early, 1.0, skewed=True)], settings=settings)
        assert 0.0 <= found.skew_s < most


def test_a_wrong_ocv_is_corrected():
    # The mean of the class is 20 mV low and tilted; the logs' rests say so.
    cells = cells_like(ocv_V=CURVE_V - 0.02 + 0.015 * SOC)
    result = fit_of(two_logs(Truth(), noise=5e-4), cells)
    rows = spline_rows(INSIDE, OCV_KNOTS)
    correction = spline_values(rows, result.theta[: result.layout.knots_ocv])
    np.testing.assert_allclose(correction, 0.02 - 0.015 * INSIDE, atol=2.5e-3)


def test_time_constants_keep_their_order_whatever_the_start():
    # The class has the truth's time constants exchanged.
    result = fit_of(two_logs(Truth(), noise=1e-3), cells_like(tau_s=(90.0, 6.0, 1500.0)))
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
    result = fit_of(wild, cells_like(1.3))
    found = errors(result, CURVED, INSIDE)
    assert found["r0"] < 0.04
    assert found["r2"] < 0.10
    assert result.level_V < 0.01, "robust against the wild rows"


def test_a_log_without_a_voltage_in_range_is_refused():
    log, _ = log_of(pulse_current(1), Truth())
    with pytest.raises(InputError, match="voltage"):
        fit_of([FitLog(log, -4.0)])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9, 0.98])
def test_independent_samples_of_an_autoregressive_series(memory):
    # n (1 - phi) / (1 + phi) independent values in an AR(1) series.
    rng = np.random.default_rng(0)
    n = 200_000
    series = _branch(np.full(n, memory), rng.standard_normal(n))
    expected = n * (1.0 - memory) / (1.0 + memory)
    assert independent_samples(series) == pytest.approx(expected, rel=0.15)

"""The LFP paper's OCV function, equation 8."""

import numpy as np
import pytest

from cellwise.identify.papers.log_linear_exp import LogLinearExp, fit_log_linear_exp

EQUATION_8 = LogLinearExp(a=3.31, b=0.035, c=0.012, d=0.06, e=42.0, f=1.03)


def test_equation_8_is_found_from_its_own_points():
    s = np.linspace(0.0, 1.0, 30)
    found = fit_log_linear_exp(s, EQUATION_8.evaluate(s))
    fine = np.linspace(0.0, 1.0, 500)
    assert np.max(np.abs(found.evaluate(fine) - EQUATION_8.evaluate(fine))) < 1e-5
    for name in "abcdef":
        assert getattr(found, name) == pytest.approx(getattr(EQUATION_8, name), rel=0.02)
    assert found.rmse_V < 1e-6


def test_it_rises_through_noisy_rests_of_a_plateau():
    s = np.linspace(0.02, 0.99, 40)
    noise_V = 4e-3 * np.random.default_rng(3).standard_normal(s.size)
    found = fit_log_linear_exp(s, EQUATION_8.evaluate(s) + noise_V)
    assert np.all(np.diff(found.evaluate(np.linspace(0.0, 1.0, 1000))) > 0.0)
    assert found.rmse_V == pytest.approx(4e-3, rel=0.3)

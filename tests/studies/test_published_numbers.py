"""The papers' numbers, against the arithmetic that the papers themselves state."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.studies.published import (
    LFP_CAPACITIES,
    LFP_ERRORS,
    LFP_POLYNOMIALS,
    LFP_TEST_CHARGES_AH,
    NCA_RESIDUALS,
)


def test_parts_add_up_to_the_total():
    for row in LFP_CAPACITIES.values():
        assert row.cc_Ah + row.cv_Ah == pytest.approx(row.total_Ah, abs=0.011)


def test_capacity_choices_are_the_means_of_the_table():
    cc = np.mean([row.cc_Ah for row in LFP_CAPACITIES.values()])
    total = np.mean([row.total_Ah for row in LFP_CAPACITIES.values()])
    assert LFP_ERRORS["cc-average"].capacity_Ah == pytest.approx(cc, abs=0.05)
    assert LFP_ERRORS["cc-cv-average"].capacity_Ah == pytest.approx(total, abs=0.05)


def test_eighteen_tests_add_up_to_the_hppc_total():
    assert len(LFP_TEST_CHARGES_AH) == 18
    assert sum(LFP_TEST_CHARGES_AH) == pytest.approx(LFP_ERRORS["hppc-total"].capacity_Ah, abs=0.1)


def test_polynomials_are_positive_where_the_cell_was_used():
    soc = np.linspace(0.05, 0.95, 91)
    for symbol, coefficients in LFP_POLYNOMIALS.items():
        assert np.all(np.polynomial.polynomial.polyval(soc, coefficients) > 0.0), symbol


def test_intervals_follow_from_mean_and_deviation():
    for row in NCA_RESIDUALS.values():
        low, high = row.ci95_mV
        assert low == pytest.approx(row.mean_mV - 1.96 * row.std_mV, abs=0.2)
        assert high == pytest.approx(row.mean_mV + 1.96 * row.std_mV, abs=0.2)
        assert row.rmse_mV == pytest.approx(np.hypot(row.mean_mV, row.std_mV), abs=0.2)

"""The papers' numbers, against the arithmetic that the papers themselves state."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.studies.published import LFP, NCR18650B


def test_parts_add_up_to_the_total():
    for row in LFP["capacities"].values():
        assert row["cc_Ah"] + row["cv_Ah"] == pytest.approx(row["total_Ah"], abs=0.011)


def test_capacity_choices_are_the_means_of_the_table():
    cc = np.mean([row["cc_Ah"] for row in LFP["capacities"].values()])
    total = np.mean([row["total_Ah"] for row in LFP["capacities"].values()])
    assert LFP["errors"]["cc-average"]["capacity_Ah"] == pytest.approx(cc, abs=0.05)
    assert LFP["errors"]["cc-cv-average"]["capacity_Ah"] == pytest.approx(total, abs=0.05)


def test_eighteen_tests_add_up_to_the_hppc_total():
    assert len(LFP["test_charges_Ah"]) == 18
    assert sum(LFP["test_charges_Ah"]) == pytest.approx(
        LFP["errors"]["hppc-total"]["capacity_Ah"], abs=0.1
    )


def test_polynomials_are_positive_where_the_cell_was_used():
    soc = np.linspace(0.05, 0.95, 91)
    for symbol, coefficients in LFP["polynomials"].items():
        assert np.all(np.polynomial.polynomial.polyval(soc, coefficients) > 0.0), symbol


def test_intervals_follow_from_mean_and_deviation():
    for row in NCR18650B["residuals"].values():
        low, high = row["ci95_mV"]
        assert low == pytest.approx(row["mean_mV"] - 1.96 * row["std_mV"], abs=0.2)
        assert high == pytest.approx(row["mean_mV"] + 1.96 * row["std_mV"], abs=0.2)
        assert row["rmse_mV"] == pytest.approx(np.hypot(row["mean_mV"], row["std_mV"]), abs=0.2)

"""The capacity of one rate, and a cell characterized at that rate only: the NCR18650B paper."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise.errors import InputError
from cellwise.studies.capacity_study_cells import (
    embedded_nmc,
    embedded_nmc_rates,
)

RATES = ("rate:C/20", "rate:C/5", "rate:C/3")


@pytest.fixture(scope="module")
def nmc_cell():
    return embedded_nmc()


@pytest.fixture(scope="module")
def nmc_study(quick, nmc_cell):
    return quick(nmc_cell, *RATES)


@pytest.mark.slow
class TestOneTestSet:
    """All laboratory tests, and only the number that is called the capacity changes."""

    def test_the_faster_the_less_comes_out(self, nmc_study, by_choice):
        capacity = [by_choice(nmc_study)[rate].capacity_Ah for rate in RATES]
        assert capacity == sorted(capacity, reverse=True)
        assert capacity[0] < nmc_study.reference_Ah

    @pytest.mark.parametrize("estimator", ["coulomb", "ekf"])
    def test_the_slower_the_better_for_soc(self, nmc_study, estimator):
        assert nmc_study.order(estimator) == RATES
        winner = nmc_study.winner(estimator)
        assert winner.alike == ()

    def test_counting_is_off_by_what_arithmetic_says(
        self, nmc_study, nmc_cell, counting_error, by_choice
    ):
        for rate in RATES:
            found = by_choice(nmc_study)[rate]
            expected = counting_error(nmc_cell, found.capacity_Ah)
            assert found.soc["coulomb"].end == pytest.approx(expected, abs=1e-3)
            assert found.axis_share["coulomb"] > 0.95


@pytest.fixture(scope="module")
def one_rate_study(quick):
    return quick(embedded_nmc_rates(), *RATES)


@pytest.mark.slow
class TestOneRateOnly:
    """HPPC and capacity test of one rate, as in the paper."""

    def test_each_is_identified_on_its_own_tests(self, one_rate_study, by_choice):
        found = by_choice(one_rate_study)
        capacity = [found[r].capacity_Ah for r in RATES]
        assert capacity == sorted(capacity, reverse=True)
        assert len({found[r].fit_rmse_V for r in RATES}) == 3

    def test_the_slowest_wins_for_counting_and_c3_for_the_drives_voltage(self, one_rate_study):
        """C/3 saves test time, as the paper says, and its pulses are nearest to a drive's."""
        assert one_rate_study.order("coulomb") == RATES
        assert one_rate_study.winner("voltage").choice == "rate:C/3"
        assert one_rate_study.winner("voltage").behind["rate:C/20"].low > 0.0


def test_a_rate_that_was_not_measured_is_refused(quick):
    with pytest.raises(InputError, match="C/20"):
        quick(embedded_nmc(), "rate:2C")


def test_a_judged_log_needs_a_counter(quick):
    cell = embedded_nmc_rates()
    blind = replace(cell.judged[0], log=replace(cell.judged[0].log, charge_Ah=None))
    with pytest.raises(InputError, match="charge counter"):
        quick(replace(cell, judged=(blind,)), "rate:C/3")
    with pytest.raises(InputError, match="no log to judge on"):
        quick(replace(cell, judged=()), "rate:C/3")

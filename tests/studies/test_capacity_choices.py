"""What each choice of the capacity does to voltage and SOC, on the embedded cells, not refined."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from cellwise.errors import InputError
from cellwise.studies.capacity_study import (
    embedded_lfp,
    embedded_nmc,
    embedded_nmc_rates,
    study_cell,
)

CC, WHOLE, HPPC, RATED = "cc-average", "cc-cv-average", "hppc-total", "as 40 of 47.7"
RATES = ("rate:C/20", "rate:C/5", "rate:C/3")


def quick(cell, *choices, estimators=("coulomb", "ekf")):
    """A choice takes a second."""
    cell = replace(cell, settings=replace(cell.settings, refine=False))
    return study_cell(cell, choices, estimators)


@cache
def study_of(name):
    """Study and its choices by name."""
    made = {
        "lfp": lambda: quick(embedded_lfp(), CC, WHOLE, HPPC, RATED),
        "nmc": lambda: quick(
            embedded_nmc(), "nominal", *RATES, estimators=("coulomb", "ekf", "adaptive")
        ),
        "rates": lambda: quick(embedded_nmc_rates(), *RATES),
    }
    study = made[name]()
    return study, {c.choice: c for c in study.choices}


def counting_error(cell, capacity_Ah):
    """SOC error that counting makes over another capacity than the reference, at the lowest SOC.

    soc0 - Ah / Q against soc0 - Ah / Q_ref, until the scale is at its end.
    """
    errors = []
    for log in cell.judged:
        most = float((log.charge_Ah - log.charge_Ah[0]).max())
        own = max(log.soc0 - most / capacity_Ah, 0.0)
        errors.append(own - (log.soc0 - most / cell.reference_Ah))
    return sum(errors) / len(errors)


@pytest.mark.slow
def test_the_cc_part_is_nearly_the_whole_in_voltage_and_not_in_soc():
    """5.5 mV lie between them in the LFP paper, and 124 mV between the best and the rated one."""
    study, found = study_of("lfp")
    assert found[CC].capacity_Ah < found[WHOLE].capacity_Ah
    assert found[WHOLE].capacity_Ah == pytest.approx(study.reference_Ah, rel=3e-3)
    assert abs(found[CC].voltage_rmse_V - found[WHOLE].voltage_rmse_V) < 0.015
    for estimator in ("coulomb", "ekf"):
        winner = study.winner(estimator)
        assert winner.choice == WHOLE
        assert winner.behind[CC].low > 0.002
        assert winner.behind[HPPC].low > 0.0


@pytest.mark.slow
def test_the_rated_capacity_is_the_worst_choice_of_a_cell_that_gives_19_percent_more():
    study, found = study_of("lfp")
    assert study.order("voltage")[-1].choice == RATED
    behind = study.winner("voltage").behind[RATED]
    assert behind.low > 0.0
    assert behind.value > 0.08  # the paper: 167 mV against 43
    # SOC is off by many points, and no filter cures it.
    soc = found[RATED].soc
    assert soc["coulomb"].rmse > 0.05
    assert soc["ekf"].rmse > 0.8 * soc["coulomb"].rmse
    assert soc["coulomb"].axis_share > 0.5


@pytest.mark.slow
def test_the_slower_the_rate_the_better_for_soc_and_the_error_is_the_scale():
    """All laboratory tests of a cell that gives 3 % more than it is rated for."""
    study, found = study_of("nmc")
    capacities = [found[rate].capacity_Ah for rate in RATES]
    assert capacities == sorted(capacities, reverse=True)
    assert capacities[0] < study.reference_Ah
    for kind in ("coulomb", "ekf", "adaptive"):
        winner = study.winner(kind)
        assert winner.choice == RATES[0]
        assert winner.behind["nominal"].low > 0.005
    for kind in ("coulomb", "ekf"):
        assert tuple(c.choice for c in study.order(kind) if c.choice in RATES) == RATES
        assert study.winner(kind).alike == ()
    assert found["nominal"].soc["ekf"].axis_share > 0.7
    for choice in ("nominal", *RATES):
        one = found[choice]
        expected = counting_error(embedded_nmc(), one.capacity_Ah)
        assert one.soc["coulomb"].end == pytest.approx(expected, abs=2e-3)
        assert one.soc["coulomb"].axis_share > 0.95


@pytest.mark.slow
def test_of_one_rate_only_the_slowest_wins_for_counting_and_c3_for_the_drives_voltage():
    """HPPC and capacity test of one rate, as in the NCR18650B paper: C/3 saves test time."""
    study, found = study_of("rates")
    capacities = [found[r].capacity_Ah for r in RATES]
    assert capacities == sorted(capacities, reverse=True)
    assert len({found[r].fit_rmse_V for r in RATES}) == 3
    assert tuple(c.choice for c in study.order("coulomb")) == RATES
    assert study.winner("voltage").choice == "rate:C/3"
    assert study.winner("voltage").behind["rate:C/20"].low > 0.0


def test_a_rate_that_was_not_measured_is_refused():
    with pytest.raises(InputError, match="C/20"):
        quick(embedded_nmc(), "rate:2C")


def test_a_judged_log_needs_a_counter():
    cell = embedded_nmc_rates()
    blind = replace(cell.judged[0], charge_Ah=None)
    with pytest.raises(InputError, match="charge counter"):
        quick(replace(cell, judged=(blind,)), "rate:C/3")
    with pytest.raises(InputError, match="no log to judge on"):
        quick(replace(cell, judged=()), "rate:C/3")

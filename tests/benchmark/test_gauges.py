"""The gauges to compare with: theorems of each on a cell whose tables are known."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.benchmark.adapter import load_adapter
from cellwise.benchmark.gauges import OneStateEkf, TableGauge
from cellwise.benchmark.standings import Standing, choice_of
from cellwise.benchmark.suite import GAUGES
from cellwise.cell.model import CellModel
from cellwise.estimate.noise import noise_for


def straight_cell(slow_ohm=0.0):
    """OCV a straight line over SOC, no branch: the one-state filter is then a Kalman filter."""
    table = np.full(11, 1e-9 + 0.5 * slow_ohm)
    return CellModel(
        capacity_Ah=2.0,
        ocv_V=np.linspace(3.0, 4.2, 11),
        r0_ohm=np.full(11, 0.03),
        r1_ohm=table,
        tau1_s=np.full(11, 10.0),
        r2_ohm=table,
        tau2_s=np.full(11, 300.0),
    )


@pytest.mark.parametrize("name", GAUGES)
def test_each_is_found_by_its_name(name, tmp_path):
    assert callable(load_adapter(name, tmp_path)(straight_cell()).step)


def test_a_constant_load_is_looked_up_exactly():
    """Where all resistances are put back, the table says the SOC that the voltage came from."""
    gauge = TableGauge(straight_cell(0.02))
    gauge.start(0.2, 0.1)
    for _ in range(100):
        answer = gauge.step(2.0, 3.0 + 1.2 * 0.7 - 2.0 * 0.05, 25.0, 60.0)
    assert answer.soc == pytest.approx(0.7, abs=1e-6)
    assert np.isnan(answer.soc_std)


def test_it_follows_with_the_slow_branchs_time_constant():
    gauge = TableGauge(straight_cell())
    gauge.start(0.2, 0.1)
    assert gauge.step(0.0, 3.0 + 1.2 * 0.7, 25.0, 300.0).soc == pytest.approx(0.7 - 0.5 / np.e)


def test_a_voltage_beyond_the_table_is_empty_or_full():
    gauge = TableGauge(straight_cell())
    for voltage, soc in ((5.0, 1.0), (2.0, 0.0)):
        gauge.start(0.5, 0.1)
        assert gauge.step(0.0, voltage, 25.0, 1e6).soc == pytest.approx(soc)


def test_on_a_straight_line_the_ekf_is_the_batch_posterior():
    """Without drift, of n voltages at rest: precisions add, the mean is weighed by them."""
    model = straight_cell()
    gauge = OneStateEkf(model)
    gauge.walk_per_sqrt_s = 0.0
    gauge.start(0.5, 0.1)
    rng = np.random.default_rng(1)
    volts = 3.0 + 1.2 * 0.6 + 0.001 * rng.standard_normal(50)
    for voltage in volts:
        answer = gauge.step(0.0, voltage, 25.0, 10.0)
    error = float(model.slow_error_V(0.5, 25.0))
    variance = noise_for(model, None).voltage_V ** 2 + 2.0 * 300.0 / 10.0 * error**2
    seen = (volts - 3.0) / 1.2
    precision = 1.0 / 0.1**2 + 50 * 1.2**2 / variance
    mean = (0.5 / 0.1**2 + 1.2**2 * seen.sum() / variance) / precision
    assert answer.soc == pytest.approx(mean, abs=1e-9)
    assert answer.soc_std == pytest.approx(precision**-0.5, rel=1e-9)


def test_without_a_voltage_the_ekf_counts():
    gauge = OneStateEkf(straight_cell())
    gauge.start(0.9, 0.01)
    for _ in range(36):
        answer = gauge.step(2.0, np.nan, 25.0, 10.0)
    assert answer.soc == pytest.approx(0.9 - 0.1)
    before = answer.soc_std
    assert gauge.step(np.nan, 3.9, 25.0, 3600.0).soc_std > before  # a gap
    assert gauge.estimate == pytest.approx(0.8)


def standing(name, score, inside, hard, rank=1):
    empty = dict.fromkeys(Standing._fields)
    said = {"estimator": name, "rank": rank, "failed": 0, "hard": hard, "coverage": inside}
    return Standing(**{**empty, **said, "interval_score": score})


def test_the_reason_to_choose_is_the_band_before_the_error():
    """A smaller error with a band that holds a fifth of the rows is not what one relies on."""
    stand = [
        standing("narrow", 0.50, 0.2, 0.01),
        standing("honest", 0.20, 0.97, 0.03, 2),
        standing("bare", None, None, 0.02, 3),
        standing("few runs", 0.01, 1.0, 0.001, None),
    ]
    said = choice_of(stand)
    assert said.startswith("To choose by: honest has the least interval score, 20.00 points")
    assert "97 % of the rows inside" in said
    assert "least error has narrow, 1.00, with 20 % inside" in said
    assert said.endswith("No band: bare.")
    assert "few runs" not in said
    assert "nothing to choose by" in choice_of([standing("bare", None, None, 0.02)])

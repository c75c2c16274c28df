"""Coulomb counting is counting: against the tester's counter, and step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.protocol import ConstantCurrent, ConstantVoltage, Rest, run_protocol
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.coulomb import Coulomb
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import Status
from cellwise.logs.reading import read_log
from example_cells import curved_cell, linear_cell, random_log


def test_it_equals_the_testers_counter_on_ideal_data():
    model = curved_cell()
    pulses = [ConstantCurrent(current_A=i, duration_s=10.0, period_s=0.1) for i in (3.0, -3.0)]
    down = ConstantCurrent(current_A=3.0, charge_Ah=1.2)
    up = ConstantVoltage(voltage_V=4.0, until_current_A=0.2, current_limit_A=2.0)
    log = run_protocol(model, [*pulses, down, Rest(600.0), *pulses, up], 0.98)
    trace = Coulomb(model).run(log, 0.98)
    np.testing.assert_allclose(trace.soc, 0.98 - log.charge_Ah / 3.0, atol=1e-11)
    np.testing.assert_allclose(trace.voltage_V, log.voltage_V, atol=1e-10)
    np.testing.assert_allclose(trace.innovation_V, 0.0, atol=1e-10)


def test_charge_counts_with_its_efficiency():
    model = linear_cell(charge_efficiency=0.97)
    log = random_log(np.random.default_rng(1), 2000, jitter=0.5)
    used = np.where(log.current_A > 0, 1.0, 0.97) * log.current_A * log.interval_s
    trace = Coulomb(model).run(log, 0.6)
    np.testing.assert_allclose(trace.soc, 0.6 - np.cumsum(used) / (3600 * 3.0), atol=1e-12)


def test_it_only_ever_becomes_less_sure():
    log = random_log(np.random.default_rng(3), 500)
    noise = Noise(soc_per_sqrt_h=0.01)
    trace = Coulomb(linear_cell(), noise).run(log, 0.6, 0.1)
    exact = np.sqrt(0.1**2 + 0.01**2 * log.time_s / 3600)
    np.testing.assert_allclose(trace.soc_std, exact, rtol=1e-12)


def test_a_wrong_start_stays_wrong():
    log = random_log(np.random.default_rng(4), 500)
    a, b = (Coulomb(linear_cell()).run(log, s).soc for s in (0.4, 0.6))
    np.testing.assert_allclose(b - a, 0.2, atol=1e-12)


def test_it_does_not_look_at_the_voltage():
    model = linear_cell()
    log = random_log(np.random.default_rng(5), 500)
    other = replace(log, voltage_V=np.full(500, 2.0))
    a, b = Coulomb(model).run(log, 0.6), Coulomb(model).run(other, 0.6)
    np.testing.assert_array_equal(a.soc, b.soc)
    np.testing.assert_array_equal(a.voltage_V, simulate(model, log, 0.6).voltage_V)


def test_bounds_and_refusals():
    log = random_log(np.random.default_rng(6), 3000, scale_A=30.0)
    trace = Coulomb(linear_cell()).run(log, 0.5)
    assert np.all((trace.soc >= 0) & (trace.soc <= 1))
    at_bound = (trace.soc == 0) | (trace.soc == 1)
    np.testing.assert_array_equal(at_bound, (trace.status & Status.CLAMPED) > 0)
    assert at_bound.any()
    with pytest.raises(InputError, match="from 0 to 1"):
        Coulomb(linear_cell()).run(log, 1.5)


@pytest.mark.parametrize(
    ("name", "share"), [("panasonic_18650pf/drive_p25_us06", 1e-3), ("nissan_leaf/hppc_p25", 5e-3)]
)
def test_a_real_current_adds_up_to_the_testers_counter(real_data, name, share):
    log = read_log(real_data / f"{name}.csv.gz")
    counted = charge_counted_Ah(log)
    moved = np.ptp(log.charge_Ah)
    np.testing.assert_allclose(counted, log.charge_Ah - log.charge_Ah[0], atol=share * moved)


def test_a_current_sampled_from_a_faster_profile_drifts_as_its_source_says(real_data):
    # The data's own notes: the current sums up to 1.979 Ah where the counter says 2.002 Ah.
    log = read_log(real_data / "plett_a123" / "dyn_p25_s1.csv.gz")
    assert charge_counted_Ah(log)[-1] == pytest.approx(1.979, abs=0.001)
    assert log.charge_Ah[-1] == pytest.approx(2.002, abs=0.001)


def charge_counted_Ah(log):
    capacity = 4 * float(np.ptp(log.charge_Ah))  # wide, so that neither bound is met
    return capacity * (0.5 - Coulomb(linear_cell(capacity_Ah=capacity)).run(log, 0.5).soc)

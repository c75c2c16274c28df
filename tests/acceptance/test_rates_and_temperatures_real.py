"""LG HG2: no HPPC, no whole drive; C/20 and three rates at six temperatures, and short cycles."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.identify.own_logs import directions
from measured_models import identified_lg, lg_log

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def lg(real_data):
    return identified_lg(real_data), lambda name: lg_log(real_data, name)


def test_every_temperature_has_its_tables(lg):
    model = lg[0].model
    assert model.temperature_C.min() < -18.0
    assert model.temperature_C.max() > 37.0
    # The C/20 test at 25 degC alone, neither joined with the others nor rid of an offset.
    assert model.capacity_Ah == pytest.approx(2.778, rel=2e-3)


def test_no_hysteresis_is_invented(lg):
    logs = [o.simulation.log for o in lg[0].own_logs if "charge" in o.sides_V]
    charges = []
    for log in logs:  # each began full
        error = simulate(lg[0].model, log, 1.0).residual_V[directions(log)["charge"]]
        charges.append(np.sqrt(np.nanmean(error**2)))
    assert len(charges) > 10
    assert max(charges) < 0.1
    assert lg[0].decided


# 60 mV: pulses were measured near full only, and US06 reaches 12 A where the data end at 8.1 A.
SHORT_OF_IT = pytest.mark.xfail(
    strict=True, reason="60 mV: mid-range seen at constant current only"
)


@pytest.mark.parametrize(
    ("name", "most_V"),
    [pytest.param("n10_601", 0.040, marks=SHORT_OF_IT), ("n20_610", 0.060)],
)
def test_us06_in_the_cold_is_simulated_within_its_bound(lg, name, most_V):
    found, log = lg
    assert simulate(found.model, log(f"drive_us06_{name}"), 1.0).rmse_above_10pct_V < most_V

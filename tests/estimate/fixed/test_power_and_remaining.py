"""State of power, remaining time and plan of the fixed step: the float64's, or refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellwise.cell.equations import CellState
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import power_limits, power_settings
from cellwise.forecast.forecast_kernels import LoadScenario, with_ends
from cellwise.forecast.remaining import uncertain_of
from cellwise.forecast.warming_kernels import STEADY
from example_cells import curved_cell, lfp_cell, linear_cell
from firmware_cases import cutoff_asked, power_asked

CELL = curved_cell()


@pytest.mark.slow
@pytest.mark.parametrize("horizon_s", [2.0, 10.0, 30.0])
def test_power_is_the_float64_s(horizon_s):
    """One interval of the horizon against five: within 2 % where resistances bend most."""
    asked = power_asked(CELL, horizon_s)
    fixed = FixedStep(CELL, dt_s=1.0, power=asked)
    for soc, v1, v2 in ((0.25, 0.0, 0.0), (0.5, 0.03, 0.05), (0.9, -0.02, -0.01)):
        state = fixed.init(soc, 0.01)
        state["v1_V"], state["v2_V"] = v1, v2
        found = fixed.power(state)[0]
        (exact,) = power_limits(
            CELL, CellState(soc, v1, v2, 0.0, 0.0), horizons_s=(horizon_s,),
            limits=asked.known.limits, hold="current",
        )  # fmt: skip
        assert found["discharge_W"] == pytest.approx(exact.discharge.power_W, rel=0.02)
        assert found["charge_W"] == pytest.approx(exact.charge.power_W, rel=0.02)
        assert 0.0 < found["discharge_low_W"] < found["discharge_W"]
        assert 0.0 <= found["charge_low_W"] < found["charge_W"]


def test_a_power_that_a_fixed_step_cannot_give_is_refused():
    limits = OperatingLimits(2.8, 4.2)
    for options, says in (
        ({"horizons_s": (2.0, 10.0), "hold": "current"}, "Give one"),
        ({"horizons_s": (10.0,), "hold": "power"}, "hold='current'"),
    ):
        with pytest.raises(InputError, match=says):
            fixed_step_tables(CELL, 1.0, power=power_settings(CELL, limits=limits, **options))
    with pytest.raises(InputError, match="no state of power"):
        FixedStep(CELL, dt_s=1.0).power(np.zeros(1))


@pytest.mark.slow
@pytest.mark.parametrize("make", [linear_cell, curved_cell, lfp_cell])
@pytest.mark.parametrize("hold", ["current", "power"])
def test_remaining_time_is_the_float64_s(make, hold):
    """64 parts against 400 steps: 1 %, 4 % below 200 s (a part is 1.6 % of the SOC)."""
    model = make()
    cutoff_V = cutoff_asked(model)
    fixed = FixedStep(model, dt_s=1.0, remaining_V=cutoff_V)
    seen = 0
    for soc in (0.9, 0.5, 0.2):
        for load_A in (0.6, 3.0, 9.0):
            found = fixed.remaining(fixed.init(soc, 0.01), load_A, hold)[0]
            go = LoadScenario(load_A, hold == "power", math.nan, 0.0, 0.0, cutoff_V, 25.0, STEADY)
            at = CellState(soc, 0.0, 0.0, 0.0, -1.0)
            exact = with_ends(model.parameters(), at, 0.01, go, uncertain_of(model))
            assert found["time_low_s"] <= found["time_s"] <= found["time_high_s"]
            assert found["energy_low_J"] <= found["energy_J"] <= found["energy_high_J"]
            if exact.usual.time_s < 60.0:
                continue
            seen += 1
            rel = 0.01 if exact.usual.time_s > 200.0 else 0.04
            assert found["time_s"] == pytest.approx(exact.usual.time_s, rel=rel)
            assert found["energy_J"] == pytest.approx(exact.usual.energy_J, rel=rel)
    assert seen >= 4


def test_a_plan_that_no_cell_gives_fails_when_its_load_comes():
    fixed = FixedStep(curved_cell(), dt_s=1.0, remaining_V=cutoff_asked(curved_cell()))
    found = fixed.plan(fixed.init(0.5, 0.01), [(60.0, 1.0), (60.0, 500.0)])[0]
    assert 60.0 < found["failed_s"] < 120.0
    assert found["chance"] < 1e-3
    for phase in ((-1.0, 2.0), (math.nan, 2.0), (10.0, math.inf)):
        refused = fixed.plan(fixed.init(0.5, 0.01), [phase])[0].item()
        assert refused == (0.0,) * len(refused)


@pytest.mark.slow
def test_half_of_the_capacity_lasts_half_as_long():
    """What a history says of the cell counts: at a current so small that no voltage ends it."""
    model = linear_cell()
    fixed = FixedStep(model, dt_s=1.0, health=True, remaining_V=1.0)
    state = fixed.init(0.8, 0.01)
    whole = fixed.remaining(state, 0.3)[0]["time_s"]
    assert whole == pytest.approx(0.8 * model.capacity_Ah * 3600 / 0.3, rel=1e-4)
    fixed.set_health(state, 0.5, 1.0)
    assert fixed.remaining(state, 0.3)[0]["time_s"] == pytest.approx(0.5 * whole, rel=1e-4)


def test_what_is_not_one_cell_s_cutoff_is_refused():
    for cutoff_V in (14.0, -1.0, math.nan):
        with pytest.raises(InputError, match="not of the pack"):
            fixed_step_tables(curved_cell(), 1.0, remaining_V=cutoff_V)
    fixed = FixedStep(curved_cell(), dt_s=1.0)
    with pytest.raises(InputError, match="no remaining time"):
        fixed.remaining(np.zeros(1), 3.0)

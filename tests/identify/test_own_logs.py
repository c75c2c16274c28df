"""Every log given is simulated back: used or not, with what remains and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.identify import CellTests, IdentifySettings, identify_cell
from cellwise.identify.identification import Start
from cellwise.identify.own_logs import directions, other_capacities

SETTINGS = IdentifySettings(nominal_Ah=5.0)


@pytest.fixture(scope="module")
def found():
    somewhere = load_dataset("nmc_drive_b")
    hidden = replace(somewhere.part(2000, len(somewhere)), name="from somewhere", soc0=None)
    tests = CellTests(
        hppc=((load_dataset("nmc_hppc"), None),),
        ocv=(load_dataset("nmc_ocv_c20"),),
        capacity=(load_dataset("nmc_cap_c3"),),
        drive=((hidden, None),),
    )
    return identify_cell(tests, SETTINGS)


def test_every_log_is_there_in_its_role(found):
    roles = [(o.role, o.simulation.log.name) for o in found.own_logs]
    assert roles == [("hppc", "nmc_hppc"), ("ocv", "nmc_ocv_c20"), ("capacity", "nmc_cap_c3"),
                     ("drive", "from somewhere")]  # fmt: skip


def test_the_discharges_that_made_the_ocv_come_back(found):
    for own in found.own_logs:
        if own.role in ("ocv", "capacity"):
            assert own.used
            assert own.sides_V["discharge"] < 0.015


def test_the_rows_are_those_of_the_contract(found):
    for own in found.to_dict()["own_logs"]:
        assert {"log", "role", "used", "rmse_V", "rmse_above_10pct_V", "reason"} <= set(own)
        assert own["used"] or own["reason"]


def test_a_charge_that_does_not_belong_is_explained():
    # The charge branch lies 0.1 V too high and brings back nine tenths: a reason must name both.
    low = load_dataset("nmc_ocv_c20")
    charge = directions(low)["charge"]
    current = np.where(low.current_A < 0.0, 0.9 * low.current_A, low.current_A)
    odd = replace(low, current_A=current, charge_Ah=None,
                  voltage_V=low.voltage_V + 0.1 * charge)  # fmt: skip
    tests = CellTests(hppc=((load_dataset("nmc_hppc"), None),), ocv=(odd,))
    own = next(o for o in identify_cell(tests, SETTINGS).own_logs if o.role == "ocv")
    assert "its charge lies" in own.reason
    assert "came back" in own.reason
    assert own.sides_V["discharge"] < 0.01
    assert own.sides_V["charge"] > 0.05


@pytest.mark.parametrize(("scale", "said"), [(1.0, 0), (1.023, 0), (0.88, 1), (1.08, 1)])
def test_a_test_of_another_cell_is_said_first_with_its_charge(scale, said):
    log = load_dataset("nmc_cap_c3")
    notices = other_capacities([Start(log, 1.0), Start(log, 1.0, capacity_scale=scale)])
    assert len(notices) == said
    for notice in notices:
        assert log.name in notice.text
        assert f"{100.0 * (scale - 1.0):+.1f} %" in notice.text
        assert notice.size_V > 0.0


def test_a_capacity_test_of_the_same_cell_keeps_the_capacity_of_the_model(found):
    own = next(o for o in found.own_logs if o.role == "capacity")
    held = own.simulation.model.capacity_Ah / found.model.capacity_Ah
    assert held == pytest.approx(1.0, abs=0.01)
    assert not found.contradictions

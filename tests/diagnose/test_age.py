"""A sensor that reads too little and a cell that has aged: the same log, and which one is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellwise import CellModel, simulate
from cellwise.cell.model_error import ModelError
from cellwise.diagnose import diagnose
from cellwise.diagnose.odds import AGE
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from random_loads import random_load

SOC0 = 0.9


def good_model() -> CellModel:
    """A model that states no more error than these logs have."""
    return replace(curved_cell(), error=ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01))


def aged(model: CellModel, share: float) -> CellModel:
    """A cell that holds a share of the charge, behind resistances that grew as much."""
    return replace(
        model,
        capacity_Ah=share * model.capacity_Ah,
        r0_ohm=model.r0_ohm / share,
        r1_ohm=model.r1_ohm / share,
        r2_ohm=model.r2_ohm / share,
    )


def drives(model: CellModel, share: float, gain: float = 1.0) -> list[CellLog]:
    """Three loads of a cell so aged, its current logged with a gain, 1 mV of noise."""
    rng, logs = np.random.default_rng(4), []
    for k in range(3):
        load = random_load(
            rng, model.capacity_Ah, SOC0, rows=2500, rate_hz=1.0, charge=k != 1,
            temperature_C=(25.0, 25.0),
        )  # fmt: skip
        log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
        voltage = simulate(aged(model, share), log, SOC0).voltage_V
        noisy = voltage + rng.normal(0.0, 1e-3, voltage.size)
        logs.append(replace(log, voltage_V=noisy, current_A=gain * load.current_A))
    return logs


def test_a_low_gain_is_exactly_age() -> None:
    model = good_model()
    sensor = simulate(aged(model, 1.0), drives(model, 1.0)[0], SOC0).voltage_V
    age = simulate(aged(model, 0.92), drives(model, 1.0, gain=0.92)[0], SOC0).voltage_V
    assert age == pytest.approx(sensor, abs=1e-9)


@pytest.mark.slow
def test_a_cell_that_has_aged_is_not_called_a_sensor() -> None:
    """Nothing in the logs tells them apart, and a sensor that is a tenth off is the rarer."""
    model = good_model()
    logs = drives(model, 0.9)
    said = diagnose(model, logs[:2], logs[2], soc0=SOC0)
    assert "current_gain" not in {c.name for c in said.causes}
    assert "capacity" in {n for w in said.competing for n in w.causes}


@pytest.mark.slow
def test_a_small_gain_is_the_sensor() -> None:
    model = good_model()
    logs = drives(model, 1.0, gain=1.04)
    said = diagnose(model, logs[:2], logs[2], soc0=SOC0)
    assert said.verdict == "current_gain"
    assert said.causes[0].parameters["gain"] == pytest.approx(1.04, abs=0.008)


@pytest.mark.slow
def test_beside_a_good_log_of_the_same_cell_it_is_the_sensor() -> None:
    model = good_model()
    good = drives(model, 1.0)[2]
    logs = drives(model, 1.0, gain=0.9)
    said = diagnose(model, logs[0], logs[1], baseline=good, soc0=SOC0)
    assert said.verdict == "current_gain"
    assert said.causes[0].parameters["gain"] == pytest.approx(0.9, abs=0.01)


@pytest.mark.slow
def test_a_cold_cell_is_not_called_aged(real_data: Path) -> None:
    """Two 0 degC drives to empty and a 25 degC model, of a cell whose C/20 test gave 2.997 Ah."""
    from benchmarks.real_findings import FINDINGS

    cold = FINDINGS["p00"]
    found = diagnose(cold.model(), cold.logs(), cold.holdout(), soc0=cold.soc0)
    assert not {c.name for c in found.causes} & AGE
    assert found.verdict != "none"
    assert found.next_test

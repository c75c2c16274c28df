"""A model at a temperature that it was not measured at: what may differ there, and there alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion, TemperatureDependence
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.simulate import simulate
from cellwise.diagnose import diagnose
from cellwise.diagnose.applied import extend_model, with_error_at
from cellwise.diagnose.causes.coordinates import (
    UNSEEN_OCV_NAMES,
    UNSEEN_R_NAMES,
    Coordinates,
)
from cellwise.diagnose.checks import unseen_temperature_C
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.odds import AGE
from cellwise.fit.start import InitialSoc
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from random_loads import random_load

COLD_C = 2.0
START = InitialSoc(0.9, 0.01, "given")
POINT = dict.fromkeys(UNSEEN_R_NAMES, 600.0) | dict.fromkeys(UNSEEN_OCV_NAMES, 2e-4)
POINT["unseen_ocv_0_V_per_K"] = -3e-4
EFFECTS = (SlowDiffusion(0.01, 900.0), Hysteresis(0.01, 20.0), TemperatureDependence(2500.0))


def drive(seed: int, warm_C: float, rows: int = 600) -> CellLog:
    rng = np.random.default_rng(seed)
    load = random_load(
        rng, 3.0, 0.9, rows=rows, rate_hz=1.0, charge=True, temperature_C=(warm_C, warm_C)
    )
    warm = warm_C + 3.0 * np.sin(np.arange(load.time_s.size) / 200.0)
    return CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7), warm)


def at_the_cold() -> tuple[Coordinates, CellLog]:
    return Coordinates(curved_cell(effects=EFFECTS), unseen_C=COLD_C), drive(1, COLD_C)


def test_the_extended_model_is_what_the_fit_has_seen_and_stays_what_it_was_elsewhere() -> None:
    coordinates, log = at_the_cold()
    model = coordinates.model
    seen, _ = gather(model, [(log, START)]).simulate(coordinates, POINT)
    extended = extend_model(coordinates, POINT, {})
    found = simulate(extended, log, 0.9).voltage_V
    np.testing.assert_allclose(found, seen, rtol=0.0, atol=1e-9)
    warm = drive(2, 30.0)
    as_before = simulate(model, warm, 0.9).voltage_V
    np.testing.assert_allclose(simulate(extended, warm, 0.9).voltage_V, as_before, atol=1e-12)


@pytest.mark.parametrize(
    ("warm_C", "unseen"), [(2.0, True), (8.0, True), (18.0, False), (40.0, False), (52.0, True)]
)
def test_unseen_is_what_lies_outside_of_what_was_measured(warm_C: float, unseen: bool) -> None:
    valid = Validity((0.0, 1.0), (22.0, 38.0), (-3.0, 6.0))
    model = curved_cell(validity=valid)
    evidence = gather(model, [(drive(1, warm_C), START)])
    assert (unseen_temperature_C(model, evidence) is not None) == unseen


def test_an_error_that_is_larger_in_the_cold_is_stated_there_alone() -> None:
    model = curved_cell()
    found = with_error_at(model, COLD_C, 3.0).error
    assert float(found.at(0.5, COLD_C)) == pytest.approx(3.0 * float(model.error.at(0.5)))
    assert float(found.at(0.5, 25.0)) == pytest.approx(float(model.error.at(0.5)))


def cold_cell(model: CellModel) -> CellModel:
    """The same healthy cell in the cold: resistances grow most towards empty, OCV by entropy."""
    s = model.soc
    factor = np.exp(0.35 + 0.8 * (1.0 - s) ** 3)
    cold = {n: getattr(model, n)[0] * factor for n in ("r0_ohm", "r1_ohm", "r2_ohm")}
    ocv = model.ocv_V[0] + 23.0 * 1e-4 * (s - 0.4)
    both = {n: np.array([v, getattr(model, n)[0]]) for n, v in {**cold, "ocv_V": ocv}.items()}
    taus = {n: np.repeat(getattr(model, n), 2, axis=0) for n in ("tau1_s", "tau2_s")}
    grid = np.array([COLD_C, 25.0])
    return replace(model, temperature_C=grid, **both, **taus)


@pytest.mark.slow
def test_a_healthy_cell_that_is_cold_has_not_aged() -> None:
    """The model states the error that it has at its own temperature, 2 mV."""
    model = curved_cell(
        error=ModelError.of_white_and_slow(1e-3, (2e-3,), 600.0, 0.01),
        validity=Validity((0.0, 1.0), (20.0, 30.0), (-5.0, 8.0)),
    )
    rng = np.random.default_rng(71)
    logs = []
    for seed in (11, 12, 13):
        log = drive(seed, COLD_C, 3000)
        voltage = simulate(cold_cell(model), log, 0.9).voltage_V
        logs.append(replace(log, voltage_V=voltage + rng.normal(0.0, 1e-3, voltage.size)))
    said = diagnose(model, logs[:2], logs[2], soc0=0.9)
    assert said.verdict == "temperature_dependence"
    assert not AGE & {c.name for c in said.causes}
    run = said.runs[-1]
    assert run.after.rmse_V < 0.5 * run.before.rmse_V
    warm = drive(14, 25.0)
    as_before = simulate(model, warm, 0.9).voltage_V
    assert simulate(said.extended_model, warm, 0.9).voltage_V == pytest.approx(as_before, abs=5e-3)

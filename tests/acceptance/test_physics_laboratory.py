"""Stored cases of the physics laboratory: cells that PyBaMM made, judged as its benchmark does.

The whole laboratory, with a fresh seed: ``python -m benchmarks.physics_laboratory both FOLDER``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.physics_laboratory.score import judge
from benchmarks.physics_laboratory.stored import model_of, read_cases

from cellwise.cell.simulate import simulate
from cellwise.diagnose import diagnose

FOLDER = Path(__file__).parent / "physics_cases"
STUCK = slice(2100, 2400)


@pytest.fixture(scope="module")
def cases():
    return {case.changes: case for case in read_cases(FOLDER)}


def judged(case):
    return judge(case, model_of(FOLDER, case.cell), diagnose)


def test_the_model_of_the_healthy_cell_is_as_good_as_its_identification_was(cases):
    """Within three millivolt on drives that it has not seen; what is found below is no misfit."""
    healthy = cases[()]
    model = model_of(FOLDER, healthy.cell)
    starts = healthy.told or (None,) * 3
    for log, soc0 in zip((*healthy.logs, *healthy.holdout), starts, strict=True):
        assert simulate(model, log, soc0).rmse_V < 3e-3


@pytest.mark.slow
def test_nothing_is_found_in_a_healthy_cell(cases):
    found = judged(cases[()])
    assert found.acceptable, found.line()


@pytest.mark.slow
def test_a_contact_resistance_is_named_and_nothing_beside_it(cases):
    found = judged(cases[("contact_resistance",)])
    assert found.exact, found.line()
    assert not found.false_names, found.line()


@pytest.mark.slow
def test_a_voltage_that_stood_still_is_a_fault_of_its_sensor_and_no_other_cause(cases):
    healthy = cases[()]
    first = healthy.logs[0]
    voltage = first.voltage_V.copy()
    voltage[STUCK] = voltage[STUCK.start]
    broken = replace(first, voltage_V=voltage)
    found = judged(replace(healthy, changes=("stuck_V",), logs=(broken, *healthy.logs[1:])))
    assert found.exact, found.line()
    assert not found.false_names, found.line()
    assert np.sum(voltage != first.voltage_V) > 0

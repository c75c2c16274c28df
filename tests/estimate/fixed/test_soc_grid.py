"""SOC points of the tables: as few as the model's own stated error allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.estimate.fixed.tables import (
    MOST_MISSED,
    SOC_GRIDS,
    fixed_step_tables,
    missed_by,
    soc_grid,
)
from example_cells import curved_cell, linear_cell

SOC = np.linspace(0.0, 1.0, 201)


def kinked(at, size_V, stated_V=0.010):
    """A straight OCV with a tooth of ``size_V`` at one point of 201, and a stated error."""
    ocv_V = 3.2 + 0.9 * SOC
    ocv_V[at] += size_V
    error = ModelError.of_white_and_slow(slow_V=stated_V)
    return linear_cell(201, ocv_V=ocv_V, error=error)


@pytest.mark.parametrize(
    ("model", "points"),
    [
        (linear_cell(201), 51),  # a straight line has no miss
        (kinked(2, 0.003), 101),  # every second point is one of 101
        (kinked(1, 0.003), 201),
        (kinked(1, 0.003, stated_V=0.050), 51),  # the same tooth, within a quarter of the error
        (linear_cell(11), 11),  # never finer than the model
    ],
)
def test_the_fewest_points_that_lose_less_than_a_quarter_of_the_stated_error(model, points):
    assert soc_grid(model).points == points
    assert fixed_step_tables(model, 1.0).options.points == points


def test_r0_at_1C_is_missed_as_well():
    r0_ohm = np.full(201, 0.030)
    r0_ohm[1] += 0.001  # 3 mV at 3 A
    assert soc_grid(replace(kinked(1, 0.0), r0_ohm=r0_ohm)).points == 201


def test_every_temperature_counts():
    warm, cold = kinked(1, 0.0), kinked(1, 0.003)
    model = linear_cell(
        201, temperature_C=np.array([0.0, 25.0]), ocv_V=np.array([cold.ocv_V[0], warm.ocv_V[0]]),
        error=cold.error,
    )  # fmt: skip
    assert soc_grid(model).points == 201


@pytest.mark.parametrize("stated_V", [0.0002, 0.001, 0.005, 0.020, 0.1])
def test_no_coarser_grid_would_do(stated_V):
    model = replace(curved_cell(501), error=ModelError.of_white_and_slow(slow_V=stated_V))
    found = soc_grid(model)
    assert found.missed <= MOST_MISSED
    assert all(missed_by(model, n) > MOST_MISSED for n in SOC_GRIDS if n < found.points)


def test_what_is_asked_for_is_taken():
    assert fixed_step_tables(linear_cell(201), 1.0, points=77).options.points == 77
    assert "as asked for" in soc_grid(linear_cell(201), 77).text

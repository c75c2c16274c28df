"""An OCV of two published half cells: found again, and aged as charge and lithium demand."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.causes.electrodes import NEGATIVE, POSITIVE, Electrodes, electrodes_of
from cellwise.diagnose.extension import extend_model
from example_cells import linear_cell

SOC = np.linspace(0.0, 1.0, 101)
CELL = Electrodes("graphite with SiOx", "NMC 811", (0.03, 0.90, 0.86, 0.27), 0.0)


@pytest.mark.parametrize("name", [*NEGATIVE, *POSITIVE])
def test_published_potentials_fall_as_lithium_goes_in(name):
    # NCA's polynomial is one of a cell that never holds less than a third of its lithium.
    filled = np.linspace(0.34 if name == "NCA" else 0.05, 0.95, 200)
    potential = {**NEGATIVE, **POSITIVE}[name][0](filled)
    assert np.all(np.diff(potential) < 2e-4)


def test_the_half_cells_of_an_ocv_are_found_again():
    found = electrodes_of(SOC, CELL.ocv(SOC))
    assert (found.negative, found.positive) == (CELL.negative, CELL.positive)
    assert found.misfit_V < 2e-4
    assert found.window == pytest.approx(CELL.window, abs=0.01)


def test_an_ocv_of_no_published_half_cells_has_none():
    assert electrodes_of(SOC, 1.2 + 0.9 * SOC) is None


@pytest.mark.parametrize("losses", [(0.1, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.1)])
def test_full_and_empty_keep_their_voltages_and_lithium_is_conserved(losses):
    """The aged window, worked out here from the aged OCV alone: its ends and its lithium."""
    lithium, negative, positive = losses
    change, share = CELL.aged(SOC, *losses)
    assert change[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-6)
    q_n, q_p = (
        q * (1.0 - lost) for q, lost in zip(CELL.capacities, (negative, positive), strict=True)
    )
    left = CELL.lithium * (1.0 - lithium)
    x = np.linspace(0.0, min(1.0, left / q_n), 200_001)
    y = (left - q_n * x) / q_p
    inside = (y >= 0.0) & (y <= 1.0)
    x, y = x[inside], y[inside]
    full_cell = POSITIVE["NMC 811"][0](y) - NEGATIVE["graphite with SiOx"][0](x)
    empty_V, full_V = CELL.ocv(np.array([0.0, 1.0]))
    ends = np.interp([empty_V, full_V], full_cell, x)
    assert share == pytest.approx(q_n * (ends[1] - ends[0]), abs=1e-4)
    aged = np.interp(ends[0] + SOC * (ends[1] - ends[0]), x, full_cell)
    assert CELL.ocv(SOC) + change == pytest.approx(aged, abs=1e-4)


@pytest.mark.parametrize(
    ("losses", "window", "share"),
    [
        ((0.07, 0.0, 0.0), (0.0246513, 0.8192000, 0.7940965, 0.2638452), 0.8985340),
        ((0.0, 0.07, 0.0), (0.0263812, 0.9791592, 0.8551835, 0.2638452), 1.0020483),
        ((0.0, 0.0, 0.07), (0.0282560, 0.9382929, 0.9168816, 0.2638452), 1.0291366),
    ],
)
def test_aged_capacity_is_that_of_pybamm(losses, window, share):
    """PyBaMM 26.10, `get_min_max_stoichiometries` of Chen2020, healthy and with 7 % lost.

    Its windows are those of the aged cell; here they also give the OCV.
    """
    healthy = (0.026345790, 0.910618047, 0.853974675, 0.263845225)
    cell = Electrodes("graphite with SiOx", "NMC 811", healthy, 0.0)
    change, found = cell.aged(SOC, *losses)
    assert found == pytest.approx(share, abs=2e-6)
    aged = Electrodes("graphite with SiOx", "NMC 811", window, 0.0).ocv(SOC)
    assert cell.ocv(SOC) + change == pytest.approx(aged, abs=1e-5)


def test_a_model_of_no_published_half_cells_is_offered_no_losses():
    titanate = linear_cell(ocv_V=2.0 + 0.6 * np.linspace(0.0, 1.0, 11))
    assert not Coordinates(titanate).possible("lithium_loss")


def test_an_extended_model_has_the_aged_ocv_and_capacity():
    model = linear_cell(51, ocv_V=CELL.ocv(np.linspace(0.0, 1.0, 51)))
    new = extend_model(Coordinates(model), {"lithium_loss": 0.05}, {})
    change, share = Coordinates(model).electrodes.aged(model.soc, 0.05, 0.0, 0.0)
    assert new.capacity_Ah == pytest.approx(share * model.capacity_Ah)
    assert new.ocv_V[0] == pytest.approx(model.ocv_V[0] + change)


@pytest.mark.parametrize("losses", [(0.999, 0.0, 0.0), (0.0, 0.999, 0.0), (0.0, 0.0, 0.999)])
def test_a_cell_that_holds_nothing_any_more_has_a_finite_ocv(losses):
    """A search may come by: a step there has to be refused by its error, not end in NaN."""
    change, capacity = CELL.aged(SOC, *losses)
    assert np.all(np.isfinite(change))
    assert 0.0 < capacity < 0.1

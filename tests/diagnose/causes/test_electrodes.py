"""An OCV of two published half cells: found again, and aged as charge and lithium demand."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.diagnose.applied import extend_model
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.causes.electrodes import NEGATIVE, POSITIVE, Electrodes, electrodes_of
from example_cells import linear_cell

SOC = np.linspace(0.0, 1.0, 101)
CELL = Electrodes("graphite with SiOx", "NMC 811", (0.03, 0.90, 0.86, 0.27), 0.0)


@pytest.mark.parametrize("name", [*NEGATIVE, *POSITIVE])
def test_published_potentials_fall_as_lithium_goes_in(name):
    # NCA's polynomial is one of a cell that never holds less than a third of its lithium.
    filled = np.linspace(0.34 if name == "NCA" else 0.05, 0.95, 200)
    potential = {**NEGATIVE, **POSITIVE}[name](filled)
    assert np.all(np.diff(potential) < 2e-4)


def test_the_half_cells_of_an_ocv_are_found_again():
    found = electrodes_of(SOC, CELL.ocv(SOC))
    assert (found.negative, found.positive) == (CELL.negative, CELL.positive)
    assert found.misfit_V < 2e-4
    assert found.window == pytest.approx(CELL.window, abs=0.01)


def test_an_ocv_of_no_published_half_cells_has_none():
    assert electrodes_of(SOC, 1.2 + 0.9 * SOC) is None


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


def test_every_share_of_lost_lithium_has_a_finite_ocv():
    """Where the positive electrode ends up empty its share is 0 to the last bit, or below."""
    cell = Electrodes("graphite", "NCA", (0.02, 0.85, 0.93, 0.27), 0.0)
    soc = np.linspace(0.0, 1.0, 11)
    for lithium in np.linspace(0.0, 0.95, 400):
        change_V, held = cell.aged(soc, float(lithium), 0.0, 0.0)
        assert np.isfinite(change_V).all()
        assert np.isfinite(held)

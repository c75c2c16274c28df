"""How far a capacity is open, on made cells that are in no prior."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.fit.capacity import TRIED, open_capacity, opened
from cellwise.fit.population import cell_classes, prior_of
from cellwise.fit.problem import Problem
from cellwise.fit.rows import FitLog
from cellwise.fit.solve import fit_logs
from cellwise.fit.unknowns import FitSettings, layout_of
from synthetic import drive_current, driven_log, lfp_cell, nmc_cell

CELLS = {"layered": nmc_cell(3.0), "lfp": lfp_cell(3.0)}
CLASSES = {c.name: c for c in cell_classes()}
GRID = np.array([25.0])


def driven(name, used):
    """A drive from full until a share of the charge is gone."""
    cell = CELLS[name]
    current = drive_current(6 * 3600, 1.0, 6.0, np.random.default_rng(4))
    gone = np.cumsum(current) / 3600.0 / cell.capacity_Ah
    return driven_log(cell, current[: int(np.argmax(gone > used))], 1.0, soc=1.0, noise_V=5e-4)


def settled(name, log, taken_Ah):
    """Fit of a drive over a capacity that is taken, its problem, the capacity by the profile."""
    layout = layout_of(3, name == "lfp")
    settings = FitSettings(hysteresis=layout.hysteresis, ln_capacity_std=0.1)
    items = (FitLog(log, 1.0, soc0_std=0.004),)
    cells = CLASSES[name]
    prior = prior_of(cells, layout, items, taken_Ah, GRID, 25.0, settings)
    fit = fit_logs(items, cells.base(), prior, layout, capacity_Ah=taken_Ah, iterations=20)
    problem = Problem(items, cells.base(), prior, layout, taken_Ah, GRID, 25.0, 800)
    return fit, problem, open_capacity(problem, fit)


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize("label", [0.93, 1.08])
def test_the_true_capacity_is_inside_whatever_the_label_says(name, label):
    true_Ah = CELLS[name].capacity_Ah
    _, _, found = settled(name, driven(name, 0.96), label * true_Ah)
    assert abs(found.mean + np.log(label)) < 2.5 * found.std
    assert found.std < 0.08


@pytest.mark.slow
def test_a_short_drive_leaves_what_the_label_leaves():
    """A tenth of the charge says next to nothing of the whole."""
    fit, problem, found = settled("layered", driven("layered", 0.1), 3.0)
    assert 0.08 < found.std < 0.13
    assert problem.prior.free[fit.layout.capacity]
    assert found.std >= TRIED.step / np.sqrt(12.0)


def test_a_deviation_is_changed_and_what_does_not_follow_stays():
    root = np.random.default_rng(1).normal(size=(4, 4))
    before = root @ root.T
    before[3, :3] = before[:3, 3] = 0.0
    after = opened(before, 0, 5.0)
    assert after[0, 0] == pytest.approx(25.0)
    assert np.allclose(after[:, 3], before[:, 3])
    # Given the first unknown, the others are as open as they were.
    for m in (before, after):
        given = m[1:, 1:] - np.outer(m[1:, 0], m[1:, 0]) / m[0, 0]
        assert np.allclose(
            given, before[1:, 1:] - np.outer(before[1:, 0], before[1:, 0]) / before[0, 0]
        )

"""The capacity by its marginal likelihood, on made cells that are in no prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.fit.capacity import TRIED, weigh_capacities
from cellwise.fit.population import cell_classes, prior_of
from cellwise.fit.problem import Problem
from cellwise.fit.rows import FitLog
from cellwise.fit.solve import fit_logs
from cellwise.fit.unknowns import FitSettings, layout_of
from synthetic import drive_current, driven_log, lfp_cell, nmc_cell

CELLS = {"layered": nmc_cell(3.0), "lfp": lfp_cell(3.0)}
CLASSES = {c.name: c for c in cell_classes()}
GRID = np.array([25.0])

pytestmark = pytest.mark.slow


def driven_empty(name, seed, used=0.96):
    """A drive from full until most is gone, of a cell whose capacity the counter shows."""
    cell = CELLS[name]
    current = drive_current(6 * 3600, 1.0, 6.0, np.random.default_rng(seed))
    share = np.cumsum(current) / 3600.0 / cell.capacity_Ah
    end = int(np.argmax(share > used)) or len(current)
    return driven_log(cell, current[:end], 1.0, soc=1.0, noise_V=5e-4)


def weighed(name, log, taken_Ah):
    """The fit of a drive over a capacity that is taken, and the capacities weighed."""
    lay = layout_of(3, name == "lfp")
    settings = FitSettings(hysteresis=lay.hysteresis, ln_capacity_std=0.1)
    items = (FitLog(log, 1.0, soc0_std=0.004),)
    cells = CLASSES[name]
    prior = prior_of(cells, lay, items, taken_Ah, GRID, 25.0, settings)
    fit = fit_logs(items, cells.base(), prior, lay, capacity_Ah=taken_Ah, iterations=20)
    problem = Problem(items, cells.base(), prior, lay, taken_Ah, GRID, 25.0, 800)
    return fit, problem, weigh_capacities(problem, fit)


MISSED = pytest.mark.xfail(
    strict=True,
    reason="7 to 9 % too large, 3 % stated; a measured LFP cell is held",
)


@pytest.mark.parametrize("name", ["layered", pytest.param("lfp", marks=MISSED)])
@pytest.mark.parametrize("label", [0.93, 1.08])
def test_the_true_capacity_is_inside_whatever_the_label_says(name, label):
    true_Ah = CELLS[name].capacity_Ah
    _, _, found = weighed(name, driven_empty(name, 4), label * true_Ah)
    away = found.median + np.log(label)
    assert abs(away) < 2.5 * found.std
    assert abs(away) < 0.06


def test_the_others_follow_the_capacity():
    """At another capacity a fit ends nearer to the regression than to where it began."""
    fit, problem, found = weighed("layered", driven_empty("layered", 4), 3.1)
    place, step = fit.layout.capacity, 2.0 * TRIED.step
    problem.prior = problem.prior.held(place, found.median + step)
    first = found.theta.copy()
    first[place] += step
    first = problem.inside(first)
    problem.judge_sizes(first)
    there, *_ = problem.minimise(first, 30)
    ocv = slice(0, fit.layout.knots_ocv)
    followed = (found.theta + step * found.slope)[ocv]
    assert np.linalg.norm(there[ocv] - followed) < np.linalg.norm(there[ocv] - found.theta[ocv])


def test_the_problem_is_left_as_it_was():
    fit, problem, found = weighed("layered", driven_empty("layered", 4), 3.0)
    place = fit.layout.capacity
    assert problem.prior.free[place]
    assert found.slope[place] == 1.0
    assert found.std >= TRIED.step / np.sqrt(12.0)
    with pytest.raises(AttributeError):
        replace(problem.prior, mean=None).held(place, 0.0)

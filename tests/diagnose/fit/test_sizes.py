"""What is known of sizes beforehand: priors of sensors, and of starts that one source has given."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from cellwise import simulate
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.least_squares import Prior
from cellwise.diagnose.fit.priors import (
    CLASS,
    GOOD,
    ln_size,
    tolerances,
    widened_for,
)
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
from emulator_drives import random_load
from example_cells import curved_cell


@pytest.mark.parametrize("name", CLASS)
@pytest.mark.parametrize("x", [0.0, 0.004, 0.03])
def test_a_sensor_keeps_its_class_or_is_one_of_the_few_that_are_wrong(name, x):
    usual, other = CLASS[name]
    wide = 0.05
    wrong = GOOD.wrong_class
    density = (1.0 - wrong) * norm.pdf(x, 0.0, usual) + wrong * norm.pdf(x, 0.0, other)
    found = ln_size({name: x}, [name], Prior({name: wide}, {}, {}, {}))
    assert found == pytest.approx(np.log(density) - norm.logpdf(x, 0.0, wide))


def test_coordinates_that_are_together_correlate_and_keep_their_size():
    prior = Prior({"a": 0.2, "b": 0.1, "c": 0.5}, {}, {}, {}).together(("b", "a"), 0.8)
    covariance = np.linalg.inv(prior.precision())
    expected = [[0.04, 0.016, 0.0], [0.016, 0.01, 0.0], [0.0, 0.0, 0.25]]
    np.testing.assert_allclose(covariance, expected, atol=1e-12)
    again = prior.together(("c",), 0.8)
    np.testing.assert_allclose(np.linalg.inv(again.precision()), expected, atol=1e-12)


def test_starts_that_are_all_wrong_by_as_much_are_likelier_than_one_against_the_other():
    model, rng, logs = curved_cell(), np.random.default_rng(2), []
    for _ in range(2):
        load = random_load(
            rng, model.capacity_Ah, 0.9, rows=400, rate_hz=1.0, charge=False,
            temperature_C=(25.0, 25.0),
        )  # fmt: skip
        log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
        log = CellLog(load.time_s, load.current_A, simulate(model, log, 0.9).voltage_V)
        logs.append((log, initial_soc(model, log, 0.9, 0.0015)))
    evidence, coordinates = gather(model, logs), Coordinates(model)
    prior = tolerances(coordinates, evidence)
    wide = widened_for(prior, CAUSES["initial_soc"], coordinates, evidence)
    std = CAUSES["initial_soc"].parameters[0].wide
    place = [wide.names.index(n) for n in evidence.starts()]
    covariance = np.linalg.inv(wide.precision())[np.ix_(place, place)]
    assert np.sqrt(np.diag(covariance)) == pytest.approx([std, std])
    assert covariance[0, 1] == pytest.approx(GOOD.stated_alike * std**2)
    alike, apart = multivariate_normal(cov=covariance).logpdf([[0.05, 0.05], [0.05, -0.05]])
    assert alike > apart
    found = [(log, initial_soc(model, log)) for log, _ in logs]
    evidence = gather(model, found)
    alone = widened_for(
        tolerances(coordinates, evidence), CAUSES["initial_soc"], coordinates, evidence
    )
    assert alone.cross is None  # each was found on its own

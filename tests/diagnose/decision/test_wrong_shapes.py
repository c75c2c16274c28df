"""Nature's effects differ from the causes' shapes: what that leaves is no second cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import CellLog, diagnose, simulate
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model_error import ModelError
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.likelihood import LEVELS, SHAPE_SHARES, wrong_shapes
from cellwise.diagnose.fit.priors import tolerances
from cellwise.diagnose.fit.rests import rest_voltages
from cellwise.diagnose.fit.rows import gather
from example_cells import curved_cell

SOC0 = 0.95
CELL = replace(curved_cell(), error=ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01))


def drive(cell, seed, rows=7200):
    rng = np.random.default_rng(seed)
    level = rng.choice([0.0, 0.5, 1.0, 2.0, -0.5], rows // 30, p=[0.2, 0.25, 0.25, 0.15, 0.15])
    current = np.repeat(level, 30) * 0.65 * cell.capacity_Ah
    log = CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), name=f"drive {seed}")
    voltage = simulate(cell, log, SOC0).voltage_V + rng.normal(0.0, 1e-3, rows)
    return replace(log, voltage_V=voltage)


BESIDE = pytest.mark.xfail(
    strict=True, reason="surface_soc of four thousand seconds beside it (0.91)"
)


@pytest.mark.slow
@pytest.mark.parametrize("uneven", [pytest.param(0.0, marks=BESIDE), 0.3, 0.5])
def test_a_resistance_that_grew_unevenly_is_one_cause(uneven):
    """Half as much again in the mean, more or less of it along the SOC."""
    share = 0.5 * (1.0 + uneven * np.sin(2.6 * np.pi * CELL.soc))
    grown = replace(CELL, r0_ohm=CELL.r0_ohm * (1.0 + share))
    logs = [drive(grown, seed) for seed in (1, 2, 3)]
    found = diagnose(CELL, logs[:2], holdout=logs[2:], soc0=SOC0)
    assert [c.name for c in found.causes] == ["ohmic_resistance"]


@pytest.fixture(scope="module")
def fits():
    logs = [(log, initial_soc(CELL, log, SOC0)) for log in (drive(CELL, 1, 1800),)]
    evidence, coordinates = gather(CELL, logs), Coordinates(CELL)
    rests = rest_voltages(evidence.logs, CELL.capacity_Ah, CELL.charge_efficiency)
    return CauseFits(evidence, coordinates, tolerances(coordinates, evidence), rests, 0)


def moved(fits, name, coordinate, value):
    base, _ = fits.base(fits.prior)
    voltage, soc = fits.evidence.simulate(base.coordinates, {**base.z, coordinate: value})
    there = replace(base, z={**base.z, coordinate: value}, voltage_V=voltage, soc=soc)
    return fits.effects_V(there, [CAUSES[name]]), there


def test_wrong_shapes_are_local_shares_of_an_effect(fits):
    effect, there = moved(fits, "ohmic_resistance", "added_r0", 0.3)
    assert np.sqrt(np.mean(effect**2)) > 1e-3
    columns = wrong_shapes(fits.evidence, effect, there.soc)
    assert columns.shape == (fits.evidence.rows, 2 * LEVELS)
    # All levels a tenth larger are the effect a tenth larger.
    np.testing.assert_allclose(columns[:, ::2].sum(axis=1), effect[:, 0], atol=1e-12)
    level = np.sqrt(np.mean(effect**2))
    np.testing.assert_allclose(columns[:, 1::2].sum(axis=1), level, rtol=1e-9)


def test_a_fault_of_a_sensor_has_its_shape_exactly(fits):
    effect, there = moved(fits, "voltage_offset", "offset_V", 0.02)
    assert effect.shape == (fits.evidence.rows, 0)
    assert wrong_shapes(fits.evidence, effect, there.soc).shape == (fits.evidence.rows, 0)


def test_the_shares_are_a_distribution():
    assert sum(SHAPE_SHARES.values()) == pytest.approx(1.0)

"""A start that was read from a rest: what an offset or another OCV makes of the same reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import simulate
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model_error import ModelError
from cellwise.diagnose import diagnose
from cellwise.diagnose.applied import extend_model
from cellwise.diagnose.causes.coordinates import OCV_NAMES, Coordinates
from cellwise.diagnose.fit.coordinate_fit import Tolerances
from cellwise.diagnose.fit.priors import start_readings
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from virtual_tester import logged

SOC0 = 0.82
MODEL = replace(curved_cell(), error=ModelError.of_white_and_slow(1e-3, (2e-3,), 60.0, 0.01))


def rested_log(seed, offset_V=0.0, rows=1800):
    """Two minutes of rest, then a random load; the voltage is read too high."""
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.uniform(-1.5, 3.0, rows // 15), 15)
    current[:120] = 0.0
    asked = CellLog(np.arange(float(rows)), current, np.full(rows, 3.7), name=f"drive {seed}")
    voltage = simulate(MODEL, asked, SOC0).voltage_V + rng.normal(0.0, 5e-4, rows)
    return replace(asked, voltage_V=voltage + offset_V)


def gathered(*logs, given=None):
    return gather(MODEL, [(log, initial_soc(MODEL, log, given, 0.005)) for log in logs])


@pytest.mark.parametrize("offset_V", [0.004, -0.02])
def test_without_its_offset_a_rest_is_read_as_predicted(offset_V):
    log = rested_log(1, offset_V)
    evidence = gathered(log)
    read = start_readings(["offset_V"], Coordinates(MODEL), evidence)["soc0:0"]["offset_V"]
    right = initial_soc(MODEL, replace(log, voltage_V=log.voltage_V - offset_V)).soc
    assert read * offset_V == pytest.approx(right - evidence.logs[0].start.soc, rel=0.1)


@pytest.mark.parametrize(("soc", "branch"), [(0.82, 1.0), (0.3, -1.0)])
def test_with_a_hysteresis_a_rest_is_read_as_predicted(soc, branch):
    """A full cell was charged, an empty one discharged, as every simulation starts."""
    rest = CellLog(np.arange(300.0), np.zeros(300), np.full(300, 3.7))
    coordinates = Coordinates(MODEL)
    cell = extend_model(coordinates, {"m_V": 0.008}, {})
    evidence = gathered(logged(cell, rest, soc))
    read = start_readings(["m_V"], coordinates, evidence)["soc0:0"]["m_V"]
    assert np.sign(read) == -branch
    assert 0.008 * read == pytest.approx(soc - evidence.logs[0].start.soc, rel=0.15)


def test_a_start_that_was_given_was_not_read():
    evidence = gathered(rested_log(3), given=SOC0)
    assert start_readings(["offset_V", *OCV_NAMES], Coordinates(MODEL), evidence) == {}


def test_the_prior_is_that_of_the_reading():
    """Start = its reading + 2 x offset: their covariance by hand."""
    read = {"soc0:0": {"offset_V": 2.0}}
    prior = Tolerances({"soc0:0": 0.1, "offset_V": 0.3}, {}, {}, {}, read=read)
    expected = [[0.1**2 + (2.0 * 0.3) ** 2, 2.0 * 0.3**2], [2.0 * 0.3**2, 0.3**2]]
    np.testing.assert_allclose(np.linalg.inv(prior.precision()), expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("offset_V", [0.03, -0.03])
def test_a_voltage_offset_is_named_though_every_start_was_read_with_it(offset_V):
    """It differs from another OCV or capacity by what the readings at rest mean with it."""
    logs = [rested_log(seed, offset_V, 7200) for seed in (4, 5, 6)]  # over half of the SOC
    said = diagnose(MODEL, logs[:2], holdout=logs[2:])
    assert [c.name for c in said.causes] == ["voltage_offset"]
    assert said.causes[0].parameters["offset_V"] == pytest.approx(offset_V, rel=0.15)


def test_of_several_logs_the_one_whose_sensor_is_off_is_named():
    """Every start is stated: what one log alone has is its sensor's, not its start's."""
    logs = [rested_log(seed, -0.03 * (seed == 5), 2400) for seed in (4, 5, 6, 7)]
    said = diagnose(
        MODEL, logs[:3], logs[3], soc0=SOC0, causes=["voltage_offset", "initial_soc", "ocv_shift"]
    )
    (cause,) = said.causes
    assert (cause.name, cause.log) == ("voltage_offset", "drive 5")
    assert cause.parameters["offset_V"] == pytest.approx(-0.03, abs=2e-3)
    # The others and the log that was held out are as they were; its own is corrected.
    assert [c is g for c, g in zip(said.corrected, said.logs, strict=True)] == [True, False, True]
    assert cause.gain == 0.0
    assert said.runs[1].gain > 0.8

"""Rests as referee of claims on charge: theorems of relaxations, cells of known charge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.diagnose.applied import extend_model
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.causes.electrodes import Electrodes
from cellwise.diagnose.fit.rests import rest_reading, rest_voltages
from cellwise.diagnose.fit.rows import gather
from cellwise.fit.start import initial_soc
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, linear_cell

CELL = curved_cell()
RELAX_S = 400


def discharged(shape, rest_s=RELAX_S, charge=False, cell=CELL):
    """An hour at C/2, then a rest whose voltage goes to the OCV as ``shape(t)`` goes to zero."""
    current = np.full(3600, (-0.5 if charge else 0.5) * cell.capacity_Ah)
    time = np.arange(3600.0 + rest_s)
    log = CellLog(time, np.concatenate((current, np.zeros(rest_s))), np.full(time.size, 3.7))
    start = 0.3 if charge else 0.9
    end = start - float(np.sum(current[1:])) / 3600.0 / cell.capacity_Ah
    ocv = float(np.interp(end, cell.soc, cell.ocv_V[0]))
    sign = -1.0 if charge else 1.0
    voltage = simulate(cell, log, start).voltage_V.copy()
    voltage[3600:] = ocv - sign * shape(np.arange(rest_s) + 1.0)
    return replace(log, voltage_V=voltage), start, end, ocv


def found_in(log, start):
    rows = gather(CELL, [(log, initial_soc(CELL, log, start, 0.002))]).logs
    return rest_voltages(rows, CELL.capacity_Ah, CELL.charge_efficiency)


@pytest.mark.parametrize("charge", [False, True])
@pytest.mark.parametrize(
    "shape",
    [
        lambda t: 0.04 * np.exp(-t / 150.0),
        lambda t: 0.02 * np.exp(-t / 60.0) + 0.03 * np.exp(-t / 2000.0),
        lambda t: 0.05 / np.sqrt(1.0 + t / 50.0),
        lambda t: 0.03 * np.exp(-t / 1e5),
    ],
)
def test_a_relaxation_never_puts_the_bound_beyond_the_ocv(shape, charge):
    """Whatever mixture of exponentials is left: the OCV lies on the far side of the bound."""
    log, start, end, ocv = discharged(shape, charge=charge)
    (rest,) = found_in(log, start).rests
    assert rest.direction == (-1 if charge else 1)
    assert rest.direction * (ocv - rest.voltage_V) > -1e-4
    assert rest.soc(start, {}, CELL.capacity_Ah) == pytest.approx(end, abs=1e-6)


def test_one_exponential_is_extrapolated_to_its_end():
    log, start, _, ocv = discharged(lambda t: 0.04 * np.exp(-t / 150.0))
    (rest,) = found_in(log, start).rests
    assert rest.voltage_V == pytest.approx(ocv, abs=2e-4)


@pytest.mark.parametrize(
    ("claim", "holds"),
    [
        ({"ln_capacity": -0.15}, False),
        ({"ln_gain": -0.15}, False),
        ({"offset_A": -0.08 * CELL.capacity_Ah}, False),
        ({"leak_A": 0.08 * CELL.capacity_Ah}, False),
        ({"soc0:0": -0.08}, False),
        ({"ln_capacity": -0.002}, True),
        ({"ln_scale": 0.5}, True),
        ({"ln_capacity": -0.15, "soc0:0": 0.5 * (np.exp(0.15) - 1.0)}, True),
    ],
)
def test_claims_on_charge_must_agree_with_a_rest(claim, holds):
    """What empties the cell further than the rest allows is refuted, a resistance is not."""
    log, start, _, _ = discharged(lambda t: 0.03 * np.exp(-t / 200.0))
    rests, coordinates = found_in(log, start), Coordinates(CELL)
    lost = rests.ln_likelihood(coordinates, {}) - rests.ln_likelihood(coordinates, claim)
    assert (lost < 4.5) == holds
    if not holds:
        assert "a rest" in rests.contradiction(coordinates, claim)


def test_a_rest_does_not_reach_over_a_gap_and_one_at_the_start_says_nothing():
    log, start, _, ocv = discharged(lambda t: 0.03 * np.exp(-t / 200.0))
    time = log.time_s.copy()
    time[3800:] += 5000.0
    first, second = found_in(replace(log, time_s=time), start).rests
    assert first.hours == pytest.approx(3799.0 / 3600.0)
    assert second.hours > 2.0
    assert ocv - first.voltage_V > -1e-4
    resting = log.part(3600, len(log))
    assert found_in(resting, start).rests == ()


def test_a_sensor_that_reads_nothing_at_rest_has_no_offset():
    log, _, _, _ = discharged(lambda t: 0.03 * np.exp(-t / 200.0))
    quiet = rest_reading([log], CELL.capacity_Ah)
    assert quiet.zero
    crawling = replace(log, current_A=np.where(log.time_s < 600.0, 0.04, 1.0) * log.current_A)
    assert rest_reading([crawling], CELL.capacity_Ah).zero  # whatever small loads read beside it
    assert quiet.ln_likelihood({"offset_A": 0.05 * CELL.capacity_Ah}) < -1000.0
    shifted = replace(log, current_A=log.current_A + 0.03 * CELL.capacity_Ah)
    load = rest_reading([shifted], CELL.capacity_Ah)
    assert not load.zero  # a load that never switches off looks the same
    assert load.ln_likelihood({}) > -13.0


def test_lithium_that_was_lost_is_a_claim_on_charge():
    """An hour at C/2 ends where the smaller capacity says, on the OCV of the aged electrodes."""
    soc = np.linspace(0.0, 1.0, 101)
    fresh = Electrodes("graphite with SiOx", "NMC 811", (0.03, 0.90, 0.86, 0.27), 0.0)
    known = linear_cell(
        101, ocv_V=fresh.ocv(soc), error=ModelError.of_white_and_slow(1e-3, (2e-3,), 300.0, 0.02)
    )
    coordinates = Coordinates(known)
    aged = {"lithium_loss": 0.1}
    model = extend_model(coordinates, aged, {})
    log, start, _, _ = discharged(lambda t: 0.0 * t, cell=model)
    rows = gather(coordinates.model, [(log, initial_soc(coordinates.model, log, start, 0.002))])
    rests = rest_voltages(rows.logs, coordinates.model.capacity_Ah, 1.0)
    assert rests.ln_likelihood(coordinates, aged) > -0.1
    assert rests.ln_likelihood(coordinates, {}) < -2.0

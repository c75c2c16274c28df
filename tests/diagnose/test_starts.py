"""A diagnosis starts every log where `simulate` does, and is no surer of that than the log is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc.gaps import simulate
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate as simulate_from
from cellwise.diagnose import diagnose
from cellwise.diagnose.applied import starts_with
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.priors import tolerances
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

ROWS, SOC0 = 2400, 0.82


@pytest.fixture(scope="module")
def unsure():
    """A model that states much of its error, so that a short rest leaves the start open."""
    model = curved_cell()
    return replace(model, error=ModelError.of_white_and_slow(slow_V=0.03))


def measured(model, loaded_from):
    """A drive after a rest that is not over: 12 mV are left of what was before it."""
    rng = np.random.default_rng(5)
    current = np.repeat(rng.normal(1.2, 1.5, ROWS // 12), 12)
    current[:loaded_from] = 0.0
    log = CellLog(np.arange(float(ROWS)), current, np.full(ROWS, 3.7), name="drive")
    left = 0.012 * np.exp(-log.time_s / 120.0)
    return replace(log, voltage_V=simulate_from(model, log, SOC0).voltage_V - left)


@pytest.mark.parametrize("loaded_from", [90, 0])
def test_a_log_starts_where_simulate_starts_it(unsure, loaded_from):
    log, held = measured(unsure, loaded_from), measured(unsure, loaded_from)
    shown = simulate(unsure, log)
    assert initial_soc(unsure, log).std > 0.02
    found = diagnose(unsure, [log], holdout=[held], causes=["current_offset"])
    for run in found.runs:
        assert run.before.soc0 == shown.soc0
        assert run.before.rmse_V == shown.rmse_V


def test_the_fit_is_no_surer_of_a_start_than_the_first_rows_are(unsure):
    """A start that the wrong model chose by all rows would hold against what makes it wrong."""
    log = measured(unsure, 90)
    first = initial_soc(unsure, log)
    start = initial_soc(unsure, log, whole_log=True)
    assert start.std < 0.8 * first.std
    prior = tolerances(Coordinates(unsure), gather(unsure, [(log, start)]))
    assert prior.std["soc0:0"] == first.std
    assert start.soc + prior.mean["soc0:0"] == pytest.approx(first.soc)
    assert prior.low["soc0:0"] < 0.0 < prior.high["soc0:0"]


def test_a_start_that_the_wrong_model_chose_is_not_held_against_the_right_cause(unsure):
    """All of the log took the model for right: with another model it says another start."""
    start = initial_soc(unsure, measured(unsure, 0), whole_log=True)
    assert start.beginning is not None
    given, z = InitialSoc(SOC0, 0.005, "given"), {"soc0:0": 0.03, "soc0:1": 0.03}
    moved = (start.soc + 0.03, SOC0)
    assert starts_with({"cell"}, False, z, [start, given]) == pytest.approx(moved)
    assert starts_with({"cell"}, False, z, [given]) is None


def test_a_rest_is_read_again_where_the_ocv_is_another_one():
    starts = (
        InitialSoc(0.8, 0.02, "rest of 90 s at the start, 3.9 V"),
        InitialSoc(SOC0, 0.005, "given"),
    )
    z = {"soc0:0": 0.03, "soc0:1": 0.03}
    assert starts_with({"cell"}, True, z, starts) == pytest.approx((0.83, SOC0))
    assert starts_with({"cell"}, False, z, starts) is None
    assert starts_with({"start"}, False, z, starts) == pytest.approx((0.83, SOC0 + 0.03))


@pytest.mark.slow
def test_a_second_diagnosis_in_one_process_says_the_same(unsure):
    """To the bit: nothing is carried over, and no sum depends on which thread was first."""
    log = measured(replace(unsure, r0_ohm=1.4 * unsure.r0_ohm), 90)
    held = measured(replace(unsure, r0_ohm=1.4 * unsure.r0_ohm), 0)
    first, other, again = (
        diagnose(unsure, [g], holdout=[h]).to_dict()
        for g, h in ((log, held), (held, log), (log, held))
    )
    assert first != other
    assert again == first

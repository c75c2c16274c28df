"""Another package's step interface in the benchmark: its prediction is ours, its SOC comes home."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.benchmark.adapter import Adapted, load_adapter
from cellwise.cell.simulate import simulate
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

pytest.importorskip("thevenin", reason="the example adapts it: pip install 'cellwise[benchmark]'")
NAME = "cellwise.benchmark.thevenin_observer:TheveninObserver"


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    cell = curved_cell()
    rng = np.random.default_rng(2)
    current = np.repeat(rng.normal(0.8, 1.5, 60), 20)
    current[:20] = 0.0
    log = CellLog(np.arange(1200.0), current, np.full(1200, 3.7), name="drive")
    log = replace(log, voltage_V=simulate(cell, log, 0.8).voltage_V)
    make = load_adapter(NAME, tmp_path_factory.mktemp("nowhere"))
    return cell, log, Adapted("thevenin", cell, make)


def test_its_prediction_is_the_model(case):
    cell, log, theirs = case
    trace = theirs.run(log, 0.8)
    # The parameters move with the SOC inside a step there, and not here.
    np.testing.assert_allclose(trace.voltage_V[1:], log.voltage_V[1:], atol=2e-3)
    assert np.max(np.abs(trace.soc - simulate(cell, log, 0.8).soc)) < 0.01


def test_a_wrong_start_is_forgotten(case):
    cell, log, theirs = case
    error = theirs.run(log, 0.5).soc - simulate(cell, log, 0.8).soc
    assert abs(error[0]) > 0.25
    assert np.max(np.abs(error[-300:])) < 0.02

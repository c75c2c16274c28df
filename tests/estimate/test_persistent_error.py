"""An error of the model that stays: it widens what is told of the SOC, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.estimate.adaptive import Adaptive
from cellwise.estimate.equations.evidence import persistent_step
from cellwise.estimate.filters.kalman import Ekf, Ukf
from cellwise.estimate.noise import Noise
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell, linear_cell
from virtual_tester import logged

ERROR_V = 0.008
FILTERS = (Ekf, Ukf, Adaptive)


def cycled(model, rows=2000, dt=10.0, seed=1):
    """Hours of charge and discharge about half charge, the model's own voltage."""
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(0.0, 1.0, rows // 20 + 1), 20)[:rows] * model.capacity_Ah
    current -= np.mean(current)
    current[0] = 0.0
    log = CellLog(dt * np.arange(rows), current, np.full(rows, 3.7))
    return logged(model, log, 0.5)


def moved(log, volt):
    return replace(log, voltage_V=log.voltage_V + volt)


@pytest.mark.parametrize("filter_", [Ekf, Ukf])
def test_the_estimate_itself_is_the_same(filter_):
    model = curved_cell()
    log = moved(cycled(model), 0.004)
    kept = Noise(mismatch_cap=0.0)
    none, half = (
        filter_(model, replace(kept, lasting_share=s)).run(log, 0.6, 0.1) for s in (0.0, 0.5)
    )
    np.testing.assert_array_equal(none.soc, half.soc)
    np.testing.assert_array_equal(none.innovation_variance_V2, half.innovation_variance_V2)
    assert np.all(none.soc_std <= half.soc_std)
    assert half.soc_std[-1] > 1.2 * none.soc_std[-1]


@pytest.mark.parametrize("filter_", [Ekf, Ukf])
def test_it_is_how_far_such_an_error_moves_the_soc(filter_):
    """Linear cell without branches: the difference of two runs, one voltage off by the error."""
    tiny = np.full(11, 1e-9)
    error = ModelError.of_white_and_slow(white_V=0.001, slow_V=(ERROR_V,))
    model = linear_cell(r1_ohm=tiny, r2_ohm=tiny, error=error)
    noise = Noise(
        current_A=0.0, branch_share=0.0, ocv_soc=0.0, mismatch_cap=0.0, gate=1e9, lasting_share=1.0
    )
    log = cycled(model)
    right, wrong = (filter_(model, noise).run(x, 0.5, 0.1) for x in (log, moved(log, ERROR_V)))
    plain = filter_(model, replace(noise, lasting_share=0.0)).run(log, 0.5, 0.1)
    lasting = np.sqrt(right.soc_std**2 - plain.soc_std**2)
    late = slice(200, None)
    np.testing.assert_allclose((wrong.soc - right.soc)[late], lasting[late], rtol=0.01)
    assert lasting[-1] == pytest.approx(ERROR_V / 0.9, rel=0.1)  # error over slope in the end


@pytest.mark.parametrize(("share", "least", "most"), [(1.0, 0.93, 0.99), (0.0, 0.0, 0.75)])
def test_coverage_where_every_cell_has_an_offset_of_its_own(share, least, most):
    """Without it the band shrinks about a wrong SOC for as long as the log goes on."""
    model = replace(curved_cell(), error=ModelError.of_white_and_slow(slow_V=(ERROR_V,)))
    ekf = Ekf(model, Noise(lasting_share=share))
    log = cycled(model, rows=3000)
    truth = simulate(model, log, 0.5).soc
    inside = []
    for z in np.random.default_rng(3).standard_normal(60):
        trace = ekf.run(moved(log, z * ERROR_V), 0.5, 0.1)
        inside.append(np.abs(trace.soc - truth) <= 2.0 * trace.soc_std)
    assert least <= np.mean(inside) <= most


@pytest.mark.parametrize("gain", [-0.02, 0.02, 5.0])
def test_no_gain_amplifies_a_persistent_error(gain):
    """The gain of a SOC that hangs on a slow branch can be negative for many rows."""
    persistent = 0.0
    for _ in range(2000):
        persistent = persistent_step(gain, 0.9, persistent, ERROR_V)
    assert abs(persistent) <= max(2000 * 0.02 * ERROR_V, 5.0 * ERROR_V) * (1.0 + 1e-9)
    if gain == 0.02:
        assert persistent == pytest.approx(ERROR_V / 0.9, rel=1e-6)


@pytest.mark.parametrize("filter_", [Ekf, Ukf])
def test_where_voltages_show_more_than_is_stated_so_much_more_may_be_wrong(filter_):
    model = replace(curved_cell(), error=ModelError.of_white_and_slow(slow_V=(0.002,)))
    log = cycled(model)
    for wrong_V, wider in ((0.0, False), (0.05, True)):
        off = moved(log, wrong_V * np.sin(log.time_s / 900.0))
        trusted, seen = (
            filter_(model, replace(Noise(), lasting_share=0.0, offset_share=0.0)).run(off, 0.5, s)
            for s in (1e-6, 0.05)
        )
        kept = Noise(mismatch_cap=0.0, lasting_share=0.0, offset_share=0.0)
        still = filter_(model, kept).run(off, 0.5, 0.05)
        ratio = np.median(seen.soc_std[200:] / still.soc_std[200:])
        assert (ratio > 1.5) == wider
        assert trusted.soc_std[1] < 1e-3  # what nobody measured yet contradicts nothing

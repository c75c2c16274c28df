"""Remaining time of the fixed step: the float64's, the same bits in C, never NaN, apart from it."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest

from cellwise.cell.equations import CellState
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import LANDING, OUTLOOK, PHASE
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.forecast.ahead_kernels import Going, with_ends
from cellwise.forecast.remaining import uncertain_of
from cellwise.forecast.warming_kernels import STEADY
from example_cells import curved_cell, lfp_cell, linear_cell
from firmware_cases import cutoff_asked, stress_samples, tables_of

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")


@pytest.mark.slow
@pytest.mark.parametrize("make", [linear_cell, curved_cell, lfp_cell])
@pytest.mark.parametrize("hold", ["current", "power"])
def test_it_is_the_float64_s(make, hold):
    """64 parts against 400 steps: 1 %, 4 % below 200 s (a part is 1.6 % of the SOC)."""
    model = make()
    cutoff_V = cutoff_asked(model)
    fixed = FixedStep(model, dt_s=1.0, remaining_V=cutoff_V)
    seen = 0
    for soc in (0.9, 0.5, 0.2):
        for load_A in (0.6, 3.0, 9.0):
            found = fixed.remaining(fixed.init(soc, 0.01), load_A, hold)[0]
            go = Going(load_A, hold == "power", math.nan, 0.0, 0.0, cutoff_V, 25.0, STEADY)
            at = CellState(soc, 0.0, 0.0, 0.0, -1.0)
            exact = with_ends(model.parameters(), at, 0.01, go, uncertain_of(model))
            assert found["time_low_s"] <= found["time_s"] <= found["time_high_s"]
            assert found["energy_low_J"] <= found["energy_J"] <= found["energy_high_J"]
            if exact.usual.time_s < 60.0:
                continue
            seen += 1
            rel = 0.01 if exact.usual.time_s > 200.0 else 0.04
            assert found["time_s"] == pytest.approx(exact.usual.time_s, rel=rel)
            assert found["energy_J"] == pytest.approx(exact.usual.energy_J, rel=rel)
    assert seen >= 4


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("case", ["lean remaining", "full remaining"])
def test_the_same_bits_in_c_and_never_nan(case):
    from cellwise.export.firmware import HostLibrary

    tables = tables_of(case)
    stepper, library = numba_stepper(tables), HostLibrary(tables, ["gcc", "-O2"])
    state = library.state()
    library.begin(state, 0.8, 0.02)
    rng = np.random.default_rng(11)

    def both(load_A, holds_power):
        phases = np.zeros(int(rng.integers(0, 6)), PHASE)
        phases["seconds"] = rng.exponential(300.0, phases.size)
        phases["load"] = load_A * rng.normal(1.0, 1.0, phases.size)
        found = []
        for name, kind, handed in (
            ("remaining", OUTLOOK, (load_A, holds_power)),
            ("plan", LANDING, (phases, phases.size, holds_power, 0.4)),
        ):
            ours, theirs = (x.answer(name, kind, state, *handed) for x in (stepper, library))
            assert ours.tobytes() == theirs.tobytes()
            found.append(ours[0].item())
        ends.append(found[1])
        return np.array(found[0])

    seen, ends = [], []
    for k, part in enumerate(np.array_split(stress_samples(4000), 400)):
        stepper.rows(state, part)
        kept = state.tobytes()
        load_A = float(rng.choice([-1.0, 0.0, 0.5, 3.0, 12.0, 40.0]))
        seen.append(both(load_A, k % 2 == 0))
        assert state.tobytes() == kept
    sound = state.copy()
    for load_A in (math.nan, math.inf, -math.inf, 1e30):
        assert np.all(both(load_A, True) == 0.0)
    for _ in range(300):  # memory that lost its content
        state.view(np.uint8)[:] = rng.integers(0, 256, state.nbytes)
        assert np.all(both(3.0, False) == 0.0)
    state[:] = sound
    ends = np.array(ends)
    assert np.all(np.isfinite(ends))
    assert np.all((ends[:, 1] <= ends[:, 0]) & (ends[:, 0] <= ends[:, 2]))
    assert np.all((ends[:, 7] >= 0.0) & (ends[:, 7] <= 1.0))
    assert np.ptp(ends[:, 7]) > 0.9
    values = np.array(seen)
    assert np.all(np.isfinite(values))
    assert np.all(values >= 0.0)
    assert np.all((values[:, 1] <= values[:, 0]) & (values[:, 0] <= values[:, 2]))
    assert np.ptp(values[:, 0]) > 0.0


def test_a_plan_that_no_cell_gives_fails_when_its_load_comes():
    fixed = FixedStep(curved_cell(), dt_s=1.0, remaining_V=cutoff_asked(curved_cell()))
    found = fixed.plan(fixed.init(0.5, 0.01), [(60.0, 1.0), (60.0, 500.0)])[0]
    assert 60.0 < found["failed_s"] < 120.0
    assert found["chance"] < 1e-3
    for phase in ((-1.0, 2.0), (math.nan, 2.0), (10.0, math.inf)):
        refused = fixed.plan(fixed.init(0.5, 0.01), [phase])[0].item()
        assert refused == (0.0,) * len(refused)


@pytest.mark.slow
def test_half_of_the_capacity_lasts_half_as_long():
    """What a history says of the cell counts: at a current so small that no voltage ends it."""
    model = linear_cell()
    fixed = FixedStep(model, dt_s=1.0, health=True, remaining_V=1.0)
    state = fixed.init(0.8, 0.01)
    whole = fixed.remaining(state, 0.3)[0]["time_s"]
    assert whole == pytest.approx(0.8 * model.capacity_Ah * 3600 / 0.3, rel=1e-4)
    fixed.set_health(state, 0.5, 1.0)
    assert fixed.remaining(state, 0.3)[0]["time_s"] == pytest.approx(0.5 * whole, rel=1e-4)


def test_what_is_not_one_cell_s_cutoff_is_refused():
    for cutoff_V in (14.0, -1.0, math.nan):
        with pytest.raises(InputError, match="not of the pack"):
            fixed_step_tables(curved_cell(), 1.0, remaining_V=cutoff_V)
    fixed = FixedStep(curved_cell(), dt_s=1.0)
    with pytest.raises(InputError, match="no remaining time"):
        fixed.remaining(np.zeros(1), 3.0)

"""State of power of the fixed step: the float64's, the same bits in C, never NaN, apart from it."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from cellwise.cell.equations import CellState
from cellwise.errors import InputError
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.layout import CAPABILITY
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.power.limits import OperatingLimits
from cellwise.estimate.power.state_of_power import power_limits, power_settings
from example_cells import curved_cell
from firmware_cases import power_asked, stress_samples, tables_of

CELL = curved_cell()
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")


@pytest.mark.slow
@pytest.mark.parametrize("horizon_s", [2.0, 10.0, 30.0])
def test_it_is_the_float64_s(horizon_s):
    """One interval of the horizon against five: within 2 % where resistances bend most."""
    asked = power_asked(CELL, horizon_s)
    fixed = FixedStep(CELL, dt_s=1.0, power=asked)
    for soc, v1, v2 in ((0.25, 0.0, 0.0), (0.5, 0.03, 0.05), (0.9, -0.02, -0.01)):
        state = fixed.init(soc, 0.01)
        state["v1_V"], state["v2_V"] = v1, v2
        found = fixed.power(state)[0]
        (exact,) = power_limits(
            CELL, CellState(soc, v1, v2, 0.0, 0.0), horizons_s=(horizon_s,),
            limits=asked.known.limits, hold="current",
        )  # fmt: skip
        assert found["discharge_W"] == pytest.approx(exact.discharge.power_W, rel=0.02)
        assert found["charge_W"] == pytest.approx(exact.charge.power_W, rel=0.02)
        assert 0.0 < found["discharge_low_W"] < found["discharge_W"]
        assert 0.0 <= found["charge_low_W"] < found["charge_W"]


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("case", ["lean power", "full power"])
def test_the_same_bits_in_c_and_never_nan(case):
    from cellwise.export.firmware import HostLibrary

    tables = tables_of(case)
    stepper, library = numba_stepper(tables), HostLibrary(tables, ["gcc", "-O2"])
    state = library.state()
    library.begin(state, 0.8, 0.02)
    rng = np.random.default_rng(11)
    seen = []
    for part in np.array_split(stress_samples(4000), 400):
        stepper.rows(state, part)
        kept = state.tobytes()
        ours, theirs = (x.answer("power", CAPABILITY, state) for x in (stepper, library))
        assert ours.tobytes() == theirs.tobytes()
        assert state.tobytes() == kept
        seen.append(ours[0].item())
    for _ in range(300):  # memory that lost its content
        state.view(np.uint8)[:] = rng.integers(0, 256, state.nbytes)
        ours, theirs = (x.answer("power", CAPABILITY, state) for x in (stepper, library))
        assert ours.tobytes() == theirs.tobytes()
        assert np.all(np.isfinite(ours[0].item()))
        assert ours[0].item() == (0.0, 0.0, 0.0, 0.0)  # not sound
    values = np.array(seen)
    assert np.all(np.isfinite(values))
    assert np.all(values >= 0.0)
    assert np.all(values[:, 1::2] <= values[:, ::2])
    assert np.ptp(values[:, 0]) > 0.0


def test_what_a_fixed_step_cannot_give_is_refused():
    limits = OperatingLimits(2.8, 4.2)
    for options, says in (
        ({"horizons_s": (2.0, 10.0), "hold": "current"}, "Give one"),
        ({"horizons_s": (10.0,), "hold": "power"}, "hold='current'"),
    ):
        with pytest.raises(InputError, match=says):
            fixed_step_tables(CELL, 1.0, power=power_settings(CELL, limits=limits, **options))
    with pytest.raises(InputError, match="no state of power"):
        FixedStep(CELL, dt_s=1.0).power(np.zeros(1))

"""A baseline teaches what carries over from one half of it to the other, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.calibration import calibrate
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.priors import tolerances
from cellwise.diagnose.fit.rest_voltages import rest_voltages
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import CellLog
from emulator_drives import random_load
from example_cells import curved_cell

# As good as it was: what it says of its error is what its instruments leave.
CELL = replace(curved_cell(), error=ModelError.of_white_and_slow(5e-4, (5e-4,), 60.0, 0.0))


def measured(factor, seed):
    """A drive of a cell whose ohmic resistance is so many times the model's."""
    rng = np.random.default_rng(seed)
    cell = replace(CELL, r0_ohm=factor * CELL.r0_ohm)
    load = random_load(
        rng, CELL.capacity_Ah, 0.9, rows=1200, rate_hz=1.0, charge=True, temperature_C=(25.0, 25.0)
    )
    log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
    voltage = simulate(cell, log, 0.9).voltage_V + rng.normal(0.0, 5e-4, load.time_s.size)
    log = replace(log, voltage_V=voltage)
    return log, initial_soc(CELL, log, 0.9, 0.0015)


def fits_of(evidence):
    coordinates = Coordinates(CELL)
    return CauseFits(
        evidence,
        coordinates,
        tolerances(coordinates, evidence),
        rest_voltages(evidence.logs, CELL.capacity_Ah, CELL.charge_efficiency),
        0,
    )


@pytest.mark.parametrize(("second", "holds"), [(1.06, True), (0.94, False)])
def test_only_what_both_halves_share_is_taken(second, holds):
    fits = fits_of(gather(CELL, [measured(1.06, 9)]))
    before = dict(fits.prior.std)
    share = calibrate(fits, CELL, [measured(1.06, 1), measured(second, 2)], fits_of)
    learnt = fits.prior.mean["ln_r0"] + fits.prior.mean["ln_r_2"]
    if holds:
        assert share > 0.5
        assert learnt > 0.02
        assert fits.prior.std["ln_r0"] < before["ln_r0"]
    else:
        assert share == 0.0
        assert learnt == 0.0
        assert fits.prior.std["ln_gain"] == pytest.approx(before["ln_gain"])

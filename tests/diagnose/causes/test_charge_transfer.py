"""An exchange current that has changed: its law, its name, where no log tells it apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import ChargeTransfer
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model_error import ModelError
from cellwise.diagnose import diagnose
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.limits import limits
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from virtual_tester import logged

PLAIN = curved_cell()
# As sure of itself as an identified model is: 1.5 mV.
SURE = ModelError.of_white_and_slow(slow_V=0.0015)
CELL = replace(PLAIN, error=SURE)
# Resistances that are the same at every SOC: no shape over it tells them apart.
FLAT = replace(CELL, **{n: np.full(101, v) for n, v in (("r0_ohm", 0.03), ("r1_ohm", 0.015))})
F_OVER_2RT = 96485.33 / (2.0 * 8.314463 * 298.15)
NAMES = ("charge_transfer", "resistance_scale", "ohmic_resistance", "rate_dependence")


def slower(exchange):
    """The cell with so many times the exchange current, by Butler and Volmer."""
    grown = replace(CELL, r1_ohm=CELL.r1_ohm / exchange)
    return grown.with_effect(ChargeTransfer(F_OVER_2RT))


def drive(rows, interval_s, largest_C, seed=2):
    rng = np.random.default_rng(seed)
    held = 12 if interval_s < 5.0 else 1
    current = np.repeat(rng.uniform(-0.4, 1.0, rows // held), held) * largest_C * CELL.capacity_Ah
    time = interval_s * np.arange(float(current.size))
    return CellLog(time, current, np.full(current.size, 3.7))


def measured(cell, log, seed=3):
    noise = 3e-4 * np.random.default_rng(seed).standard_normal(len(log))
    return logged(cell, log, 0.9, noise)


@pytest.mark.slow
def test_a_slower_reaction_is_named_and_a_resistance_is_not_taken_for_one():
    logs = [drive(2400, 1.0, 3.0, seed) for seed in (2, 5)]
    found = diagnose(
        CELL, *([measured(slower(0.4), g, k)] for k, g in enumerate(logs)), soc0=0.9, causes=NAMES
    )
    assert [c.name for c in found.causes] == ["charge_transfer"]
    assert found.causes[0].parameters["exchange_scale"] == pytest.approx(0.4, rel=0.1)
    grown = replace(CELL, r0_ohm=CELL.r0_ohm + 0.012)
    found = diagnose(
        CELL, *([measured(grown, g, k)] for k, g in enumerate(logs)), soc0=0.9, causes=NAMES
    )
    assert [c.name for c in found.causes] == ["ohmic_resistance"]


@pytest.mark.parametrize(
    ("interval_s", "largest_C", "apart"), [(1.0, 2.5, True), (60.0, 0.1, False)]
)
def test_small_currents_in_slow_rows_do_not_tell_it_from_an_ohmic_resistance(
    interval_s, largest_C, apart
):
    log = measured(FLAT, drive(2400, interval_s, largest_C))
    evidence = gather(FLAT, [(log, initial_soc(FLAT, log, 0.9, 0.002))])
    fits = CauseFits.of(evidence, Coordinates(FLAT), 0)
    found = limits(fits, [CAUSES[n] for n in NAMES], *fits.base(), 10.0)
    pair = {"charge_transfer", "ohmic_resistance"}
    assert any(pair <= set(group) for group in found.inseparable) != apart
    assert "exchange_scale" in found.sizes["charge_transfer"]

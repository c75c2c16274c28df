"""The smallest size that logs could show: against noise that is known, and what is the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.diagnose.applied import plain_runs
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.checks import claim_checks
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.limits import limits
from cellwise.diagnose.odds import RARE
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from random_loads import random_load
from virtual_tester import logged

CELL = curved_cell()
AS_STATED = 1.0  # times the model's error
NAMES = ("current_offset", "current_gain", "voltage_offset", "capacity", "resistance_scale")


def started(rows, seed=3, noise_V=1e-3):
    rng = np.random.default_rng(seed)
    load = random_load(
        rng, CELL.capacity_Ah, 0.9, rows=rows, rate_hz=1.0, charge=True, temperature_C=(25.0, 25.0)
    )
    log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
    log = logged(CELL, log, 0.9, rng.normal(0.0, noise_V, load.time_s.size))
    return log, initial_soc(CELL, log, 0.9, 0.002)


def fits_of(logs):
    fits = CauseFits.of(gather(CELL, logs), Coordinates(CELL), 0)
    return fits, fits.base()[0]


@pytest.fixture(scope="module")
def short():
    fits, base = fits_of([started(1500)])
    return fits, base, limits(fits, [CAUSES[n] for n in NAMES], base, AS_STATED, RARE.one_cause)


def test_every_cause_has_a_limit_above_what_a_good_laboratory_leaves_open(short):
    fits, _, found = short
    assert set(found.sizes) == set(NAMES)
    assert found.sizes["voltage_offset"]["offset_V"] > fits.prior.std["offset_V"]
    assert found.sizes["capacity"]["capacity_Ah"] > fits.prior.std["ln_capacity"] * CELL.capacity_Ah


def test_a_change_at_its_limit_has_the_evidence_that_is_asked_for(short):
    """By the likelihood itself, fitted: half the limit is too little, twice of it is enough."""
    _, _, found = short
    cause = CAUSES["voltage_offset"]
    size = found.sizes["voltage_offset"]["offset_V"]
    for times, enough in ((0.4, False), (2.0, True)):
        log, start = started(1500)
        moved = replace(log, voltage_V=log.voltage_V + times * size)
        fits, base = fits_of([(moved, start)])
        none = fits.explained(base, AS_STATED, fits.prior, ()).total
        with_it = fits.fit_causes((cause,), base, AS_STATED)
        prior = fits.widened_for((cause,), fits.coordinates)
        score = fits.explained(with_it, AS_STATED, prior, (cause,)).total - none
        assert (score > RARE.one_cause) == enough, (times, score)


def test_what_a_log_cannot_tell_apart_is_one_group():
    """At a constant current a gain is an offset."""
    time = np.arange(1200.0)
    current = np.full(1200, 0.2 * CELL.capacity_Ah)
    log = CellLog(time, current, np.full(1200, 3.7))
    log = logged(CELL, log, 0.6)
    fits, base = fits_of([(log, initial_soc(CELL, log, 0.6, 0.002))])
    found = limits(
        fits, [CAUSES[n] for n in ("current_offset", "current_gain")], base, AS_STATED, 10.0
    )
    assert found.inseparable == (("current_offset", "current_gain"),)


def test_an_error_within_the_claim_is_not_beyond_it():
    log, start = started(1500)
    evidence = gather(CELL, [(log, start)])
    (good,) = claim_checks(CELL, plain_runs(CELL, [(log, start)]), evidence)
    assert not good.beyond
    claim = float(np.mean(CELL.error.at(CELL.soc)))
    bad_log = replace(log, voltage_V=log.voltage_V + 8.0 * claim)
    (bad,) = claim_checks(CELL, plain_runs(CELL, [(bad_log, start)]), evidence)
    assert bad.beyond
    assert f"{1e3 * bad.rmse_V:.1f} mV" in bad.text()


@pytest.mark.parametrize("r3_ohm", [1e-9, 90.0])
def test_a_limit_is_a_change_that_a_cell_can_have(r3_ohm):
    """Of next to nothing no log shows how many times as large it is, nor hundreds of ohms."""
    odd = CELL.with_effect(SlowDiffusion(r3_ohm, 5e4))
    own = CauseFits.of(gather(odd, [started(1500)]), Coordinates(odd), 0)
    cause = CAUSES["slow_diffusion"]
    found = limits(own, [cause], own.base()[0], AS_STATED, RARE.one_cause).sizes
    assert found.get("slow_diffusion", {}).get("r3_ohm", 0.0) <= min(r3_ohm, 100.0)

"""Sets of causes fitted together: what is needless is not named, what is there beside it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise import simulate
from cellwise.cell.effects import Hysteresis, RateDependence, SlowDiffusion
from cellwise.cell.model_error import ModelError
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.priors import starts_to_try
from cellwise.diagnose.fit.rows import gather
from cellwise.diagnose.odds import RARE, Rarity
from cellwise.diagnose.sets import Explanations, Outcome, decide
from cellwise.fit.start import initial_soc
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from random_loads import random_load

SOC0 = 0.9
TRIED = [CAUSES[n] for n in ("current_gain", "capacity", "voltage_offset", "time_skew")]


QUIET = ModelError.of_white_and_slow(1e-3, (1e-3,), 60.0, 0.01)


def fits_of(
    capacity_share: float,
    gain: float,
    late_s: float = 0.0,
    error: ModelError = QUIET,
    rate_h: float = 0.0,
    hysteresis_V: float = 0.0,
) -> CauseFits:
    """Two loads to fit, one held out, of another capacity whose current is read with a gain.

    The voltage is logged late, the cell's resistances fall with the rate, its OCV has hysteresis.
    """
    model = replace(curved_cell(), error=error)
    cell = replace(model, capacity_Ah=capacity_share * model.capacity_Ah)
    cell = cell.with_effect(RateDependence(rate_h)).with_effect(Hysteresis(hysteresis_V, 60.0))
    rng, logs = np.random.default_rng(5), []
    for _ in range(3):
        load = random_load(
            rng, cell.capacity_Ah, SOC0, rows=2000, rate_hz=1.0, charge=True,
            temperature_C=(25.0, 25.0),
        )  # fmt: skip
        log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
        voltage = simulate(cell, log, SOC0).voltage_V + rng.normal(0.0, 1e-3, load.time_s.size)
        voltage = np.interp(load.time_s - late_s, load.time_s, voltage)
        log = replace(log, voltage_V=voltage, current_A=gain * load.current_A)
        logs.append((log, initial_soc(model, log, SOC0, 0.002)))
    return CauseFits.of(gather(model, logs[:2], logs[2:]), Coordinates(model), 0)


def decided(fits: CauseFits) -> Outcome:
    sets = Explanations(fits, Rarity())
    sets.search(TRIED, *fits.base())
    return decide(sets)


@pytest.mark.slow
def test_a_cause_that_another_makes_needless_is_not_named():
    found = decided(fits_of(0.9, 1.0))
    assert [c.name for c in found.causes] == ["capacity"]
    assert np.exp(found.fit.z["ln_capacity"]) == pytest.approx(0.9, abs=0.005)
    assert abs(found.fit.z["ln_gain"]) < 0.006  # within its tolerance


@pytest.mark.slow
def test_two_that_only_explain_together_are_both_named():
    found = decided(fits_of(0.85, 0.9))
    assert {c.name for c in found.causes} == {"current_gain", "capacity"}
    assert np.exp(found.fit.z["ln_gain"]) == pytest.approx(0.9, abs=0.012)  # resistance: 1 %
    assert np.exp(found.fit.z["ln_capacity"]) == pytest.approx(0.85, abs=0.015)


@pytest.mark.slow
def test_beside_a_quick_error_the_models_own_counts_no_more_than_alone():
    """A voltage 1.5 s late, of a model whose resistances err with the rate as much as it states."""
    fits = fits_of(
        1.0,
        1.0,
        late_s=1.5,
        error=ModelError.of_white_and_slow(1e-3, (4e-3,), 600.0, 0.03),
        rate_h=0.05,
    )
    sets = Explanations(fits, Rarity())
    tried = [CAUSES[n] for n in ("time_skew", "rate_dependence", "resistance_scale")]
    sets.search(tried, *fits.base())
    assert [c.name for c in decide(sets).causes] == ["time_skew"]


@pytest.mark.slow
def test_a_voltage_that_is_seconds_late_is_seen_beside_a_large_error():
    """Edges that far apart do not pull at each other: from a delay of nothing none is in sight."""
    sets = Explanations(fits_of(1.0, 1.0, late_s=6.0, hysteresis_V=0.05), Rarity())
    tried = [CAUSES[n] for n in ("hysteresis", "time_skew", "ocv_shift", "voltage_offset")]
    sets.search(tried, *sets.fits.base())
    found = decide(sets)
    assert {c.name for c in found.causes} == {"hysteresis", "time_skew"}
    assert found.fit.z["skew_s"] == pytest.approx(6.0, abs=0.1)


@pytest.mark.slow
def test_where_no_named_cause_is_kept_the_likely_sets_stay_open():
    """One that leaves held-out rows no better is not named; `none` would deny what is likely."""
    found = decided(fits_of(0.9, 1.0))
    assert found.accepted
    assert found.open_between == ()
    none_kept = replace(found, accepted=())
    assert not none_kept.causes
    assert {"capacity"} in [set(e.names) for e in none_kept.open_between]


def test_what_a_good_log_taught_stays_as_taught_where_a_cause_is_applied():
    fits = fits_of(0.9, 1.0)
    base, _ = fits.base()
    calibrated = {"ocv_4": 0.004, "ln_r0": 0.02}
    cross = np.zeros((len(calibrated), len(calibrated)))
    mean = {**fits.prior.mean, **calibrated}
    fits.prior = replace(fits.prior, mean=mean, linked=tuple(calibrated), cross=cross)
    assert base.z["ocv_4"] != calibrated["ocv_4"]  # the fit has made something else of it
    at = fits.point(base, {"ln_capacity"})
    assert at == {**calibrated, "ln_capacity": base.z["ln_capacity"]}


def test_a_memory_that_the_model_has_is_tried_from_others_too():
    fits, slow = fits_of(1.0, 1.0), CAUSES["slow_diffusion"]
    plain = fits.coordinates
    shapes = [c.tau3_s for c, start in starts_to_try(slow, plain, fits.evidence) if not start]
    assert len(shapes) > 1
    has = Coordinates(plain.model.with_effect(SlowDiffusion(0.01, 1000.0)))
    begun = [start.get("ln_tau3", 0.0) for _, start in starts_to_try(slow, has, fits.evidence)]
    assert begun[0] == 0.0
    assert min(abs(x) for x in begun[1:]) > 0.5  # none is its own once more


def test_what_age_does_at_once_is_one_coincidence():
    age = Rarity().nats(("capacity", "resistance_scale"))
    assert age == pytest.approx(RARE.one_cause + RARE.both)
    further = Rarity().nats(("capacity", "ocv_shift"))
    assert further == pytest.approx(RARE.one_cause + RARE.further_age)
    assert Rarity().nats(("time_skew", "voltage_offset")) == pytest.approx(2.0 * RARE.one_cause)
    cold = Rarity(extrapolated=True)
    both = cold.nats(("temperature_dependence", "slow_diffusion"))
    assert both == pytest.approx(RARE.further_age)
    assert cold.nats(("slow_diffusion",)) == pytest.approx(RARE.further_age + RARE.law_holds)

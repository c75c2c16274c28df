"""What was accepted, seen again; and who is believed of those that explain about as much."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cellwise import simulate
from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.initial_soc import initial_soc
from cellwise.diagnose.causes.catalogue import CAUSES
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.decision.acceptance import (
    LEAST_SCORE,
    close_candidates,
    predicts_worse,
    significance_of,
)
from cellwise.diagnose.decision.outcome import Accepted, Stage
from cellwise.diagnose.decision.revision import refitted, unnecessary
from cellwise.diagnose.fit.cause_fits import CauseFits
from cellwise.diagnose.fit.least_squares import complete
from cellwise.diagnose.fit.priors import starts_to_try, tolerances
from cellwise.diagnose.fit.rest_voltages import rest_voltages
from cellwise.diagnose.fit.rows import FITTED, HELD, gather
from cellwise.diagnose.fit.whitening_kernels import NoiseLevel
from cellwise.logs.cell_log import CellLog
from emulator_drives import random_load
from example_cells import curved_cell

SOC0 = 0.9
GAIN, CAPACITY = CAUSES["current_gain"], CAUSES["capacity"]


def fitter_of(capacity_share: float, gain: float) -> CauseFits:
    """Two loads to fit, one held out, of another capacity whose current is read with a gain."""
    model = curved_cell()
    cell = replace(model, capacity_Ah=capacity_share * model.capacity_Ah)
    rng, logs = np.random.default_rng(5), []
    for _ in range(3):
        load = random_load(
            rng, cell.capacity_Ah, SOC0, rows=2000, rate_hz=1.0, charge=True,
            temperature_C=(25.0, 25.0),
        )  # fmt: skip
        log = CellLog(load.time_s, load.current_A, np.full(load.time_s.size, 3.7))
        voltage = simulate(cell, log, SOC0).voltage_V + rng.normal(0.0, 1e-3, load.time_s.size)
        log = replace(log, voltage_V=voltage, current_A=gain * load.current_A)
        logs.append((log, initial_soc(model, log, SOC0, 0.002)))
    evidence, coordinates = gather(model, logs[:2], logs[2:]), Coordinates(model)
    slow = float(np.mean(model.error.slow_V))
    return CauseFits(
        evidence,
        coordinates,
        tolerances(coordinates, evidence),
        NoiseLevel(5e-4, 0.05 * slow, 20.0, 0.1 * slow, 600.0),
        slow,
        rest_voltages(evidence.logs, model.capacity_Ah, model.charge_efficiency),
        0,
    )


def staged(fits: CauseFits) -> tuple[Stage, object]:
    """Gain and capacity accepted in this order, whatever is true; and the fit without any."""
    base, noise = fits.base(fits.prior)
    entries, causes = [], (GAIN, CAPACITY)
    prior = fits.widened_for(causes, fits.coordinates)
    found = fits.fit(noise, fits.coordinates, prior, base.z, 9)
    found = complete(fits.objective(noise), found, prior)
    gain = fits.gain(base.voltage_V, found.voltage_V)
    entries = [Accepted(c, gain, 100.0, ()) for c in causes]
    return Stage(tuple(entries), prior, found, fits.noise(found, prior)), base


def test_what_a_later_cause_makes_needless_is_given_up():
    fits = fitter_of(0.9, 1.0)
    stage, base = staged(fits)
    assert unnecessary(fits, stage) == "current_gain"
    left = refitted(fits, stage.accepted[1:], base, stage.fit)
    assert left.causes == (CAPACITY,)
    assert np.exp(left.fit.z["ln_capacity"]) == pytest.approx(0.9, abs=0.003)
    assert abs(left.fit.z["ln_gain"]) < 0.006  # back within its tolerance
    assert left.accepted[0].gain.gain > 0.8


def test_what_is_true_beside_another_stays():
    fits = fitter_of(1.1, 1.06)
    stage, base = staged(fits)
    assert unnecessary(fits, stage) is None
    both = refitted(fits, stage.accepted, base, stage.fit)
    assert np.exp(both.fit.z["ln_gain"]) == pytest.approx(1.06, abs=0.012)  # resistance: 1 %
    assert np.exp(both.fit.z["ln_capacity"]) == pytest.approx(1.1, abs=0.015)
    assert min(a.score for a in both.accepted) > LEAST_SCORE  # each over those before it
    first, second = (a.gain for a in both.accepted)
    assert first.held_after_V == pytest.approx(second.held_before_V)
    assert second.held_after_V < first.held_after_V


def test_what_a_good_log_taught_stays_as_taught_where_a_gain_is_measured():
    fits = fitter_of(0.9, 1.0)
    stage, _ = staged(fits)
    calibrated = {"ocv_4": 0.004, "ln_r0": 0.02}
    cross = np.zeros((len(calibrated), len(calibrated)))
    mean = {**fits.prior.mean, **calibrated}
    fits.prior = replace(fits.prior, mean=mean, linked=tuple(calibrated), cross=cross)
    assert stage.fit.z["ocv_4"] != calibrated["ocv_4"]  # the fit has made something else of it
    at = fits.point(stage.fit, {"ln_capacity"})
    assert at == {**calibrated, "ln_capacity": stage.fit.z["ln_capacity"]}


def test_a_memory_that_the_model_has_is_tried_from_others_too():
    fits, slow = fitter_of(1.0, 1.0), CAUSES["slow_diffusion"]
    plain = fits.coordinates
    shapes = [c.tau3_s for c, start in starts_to_try(slow, plain, fits.evidence) if not start]
    assert len(shapes) > 1
    has = Coordinates(plain.model.with_effect(SlowDiffusion(0.01, 1000.0)))
    begun = [start.get("ln_tau3", 0.0) for _, start in starts_to_try(slow, has, fits.evidence)]
    assert begun[0] == 0.0
    assert min(abs(x) for x in begun[1:]) > 0.5  # none is its own once more


@pytest.mark.parametrize(
    ("alone", "together", "says"),
    [
        ((0.3, 0.1), (-0.2, -0.2), "gains 30 % (at least 10 %)"),
        ((0.3, -0.1), (0.04, 0.02), "at least 4 %"),
        ((0.3, -0.1), (-0.2, -0.2), "e^12 times"),
    ],
)
def test_where_rmse_alone_is_not_sure_it_says_what_is(alone, together, says):
    one = SimpleNamespace(gain_in_size=alone[0], low_in_size=alone[1])
    both = SimpleNamespace(low=together[0], low_in_size=together[1])
    assert says in significance_of(SimpleNamespace(held_low=12.0), one, both)


def candidate(name: str, score: float, terms: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(name=name, cause=CAUSES[name], score=score, terms=terms)


@pytest.fixture
def rows():
    role = np.repeat([FITTED, HELD], 600).astype(np.int32)
    return SimpleNamespace(
        role=role, known=np.ones(1200, dtype=np.bool_), block=np.repeat(np.arange(24), 50)
    )


def test_who_is_surely_behind_does_not_contend(rows):
    rng = np.random.default_rng(2)
    first = candidate("capacity", 300.0, np.full(1200, 0.25))
    uneven = candidate("current_offset", 280.0, 0.25 + rng.choice([-2.0, 2.0], 24).repeat(50))
    evenly_behind = candidate("self_discharge", 200.0, np.full(1200, 0.25 - 100.0 / 1200))
    nothing = candidate("hysteresis", 4.0, 0.25 + rng.choice([-9.0, 9.0], 24).repeat(50))
    close = close_candidates([first, uneven, evenly_behind, nothing], rows)
    assert [c.name for c in close] == ["capacity", "current_offset"]


def gain(plain: float, in_size: float, low: float) -> SimpleNamespace:
    return SimpleNamespace(gain=plain, gain_in_size=in_size, low=low, low_in_size=low)


@pytest.mark.parametrize(
    ("one", "lead", "over", "extrapolated", "worse"),
    [
        ("capacity", "current_offset", (0.4, 0.3, 0.1), False, True),
        ("capacity", "current_offset", (0.4, 0.3, -0.1), False, False),  # not sure
        ("capacity", "current_offset", (0.4, 0.1, 0.1), False, False),  # only near empty
        ("capacity", "current_offset", (0.4, 0.3, 0.1), True, False),  # another temperature
        (
            "voltage_offset",
            "ocv_shift",
            (0.4, 0.3, 0.1),
            False,
            True,
        ),  # more than its constant part
    ],
)
def test_who_predicts_far_better_goes_first(one, lead, over, extrapolated, worse):
    flat = np.zeros(1200)
    pair = candidate(one, 100.0, flat), candidate(lead, 90.0, flat)
    assert predicts_worse(*pair, gain(*over), extrapolated) is worse

"""Capacity that is left, between two rests: made cells against truth, the same bits in C."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import Hysteresis, SlowDiffusion
from cellwise.cell.posterior import CAPACITY, POINTS, Posterior
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.capacity.soh import EstimatedSoh, SohEstimator
from cellwise.estimate.fixed import layout
from cellwise.estimate.fixed.fixed_step import FixedStep, samples_of
from cellwise.estimate.fixed.stepper import numba_stepper
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import Noise
from cellwise.export.firmware import Firmware, HostLibrary
from cellwise.logs import CellLog
from example_cells import curved_cell
from firmware_cases import full_model, stress_samples

DT_S = 10.0
LONG_S, SHORT_S = 7200.0, 600.0
KEPT = {"offset_share": 0.001, "gap_soc": 0.002}  # a good sensor; nothing flows while it sleeps


def use(rest_s, cycles=6, rate_C=0.5, hours=1.4):
    """Currents in C of charges and discharges with a rest after each."""
    rest = np.zeros(int(rest_s / DT_S))
    half = np.full(int(hours * 3600.0 / DT_S), rate_C)
    return np.concatenate(
        [rest, *(part for _ in range(cycles) for part in (half, rest, -half, rest))]
    )


def field_log(model, share, rate_C, *, offset_A=0.0, noise_V=0.001, seed=1, soc0=0.9):
    """What a target sees of a cell of which a share of the capacity is left."""
    aged = replace(model, capacity_Ah=share * model.capacity_Ah)
    current = rate_C * model.capacity_Ah * share
    time_s = DT_S * np.arange(current.size)
    true = simulate(aged, CellLog(time_s, current, np.full(current.size, 3.7)), soc0=soc0)
    rng = np.random.default_rng(seed)
    volts = true.voltage_V + noise_V * rng.standard_normal(current.size)
    return CellLog(time_s, current + offset_A, volts)


def estimated(model, log, soc0=0.9, **noise):
    of = replace(Noise.of_model(model), **{**KEPT, **noise})
    return SohEstimator(FixedStep(model, of, dt_s=DT_S, soh=True)).run(log, soc0)


@pytest.mark.parametrize("share", [0.7, 0.8, 0.9, 1.0])
def test_the_share_that_is_left_is_found_within_its_deviation(share):
    found = estimated(curved_cell(), field_log(curved_cell(), share, use(LONG_S)))
    assert found.pairs >= 5
    assert found.share == pytest.approx(share, abs=0.01)
    assert abs(found.share - share) < 2.0 * found.share_std


@pytest.mark.parametrize("offset_share", [-0.01, 0.01])
def test_a_sensor_that_is_off_is_told_from_a_capacity_that_is_lost(offset_share):
    """Charge and discharge of one cell see an offset with opposite signs."""
    model = curved_cell()
    log = field_log(model, 0.85, use(LONG_S), offset_A=offset_share * model.capacity_Ah)
    found = estimated(model, log, offset_share=0.03)
    assert found.share == pytest.approx(0.85, abs=0.02)
    assert abs(found.share - 0.85) < 2.0 * found.share_std


@pytest.mark.parametrize("rate_C", [use(SHORT_S), use(LONG_S, hours=0.3)], ids=["short", "close"])
def test_short_rests_or_rests_close_together_say_nothing(rate_C):
    found = estimated(curved_cell(), field_log(curved_cell(), 0.8, rate_C))
    assert (found.share, found.pairs) == (1.0, 0)
    assert found.share_std == pytest.approx(0.15)


def test_an_error_of_the_ocv_is_not_averaged_out():
    """The table of the OCV is as wrong in every pair: twenty times as many say hardly more."""
    once, often = (
        estimated(curved_cell(), field_log(curved_cell(), 0.8, use(LONG_S, cycles=n)))
        for n in (1, 20)
    )
    assert often.pairs > 15 * once.pairs
    assert often.share_std > 0.8 * once.share_std


def test_an_ocv_that_is_off_is_within_the_stated_deviation():
    """A cell whose OCV is a deviation of the model's error higher at every SOC but the full one."""
    model = curved_cell()
    error_V = float(np.mean(model.slow_error_tables_V()))
    moved = model.ocv_V + error_V * np.cos(np.pi * model.soc)
    found = estimated(model, field_log(replace(model, ocv_V=moved), 0.8, use(LONG_S, cycles=20)))
    assert abs(found.share - 0.8) > 0.002  # it does matter
    assert abs(found.share - 0.8) < 2.0 * found.share_std


def plateau_cell(**more):
    """A steep OCV, a plateau from 0.03 to 0.15 SOC, a line."""
    soc = np.linspace(0.0, 1.0, 101)
    line_V = 3.39 + 0.8 * np.maximum(soc - 0.15, 0.0) + 0.005 * soc
    return curved_cell(ocv_V=line_V - 12.0 * np.maximum(0.03 - soc, 0.0), **more)


@pytest.mark.parametrize("deviations", [-1.0, 0.0, 1.0])
def test_beside_a_plateau_a_steep_ocv_does_not_say_the_soc(deviations):
    """A little lower, a voltage of the plateau is one of the steep part, far away in SOC."""
    model = plateau_cell()
    moved = model.ocv_V + deviations * model.slow_error_tables_V()
    log = field_log(replace(model, ocv_V=moved), 0.8, use(LONG_S), soc0=0.8)
    found = estimated(model, log, 0.8)
    assert abs(found.share - 0.8) < 2.0 * found.share_std


@pytest.mark.parametrize("left_open", [0.0, 0.05])
def test_the_share_is_no_surer_than_the_capacity_of_the_model(left_open):
    """A new cell that holds a deviation more than the model: it keeps 0.8 of its own capacity."""
    of = Posterior(
        (CAPACITY,), np.eye(1), np.array([left_open]), np.zeros((1, POINTS)), np.zeros((1, POINTS))
    )
    model = replace(curved_cell(), posterior=of)
    more = 1.0 + model.capacity_share
    log = field_log(model, 0.8 * more, use(LONG_S, cycles=20, hours=1.9), soc0=0.99)
    found = estimated(model, log, 0.99)
    assert found.share == pytest.approx(0.8 * more, abs=0.01)
    assert abs(found.share - 0.8) < 1.5 * found.share_std
    assert found.share_std < 1.5 * model.capacity_share


def test_a_current_that_is_lost_ends_the_count():
    log = field_log(curved_cell(), 0.8, use(LONG_S))
    current = np.array(log.current_A)
    for first in np.flatnonzero(current)[::100]:
        current[first : first + 30] = np.nan
    assert estimated(curved_cell(), replace(log, current_A=current)).pairs == 0


@pytest.mark.parametrize("lost", [0.2, 0.4, 0.6])
def test_samples_that_are_lost_all_the_time_are_not_counted_on(lost):
    """Gaps too long to bridge hide one load: what they take does not average out."""
    model = curved_cell()
    estimator = SohEstimator(
        FixedStep(model, replace(Noise.of_model(model), **KEPT), dt_s=DT_S, soh=True)
    )
    log = field_log(model, 0.8, use(LONG_S))
    kept = np.sort(np.random.default_rng(3).choice(len(log), int(len(log) * (1.0 - lost)), False))
    rows = samples_of(model, log, DT_S).records[kept]
    stepper, record = estimator.filter.stepper(DT_S), estimator.begin()
    state = stepper.state()
    stepper.begin(state, 0.9, 0.02)
    stepper.rows_beside("soh_rows", state, record, rows)
    found = EstimatedSoh.of(record)
    assert abs(found.share - 0.8) < 3.0 * found.share_std


def test_a_cell_that_is_replaced_is_found_again():
    """What is known of an old cell does not refuse a new one for good."""
    model, of = curved_cell(), replace(Noise.of_model(curved_cell()), **KEPT)
    estimator = SohEstimator(FixedStep(model, of, dt_s=DT_S, soh=True))
    kept = estimator.begin()
    old = estimator.run(field_log(model, 0.65, use(LONG_S, cycles=20)), 0.9, kept)
    assert old.share == pytest.approx(0.65, abs=0.01)
    new = estimator.run(field_log(model, 1.0, use(LONG_S, cycles=8)), 0.9, kept)
    assert new.share == pytest.approx(1.0, abs=0.02)


def test_a_charge_while_the_target_is_off_is_not_counted_over():
    model, of = curved_cell(), replace(Noise.of_model(curved_cell()), **KEPT)
    estimator = SohEstimator(FixedStep(model, of, dt_s=DT_S, soh=True))
    kept = estimator.begin()
    estimator.run(field_log(model, 0.8, use(LONG_S)[:-2000]), 0.9, kept)
    kept["begun"], kept["variance"] = 0, 0.0
    pairs = int(kept["pairs"][0])
    found = estimator.run(field_log(model, 0.8, use(LONG_S), soc0=0.75), 0.75, kept)
    assert found.pairs > pairs
    assert found.share == pytest.approx(0.8, abs=0.01)
    assert abs(found.share - 0.8) < 2.0 * found.share_std


def test_memory_that_lost_a_bit_begins_again():
    model, of = curved_cell(), replace(Noise.of_model(curved_cell()), **KEPT)
    estimator = SohEstimator(FixedStep(model, of, dt_s=DT_S, soh=True))
    log = field_log(model, 0.8, use(LONG_S))
    for name, bad in (("share", np.nan), ("own_qq", -1.0), ("counted", np.inf), ("soc", 7.0)):
        kept = estimator.begin()
        kept[name] = bad
        found = estimator.run(log, 0.9, kept)
        assert found.share == pytest.approx(0.8, abs=0.01)
        assert abs(found.share - 0.8) < 2.0 * found.share_std


def grown(model, scale):
    """The model with every resistance that many times as large."""
    names = ("r0_ohm", "r1_ohm", "r2_ohm")
    return replace(model, **{name: scale * getattr(model, name) for name in names})


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.5, 2.5])
@pytest.mark.parametrize("share", [0.7, 1.0])
def test_the_resistance_is_found_within_its_deviation(scale, share):
    """With the capacity, which moves the OCV under the load."""
    model = curved_cell()
    found = estimated(model, field_log(grown(model, scale), share, use(LONG_S)))
    assert found.loads >= 10
    assert found.resistance == pytest.approx(scale, rel=0.1)
    assert abs(found.resistance - scale) < 2.0 * found.resistance_std
    assert found.resistance_std < 0.25 * scale


def test_a_ramp_a_small_load_and_a_short_rest_say_nothing_of_the_resistance():
    model = grown(curved_cell(), 1.5)
    rest = np.zeros(int(LONG_S / DT_S))
    ramp = np.linspace(0.0, 1.0, 90) ** 2  # never still within the first half minute
    for load in (ramp, np.full(90, 0.1)):
        log = field_log(model, 1.0, np.concatenate([rest, load, rest, load, rest]))
        assert estimated(curved_cell(), log).loads == 0
    assert estimated(curved_cell(), field_log(model, 1.0, use(SHORT_S))).loads == 0


def test_a_contact_that_comes_loose_is_found_by_and_by():
    model, of = curved_cell(), replace(Noise.of_model(curved_cell()), **KEPT)
    estimator = SohEstimator(FixedStep(model, of, dt_s=DT_S, soh=True))
    kept = estimator.begin()
    before = estimator.run(field_log(model, 1.0, use(LONG_S, cycles=20)), 0.9, kept)
    assert before.resistance == pytest.approx(1.0, abs=0.1)
    after = estimator.run(field_log(grown(model, 3.0), 1.0, use(LONG_S, cycles=40)), 0.9, kept)
    assert after.resistance > 2.0


def test_what_a_target_shows_of_a_record_without_content_is_what_is_usual():
    stepper = numba_stepper(fixed_step_tables(curved_cell(), DT_S, soh=True))
    record = np.frombuffer(b"\xff" * layout.SOH.itemsize, layout.SOH).copy()
    now = stepper.answer("soh_of", layout.SOH_OUTPUT, record)[0]
    assert (now["share"], now["resistance"]) == (1.0, 1.0)
    assert np.sqrt([now["share_variance"], now["resistance_variance"]]) == pytest.approx(
        [0.15, 0.5]
    )


def test_a_filter_without_it_is_refused():
    with pytest.raises(InputError, match="soh=True"):
        SohEstimator(FixedStep(curved_cell(), dt_s=DT_S))
    estimator = SohEstimator(FixedStep(curved_cell(), dt_s=DT_S, soh=True))
    with pytest.raises(InputError, match="begin"):
        estimator.run(field_log(curved_cell(), 0.8, use(LONG_S)), 0.9, np.zeros(3))


needs_c = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
MODELS = {
    "lean": (curved_cell(), {"wide": False}),
    "wide": (curved_cell(), {"health": True, "offset": True}),
    "every effect": (full_model(), {"health": True}),
    "slow, hysteresis": (
        curved_cell(effects=(SlowDiffusion(0.01, 900.0), Hysteresis(m_V=0.01, gamma=40.0))), {}
    ),
}  # fmt: skip


@needs_c
@pytest.mark.parametrize("name", MODELS)
def test_the_c_has_the_same_bits(name):
    pytest.importorskip("cffi")
    model, asked = MODELS[name]
    noise = replace(Noise.of_model(model), **KEPT)
    tables = fixed_step_tables(model, DT_S, noise, soh=True, **asked)
    used = samples_of(model, field_log(model, 0.8, use(LONG_S, cycles=3)), DT_S).records
    found = []
    for twin in (numba_stepper(tables), HostLibrary(tables, ["gcc", "-O2"])):
        state, record = twin.state(), np.zeros(1, layout.SOH)
        twin.begin(state, 0.9, 0.02)
        twin.call("start_soh", record)
        said = []
        for samples in (used, stress_samples(4000), used):
            said += [
                twin.rows_beside("soh_rows", state, record, samples).tobytes(),
                record.tobytes(),
            ]
            said.append(twin.answer("soh_of", layout.SOH_OUTPUT, record).tobytes())
        found.append((said, EstimatedSoh.of(record)))
    assert found[0] == found[1]
    assert found[0][1].pairs >= 1
    assert found[0][1].loads >= 1


@needs_c
def test_firmware_is_a_filter_for_it():
    pytest.importorskip("cffi")
    log = field_log(curved_cell(), 0.8, use(LONG_S, cycles=2))
    noise = replace(Noise.of_model(curved_cell()), **KEPT)
    ours, theirs = (
        SohEstimator(kind(curved_cell(), noise, dt_s=DT_S, soh=True)).run(log, 0.9)
        for kind in (FixedStep, Firmware)
    )
    assert ours == theirs

"""What holds for every estimator with every effect, since all of them step the same cell."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest

from cellwise.cell.effects import EFFECTS, is_neutral
from cellwise.cell.simulate import simulate
from cellwise.estimate.fixed.tables import fixed_step_tables
from cellwise.estimate.noise import Noise
from cellwise.estimate.status import Status
from estimator_cases import ACTIVE, MEANS, NEUTRAL, Rows, follow
from example_cells import curved_cell, lfp_cell, linear_cell

WARM = (ACTIVE["temperature_dependence"], ACTIVE["self_heating"])
FAST = ("ekf", "ukf", "adaptive", "lockstep", "filterpy-ekf")
FLOAT64 = (*FAST, "filterpy-ukf")
# Sigma points in plain Python take a second where the others take a hundredth.
DEEP_UKF = (*FAST, pytest.param("filterpy-ukf", marks=pytest.mark.slow))
NO_COMPILER = shutil.which("gcc") is None or find_spec("cffi") is None
FIRMWARE = pytest.param(
    "firmware", marks=pytest.mark.skipif(NO_COMPILER, reason="needs gcc and cffi")
)
FIXED = (pytest.param("fixed-step", marks=pytest.mark.slow), FIRMWARE)
GATED = ("ekf", "ukf", "adaptive", "lockstep")


def cases(effects):
    """Each effect alone, and all of them together."""
    return {**{name: (effect,) for name, effect in effects.items()}, "all": (*effects.values(),)}


estimators = partial(pytest.mark.parametrize, "name")
every_effect = pytest.mark.parametrize("effects", cases(ACTIVE).values(), ids=cases(ACTIVE))


def test_every_effect_is_here():
    assert set(ACTIVE) == set(NEUTRAL) == set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_record_says_which_value_is_neutral(name):
    assert is_neutral(NEUTRAL[name])
    assert not is_neutral(ACTIVE[name])


@estimators(FLOAT64)
@pytest.mark.parametrize(
    ("field", "effects", "tau_s"),
    [
        ("heat_K", WARM, ACTIVE["self_heating"].thermal_s),
        ("slow_A", (ACTIVE["surface_soc"],), ACTIVE["surface_soc"].tau_s),
    ],
)
def test_over_a_gap_heat_and_surface_only_decay(name, field, effects, tau_s):
    """Nobody knows what flowed, so nothing heats and no current is followed: e-folds are left."""
    pause = 1.0 if name == "lockstep" else 300.0  # the lockstep has one time step
    rows = Rows.of([0.0, *[5.0] * 120]).interval(100, pause, gap=True)
    value = getattr(follow(name, curved_cell(effects=effects), rows, 0.8), field)
    assert value[99] > 0.1
    assert value[100] == pytest.approx(np.exp(-pause / tau_s) * value[99], rel=1e-12)
    assert value[101] > value[100]
    if field == "slow_A":
        assert value[99] == pytest.approx(-5.0 * np.expm1(-99.0 / tau_s), rel=1e-12)


def ekf_beside(name, model, rows, soc0, soc0_std=0.01, noise=None):
    """The EKF over the same intervals: the lockstep's first sample ends one, too."""
    return follow("ekf", model, as_taken(name, rows), soc0, soc0_std, noise)


def as_taken(name, rows):
    return rows.interval(0, rows.tick_s) if name == "lockstep" else rows


def driven(model, seconds=400, tick_s=1.0, soc0=0.7, rest_s=5.0, spread_A=1.0):
    """Loads of ten seconds after a rest, with the voltage that the EKF expects of them."""
    steps = np.random.default_rng(4).normal(2.5, spread_A, int(seconds / 10) + 1)
    time = tick_s * np.arange(int(seconds / tick_s))
    current = np.where(time < rest_s, 0.0, steps[(time / 10).astype(int)])
    rows = Rows.of(current, tick_s)
    return replace(rows, voltage_V=follow("ekf", model, rows, soc0).voltage_V)


@estimators(GATED)
def test_the_gate_counts_alike(name):
    """Rejections in a row add up to the same sample: four of 0.25 s are one of a second."""
    model = linear_cell()
    rows = driven(model, seconds=100, tick_s=0.25, spread_A=0.0)
    jump = rows.voltage_V.copy()
    jump[100:] += 0.2
    rows = replace(rows, voltage_V=jump)
    noise = replace(Noise.of_model(model), recovery_after=1)
    status = follow(name, model, rows, 0.7, noise=noise).status.astype(int)
    assert np.flatnonzero(status & Status.GATE_RECOVERY)[0] == 100 + 3


@pytest.mark.parametrize("make", [curved_cell, lfp_cell])
@estimators(["adaptive", "lockstep"])
def test_a_first_voltage_at_rest_says_the_same(name, make):
    """A resting cell shows its OCV: a start that knows little of itself believes it at once."""
    model = make()
    for truth in (0.15, 0.45, 0.95):
        rows = driven(model, seconds=60, soc0=truth)
        mine, ekf = (walk(name, model, rows, 0.7, 0.2) for walk in (follow, ekf_beside))
        # The adaptive filter weighs an offset by other odds.
        same = 1e-3 if name == "adaptive" else 1e-12
        assert mine.soc[0] == pytest.approx(ekf.soc[0], abs=same)
        np.testing.assert_allclose(mine.soc, ekf.soc, atol=1e-3)


@estimators(["ukf", "adaptive", "lockstep"])
def test_a_lock_out_ends_at_the_same_soc(name):
    """A filter that is sure of a wrong SOC looks for it over the whole range, as the EKF does."""
    model = curved_cell()
    for truth in (0.25, 0.5, 0.85):
        rows = driven(model, seconds=400, soc0=truth)
        mine, ekf = (walk(name, model, rows, 0.65, 0.002) for walk in (follow, ekf_beside))
        ends = [np.flatnonzero(p.status.astype(int) & Status.GATE_RECOVERY) for p in (mine, ekf)]
        np.testing.assert_array_equal(*ends)
        assert ends[0].size > 0
        after = int(ends[0][0])
        assert mine.soc[after] == pytest.approx(ekf.soc[after], abs=1e-3)
        assert abs(mine.soc[-1] - ekf.soc[-1]) < 5e-3


def faulty(name, seed=5, rows=160):
    """Currents of both signs, some missing, a gap, repeated stamps; no voltage.

    The lockstep has one time step: its gap lasts one, no stamp comes twice. filterpy's filters
    hold a missing current for ever, so none is missing for longer than it may be held.
    """
    rng = np.random.default_rng(seed)
    current = np.repeat(rng.normal(0.5, 3.0, rows // 8 + 1), 8)[:rows]
    current[0] = 0.0
    current[30:36] = np.nan
    found = Rows.of(current, temperature_C=rng.uniform(5.0, 40.0, rows))
    found = found.interval(60, 1.0 if name == "lockstep" else 120.0, gap=True)
    return found if name == "lockstep" else found.interval(90, 0.0).interval(91, 0.0)


def counted(model, rows, soc0, delayed=True):
    """SOC by counting, the rules in plain words: the oracle of every estimator's SOC."""
    skew = next((e.skew_s for e in model.effects if e.name == "time_skew"), 0.0)
    leak = next((e.leak_A for e in model.effects if e.name == "self_discharge"), 0.0)
    soc, before, left = [], 0.0, soc0
    for current, dt, gap in zip(rows.current_A, rows.dt_s, rows.gap, strict=True):
        now = before if np.isnan(current) else current
        seen = now + min(skew / dt, 1.0) * (before - now) if delayed and skew and dt else now
        before = now
        flow = 0.0 if gap else seen
        flow *= 1.0 if flow > 0.0 else model.charge_efficiency
        left -= (flow + leak) * dt / (3600.0 * model.capacity_Ah)
        soc.append(left)
    return np.array(soc)


@estimators(("coulomb", *DEEP_UKF))
@every_effect
def test_charge_is_conserved(name, effects):
    """Missing currents are held, over a gap nothing is counted, a repeated stamp moves nothing."""
    model = curved_cell(effects=effects, charge_efficiency=0.97)
    rows = faulty(name)
    soc = follow(name, model, rows, 0.5).soc
    expected = counted(model, as_taken(name, rows), 0.5, delayed=name != "coulomb")
    np.testing.assert_allclose(soc, expected, rtol=0.0, atol=1e-10)


@estimators(FIXED)
def test_charge_is_conserved_on_the_target(name):
    """A short gap is bridged by the mean of the currents on both sides, a long one is not."""
    model = linear_cell()
    current = np.repeat([0.0, 2.0, -1.0, 3.0, 1.0], [1, 40, 40, 40, 39])
    current[30:36] = np.nan
    rows = Rows.of(current).interval(61, 4.0).interval(81, 5.0).interval(100, 0.0)
    rows = rows.interval(120, 900.0)
    flowed = np.where(np.isnan(current), 2.0, current)
    flowed[[0, 100]] = 0.0
    flowed[61] += 3.0 * -1.0
    flowed[81] += 4.0 * (3.0 - 1.0) / 2.0
    soc = follow(name, model, rows, 0.5).soc
    np.testing.assert_allclose(soc, 0.5 - np.cumsum(flowed) / (3600.0 * 3.0), atol=1e-6)


@pytest.mark.slow
@estimators([FIRMWARE])
@every_effect
def test_charge_is_conserved_on_the_target_with_every_effect(name, effects):
    model = linear_cell(effects=effects, charge_efficiency=0.97)
    current = np.repeat([0.0, 2.0, -1.0, 3.0, 1.0], [1, 40, 40, 40, 39])
    current[30:36] = np.nan
    rows = Rows.of(current).interval(100, 0.0)
    soc = follow(name, model, rows, 0.5).soc
    np.testing.assert_allclose(soc, counted(model, rows, 0.5), rtol=0.0, atol=1e-6)


@estimators([FIRMWARE])
@pytest.mark.parametrize("field", ["heat_K", "slow_A", "soc"])
def test_over_a_long_gap_on_the_target_only_the_current_is_unknown(name, field):
    """Heat and followed current decay, self-discharge goes on: as in the EKF, up to the rows."""
    surface, leak = (ACTIVE["surface_soc"],), (ACTIVE["self_discharge"],)
    effects = {"heat_K": WARM, "slow_A": surface, "soc": leak}[field]
    model = linear_cell(effects=effects)
    rows = Rows.of([0.0, *[5.0] * 100, 0.0, 0.0]).interval(101, 900.0, gap=True)
    mine, ekf = (follow(n, model, rows, 0.8) for n in (name, "ekf"))
    np.testing.assert_allclose(getattr(mine, field), getattr(ekf, field), rtol=5e-3, atol=1e-5)


def rough(model, seed=6):
    """A drive from a wrong start: noise, missing and wrong voltages, a gap, changing warmth."""
    rng = np.random.default_rng(seed)
    rows = driven(model, seconds=240)
    voltage = rows.voltage_V + rng.normal(0.0, 0.003, len(rows))
    voltage[100:106] = np.nan
    voltage[150:156] += 0.4
    current = rows.current_A.copy()
    current[120:124] = np.nan
    warm = np.linspace(10.0, 35.0, len(rows))
    rows = replace(rows, current_A=current, voltage_V=voltage, temperature_C=warm)
    return rows.interval(200, rows.tick_s, gap=True)


def same_bits(name, models, rows):
    """Every model gives the first one's path, bit for bit."""
    first, *others = (follow(name, model, rows, 0.6, 0.1) for model in models)
    for other in others:
        np.testing.assert_array_equal(other, first)


@estimators(("coulomb", *DEEP_UKF))
@pytest.mark.parametrize("effects", cases(NEUTRAL).values(), ids=cases(NEUTRAL))
def test_a_neutral_effect_is_none(name, effects):
    plain = curved_cell()
    rows = rough(plain)
    if name.startswith("filterpy"):  # a log finds its gaps by itself
        rows = replace(rows, gap=np.zeros_like(rows.gap))
    same_bits(name, (plain, replace(plain, effects=effects)), rows)


@pytest.mark.parametrize("effects", cases(NEUTRAL).values(), ids=cases(NEUTRAL))
def test_a_neutral_effect_is_none_on_the_target(effects):
    """Options, constants and tables are all that the target knows of a model."""
    plain = curved_cell()
    one, other = (fixed_step_tables(m, 1.0) for m in (plain, replace(plain, effects=effects)))
    assert one.options == other.options
    assert one.to_bytes() == other.to_bytes()


@pytest.mark.parametrize("effect", ACTIVE.values(), ids=ACTIVE)
def test_no_effect_is_left_out_on_the_target(effect):
    """What a cell has beside the plain model is in the target's numbers, or it would be ignored."""
    beside = () if effect.name == "temperature_dependence" else WARM[:1]  # heat moves nothing alone
    plain = curved_cell(effects=beside)
    one, other = (
        fixed_step_tables(m, 1.0) for m in (plain, curved_cell(effects=(*beside, effect)))
    )
    assert one.options != other.options or one.to_bytes() != other.to_bytes()


@estimators(("coulomb", *DEEP_UKF))
def test_the_order_of_the_effects_does_not_matter(name):
    plain = curved_cell()
    effects = [*ACTIVE.values()]
    orders = (effects, effects[::-1], [*effects[3:], *effects[:3]])
    same_bits(name, [replace(plain, effects=tuple(order)) for order in orders], rough(plain))


def test_the_order_of_the_effects_does_not_matter_on_the_target():
    effects = [*ACTIVE.values()]
    one, other = (
        fixed_step_tables(curved_cell(effects=tuple(order)), 1.0)
        for order in (effects, effects[::-1])
    )
    assert one.options == other.options
    assert one.to_bytes() == other.to_bytes()


def steady(tick_s, current_A, seconds=240):
    return Rows.of(np.full(int(seconds / tick_s) + 1, current_A), tick_s)


COOL = {name: effects for name, effects in cases(ACTIVE).items() if name != "all"}
COOL["all but heating"] = tuple(e for e in ACTIVE.values() if e.name != "self_heating")


@estimators(("coulomb", *DEEP_UKF))
@pytest.mark.parametrize("effects", COOL.values(), ids=COOL)
def test_one_step_of_two_dt_is_two_steps_of_dt(name, effects):
    """At constant current and constant parameters the step is exact, whatever its length.

    Of a cell that warms the parameters are not constant: there its states are compared alone.
    """
    model = linear_cell(effects=effects)
    for current in (2.0, -2.0):
        one, two = (follow(name, model, steady(t, current), 0.5) for t in (2.0, 1.0))
        skip = 1 if name == "lockstep" else 0  # its first sample ends an interval, too
        for field in (*MEANS, "slow_A"):
            expected = getattr(two, field)[skip::2]
            found = getattr(one, field)[: expected.size]
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10, err_msg=field)


@estimators(FIXED)
def test_one_step_of_two_dt_is_two_steps_of_dt_on_the_target(name):
    model = linear_cell()
    one, two = (follow(name, model, steady(t, 2.0), 0.5) for t in (2.0, 1.0))
    for field in ("soc", "v1_V", "v2_V"):
        np.testing.assert_allclose(getattr(one, field), getattr(two, field)[::2], atol=2e-6)


@estimators([n for n in DEEP_UKF if n != "ekf"])
@every_effect
def test_without_a_voltage_all_filters_carry_the_same_cell(name, effects):
    """Mean of SOC, branches, hysteresis and heat, and their variances: one cell, one noise.

    A UKF sees how the tables bend over SOC: ours where the SOC is badly known, filterpy's always.
    """
    model = (linear_cell if name == "filterpy-ukf" else curved_cell)(effects=effects)
    noise = replace(Noise.of_model(model), gap_soc=0.01, offset_share=0.0)
    rows = faulty(name)
    if not name.startswith("filterpy"):  # lost, not held any more
        current = rows.current_A.copy()
        current[120:135] = np.nan
        rows = replace(rows, current_A=current)
    mine, ekf = (walk(name, model, rows, 0.6, 0.001, noise) for walk in (follow, ekf_beside))
    for field in (*MEANS, "heat_K", "slow_A", "soc_std", "p11", "p22", "p33"):
        np.testing.assert_allclose(
            getattr(mine, field), getattr(ekf, field), rtol=1e-9, atol=1e-9, err_msg=field
        )
    assert np.ptp(ekf.v1_V) > 0.01


@every_effect
def test_without_a_voltage_the_filter_simulates(effects):
    """A resting cell that is followed without a voltage is the model's own simulation."""
    model = curved_cell(effects=effects)
    rows = driven(model)
    rows = replace(rows, voltage_V=np.full(len(rows), np.nan))
    run = simulate(model, rows.log(), 0.7)
    path = follow("ekf", model, rows, 0.7)
    np.testing.assert_allclose(path.soc, run.soc[:-1], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(path.voltage_V, run.voltage_V[:-1], rtol=0.0, atol=1e-12)


@estimators(["adaptive", "lockstep"])
@every_effect
def test_a_voltage_as_expected_moves_nothing(name, effects):
    """The lockstep's short way is taken here: it predicts what the EKF predicts."""
    model = linear_cell(effects=effects)
    rows = as_taken(name, driven(model))
    blind = replace(rows, voltage_V=np.full(len(rows), np.nan))
    rows = replace(rows, voltage_V=follow("ekf", model, blind, 0.7).voltage_V)
    seen, ekf = follow(name, model, rows, 0.7), follow("ekf", model, blind, 0.7)
    for field in (*MEANS, "heat_K", "slow_A", "voltage_V"):
        np.testing.assert_allclose(
            getattr(seen, field), getattr(ekf, field), rtol=1e-6, atol=1e-8, err_msg=field
        )

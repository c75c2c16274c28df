"""A start that nobody knows: exact where everything is linear, better where it is not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.equations.bank import (
    gather,
    know_past,
    know_past_better,
    left_by_load,
)
from cellwise.estimate.equations.components import evidence_share, past_of
from cellwise.estimate.equations.constants import (
    LEAST_PAST_V2,
    LOOKS,
    PAST_RATE,
    PAST_SPREAD,
    START_BRANCH_V,
    TAIL,
)
from cellwise.estimate.evidence_kernels import constants_of, step_constants
from cellwise.estimate.filters.bank_kernels import BANK_FIELDS, RECORD
from cellwise.estimate.filters.component_kernels import (
    STATE,
    BankModel,
    ComponentPlace,
)
from cellwise.estimate.filters.filter_state import EkfState
from cellwise.estimate.filters.kalman import BankState, Ekf, Ukf
from cellwise.estimate.lockstep import LockstepEkf
from cellwise.estimate.noise import Noise
from cellwise.estimate.saved_state import state_from_dict, state_to_dict
from cellwise.logs.cell_log import CellLog

R3_OHM, TAU3_S = 0.02, 300.0
SLOW_V = 0.01
FLAT = np.full(11, 1.0)
PLACE = ComponentPlace(25.0, 0.0)


def linear(r_slope: float = 0.0, tau3_s: float = TAU3_S) -> CellModel:
    """Every resistance the same at every SOC, but for ``r_slope`` per unit of SOC, OCV a line."""
    bend = 1.0 + r_slope * np.linspace(0.0, 1.0, 11)
    return CellModel(
        capacity_Ah=3.0,
        ocv_V=np.linspace(3.2, 4.2, 11),
        r0_ohm=0.03 * bend,
        r1_ohm=0.01 * bend,
        tau1_s=2.0 * FLAT,
        r2_ohm=0.02 * bend,
        tau2_s=30.0 * FLAT,
        effects=(SlowDiffusion(R3_OHM * bend[None, :], tau3_s),),
        error=ModelError.of_white_and_slow(white_V=0.001, slow_V=(SLOW_V,), resistance_share=0.0),
    )


def component(soc: float, v3: float, variances: tuple[float, float, float]) -> EkfState:
    """A state with a variance of SOC and of the slow branch, and their covariance."""
    state = Ekf(linear()).init(soc, 0.1)
    p = state.p._replace(ss=variances[0], p33=variances[1], s3=variances[2])
    return state._replace(cell=state.cell._replace(v3_V=v3), p=p)


def bank_model(model: CellModel) -> BankModel:
    """What the functions of a bank are handed, at one sample a second."""
    ekf, tables = Ekf(model), model.parameters()
    noise = ekf.noise.scalars(model)
    constant = step_constants(tables.cell, noise, 1.0)
    return BankModel(constant, tables, noise, ekf.start(0.5))


def in_memory(state: EkfState) -> np.ndarray:
    """A component as a bank holds it, shape (1,)."""
    memory = np.zeros(1, STATE)
    memory.view(float)[: state.row().size] = state.row()
    return memory


def test_what_is_known_of_the_past_is_a_measurement_of_the_slow_branch():
    """Against the normal equations of two unknowns; components compare by its evidence."""
    model = linear()
    mean_A, since_s = 1.5, 60.0
    left = np.exp(-since_s / TAU3_S)
    before = R3_OHM * mean_A  # a discharge from full at that current has long filled the branch
    held = R3_OHM * (1 - left) * mean_A + left * before
    spread = left * (PAST_SPREAD * before + R3_OHM * PAST_RATE * 3.0)
    costs, expected = [], []
    for soc, v3 in ((0.5, 0.05), (0.5, -0.02)):
        p = np.array([[0.01, -3e-4], [-3e-4, 4e-4]])
        state = component(soc, v3, (p[0, 0], p[1, 1], p[0, 1]))
        memory = in_memory(state)
        know_past(bank_model(model), PLACE, memory[0], since_s, mean_A)
        after, cost = memory[0], float(memory["cost"][0])
        one = spread**2 + LEAST_PAST_V2
        gain = p[:, 1] / (p[1, 1] + one)
        np.testing.assert_allclose(
            (after["soc"], after["v3_V"]), (soc, v3) + gain * (held - v3), rtol=1e-3
        )
        left_over = p - np.outer(gain, p[1])
        np.testing.assert_allclose(
            (after["ss"], after["s3"], after["p33"]),
            (left_over[0, 0], left_over[0, 1], left_over[1, 1]), rtol=1e-3,
        )  # fmt: skip
        costs.append(cost)
        expected.append(-stats.norm.logpdf(held, v3, np.sqrt(p[1, 1] + one)))
    assert costs[1] - costs[0] == pytest.approx(expected[1] - expected[0], rel=1e-3)


@pytest.mark.parametrize(("start", "std"), [(0.5, 0.15), (0.3, 0.1), (0.8, 0.3)])
def test_the_bank_is_the_posterior_of_a_start_with_tails(start, std):
    """One voltage at rest of a cell without memory, against every SOC weighed by itself."""
    truth, sigma = 0.62, 0.06
    model = CellModel(
        capacity_Ah=3.0,
        ocv_V=np.linspace(3.2, 4.2, 11),
        r0_ohm=0.03 * FLAT,
        r1_ohm=1e-6 * FLAT,
        tau1_s=2.0 * FLAT,
        r2_ohm=1e-6 * FLAT,
        tau2_s=30.0 * FLAT,
        error=ModelError.of_white_and_slow(white_V=sigma, slow_V=(1e-6,), resistance_share=0.0),
    )
    noise = replace(Noise.of_model(model), ocv_soc=0.0, mismatch_cap=0.0, lasting_share=0.0)
    ekf = Ekf(model, noise)
    _, info = ekf.step(ekf.init(start, std), 0.0, 3.2 + truth, 25.0, dt_s=0.0)
    s = np.linspace(0.0, 1.0, 4001)
    one = np.hypot(sigma, START_BRANCH_V * np.sqrt(2.0))
    weight = stats.t.pdf(s, TAIL, start, std) * stats.norm.pdf(s, truth, one)
    weight /= weight.sum()
    mean = np.sum(weight * s)
    assert info.soc == pytest.approx(mean, abs=0.1 * std)
    assert info.soc_std == pytest.approx(np.sqrt(np.sum(weight * (s - mean) ** 2)), rel=0.2)


def test_what_flows_after_the_start_is_in_the_branch_whatever_was_before():
    held, variance = past_of(R3_OHM, 1.0, 1.5, 1.0, 0.15)
    assert held == pytest.approx(R3_OHM * 1.5)
    assert variance == LEAST_PAST_V2


@pytest.mark.parametrize(("mean_A", "soc"), [(2.0, 0.995), (-2.0, 0.005)])
def test_near_the_end_that_a_load_comes_from_a_slow_branch_holds_nothing(mean_A, soc):
    """A charge from empty has just begun near empty: the OCV alone is the level there."""
    left = left_by_load(bank_model(linear()), PLACE, mean_A, soc)
    assert abs(left) < 0.2 * R3_OHM * 2.0


HOURS_S = 5000.0


def left_after(mean_A: float, soc: float) -> float:
    """A branch of :func:`linear` that a discharge from full has come to a SOC with."""
    return R3_OHM * mean_A * (1.0 - np.exp(-(1.0 - soc) * 3.0 * 3600.0 / mean_A / HOURS_S))


@pytest.mark.parametrize("mean_A", [0.3, 1.5, 3.0])
def test_a_past_of_constant_load_is_what_its_equation_says(mean_A):
    model = linear(tau3_s=HOURS_S)
    left = left_by_load(bank_model(model), PLACE, mean_A, 0.4)
    assert left == pytest.approx(left_after(mean_A, 0.4), rel=0.03)


def test_another_mean_load_is_another_past():
    model = linear(tau3_s=HOURS_S)
    since_s, looked_A, mean_A = 960.0, 0.3, 1.5
    state = component(0.4, 0.03, (0.01, 4e-4, 1e-3))
    memory = in_memory(state)
    know_past_better(bank_model(model), PLACE, memory[0], since_s, mean_A, looked_A)
    after = EkfState.of_row(memory.view(float)[: state.row().size])
    left = np.exp(-since_s / HOURS_S)
    more = left * (left_after(mean_A, 0.4) - left_after(looked_A, 0.4))
    assert after.cell.v3_V - state.cell.v3_V == pytest.approx(more, rel=0.03)
    # What the branch does not hold is the SOC's, as the covariance has them together.
    soc = state.p.s3 / state.p.p33 * more
    assert after.cell.soc - state.cell.soc == pytest.approx(soc, rel=0.03)
    assert after.p == state.p


@pytest.mark.parametrize("kind", [Ekf, Ukf])
def test_a_use_that_pauses_in_its_first_minutes_is_found_after_some_more(kind):
    """240 s at a fifth of the load before them say too little of a branch of hours."""
    model = linear(tau3_s=HOURS_S)
    time = np.arange(0.0, 3600.0 + 1500.0)
    current = np.full(time.size, 1.5)
    current[3600:3850] = 0.3
    current[3850:] = 1.8
    whole = CellLog(time, current, np.full(time.size, 4.0), temperature_C=np.full(time.size, 25.0))
    done = simulate(model, whole, 1.0)
    rows = slice(3600, None)
    log = CellLog(
        time[rows] - 3600.0, current[rows], done.voltage_V[rows], temperature_C=np.full(1500, 25.0)
    )
    error = kind(model).run(log, float(done.soc[3600]), 0.15).soc - done.soc[rows]
    before, after = error[955], error[965]
    assert abs(before) > 0.003
    assert abs(after) < 0.5 * abs(before)


def use(model: CellModel, soc0: float, seed: int) -> tuple[CellLog, np.ndarray]:
    """A drive's second half, with what its first half has left in the branches; its SOC."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 3000.0)
    current = np.repeat(rng.uniform(-0.5, 3.5, 600), 5)
    whole = CellLog(time, current, np.full(time.size, 4.0), temperature_C=np.full(time.size, 25.0))
    done = simulate(model, whole, soc0)
    rows = slice(1500, None)
    log = CellLog(
        time[rows] - time[1500], current[rows], done.voltage_V[rows],
        temperature_C=np.full(1500, 25.0),
    )  # fmt: skip
    return log, done.soc[rows]


@pytest.mark.parametrize("kind", [Ekf, Ukf])
@pytest.mark.parametrize("wrong", [-0.25, 0.25])
def test_cut_out_of_a_use_the_band_holds_the_truth_and_closes(kind, wrong):
    """Resistances that change by half over SOC: what a tangent at the wrong start cannot know."""
    model = linear(r_slope=-0.5)
    inside, errors = [], []
    for seed in range(6):
        log, truth = use(model, 0.8, seed)
        trace = kind(model).run(log, float(truth[0]) + wrong, 0.15)
        error = trace.soc - truth
        inside.append(np.mean(np.abs(error) < 2.0 * trace.soc_std))
        errors.append(error[300:])
    assert np.mean(inside) > 0.93
    # The model is perfect and claims 10 mV, a point of SOC, and so do branches.
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def looks_of(state: EkfState) -> float:
    """How often the past has been looked at; LOOKS: nothing more is to come."""
    return state.bank[RECORD, BANK_FIELDS.index("looks")]


def test_a_start_that_is_known_or_at_rest_is_not_looked_at():
    ekf = Ekf(linear())
    known, _ = ekf.step(ekf.init(0.5, 0.005), 2.0, 3.6, dt_s=0.0)
    resting, _ = ekf.step(ekf.init(0.5, 0.15), 0.0, np.nan, dt_s=0.0)
    under_load, _ = ekf.step(ekf.init(0.5, 0.15), 2.0, 3.6, dt_s=0.0)
    assert not isinstance(known, BankState)
    assert looks_of(resting) == LOOKS
    assert looks_of(under_load) == 0.0


def test_a_gap_ends_the_looks():
    ekf = Ekf(linear())
    state, _ = ekf.step(ekf.init(0.5, 0.15), 2.0, 3.6, dt_s=0.0)
    state, _ = ekf.step(state, 2.0, 3.6, dt_s=1.0)
    assert looks_of(state) == 0.0
    state, _ = ekf.step(state, 2.0, 3.6, dt_s=60.0, gap=True)
    assert looks_of(state) == LOOKS


@pytest.mark.parametrize("share", [0.2, 0.5, 0.85])
def test_a_persistent_error_is_evidence_once(share):
    """Over any time no more than one error over its share; all of it while little is persistent."""
    noise = replace(Noise.of_model(linear()), lasting_share=share, slow_s=300.0).scalars()
    c = constants_of(3600.0, 0.0, noise, 1.0, 1.0)
    time_s, step_s = np.linspace(0.0, 400_000.0, 80_001, retstep=True)
    new = np.array([evidence_share(c.fades, c.stays, c.shared, t) for t in time_s])
    assert np.all(np.diff(new) <= 0.0)
    assert new[0] == 1.0
    errors = step_s * np.cumsum(new) / (2.0 * noise.slow_s)
    assert errors[-1] < 1.0 / share
    assert errors[-1] > 0.3 / share


def test_components_follow_a_block_as_they_would_every_sample():
    """Each by its own resistances, whatever current has flowed within the block."""
    r_slope, rows = 0.5, 45
    current_A = np.random.default_rng(4).uniform(-3.0, 6.0, rows)
    ekf = Ekf(linear(r_slope))
    state = ekf.init(0.5, 0.15)
    for k in range(rows):
        state, _ = ekf.step(state, current_A[k], np.nan, 25.0, dt_s=float(k > 0))
        if k == 0:
            began = np.frombuffer(state.bank.tobytes(), STATE)[1:-1]["soc"].copy()
    of = np.frombuffer(state.bank.tobytes(), STATE)[1:-1]
    blocks = 40  # what is not over yet no component has seen
    used = np.sum(current_A[1 : blocks + 1]) / 3600.0 / 3.0
    np.testing.assert_allclose(of["soc"], np.clip(began - used, 0.0, 1.0), atol=1e-9)
    bend = 1.0 + r_slope * of["soc"]
    for name, r_ohm, tau_s in (
        ("v1_V", 0.01, 2.0), ("v2_V", 0.02, 30.0), ("v3_V", R3_OHM, TAU3_S),
    ):  # fmt: skip
        left = np.exp(-1.0 / tau_s)
        expected = 0.5 * current_A[0]
        for now in current_A[1 : blocks + 1]:
            expected = left * expected + (1.0 - left) * now
        np.testing.assert_allclose(of[name], r_ohm * bend * expected, rtol=0.01)


def test_what_nobody_counted_begins_the_components_again():
    ekf = Ekf(linear())
    state, _ = ekf.step(ekf.init(0.6, 0.005), 1.0, 3.75, dt_s=1.0)
    assert not isinstance(state, BankState)
    state, info = ekf.step(state, 1.0, 3.75, dt_s=7200.0, gap=True)
    assert isinstance(state, BankState)
    assert info.soc_std > 0.03


@pytest.mark.parametrize("components", [0, -3, 2.5, True, 1000, "11"])
def test_another_number_of_components_is_refused(components):
    with pytest.raises(InputError, match="components"):
        Ekf(linear(), components=components)


def test_a_restart_goes_on_with_the_looks():
    model = linear(r_slope=-0.5)
    log, truth = use(model, 0.8, 3)
    ekf = Ekf(model)
    straight = put_away = ekf.init(float(truth[0]) - 0.2, 0.15)
    for k in range(970):
        reading = log.current_A[k], log.voltage_V[k], 25.0
        dt_s = 1.0 if k else 0.0
        straight, _ = ekf.step(straight, *reading, dt_s=dt_s)
        put_away, _ = ekf.step(put_away, *reading, dt_s=dt_s)
        if k in (30, 500):
            assert k > 30 or isinstance(put_away, BankState)
            put_away = state_from_dict(json.loads(json.dumps(state_to_dict(put_away))))
    assert put_away == straight


def test_lockstep_looks_as_the_filter_does():
    model = linear(r_slope=-0.5)
    log, truth = use(model, 0.8, 3)
    start = float(truth[0]) - 0.2
    ekf, fleet = Ekf(model), LockstepEkf(model, 2, 1.0)
    one, many = ekf.init(start, 0.15), fleet.init(np.array([start, 0.6]), 0.15)
    for k in range(300):
        one, _ = ekf.step(one, log.current_A[k], log.voltage_V[k], 25.0, dt_s=1.0)
        both = np.full(2, log.current_A[k]), np.full(2, log.voltage_V[k])
        many, _ = fleet.step(many, *both, 25.0)
    np.testing.assert_allclose(fleet.cell_state(many, 0).soc, one.soc, rtol=1e-9)


def test_a_bank_closes_where_its_components_agree_however_unsure_each_is():
    """One Gaussian is all that a sum of the same ones says."""
    of = np.concatenate([in_memory(component(0.6, 0.0, (0.01, 1e-6, 0.0))) for _ in range(3)])
    bank = np.zeros(1, [(name, float) for name in BANK_FIELDS])[0]
    for apart, spread in ((0.3, 1), (0.0, 0)):
        bank["spread"], bank["likeliest"], bank["looks"] = 1.0, 1.0, LOOKS
        of["soc"][1:] = 0.6 - apart / 2.0, 0.6 + apart / 2.0
        of["cost"], of["weight"] = 0.0, 0.5
        gather(bank, of, 2)
        assert bank["spread"] == spread
        assert of["soc"][0] == pytest.approx(0.6)

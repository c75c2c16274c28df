"""Many cells in lockstep: each is the EKF of its own samples, whatever the others do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.effects import (
    ChargeAsymmetry,
    ChargeTransfer,
    Hysteresis,
    RateDependence,
    SelfDischarge,
    SelfHeating,
    SlowDiffusion,
    SurfaceSoc,
    TemperatureDependence,
    TimeSkew,
)
from cellwise.cell.plausibility.validity import Validity
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.lockstep import LockstepEkf
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell

CELLS = 37  # two whole blocks and a part
STEPS = 400

MODELS = {
    "plain": curved_cell(),
    "slow branch": curved_cell(effects=(SlowDiffusion(r3_ohm=0.02, tau3_s=1500.0),)),
    "hysteresis": curved_cell(effects=(Hysteresis(m_V=0.02, gamma=40.0),)),
    "skew, leak, rate, charge": curved_cell(
        effects=(
            TimeSkew(skew_s=0.4), SelfDischarge(leak_A=0.01), RateDependence(rate_h=0.2),
            ChargeAsymmetry(charge_scale=1.3), SlowDiffusion(r3_ohm=0.02, tau3_s=800.0),
        ),
        charge_efficiency=0.98,
    ),
    "Arrhenius": curved_cell(effects=(TemperatureDependence(activation_K=3000.0),)),
    "beyond its data": curved_cell(validity=Validity(temperature_C=(18.0, 22.0))),
    "charge transfer": curved_cell(effects=(ChargeTransfer(asinh_per_V=60.0),)),
    "surface": curved_cell(effects=(SurfaceSoc(depth_h=0.08, tau_s=60.0),)),
    "heating": curved_cell(
        effects=(TemperatureDependence(activation_K=3000.0), SelfHeating(rth_K_per_W=4.0)),
    ),
}  # fmt: skip


def warm_cell():
    """Tables at two temperatures."""
    cold, room = curved_cell(), curved_cell()
    both = {name: np.vstack([1.5 * getattr(cold, name), getattr(room, name)])
            for name in ("r0_ohm", "r1_ohm", "r2_ohm")}  # fmt: skip
    same = {name: np.vstack([getattr(cold, name), getattr(room, name)])
            for name in ("ocv_V", "tau1_s", "tau2_s")}  # fmt: skip
    return replace(room, **both, **same, temperature_C=np.array([0.0, 25.0]))


MODELS["two temperatures"] = warm_cell()


def samples(model, rng, faults=True):
    """Currents, voltages and temperatures of cells that each go their own way."""
    current = np.repeat(rng.normal(0.5, 2.0, (STEPS // 10, CELLS)), 10, axis=0)
    current[:3] = 0.0
    warm = 20.0 + 4.0 * rng.standard_normal(CELLS) + 0.01 * np.arange(STEPS)[:, None]
    soc0 = rng.uniform(0.35, 0.9, CELLS)
    voltage = np.empty_like(current)
    for k in range(CELLS):
        time, flow = np.arange(STEPS + 1.0), np.append(0.0, current[:, k])
        log = CellLog(time, flow, np.full(STEPS + 1, 3.7), np.append(warm[0, k], warm[:, k]))
        voltage[:, k] = simulate(model, log, float(soc0[k])).voltage_V[1:]
    voltage += 0.002 * rng.standard_normal(voltage.shape)
    gap = np.zeros((STEPS, CELLS), dtype=bool)
    if faults:
        current[50:70, 3] = np.nan  # lost
        voltage[100:140, 5] = np.nan
        voltage[200:260, 7] = voltage[200, 7]  # frozen
        voltage[120, 9] = 9.0
        warm[150:160, 11] = np.nan
        gap[220, 13] = True
        voltage[250:, 15] += 0.3  # gate and recovery
        current[180, 36] = 1e9
    return current, voltage, warm, gap, soc0


@pytest.mark.parametrize("name", MODELS)
def test_every_cell_is_the_ekf_of_its_own_samples(name):
    model = MODELS[name]
    rng = np.random.default_rng(8)
    current, voltage, warm, gap, soc0 = samples(model, rng)
    told = np.clip(soc0 + rng.uniform(-0.3, 0.3, CELLS), 0.0, 1.0)
    stds = np.where(np.arange(CELLS) % 3, 0.15, 0.01)
    fleet = LockstepEkf(model, CELLS, 1.0)
    state = fleet.init(told, stds)
    ekf = Ekf(model)
    one_by_one = [ekf.init(float(s), float(d)) for s, d in zip(told, stds, strict=True)]
    short = 0
    for k in range(STEPS):
        state, info = fleet.step(state, current[k], voltage[k], warm[k], gap=gap[k])
        short += info.short
        his = []
        for j in range(CELLS):
            one_by_one[j], seen = ekf.step(
                one_by_one[j], current[k, j], voltage[k, j], warm[k, j], dt_s=1.0, gap=gap[k, j]
            )
            his.append(seen)
        soc, std, predicted = (np.array([getattr(h, f) for h in his])
                               for f in ("soc", "soc_std", "voltage_V"))  # fmt: skip
        np.testing.assert_allclose(info.soc, soc, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(info.soc_std, std, rtol=1e-9)
        np.testing.assert_allclose(info.voltage_V, predicted, rtol=1e-12)
        assert info.status.tolist() == [h.status for h in his], k
    assert short > 0.5 * STEPS * CELLS
    for j in (0, 15, 36):
        assert fleet.cell_state(state, j).watch.repeats == one_by_one[j].watch.repeats
        assert fleet.cell_state(state, j).p.p12 == pytest.approx(one_by_one[j].p.p12, abs=1e-12)


def test_one_number_is_for_all_and_a_whole_number_of_blocks_is_no_other():
    model = MODELS["plain"]
    current, voltage, *_ = samples(model, np.random.default_rng(4), faults=False)
    many, few = LockstepEkf(model, 32, 1.0), LockstepEkf(model, 5, 1.0)
    a, b = many.init(0.6, 0.1), few.init(np.full(5, 0.6), np.full(5, 0.1))
    for k in range(50):
        a, all_of_them = many.step(a, current[k, :32], voltage[k, :32], 25.0)
        b, some = few.step(b, current[k, :5], voltage[k, :5], np.full(5, 25.0))
        np.testing.assert_array_equal(all_of_them.soc[:5], some.soc)
        assert some.soc.shape == some.status.shape == (5,)


def test_what_fits_nowhere_is_refused():
    model = MODELS["plain"]
    with pytest.raises(InputError, match="0 cells"):
        LockstepEkf(model, 0, 1.0)
    with pytest.raises(InputError, match="dt_s"):
        LockstepEkf(model, 3, 0.0)
    fleet = LockstepEkf(model, 3, 1.0)
    with pytest.raises(InputError, match="soc0"):
        fleet.init([0.5, 0.6])
    state = fleet.init(0.5)
    with pytest.raises(InputError, match="current_A of shape"):
        fleet.step(state, np.zeros(4), 3.7)
    with pytest.raises(InputError, match="a state of 4 cells"):
        fleet.step(LockstepEkf(model, 4, 1.0).init(0.5), 0.0, 3.7)

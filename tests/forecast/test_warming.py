"""How a cell will warm, against lumps whose heat capacity and surroundings are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from known_flights import CUTOFF_V, discharge, known_replay, until

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.model_error import ModelError
from cellwise.cell.simulate import simulate
from cellwise.estimate.replay import replay
from cellwise.forecast.outlook import Outlook
from cellwise.forecast.remaining import forecast
from cellwise.forecast.warming_kernels import (
    COOLING_PER_S,
    NOTHING_SEEN,
    SHARE_OF_HEAT,
    SURROUNDINGS_K,
    Warmth,
    observed,
    rise_std_K,
    thermal_of,
    usual_per_J,
    warmed,
)
from cellwise.live import LiveFilter
from cellwise.logs.cell_log import CellLog
from example_cells import curved_cell
from streams import samples

CHARGE_AS = 3600.0 * 3.0


def lump_log(per_J, per_s, drift, lost_W, dt, first_C=20.0):
    """Temperatures of a lump by small Euler steps: another way than the module's."""
    temperature = np.empty(lost_W.size)
    rise = 0.0
    for k, watts in enumerate(lost_W):
        temperature[k] = first_C + rise
        for _ in range(10):
            rise += dt / 10 * (per_J * watts - per_s * rise + drift)
    return temperature


def watched(temperature, lost_W, dt):
    seen = NOTHING_SEEN
    for k in range(temperature.size):
        seen = observed(seen, CHARGE_AS, lost_W[max(k - 1, 0)], temperature[k], dt)
    return seen


def test_a_lump_is_found_again():
    """Loads that come and go over some hours separate losses, cooling and surroundings."""
    lost = np.where(np.arange(3000) // 300 % 2 == 0, 6.0, 0.5)
    truth = 1 / 45.0, 1 / 700.0, 4.0 / 700.0
    seen = watched(lump_log(*truth, lost, 5.0), lost, 5.0)
    lump = thermal_of(seen, CHARGE_AS, 25.0, False)
    assert lump.per_J == pytest.approx(truth[0], rel=0.03)
    assert lump.per_s == pytest.approx(truth[1], rel=0.05)
    assert lump.drift_K_per_s == pytest.approx(truth[2], rel=0.15)


def test_its_deviation_is_that_of_lumps_drawn_from_what_was_expected():
    """After five minutes and after forty, the temperature half an hour later: z of 60 lumps."""
    rng = np.random.default_rng(3)
    usual = usual_per_J(CHARGE_AS)
    z = {60: [], 480: []}
    lost = np.full(900, 0.5)
    for _ in range(60):
        a = usual * max(1 + SHARE_OF_HEAT * rng.normal(), 0.2)
        k = COOLING_PER_S * max(1 + rng.normal(), 0.05)
        c = COOLING_PER_S * SURROUNDINGS_K * rng.normal()
        truth = lump_log(a, k, c, lost, 5.0)
        noisy = truth + rng.normal(0, 0.1, lost.size)
        for rows, found in z.items():
            lump = thermal_of(watched(noisy[:rows], lost, 5.0), CHARGE_AS, 0.0, False)
            at = Warmth(noisy[rows - 1] - lump.origin_C, 0.0, 0.0, 0.0)
            for _ in range(360):
                at = warmed(lump, at, 0.5, 5.0)
            away = lump.origin_C + at.rise_K - truth[rows - 1 + 360]
            found.append(away / math.hypot(rise_std_K(lump, at), 0.1))
    for found in z.values():
        assert np.sqrt(np.mean(np.square(found))) < 1.3
    assert np.mean(np.abs(z[60]) < 2.0) > 0.9
    assert np.sqrt(np.mean(np.square(z[60]))) > 0.5


def test_a_temperature_that_never_moves_was_stated():
    seen = watched(np.full(600, 23.0), np.full(600, 6.0), 5.0)
    assert not thermal_of(seen, CHARGE_AS, 23.0, False).heats
    unseen = thermal_of(seen, CHARGE_AS, 23.0, True)
    assert unseen.heats
    assert unseen.per_J == pytest.approx(usual_per_J(CHARGE_AS))


def warming_discharge(current_A, per_J=1 / 60.0):
    """A cell whose resistance follows Arrhenius, its log, and the truth."""
    model = replace(
        curved_cell(), effects=(TemperatureDependence(activation_K=3600.0, reference_C=25.0),)
    )
    bare = CellLog(np.arange(4000.0), np.full(4000, current_A), np.full(4000, 3.7), name="warming")
    warm = np.full(4000, 5.0)
    for _ in range(6):  # losses follow the temperature, and it them
        log = replace(bare, temperature_C=warm)
        truth = simulate(model, log, 0.95)
        ocv = np.interp(truth.soc, model.soc, model.ocv_V[0])
        lost = current_A * (ocv - truth.voltage_V)
        warm = lump_log(per_J, 1 / 900.0, 0.0, np.maximum(lost, 0.0), 1.0, first_C=5.0)
    return model, replace(log, voltage_V=truth.voltage_V), truth


def test_a_cell_that_warms_lasts_as_long_as_it_will():
    model, whole, truth = warming_discharge(7.5)
    end_s, _ = until(whole, truth.soc, CUTOFF_V)
    now = int(0.35 * end_s)
    assert whole.temperature_C[int(end_s)] - whole.temperature_C[now] > 10.0
    known = known_replay(whole.part(0, now), truth.soc[:now], 0.002)
    left = forecast(model, known, cutoff_V=CUTOFF_V, hold="current").last
    truly_s = end_s - left.time_s
    low, high = left.remaining_s_band
    assert low < truly_s < high
    assert left.remaining_s == pytest.approx(truly_s, rel=0.02)
    # What a temperature that stays would have said.
    stays = replace(known.log, temperature_C=np.full(now, known.log.temperature_C[-1]))
    flat = replace(model, effects=(replace(model.effects[0], activation_K=0.0),))
    scale = math.exp(3600.0 * (1 / (stays.temperature_C[-1] + 273.15) - 1 / 298.15))
    tables = ("r0_ohm", "r1_ohm", "r2_ohm")
    flat = replace(flat, **{name: scale * getattr(flat, name) for name in tables})
    cold = forecast(
        flat, known_replay(stays, truth.soc[:now]), cutoff_V=CUTOFF_V, hold="current"
    ).last
    assert abs(left.remaining_s - truly_s) < 0.5 * abs(cold.remaining_s - truly_s)


def test_a_temperature_that_nobody_measures_widens_the_band():
    model, whole, truth = warming_discharge(7.5)
    end_s, _ = until(whole, truth.soc, CUTOFF_V)
    now = int(0.35 * end_s)
    part = whole.part(0, now)
    bands = []
    for log in (part, replace(part, temperature_C=None)):
        found = forecast(
            model, known_replay(log, truth.soc[:now], 0.002), cutoff_V=CUTOFF_V, hold="current"
        ).last
        bands.append(found.remaining_s_band)
    assert bands[1][1] - bands[1][0] > bands[0][1] - bands[0][0]
    assert bands[1][0] < end_s - part.time_s[-1] < bands[1][1]


@pytest.mark.slow
def test_live_knows_the_warming_that_a_replay_knows():
    model, whole, _ = warming_discharge(3.0)
    part = whole.part(0, 900)
    live = LiveFilter(model, soc0=0.95, soc0_std=0.01)
    outlook = Outlook(model, CUTOFF_V)
    for sample in samples(part):
        outlook.take(live.take(sample))
    now = outlook.forecast(live.state, float(part.temperature_C[-1]))
    same = replay(model, part, "ekf", soc0=0.95, soc0_std=0.01)
    told = forecast(model, same, cutoff_V=CUTOFF_V).last
    assert now.remaining_s == pytest.approx(told.remaining_s, rel=0.01)
    assert now.remaining_s_band == pytest.approx(told.remaining_s_band, rel=0.05)


def test_what_a_resistance_is_off_by_grows_with_the_polarisation():
    """Twice the resistance, and a model that states its resistances as the uncertain part."""
    model = curved_cell()
    aged = model.with_resistances(1.5)
    whole, truth = discharge(aged, np.full(4000, 4.0), 0.95)
    end_s, _ = until(whole, truth.soc, CUTOFF_V)
    now = int(0.4 * end_s)
    missed = []
    for share in (0.0, 0.5):
        says = replace(
            model, error=ModelError.of_white_and_slow(slow_V=(0.002,), resistance_share=share)
        )
        known = known_replay(whole.part(0, now), truth.soc[:now])
        left = forecast(says, known, cutoff_V=CUTOFF_V, hold="current").last
        missed.append(abs(left.remaining_s - (end_s - left.time_s)))
    assert missed[1] < 0.3 * missed[0]

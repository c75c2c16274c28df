"""An effect is hidden, the diagnosis must name it first; where nothing is, nothing.

In simulated cells, which are as far from their model as that states, every cause; in measured
drives of 50 minutes, whose residual no model knows, those that the ablation bench hides, at twice
its sizes, near the limits of what such logs show.
Cells of other physics: `test_physics_laboratory`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.ablation.diagnosis import HIDDEN, ROWS, STEP_S, with_effect

from cellwise.cell.effects import TemperatureDependence
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.cell.model_error import ModelError
from cellwise.diagnose import diagnose
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.rows import gather
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import CellLog, read_log
from cellwise.logs.cell_log import resample
from example_cells import curved_cell, within_its_error
from measured_models import identify_once
from random_loads import random_load

SOC0 = 0.9
# Cause to its coordinates: 10 to 40 mV each. Losses of electrodes: `causes/test_electrodes`.
EFFECTS = {
    "current_offset": {"offset_A": 0.10},
    "current_gain": {"ln_gain": 0.06},
    "voltage_offset": {"offset_V": -0.020},
    "time_skew": {"skew_s": 0.8},
    "initial_soc": {"soc0:0": -0.05},
    "capacity": {"ln_capacity": -0.08},
    "resistance_scale": {"ln_scale": 0.3},
    "ohmic_resistance": {"added_r0": 0.4},
    "entropy": {"docv_dT": 1.5e-3},
    "ocv_shift": {"ocv_3": 0.02, "ocv_4": 0.04, "ocv_5": 0.02},
    "slow_diffusion": {"r3": 1.0},
    "hysteresis": {"m_V": 0.03, "ln_gamma": 0.7},
    "temperature_dependence": {"activation_K": 3000.0},
    "rate_dependence": {"rate_h": 0.4},
    "charge_asymmetry": {"ln_charge_scale": 0.4},
    "self_heating": {"rth_K_per_W": 40.0},
    "self_discharge": {"leak_A": 0.15},
}
MISSED = 0.1  # of the effects, at most; as many names may be false


def said_of(name: str):
    """The diagnosis of two logs with an effect, a third held out and a clean one as baseline."""
    effect = EFFECTS.get(name, {})
    rng = np.random.default_rng(41)
    error = ModelError.of_white_and_slow(1e-3, (2e-3,), 120.0, 0.01)
    model = replace(curved_cell(), error=error).with_effect(TemperatureDependence(2000.0))
    cell = Coordinates(within_its_error(model, rng))
    made = []
    for k in range(4):
        load = random_load(
            rng, 3.0, SOC0, rows=2500, rate_hz=1.0, charge=True, temperature_C=(10.0, 40.0)
        )
        here = {} if k == 3 else effect
        read = load.current_A * np.exp(here.get("ln_gain", 0.0)) + here.get("offset_A", 0.0)
        log = CellLog(load.time_s, read, np.full(read.size, 3.7), load.temperature_C)
        rows = gather(cell.model, [(log, InitialSoc(SOC0, 0.002, "given"))])
        voltage, _ = rows.simulate(cell, here)
        made.append(replace(log, voltage_V=voltage + rng.normal(0.0, 1e-3, voltage.size)))
    return diagnose(model, made[:2], holdout=made[2:3], baseline=made[3:], soc0=SOC0)


@pytest.mark.slow
def test_an_effect_is_named_first_and_where_nothing_is_hidden_nothing():
    assert said_of("voltage_offset").verdict == "voltage_offset"
    assert said_of("nothing").verdict == "none"


@pytest.mark.slow
def test_nine_of_ten_effects_are_named_first_and_hardly_a_false_one():
    found = {name: said_of(name) for name in EFFECTS}
    missed = {n: f"{s.verdict} {s.causes}" for n, s in found.items() if s.verdict != n}
    false = [(n, c.name) for n, s in found.items() for c in s.causes if c.name != n]
    assert len(missed) <= MISSED * len(found), missed
    assert len(false) <= MISSED * len(found), false


@cache
def measured(folder):
    """Model of the Panasonic cell by its tests and two drives, and three other drives."""
    hppc, ocv, one_C, two, three, nn, us06, clean = (
        read_log(folder / f"panasonic_18650pf/{name}.csv.gz")
        for name in ("hppc_p25", "ocv_c20_p25", "cap_1c_p25_start_1", "drive_p25_cycle_2",
                     "drive_p25_cycle_3", "drive_p25_nn", "drive_p25_us06", "drive_p25_hwfta")
    )  # fmt: skip
    tests = CellTests(hppc=hppc, ocv=ocv, capacity=one_C, drive=(two, three))
    model = identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model
    return model, [resample(log, STEP_S).part(0, ROWS) for log in (nn, us06, clean)]


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="slow diffusion stays open, a capacity likelier (0.86)")
def test_an_effect_in_measured_drives_is_named_or_the_likeliest_of_what_stays_open(real_data):
    model, (nn, us06, clean) = measured(real_data)
    named = 0
    for effect, (right, size) in HIDDEN.items():
        a, b = (with_effect(log, effect, 2.0 * size, model.capacity_Ah) for log in (nn, us06))
        said = diagnose(model, a, holdout=b, baseline=clean, soc0=1.0)
        named += said.verdict in right
        assert said.verdict in (*right, "undetermined"), effect
        assert set(said.competing[0].causes) & set(right), effect
        assert all(c.name in right for c in said.causes), effect
    assert named >= len(HIDDEN) // 2
    assert diagnose(model, nn, holdout=us06, baseline=clean, soc0=1.0).verdict == "none"

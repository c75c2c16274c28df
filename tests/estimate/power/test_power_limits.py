"""State of power: a linear cell's closed form, finer intervals, draws of the SOC."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.equations import CellState, advance, empty_state, voltage_of
from cellwise.cell.model_error import ModelError, moved_part
from cellwise.cell.plausibility.validity import Validity
from cellwise.errors import InputError
from cellwise.estimate.noise import Noise
from cellwise.estimate.power.limit_kernels import Question, largest_load
from cellwise.estimate.power.limits import OperatingLimits, operating_limits
from cellwise.estimate.power.load_kernels import AS_MODEL, BIAS_S, OperatingPoint
from cellwise.estimate.power.state_of_power import power_limits, power_settings
from example_cells import EFFECTS, curved_cell, lfp_cell, linear_cell, random_model

LIMITS = OperatingLimits(3.0, 4.2)
LOADED = CellState(0.55, 0.02, 0.03, 0.0, 0.0)
WARM_C = 25.0


def constant_current(model, state, limit_V, horizon_s):
    """Current at which a linear cell's voltage is the limit after the horizon, solved by hand."""
    slope = float(model.ocv_V[0, -1] - model.ocv_V[0, 0])
    rest, per_A = float(np.interp(state.soc, model.soc, model.ocv_V[0])), float(model.r0_ohm[0, 0])
    per_A += slope * horizon_s / (3600.0 * model.capacity_Ah)
    for v, r, tau in (
        (state.v1_V, model.r1_ohm[0, 0], model.tau1_s[0, 0]),
        (state.v2_V, model.r2_ohm[0, 0], model.tau2_s[0, 0]),
    ):
        left = np.exp(-horizon_s / tau)
        rest -= v * left
        per_A += r * (1.0 - left)
    return (rest - limit_V) / per_A


@pytest.mark.parametrize("horizon_s", [2.0, 10.0, 30.0])
def test_a_linear_cell_has_a_closed_form(horizon_s):
    model = linear_cell()
    found = power_limits(model, LOADED, horizons_s=(horizon_s,), limits=LIMITS, hold="current")[0]
    out_A = constant_current(model, LOADED, 3.0, horizon_s)
    in_A = -constant_current(model, LOADED, 4.2, horizon_s)
    assert found.discharge.current_A == pytest.approx(out_A, rel=1e-5)
    assert found.discharge.power_W == pytest.approx(3.0 * out_A, rel=1e-5)
    assert found.charge.current_A == pytest.approx(in_A, rel=1e-5)
    assert found.charge.power_W == pytest.approx(4.2 * in_A, rel=1e-5)
    assert found.discharge.by == found.charge.by == "voltage"


def lowest_and_highest(model, state, power_W, horizon_s, steps=400):
    """Hold a power by many short intervals of constant current; voltages on the way."""
    tables = model.parameters()
    voltages, x = [], state
    voltage = float(np.interp(state.soc, model.soc, model.ocv_V[0]))
    for k in range(steps + 1):
        for _ in range(30):  # the current whose voltage gives that power
            _, point = advance(tables, x, power_W / voltage, 0.0, WARM_C)
            voltage = voltage_of(point, x, power_W / voltage)
        voltages.append(voltage)
        if k < steps:
            x, _ = advance(tables, x, power_W / voltage, horizon_s / steps, WARM_C)
    return min(voltages), max(voltages)


@pytest.mark.slow
@pytest.mark.parametrize("horizon_s", [2.0, 10.0, 30.0])
@pytest.mark.parametrize("make", [linear_cell, curved_cell, lfp_cell])
def test_the_power_held_in_short_intervals_ends_at_the_limit(make, horizon_s):
    """Five intervals of the horizon are within 3 mV of four hundred."""
    model = replace(make(), effects=(EFFECTS[0], EFFECTS[1]))
    middle = float(np.interp(LOADED.soc, model.soc, model.ocv_V[0]))
    limits = OperatingLimits(middle - 0.5, middle + 0.3)
    found = power_limits(model, LOADED, horizons_s=(horizon_s,), limits=limits)[0]
    low_V, _ = lowest_and_highest(model, LOADED, found.discharge.power_W, horizon_s)
    _, high_V = lowest_and_highest(model, LOADED, -found.charge.power_W, horizon_s)
    assert low_V == pytest.approx(middle - 0.5, abs=0.003)
    assert high_V == pytest.approx(middle + 0.3, abs=0.003)


def test_power_and_current_held_differ_as_they_must():
    """A current that grows on the way leaves less behind it; on charge the other way round."""
    model = curved_cell()
    power = power_limits(model, LOADED, limits=LIMITS)
    current = power_limits(model, LOADED, limits=LIMITS, hold="current")
    for p, c in zip(power, current, strict=True):
        assert c.discharge.power_W < p.discharge.power_W < 1.03 * c.discharge.power_W
        assert 0.97 * c.charge.power_W < p.charge.power_W < c.charge.power_W


def test_longer_is_less_and_fuller_gives_more():
    model = curved_cell()
    by_soc = [power_limits(model, empty_state(s), limits=LIMITS) for s in (0.2, 0.5, 0.8)]
    for found in by_soc:
        out = [s.discharge.power_W for s in found]
        assert out == sorted(out, reverse=True)
    out = [found[1].discharge.power_W for found in by_soc]
    taken = [found[1].charge.power_W for found in by_soc]
    assert out == sorted(out)
    assert taken == sorted(taken, reverse=True)


def test_every_limit_is_kept_and_named():
    model = linear_cell()
    state = empty_state(0.5)
    few = OperatingLimits(3.0, 4.2, discharge_A=2.0, charge_A=1.0)
    found = power_limits(model, state, limits=few, hold="current")[1]
    assert (found.discharge.by, found.charge.by) == ("current", "current")
    assert found.discharge.current_A == pytest.approx(2.0, rel=1e-5)
    assert found.charge.current_A == pytest.approx(1.0, rel=1e-5)
    narrow = OperatingLimits(2.0, 5.0, soc_min=0.499, soc_max=0.502)
    found = power_limits(model, state, horizons_s=(30.0,), limits=narrow, hold="current")[0]
    assert (found.discharge.by, found.charge.by) == ("soc", "soc")
    per_soc = 3600.0 * model.capacity_Ah / 30.0
    assert found.discharge.current_A == pytest.approx(0.001 * per_soc, rel=1e-4)
    assert found.charge.current_A == pytest.approx(0.002 * per_soc, rel=1e-4)
    # Beyond a quarter of E^2 / R0 no current gives more power.
    weak = OperatingLimits(0.5, 4.2)
    found = power_limits(model, state, horizons_s=(0.001,), limits=weak)[0]
    rest = 3.2 + 0.9 * 0.5
    assert found.discharge.by == "supply"
    assert found.discharge.power_W == pytest.approx(rest**2 / (4 * 0.030), rel=1e-3)


def test_at_the_ends_there_is_none():
    model = curved_cell()
    for hold in ("power", "current"):
        empty, full = (
            power_limits(model, empty_state(s), limits=LIMITS, hold=hold)[1] for s in (0.0, 1.0)
        )
        assert empty.discharge.power_W == empty.discharge.power_low_W == 0.0
        assert full.charge.power_W == full.charge.power_low_W == 0.0
        assert empty.charge.power_W > 0.0
        assert full.discharge.power_W > 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_of_draws_of_the_soc_95_of_100_sustain_the_lower_bound(side):
    """The closed form of each draw says whether it holds."""
    right = ModelError.of_white_and_slow(white_V=1e-6, slow_V=(0.0,), resistance_share=0.0)
    model = linear_cell(error=right)
    now = OperatingPoint(LOADED, 0.02**2, WARM_C, AS_MODEL)
    limits = operating_limits(model, LIMITS).scalars()
    noise = replace(Noise.of_model(model), ocv_soc=0.0, current_A=0.0).scalars(model)
    asked = Question(model.parameters(), noise, limits, now, False, 10.0, side, 1.6449)
    found = largest_load(asked, 0.0)
    current_A = found[1]
    socs = np.random.default_rng(3).normal(LOADED.soc, 0.02, 4000)
    limit_V = 3.0 if side > 0 else 4.2
    able = np.array(
        [side * constant_current(model, LOADED._replace(soc=x), limit_V, 10.0) for x in socs]
    )
    assert np.mean(able >= current_A) == pytest.approx(0.95, abs=0.012)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_error_that_was_seen_leaves_the_bound_what_it_may_still_do(side):
    """Half a minute of voltages: of a slow error a fifth is left, of a SOC on a line nothing."""
    slow = ModelError.of_white_and_slow(1e-6, 0.030, 1000.0, resistance_share=0.0)
    model = linear_cell(error=slow)
    noise = replace(Noise.of_model(model), ocv_soc=0.0, current_A=0.0)
    settings = power_settings(model, horizons_s=(10.0,), limits=LIMITS, noise=noise)
    (seen,) = settings.seen
    low_A = {}
    for known, seen_s in ((settings, 0.0), (seen, BIAS_S)):
        scalars = noise.scalars(model)
        now = OperatingPoint(LOADED, 0.02**2, WARM_C, AS_MODEL._replace(seen_s=seen_s))
        limits = settings.known.scalars()
        asked = Question(known.tables, scalars, limits, now, False, 10.0, side, 1.6449)
        low_A[seen_s] = largest_load(asked, 0.0).current_A
    limit_V = 3.0 if side > 0 else 4.2
    of_soc_V = 0.02 * 0.9
    (part,) = moved_part(np.array([1000.0]), 10.0, BIAS_S).tolist()
    for seen_s, off_V in ((0.0, np.hypot(0.030, of_soc_V)), (BIAS_S, part * 0.030)):
        kept_V = limit_V + side * 1.6449 * off_V
        expected_A = side * constant_current(model, LOADED, kept_V, 10.0)
        assert low_A[seen_s] == pytest.approx(expected_A, rel=2e-3)


@pytest.mark.parametrize("side", ["discharge", "charge"])
def test_beyond_the_temperatures_of_the_data_an_error_that_was_seen_counts_whole(side):
    """There a resistance is off, and what it was seen to do at one current it does at no other."""
    slow = ModelError.of_white_and_slow(1e-6, 0.030, 1000.0, resistance_share=0.2)
    model = linear_cell(error=slow, validity=Validity(temperature_C=(20.0, 30.0)))
    settings = power_settings(model, horizons_s=(10.0,), limits=LIMITS, hold="current")
    low_W = {}
    for warm_C in (-10.0, 25.0, 50.0):
        for seen_s in (0.0, BIAS_S):
            now = OperatingPoint(LOADED, 0.02**2, warm_C, AS_MODEL._replace(seen_s=seen_s))
            (able,) = settings.of(now)
            low_W[warm_C, seen_s] = getattr(able, side).power_low_W
    assert low_W[25.0, BIAS_S] > 1.05 * low_W[25.0, 0.0]
    assert low_W[-10.0, BIAS_S] == low_W[-10.0, 0.0] > 0.0
    assert low_W[50.0, BIAS_S] == low_W[50.0, 0.0] > 0.0


def test_a_model_that_is_less_sure_promises_less():
    model = curved_cell()
    wide = replace(
        model, error=ModelError.of_white_and_slow(slow_V=(0.030,), resistance_share=0.15)
    )
    found = power_limits(model, LOADED, limits=LIMITS)[1]
    less = power_limits(wide, LOADED, limits=LIMITS)[1]
    assert less.discharge.power_W == found.discharge.power_W
    assert less.discharge.power_low_W < 0.95 * found.discharge.power_low_W
    assert found.discharge.power_low_W < found.discharge.power_W


def test_factors_and_bias_act_as_they_would_in_the_model():
    """Twice the resistances with half the branch voltages are the other model's cell."""
    model = curved_cell()
    aged = replace(model, r0_ohm=2 * model.r0_ohm, r1_ohm=2 * model.r1_ohm, r2_ohm=2 * model.r2_ohm)
    lower = replace(model, ocv_V=model.ocv_V - 0.05)
    settings = power_settings(model, limits=LIMITS)
    for other, state, but in (
        (aged, LOADED._replace(v1_V=0.04, v2_V=0.06), AS_MODEL._replace(common=1.0, tail=1.0)),
        (lower, LOADED, AS_MODEL._replace(bias_V=-0.05)),
    ):
        corrected = settings.of(OperatingPoint(LOADED, 0.0, WARM_C, but))
        known = power_limits(other, state, limits=LIMITS)
        for a, b in zip(corrected, known, strict=True):
            assert a.discharge.power_W == pytest.approx(b.discharge.power_W, rel=1e-5)
            assert a.charge.power_W == pytest.approx(b.charge.power_W, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_random_cells_stay_within_their_limits(seed):
    """Whatever effects and tables: value and bound are finite, ordered, and keep the limits."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    low, high = float(model.ocv_V.min()), float(model.ocv_V.max())
    limits = OperatingLimits(low - 0.2, high + 0.1, 20 * model.capacity_Ah, 5 * model.capacity_Ah)
    for soc in rng.uniform(0.02, 0.98, 5):
        for hold in ("power", "current"):
            for s in power_limits(model, empty_state(soc), limits=limits, hold=hold):
                for way, edge in ((s.discharge, low - 0.2), (s.charge, high + 0.1)):
                    assert 0.0 <= way.power_low_W <= way.power_W < np.inf
                    inside = way.voltage_V - edge if way is s.discharge else edge - way.voltage_V
                    assert inside > -1e-9
                assert s.discharge.current_A <= 20 * model.capacity_Ah
                assert s.charge.current_A <= 5 * model.capacity_Ah


def test_where_limits_come_from():
    cell = curved_cell(chemistry="NMC / graphite", validity=Validity(current_A=(-0.1, 9.0)))
    known = operating_limits(cell)
    assert known.sources == {
        "voltage_min_V": "chemistry",
        "voltage_max_V": "chemistry",
        "discharge_A": "data",
        "charge_A": "none",  # 0.1 A is no charge
    }
    assert (known.limits.voltage_min_V, known.limits.discharge_A) == (2.5, 9.0)
    assert "usual for its chemistry" in known.notices[0].text
    assert "9 A on discharge" in known.notices[1].text
    assert "on charge: voltage and SOC alone" in known.notices[2].text
    stated = replace(cell, voltage_min_V=2.8, voltage_max_V=4.15)
    given = operating_limits(stated, OperatingLimits(voltage_min_V=3.1, discharge_A=5, charge_A=2))
    assert given.sources["voltage_min_V"] == "given"
    assert given.sources["voltage_max_V"] == "model"
    assert (given.limits.voltage_min_V, given.limits.voltage_max_V) == (3.1, 4.15)
    assert given.notices == ()


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"voltage_min_V": np.nan}, "a finite number"),
        ({"charge_A": 0.0}, "a size above zero"),
        ({"soc_min": 0.9, "soc_max": 0.1}, "the lower one below"),
    ],
)
def test_limits_that_are_none_are_refused(limits, says):
    with pytest.raises(InputError, match=says):
        OperatingLimits(**limits)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"horizons_s": ()}, "times above zero"),
        ({"horizons_s": (np.nan,)}, "times above zero"),
        ({"horizons_s": (10.0, 10.0)}, "each once"),
        ({"hold": "torque"}, "Choose one"),
        ({"limits": None}, "Give both voltages: `limits=...`"),
        ({"limits": OperatingLimits(3.0, None)}, "no upper voltage limit"),
        ({"horizons_s": ("ten",)}, "horizons_s"),
    ],
)
def test_what_no_power_can_be_computed_of_is_refused(options, says):
    with pytest.raises(InputError, match=re.escape(says)):
        power_limits(curved_cell(), LOADED, **({"limits": LIMITS} | options))


@pytest.mark.parametrize("state", [None, 0.5, "full"])
def test_a_state_of_another_kind_is_refused(state):
    with pytest.raises(InputError, match="state = "):
        power_limits(curved_cell(), state, limits=LIMITS)

"""Steps that could not end or make no sense are refused; the ready-made tests do what they say."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.protocol import (
    ConstantCurrent,
    ConstantVoltage,
    DriveProfile,
    Rest,
    capacity_test,
    hppc_test,
    run_protocol,
)
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from example_cells import curved_cell, lfp_cell

WINDOW = {"voltage_min_V": 2.9, "voltage_max_V": 4.15}


@pytest.mark.parametrize(
    "make",
    [
        lambda: Rest(0.0),
        lambda: Rest(-5.0),
        lambda: Rest(np.nan),
        lambda: Rest(10.0, 0.0),
        lambda: ConstantCurrent(current_A=0.0),
        lambda: ConstantCurrent(current_A=np.nan, duration_s=5.0),
        lambda: ConstantCurrent(current_A=1.0, duration_s=-1.0),
        lambda: ConstantCurrent(current_A=1.0, charge_Ah=-0.1),
        lambda: ConstantCurrent(current_A=1.0, voltage_min_V=np.inf),
        lambda: ConstantCurrent(current_A=1.0, duration_s=5.0, period_s=0.0),
        lambda: ConstantCurrent(current_A=1.0, hold_at_limit=True),
        lambda: ConstantCurrent(current_A=1.0, hold_at_limit=True, duration_s=5.0, soc=0.1),
        lambda: ConstantVoltage(voltage_V=4.2),
        lambda: ConstantVoltage(voltage_V=np.nan, duration_s=5.0),
        lambda: ConstantVoltage(voltage_V=4.2, until_current_A=0.0),
        lambda: ConstantVoltage(voltage_V=4.2, until_current_A=2.0, current_limit_A=1.0),
        lambda: ConstantVoltage(voltage_V=4.2, until_current_A=0.1, current_limit_A=-1.0),
        lambda: DriveProfile(time_s=[], current_A=[]),
        lambda: DriveProfile(time_s=[0.0], current_A=[1.0]),
        lambda: DriveProfile(time_s=[1.0, 2.0], current_A=[1.0]),
        lambda: DriveProfile(time_s=[1.0, 1.0], current_A=[1.0, 2.0]),
        lambda: DriveProfile(time_s=[-1.0, 1.0], current_A=[1.0, 2.0]),
        lambda: DriveProfile(time_s=[1.0, 2.0], current_A=[1.0, np.nan]),
        lambda: DriveProfile(time_s=[[1.0, 2.0]], current_A=[[1.0, 2.0]]),
        lambda: capacity_test(0.0, 0.2, **WINDOW),
        lambda: capacity_test(3.0, -0.2, **WINDOW),
        lambda: capacity_test(3.0, 0.2, voltage_min_V=4.2, voltage_max_V=2.5),
        lambda: hppc_test(3.0, **WINDOW, rates=(1.0, 0.0)),
        lambda: hppc_test(3.0, **WINDOW, levels=()),
        lambda: hppc_test(3.0, **WINDOW, levels=(0.5, 0.9)),
        lambda: hppc_test(3.0, **WINDOW, levels=(90.0, 50.0)),
    ],
)
def test_refused_when_written_not_when_run(make):
    with pytest.raises(InputError):
        make()


def test_steps_are_frozen():
    with pytest.raises(AttributeError):
        Rest(5.0).duration_s = 6.0


@pytest.mark.parametrize("rate", [1 / 20, 1 / 5, 1 / 3, 2.0])
def test_capacity_test_charges_discharges_and_finds_the_charge(rate):
    model = curved_cell()
    log = run_protocol(model, capacity_test(3.0, rate, **WINDOW, period_s=5.0), 0.4)
    top = np.flatnonzero(log.step == 3)[-1]
    bottom = np.flatnonzero(log.step == 4)[-1]
    assert log.voltage_V[bottom] == pytest.approx(2.9, abs=1e-10)
    assert log.voltage_V[np.flatnonzero(log.step == 2)[-1]] == pytest.approx(4.15, abs=1e-10)
    # The drop lies between R0 I and (R0 + R1 + R2) I, as resistances only grow on the way down;
    # so the limit comes between the SOCs at which either drop takes the OCV to it.
    drops = (
        rate * 3.0 * np.stack((model.r0_ohm[0], (model.r0_ohm + model.r1_ohm + model.r2_ohm)[0]))
    )
    early, late = (
        np.interp(2.9, model.ocv_V[0] - drop, model.soc) for drop in (drops[1], drops[0])
    )
    soc = simulate(model, log, 0.4).soc
    assert late <= soc[bottom] <= early
    full = np.interp(4.15, model.ocv_V[0], model.soc)
    assert soc[top] == pytest.approx(full, abs=0.01)
    taken = log.charge_Ah[bottom] - log.charge_Ah[top]
    assert taken == pytest.approx(3.0 * (soc[top] - soc[bottom]))


def test_cv_part_makes_the_total_independent_of_the_rate():
    # The LFP paper's table: 47.71, 47.71, 47.70 Ah at 0.5C to 2C, while the CC part falls.
    model = curved_cell()
    parts = []
    for rate in (0.5, 1.0, 2.0):
        steps = capacity_test(3.0, rate, **WINDOW, hold_when_empty=True, cutoff_rate=0.002)
        log = run_protocol(model, steps, 0.9)
        ends = [log.charge_Ah[np.flatnonzero(log.step == k)[-1]] for k in (3, 4, 5)]
        parts.append((ends[1] - ends[0], ends[2] - ends[1]))
    cc, cv = np.array(parts).T
    assert np.all(np.diff(cc) < -0.001)
    assert np.all(np.diff(cv) > 0.001)
    np.testing.assert_allclose(cc + cv, (cc + cv)[0], rtol=1e-3)


def test_hppc_test_visits_its_levels_with_its_pulses():
    levels = (0.9, 0.7, 0.4)
    # A wide window: a trimmed pulse would not put its charge back.
    window = {"voltage_min_V": 2.5, "voltage_max_V": 4.5}
    steps = hppc_test(3.0, **window, rates=(0.5, 1.0), levels=levels, rest_s=600.0)
    log = run_protocol(curved_cell(), steps, 1.0)
    assert log.gaps == ()
    pulses = [s for s in steps if isinstance(s, ConstantCurrent) and s.hold_at_limit]
    assert [s.current_A for s in pulses] == [1.5, -1.5, 3.0, -3.0] * 2 + [-1.5, 1.5, -3.0, 3.0]
    moves = [
        number
        for number, s in enumerate(steps, start=1)
        if isinstance(s, ConstantCurrent) and s.charge_Ah is not None
    ]
    for level, number in zip(levels, moves, strict=True):
        last = np.flatnonzero(log.step == number)[-1]
        assert 1.0 - log.charge_Ah[last] / 3.0 == pytest.approx(level, abs=1e-9)


def test_hppc_test_upwards_charges_between_its_levels():
    steps = hppc_test(3.0, **WINDOW, levels=(0.2, 0.5), start_level=0.0)
    moves = [s for s in steps if isinstance(s, ConstantCurrent) and s.charge_Ah is not None]
    assert all(s.current_A < 0 for s in moves)
    assert moves[0].charge_Ah == pytest.approx(0.6)


def test_pulses_at_the_ends_are_trimmed_and_keep_their_time():
    steps = hppc_test(2.3, voltage_min_V=2.9, voltage_max_V=3.45, rates=(3.0,), levels=(1.0, 0.03))
    log = run_protocol(lfp_cell(), steps, 1.0)
    trimmed = 0
    for number, step in enumerate(steps, start=1):
        if isinstance(step, ConstantCurrent) and step.hold_at_limit:
            rows = log.step == number
            assert np.sum(log.interval_s[rows]) == pytest.approx(10.0, abs=1e-6)
            assert np.all(log.current_A[rows] * step.current_A >= 0)
            trimmed += bool(np.any(log.current_A[rows] != step.current_A))
    assert trimmed >= 2
    loaded = log.current_A != 0
    assert log.voltage_V[loaded & (log.current_A < 0)].max() <= 3.45 + 1e-9
    assert log.voltage_V[loaded & (log.current_A > 0)].min() >= 2.9 - 1e-9

"""Phases: they tile the log, keep its charge, and are what the tester did."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.hppc.phases import find_phases
from cellwise.logs import read_log
from synthetic import (
    HppcPlan,
    Tester,
    drive_current,
    driven_log,
    finish,
    hppc_log,
    lfp_cell,
    nmc_cell,
)


def kinds(phases):
    return [p.kind for p in phases]


def tiles(phases, log):
    bounds = [phases[0].start, *(p.stop for p in phases)]
    return (
        bounds[0] == 0 and bounds[-1] == len(log) and bounds[1:-1] == [p.start for p in phases[1:]]
    )


def capacity_test(cell, rate, *, hz=1.0, noise_V=0.0, noise_A=0.0, cutoff=0.02):
    """Rest, discharge CC-CV, rest, charge CC-CV, rest; and the true row of each knee."""
    plan = HppcPlan(noise_V=noise_V, noise_A=noise_A)
    tester = Tester(cell, 1.0, np.random.default_rng(0))
    one_c = cell.capacity_Ah
    tester.run(0.0, 600.0, hz, plan=plan)
    knees = []
    for amps in (rate * one_c, -0.5 * one_c):
        tester.run(amps, 6e4, hz, plan=plan, role="charge", cutoff_A=cutoff * one_c)
        knees.append(sum(c[0].size for c in tester.columns[:-1]) + 1)
        tester.run(0.0, 1800.0, hz, plan=plan)
    return finish(tester, plan), knees


@pytest.mark.parametrize("hz", [2.0, 0.2, 1 / 60])
@pytest.mark.parametrize("cell", [nmc_cell(), lfp_cell()], ids=["nmc", "lfp"])
def test_a_capacity_test_is_split_into_its_parts(cell, hz):
    made, _ = capacity_test(cell, 1.0, hz=hz)
    phases = find_phases(made.log)
    assert kinds(phases) == ["rest", "cc", "cv", "rest", "cc", "cv", "rest"]
    charge = np.cumsum(made.current_A * made.log.interval_s) / 3600.0
    for phase in phases:
        true = charge[phase.stop - 1] - charge[max(phase.start - 1, 0)]
        assert phase.charge_Ah == pytest.approx(true, abs=1e-9)
    held, full = (made.log.voltage_V[row] for row in (phases[2].start - 1, phases[5].stop - 1))
    assert held == pytest.approx(cell.lower_V, abs=0.03 if hz > 0.1 else 0.2)
    assert full == pytest.approx(cell.upper_V, abs=1e-3)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_knee_between_cc_and_cv_is_found(noise):
    cell = nmc_cell()
    made, knees = capacity_test(cell, 1.0, noise_V=noise, noise_A=noise * cell.capacity_Ah)
    phases = find_phases(made.log)
    found = [p.start for p in phases if p.kind == "cv"]
    # In the row of the knee the current has not fallen yet: it falls by 0.1 % within seconds.
    for row, true in zip(found, knees, strict=True):
        assert true - 1 <= row <= true + 10
    current = made.current_A
    q_cc = np.sum(current[phases[1].start : knees[0]]) / 3600.0
    assert phases[1].charge_Ah == pytest.approx(q_cc, rel=2e-3)


@pytest.mark.parametrize(
    "plan",
    [
        HppcPlan(),
        HppcPlan(noise_V=1e-3, noise_A=0.01, jitter=0.3, ramp_s=0.3),
        HppcPlan(pulse_hz=1.0, rest_hz=1 / 60, move_hz=1 / 60, level_rest_s=3600.0),
        HppcPlan(levels=(0.05, 0.5, 0.95), initial_charge=False, limit="stop"),
        HppcPlan(initial_charge=True, aligned=False, pulse_hz=1.0),
    ],
)
def test_phases_tile_the_log_and_keep_its_charge(plan):
    made = hppc_log(nmc_cell(), plan)
    phases = find_phases(made.log)
    assert tiles(phases, made.log)
    total = made.log.charge_Ah[-1] - made.log.charge_Ah[0]
    assert sum(p.charge_Ah for p in phases) == pytest.approx(total, abs=1e-9)
    seconds = sum(p.duration_s for p in phases)
    assert seconds == pytest.approx(made.log.duration_s)
    for p in phases:
        if p.kind == "cc":
            assert 3600.0 * p.charge_Ah == pytest.approx(p.current_A * p.duration_s, rel=0.01)


def test_glitches_of_the_sensor_split_nothing():
    made = hppc_log(nmc_cell(), HppcPlan(pulse_s=30.0, limit="none"))
    current = made.log.current_A.copy()
    rows = [k for k in range(50, len(made.log) - 50) if np.ptp(current[k - 10 : k + 10]) == 0.0]
    current[np.random.default_rng(1).choice(rows, 30, replace=False)] += 4.0
    glitched = replace(made.log, current_A=current)
    bounds = [(p.kind, p.start, p.stop) for p in find_phases(made.log)]
    assert [(p.kind, p.start, p.stop) for p in find_phases(glitched)] == bounds


@pytest.mark.parametrize("hz", [1.0, 10.0])
def test_a_drive_is_dynamic_between_its_stops(hz):
    rng = np.random.default_rng(3)
    log = driven_log(nmc_cell(), drive_current(3000.0, hz, 6.0, rng), hz, noise_A=0.003, rng=rng)
    phases = find_phases(log)
    moving = sum(p.duration_s for p in phases if p.kind == "dynamic")
    loaded = sum(p.duration_s for p in phases if p.kind != "rest")
    assert moving > 0.9 * loaded  # at full power it holds a level for seconds, too


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("panasonic_18650pf/charge2_1c_p25_start.csv.gz", ["rest", "cc", "cv", "rest"]),
        ("panasonic_18650pf/cap_1c_p25_start_1.csv.gz", ["cc", "rest"]),
        ("panasonic_18650pf/ocv_c20_p25.csv.gz", ["rest", "cc", "rest", "cc", "rest"]),
        ("lipo_5450/c4_cycle48.csv.gz", ["cc", "cc", "cv", "rest"]),
        ("plett_a123/ocv_p25_s1.csv.gz", ["rest", "cc", "rest"]),
        ("lg_18650hg2/ocv_c20_p25_549.csv.gz", ["cc", "rest", "cc", "cv", "rest"]),
        ("nissan_leaf/cap_2c_p23.csv.gz", (["rest", "cc", "cv", "rest", "cc"] * 6)[:25]),
    ],
)
def test_measured_tests_are_split_into_their_parts(real_data, name, expected):
    log = read_log(real_data / name)
    phases = find_phases(log)
    assert tiles(phases, log)
    if "nissan" in name:  # five rounds; the file begins inside one of them
        assert sum(p.kind == "cv" for p in phases) == 5
        assert sum(p.kind == "cc" and p.current_A > 60.0 for p in phases) == 5
    else:
        assert kinds(phases) == expected


def test_the_panasonic_charge_stops_its_constant_current_at_the_limit(real_data):
    log = read_log(real_data / "panasonic_18650pf/charge2_1c_p25_start.csv.gz")
    _, cc, cv, _ = find_phases(log)
    assert cc.current_A == pytest.approx(-2.9, rel=1e-3)
    assert log.voltage_V[cv.stop - 1] == pytest.approx(4.2, abs=2e-3)
    assert cc.charge_Ah + cv.charge_Ah == pytest.approx(-2.7838, abs=2e-4)  # the file's README

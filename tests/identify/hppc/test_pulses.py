"""Pulses: all found, none invented, at the right rows, whatever the order, rate or starting end."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.logs import read_log
from rich_cell import Logger, gitt, rich_nmc, run
from synthetic import HppcPlan, drive_current, driven_log, hppc_log, lfp_cell, nmc_cell

NOISY = {"noise_V": 1e-3, "noise_A": 0.003, "jitter": 0.2}
PLANS = {
    "pairs": {},
    "1 Hz": {"pulse_hz": 1.0, **NOISY},
    "135 Hz": {"pulse_hz": 135.0, **NOISY},
    "60 s rows at rest": {"rest_hz": 1 / 60, "move_hz": 1 / 60, "level_rest_s": 3600.0},
    "charge first": {"order": "charge", **NOISY},
    "order turned at half": {"order": "by-level", "pulse_s": 60.0, "rates_c": (0.5, 1.0, 2.0, 3.0)},
    "discharge only": {"order": "discharge-only", "rates_c": (0.5, 1.0, 2.0, 4.0, 6.0)},
    "charge only": {"order": "charge-only"},
    "from empty, upwards": {"levels": (0.1, 0.3, 0.5, 0.7, 0.9), **NOISY},
    "comes empty": {"initial_charge": True, **NOISY},
    "slow rise": {"ramp_s": 0.5, **NOISY},
    "free clock": {"aligned": False, "rest_hz": 10.0, "move_hz": 10.0, "level_rest_s": 600.0},
    "ends at the limit": {"levels": (0.5, 0.1, 0.02), "limit": "stop", **NOISY},
    "moves at C/20": {"move_rate_c": 0.05, "rates_c": (1.0, 6.0), "order": "discharge-only"},
}


def wanted(made):
    # A charge with which the log begins follows no rest, so it is nobody's pulse.
    return [p for p in made.pulses if p.role != "charge" and p.start > 1]


@pytest.mark.parametrize("cell", [nmc_cell(), lfp_cell(3.0)], ids=["nmc", "lfp"])
@pytest.mark.parametrize("plan", PLANS.values(), ids=PLANS.keys())
def test_all_pulses_are_found_and_none_is_invented(plan, cell):
    made = hppc_log(cell, HppcPlan(**plan))
    pulses = find_pulses(made.log)
    assert [(p.start, p.role) for p in pulses] == [(p.start, p.role) for p in wanted(made)]
    for found, true in zip(pulses, wanted(made), strict=True):
        assert found.stop == true.stop
        assert found.current_A * true.current_A > 0.0
        if not true.limited:
            assert found.current_A == pytest.approx(true.current_A, rel=5e-3)
            assert found.quality in ("healthy", "distorted")


def test_a_rise_over_many_rows_does_not_hide_or_split_a_pulse():
    """67 rows of rise, each a few sigmas of noise: the row is good to what the noise lets see."""
    made = hppc_log(nmc_cell(), HppcPlan(ramp_s=0.5, pulse_hz=135.0, **NOISY))
    pulses = find_pulses(made.log)
    assert [p.role for p in pulses] == [p.role for p in wanted(made)]
    for found, true in zip(pulses, wanted(made), strict=True):
        assert true.start <= found.start <= true.start + 2
        assert true.stop <= found.stop <= true.stop + 10


def test_a_charge_pulse_into_which_the_move_runs_has_no_relaxation():
    current = np.zeros(20_000)
    for k in range(4):
        at = 1000 + 5000 * k
        current[at : at + 300], current[at + 700 : at + 800] = 3.0, -2.0
        current[at + 800 : at + 2800] = 1.0
    pulses = find_pulses(driven_log(nmc_cell(), current, 10.0))
    assert [(p.current_A > 0.0, p.duration_s) for p in pulses[:2]] == [
        (True, pytest.approx(30.0)),
        (False, pytest.approx(10.0)),
    ]
    assert len(pulses) == 8
    assert {p.role for p in pulses} == {"pulse"}
    assert all(p.relax_stop == p.stop for p in pulses if p.current_A < 0.0)


@pytest.mark.parametrize(("rate", "seconds"), [(1 / 20, 7200.0), (1 / 5, 1800.0), (1 / 3, 1080.0)])
def test_where_all_steps_are_long_the_moves_serve_as_pulses(rate, seconds):
    """The NCR18650B paper's test: 10 % steps, one hour of rest, nothing else."""
    levels = tuple(np.round(np.arange(0.9, 0.15, -0.1), 3))
    plan = HppcPlan(levels=levels, rates_c=(), move_rate_c=rate, level_rest_s=3600.0)
    made = hppc_log(nmc_cell(), plan)
    pulses = find_pulses(made.log)
    assert [p.start for p in pulses] == [p.start for p in made.pulses]
    assert all(p.duration_s == pytest.approx(seconds, rel=1e-2) for p in pulses)
    assert {p.role for p in pulses} == {"move"}
    assert len(pulses_to_fit(pulses)) >= 5


def no_pulses():
    rng = np.random.default_rng(7)
    t = np.arange(20_000) * 0.1
    yield "rest", np.zeros(5000)
    yield "noise", rng.normal(0.0, 0.01, 20_000)
    yield "never rests", np.where((t // 50) % 2 == 0, 1.0, 3.0)
    yield "one long load", np.full(5000, 1.0)
    yield "sine", 3.0 * np.sin(2.0 * np.pi * t / 120.0)
    yield "noisy sine", 3.0 * np.sin(2.0 * np.pi * t / 30.0) + rng.normal(0.0, 0.02, t.size)
    yield "drive", drive_current(2000.0, 10.0, 6.0, rng)
    yield "noisy drive", drive_current(2000.0, 10.0, 6.0, rng) + rng.normal(0.0, 0.02, 1)[0]
    yield "random levels", np.repeat(rng.normal(1.0, 2.0, 2000), 10)


@pytest.mark.parametrize(("name", "current"), list(no_pulses()), ids=[n for n, _ in no_pulses()])
def test_what_is_no_hppc_has_no_pulses(name, current):
    log = driven_log(nmc_cell(), current, 10.0, noise_V=1e-3)
    assert [p for p in find_pulses(log) if p.quality != "spurious"] == []


@pytest.mark.parametrize("tag", ["p25", "p10", "p00", "n10", "n20"])
def test_panasonic_pulses_are_those_of_the_readme(real_data, tag):
    """0.5, 1, 2, 4, 6C for 10 s at each level, 0.3C in between, cut at 2.5 V."""
    log = read_log(real_data / f"panasonic_18650pf/hppc_{tag}.csv.gz")
    pulses = find_pulses(log)
    on = log.current_A > 0.05
    starts = np.flatnonzero(on[1:] & ~on[:-1]) + 1
    assert [p.start for p in pulses] == starts.tolist()
    rates = {round(p.current_A / 2.9, 1) for p in pulses if p.role == "pulse"}
    assert rates <= {0.5, 1.0, 2.0, 4.0, 6.0}
    assert {round(p.current_A, 2) for p in pulses if p.role == "move"} == {0.87}
    short = [p for p in pulses if p.role == "pulse" and p.duration_s < 9.0]
    assert [p for p in pulses if p.role == "pulse" and p.quality == "trimmed"] == short
    assert all(log.voltage_V[p.stop - 1] < 2.5 for p in short)
    assert not [p for p in pulses if p.quality == "spurious"]


@pytest.mark.parametrize("tag", ["p10", "p25", "p40"])
def test_leaf_pulses_are_those_of_the_readme(real_data, tag):
    """30 s at 30 A, 40 s of rest, 10 s of charge, at each 10 %; the log begins empty."""
    pulses = find_pulses(read_log(real_data / f"nissan_leaf/hppc_{tag}.csv.gz"))
    loads = [p for p in pulses if p.current_A > 25.0]
    charges = [p for p in pulses if p.current_A < 0.0 and p.role == "pulse"]
    assert len(loads) == len(charges) == 10
    assert all(p.duration_s == pytest.approx(30.0, abs=0.2) for p in loads)
    assert all(p.duration_s == pytest.approx(10.0, abs=0.2) for p in charges)
    assert all(40.0 < c.start - d.stop + 1 < 42 for d, c in zip(loads, charges, strict=True))
    assert charges[0].quality == "trimmed"
    assert all(p.quality == "healthy" for p in charges[1:])


@pytest.mark.parametrize("tag", ["p25_us06", "p25_nn", "n10_udds", "p10_la92", "p00_cycle_1"])
def test_measured_drives_have_no_pulses(real_data, tag):
    assert find_pulses(read_log(real_data / f"panasonic_18650pf/drive_{tag}.csv.gz")) == ()


# --- steps of incremental OCV tests, noisy chargers

CELL = rich_nmc(3.0)


@pytest.mark.parametrize("period_s", [1.0, 10.0])
@pytest.mark.parametrize("seed", range(6))
def test_every_step_of_an_incremental_test_is_one_load(seed, period_s):
    # Noise of the size of the resolution once cut a step in two, and one half was "the" pulse.
    steps = gitt(CELL, rest_s=1800.0)
    log = run(CELL, steps, 1.0, Logger(period_s), seed=seed).log
    found = find_pulses(log)
    assert len(found) == 10
    assert {p.role for p in found} == {"move"}
    np.testing.assert_allclose([p.duration_s for p in found], 720.0, atol=period_s)
    assert len(pulses_to_fit(found)) >= 7


@pytest.mark.parametrize("soc0", [0.98, 0.96])
def test_a_last_step_that_the_limit_cut_is_no_short_pulse(soc0):
    log = run(CELL, gitt(CELL, rest_s=3600.0), soc0, Logger(1.0), seed=3).log
    found = find_pulses(log)
    assert found[-1].duration_s < 700.0
    assert found[-1].role == "move"
    assert found[-1].quality != "healthy"
    assert len(pulses_to_fit(found)) >= 7


def test_a_single_pulse_among_steps_does_not_stand_for_all():
    steps = [(0.0, 1800.0), (3.0, 10.0), (0.0, 600.0), *gitt(CELL)[1:]]
    found = find_pulses(run(CELL, steps, 1.0, Logger(1.0)).log)
    assert [p.role for p in found].count("pulse") == 1
    assert len(pulses_to_fit(found)) >= 7


def noisy_charger_log(seed, noise_A=0.02):
    """1C out by a quiet load, a tenth of it back by a noisy charger, 5 % at C/3; 1 Hz."""
    one = [(3.0, 10.0), (0.0, 180.0), (-0.3, 100.0), (0.0, 180.0), (1.0, 540.0), (0.0, 1800.0)]
    log = run(CELL, [(0.0, 600.0), *(one * 8)], 0.9, Logger(1.0), seed=seed).log
    rng = np.random.default_rng(100 + seed)
    charging = log.current_A < -0.1
    current = log.current_A + noise_A * charging * rng.standard_normal(len(log))
    return replace(log, current_A=np.round(current, 3))


@pytest.mark.parametrize("seed", range(4))
def test_a_charger_may_be_noisier_than_the_load(seed):
    found = find_pulses(noisy_charger_log(seed))
    short = [p for p in found if p.role == "pulse"]
    assert len(short) == 16, "what a weak current gives back is a pulse, too"
    assert {p.quality for p in short} == {"healthy"}
    assert [p.current_A > 0.0 for p in short] == [True, False] * 8
    charges = [p.duration_s for p in short if p.current_A < 0.0]
    np.testing.assert_allclose(charges, 100.0, atol=2.0)


@pytest.mark.parametrize("name", ["1c_p20", "1c_p30", "1c_p40", "2c_p20", "2c_p30", "2c_p40"])
def test_measured_pulses_at_1_hz(real_data, name):
    """19 or 20 levels, each a pulse and what gives it back; the emptiest ones bend."""
    log = read_log(real_data / f"samsung_30q_ageing/hppc_dnn01_{name}_time_rebuilt.csv.gz")
    short = [p for p in find_pulses(log) if p.role == "pulse"]
    assert 32 <= len(short) <= 40
    healthy = [p for p in short if p.quality == "healthy"]
    assert len(healthy) >= 30
    for sign, seconds in ((1.0, 10.0), (-1.0, 101.0)):
        chosen = [p.duration_s for p in healthy if sign * p.current_A > 0.0]
        assert len(chosen) >= 14
        assert np.median(chosen) == pytest.approx(seconds, abs=1.0)

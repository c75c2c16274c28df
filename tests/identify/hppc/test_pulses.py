"""Pulses: all found, none invented, at the right rows, whatever the order, rate or starting end."""

import numpy as np
import pytest

from cellwise.identify.hppc.pulses import find_pulses, pulses_to_fit
from cellwise.logs.cell_log import CellLog
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


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hz", [1.0, 10.0])
def test_no_drive_has_pulses(seed, hz):
    rng = np.random.default_rng(seed)
    current = drive_current(3000.0, hz, 8.0, rng)
    log = driven_log(nmc_cell(), current, hz, noise_V=1e-3, noise_A=0.004, rng=rng)
    assert find_pulses(log) == ()


def real(folder, name):
    import pandas as pd

    table = pd.read_csv(folder / name)
    return CellLog(
        table.time_s.to_numpy(), table.current_A.to_numpy(), table.voltage_V.to_numpy(),
        charge_Ah=table.ampere_hours.to_numpy(), name=name,
    )  # fmt: skip


@pytest.mark.parametrize("tag", ["p25", "p10", "p00", "n10", "n20"])
def test_panasonic_pulses_are_those_of_the_readme(real_data, tag):
    """0.5, 1, 2, 4, 6C for 10 s at each level, 0.3C in between, cut at 2.5 V."""
    log = real(real_data, f"panasonic_18650pf/hppc_{tag}.csv.gz")
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
    pulses = find_pulses(real(real_data, f"nissan_leaf/hppc_{tag}.csv.gz"))
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
    assert find_pulses(real(real_data, f"panasonic_18650pf/drive_{tag}.csv.gz")) == ()


@pytest.mark.parametrize(
    "name", ["lfp/hppc", "nmc/hppc", "nmc/hppc_p00", "nmc/hppc_c20", "nmc/hppc_c5", "nmc/hppc_c3"]
)
def test_embedded_hppc_logs_give_every_load_of_theirs(datasets, name):
    """A virtual tester clamps zero: whatever is not zero is a load, up to its change of sign."""
    path = datasets / f"{name}.parquet"
    if not path.is_file():
        pytest.skip(f"{path.name} is not generated: cellwise data generate")
    import pyarrow.parquet as pq

    table = pq.read_table(path).to_pydict()
    log = CellLog(*(np.array(table[k]) for k in ("time_s", "current_A", "voltage_V")))
    sign = np.sign(log.current_A)
    starts = np.flatnonzero((sign[1:] != 0.0) & (sign[1:] != sign[:-1])) + 1
    pulses = find_pulses(log)
    assert [p.start for p in pulses] == starts.tolist()
    assert not [p for p in pulses if p.quality == "spurious"]
    moves = {round(p.current_A, 1) for p in pulses if p.role == "move" and p.quality == "healthy"}
    assert len(moves) == 1

"""OCV from rests: known curves come back, anchors, extrapolation, bad input, real relaxations."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.identify.ocv.ocv_rests import find_ocv_rests, ocv_from_rests
from cellwise.logs import CellLog, read_log
from rich_cell import Logger, gitt, rich_nmc, run

CAPACITY_AH, R0, R1, TAU_S = 5.0, 0.02, 0.015, 400.0


def ocv(s):
    return 3.0 + 0.8 * s + 0.3 * (1 - np.exp(-s / 0.05))


def cell_log(parts, soc, row_s=2.0, counter=True, noise_V=0.0):
    """A cell with one RC branch through (current_A, duration_s) parts, written row by row."""
    rng = np.random.default_rng(0)
    rows = [(0.0, 0.0, float(ocv(soc)), 0.0)]
    v1, t, q = 0.0, 0.0, 0.0
    for current, duration in parts:
        for _ in range(max(1, round(duration / row_s))):
            dt = duration / max(1, round(duration / row_s))
            decay = np.exp(-dt / TAU_S)
            v1 = decay * v1 + R1 * (1 - decay) * current
            t, q = t + dt, q + current * dt / 3600
            v = ocv(soc - q / CAPACITY_AH) - R0 * current - v1 + rng.normal(0.0, noise_V)
            rows.append((t, current, float(v), q))
    t, i, v, q = np.array(rows).T
    return CellLog(t, i, v, charge_Ah=q if counter else None, name="made")


def hppc(rest_s=3600.0, levels=10, sign=1):
    """Pulse, rest, move, rest at every level."""
    move = (sign * 5.0, 3600 * 0.98 / levels)
    pulse = [(10.0, 10.0), (0.0, 1200.0), (-10.0, 10.0), (0.0, 1200.0)]
    return [(0.0, 600.0)] + levels * [*pulse, move, (0.0, rest_s)]


@pytest.mark.parametrize("row_s", [1.0, 10.0, 60.0])
@pytest.mark.parametrize("counter", [True, False])
def test_relaxed_rests_lie_on_the_ocv(row_s, counter):
    log = cell_log(hppc(rest_s=7200.0), 1.0, row_s, counter)
    curve = ocv_from_rests(log, capacity_Ah=CAPACITY_AH)
    relaxed = curve.points_weight > 0.5 * curve.points_weight.max()
    # What is left of the pulses after 1200 s at a time constant of 400 s, carried to its end by
    # rows that may be a minute apart.
    assert curve.points_V[relaxed] == pytest.approx(ocv(curve.points_soc[relaxed]), abs=4e-4)
    s = np.linspace(0.1, 1.0, 100)
    assert curve.function.evaluate(s) == pytest.approx(ocv(s), abs=1e-2)
    assert curve.capacity_Ah == CAPACITY_AH


def test_start_soc_places_a_log_that_is_never_full():
    log = replace(cell_log(hppc(levels=10)[: 1 + 6 * 5], 0.8), soc0=0.8)
    curve = ocv_from_rests(log, capacity_Ah=CAPACITY_AH)
    assert curve.points_V == pytest.approx(ocv(curve.points_soc), abs=1e-3)


def test_rests_beyond_a_capacity_that_is_too_small_are_left_out_and_named():
    curve = ocv_from_rests(cell_log(hppc(), 1.0), capacity_Ah=4.0)
    assert curve.points_soc.min() >= -0.02
    assert any("left out" in note.text for note in curve.notes)


def test_voltage_is_the_mean_of_the_last_ten_seconds():
    t = np.arange(0.0, 2000.0, 0.5)
    v = np.where(t <= 900.0, 3.5, 3.4) + 1e-3 * np.sin(2 * np.pi * t / 2.0)
    current = np.where((t > 900.0) & (t <= 960.0), 2.0, 0.0)
    first = find_ocv_rests(CellLog(t, current, v))[0]
    last = (t > 890.0 - 1e-9) & (t <= 900.0)
    assert first.voltage_V == pytest.approx(np.mean(v[last]), abs=1e-6)


def test_extrapolation_stays_near_a_noisy_rest():
    log = cell_log([(5.0, 360.0), (0.0, 3600.0)] * 9, 1.0, noise_V=1e-3)
    for rest in find_ocv_rests(log):
        assert abs(rest.remaining_V) < 2e-3


def test_log_that_never_rests_is_refused():
    t = np.arange(0.0, 3600.0)
    log = CellLog(t, 2.0 + np.sin(t / 7.0), 3.9 - t / 9000, name="drive")
    with pytest.raises(InputError, match="no rest in log 'drive'"):
        ocv_from_rests(log, capacity_Ah=5.0)


@pytest.mark.parametrize("tag", ["p10", "p25", "p40"])
def test_leaf_log_begins_empty_and_is_full_after_its_charge(real_data, tag):
    log = read_log(real_data / f"nissan_leaf/hppc_{tag}.csv.gz")
    curve = ocv_from_rests(log, capacity_Ah=30.3)
    top = int(np.argmax(curve.points_soc))
    assert curve.points_soc[top] == 1.0
    assert curve.points_V[top] == pytest.approx(4.18, abs=0.01)  # one hour after CC-CV to 4.2 V
    # Rests at every 10 %: the pulse pair moves 0.18 Ah, the move 3.0 Ah, of 30.3 Ah.
    steps = np.diff(np.sort(curve.points_soc))[-7:]
    assert steps == pytest.approx((3.0 + 0.18) / 30.3, abs=2e-3)
    assert np.std(curve.points_V - curve.function.evaluate(curve.points_soc)) < 6e-3


def test_panasonic_rests_lie_on_one_curve(real_data):
    log = read_log(real_data / "panasonic_18650pf/hppc_p25.csv.gz")
    curve = ocv_from_rests(log, capacity_Ah=2.997)
    assert curve.points_soc.size > 60
    assert curve.points_soc.max() == 1.0
    assert np.std(curve.points_V - curve.function.evaluate(curve.points_soc)) < 8e-3


@pytest.mark.parametrize(
    "path", ["panasonic_18650pf/hppc_p25", "panasonic_18650pf/hppc_n10", "nissan_leaf/hppc_p10"]
)
def test_extrapolated_rest_cut_to_a_third_is_nearer_to_its_true_end(real_data, path):
    log = read_log(real_data / f"{path}.csv.gz")
    last, ahead = [], []
    for rest in find_ocv_rests(log, min_rest_s=1000.0):
        if rest.start == 0:
            continue
        begin = log.time_s[rest.start - 1]
        stop = int(np.searchsorted(log.time_s, begin + rest.duration_s / 3, side="right"))
        start = max(0, rest.start - 40)
        if stop - rest.start < 8:
            continue
        cut = find_ocv_rests(log.part(start, stop), min_rest_s=100.0)[-1]
        last.append(cut.voltage_V - rest.voltage_V)
        ahead.append(cut.final_V - rest.voltage_V)
    assert len(last) >= 8
    assert np.sqrt(np.mean(np.square(ahead))) < 0.75 * np.sqrt(np.mean(np.square(last)))


def climbing_log(seconds=3600.0):
    cell = rich_nmc(3.0)
    made = run(cell, gitt(cell, rest_s=seconds, charge=True), 0.0, Logger(1.0), seed=4)
    return made, cell


def test_a_climb_that_ends_at_the_limit_is_known_where_it_began():
    made, cell = climbing_log()
    assert made.soc[-1] < 0.97, "the limit came first"
    inside = np.linspace(0.1, 0.9, 33)
    curve = ocv_from_rests(made.log, capacity_Ah=3.0)
    error = curve.function.evaluate(inside) - cell.ocv_V(inside)
    assert float(np.sqrt(np.mean(error**2))) < 0.005  # 0.02 and more from full

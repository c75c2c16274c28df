"""The kernel of the fit: sensitivities against finite differences, voltage against oracles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cellwise.fit.problem import Problem
from cellwise.fit.rows import BaseOcv, FitLog, PreparedLog, choose_rows, prepare_log
from cellwise.fit.sensitivity_kernels import voltage_and_jacobian
from cellwise.fit.solver import Prior
from cellwise.fit.unknowns import SKEW_UNIT_S, Layout, layout_of, scalars_of
from cellwise.logs.cell_log import CellLog

CAPACITY_AH = 3.0
REFERENCE_C = 25.0
LAYOUTS = [(2, False, 1), (2, True, 1), (3, False, 1), (3, True, 1), (3, True, 3)]
GRID_C = {1: None, 3: np.array([5.0, 22.0, 38.0])}
BASE = BaseOcv(np.linspace(3.2, 4.0, 201))  # straight: its slope has no steps


def make_layout(branches=3, hysteresis=True, temperatures=1) -> Layout:
    return layout_of(branches, hysteresis, temperatures)


def make_log(rng, rows=260, *, temperature=True, jitter=0.4) -> CellLog:
    """Steps of random size and sign with rests, uneven time, warm and cold, from half full."""
    held = np.repeat(
        rng.normal(0.2, 1.0, rows) * rng.integers(0, 2, rows), rng.integers(1, 9, rows)
    )
    current = 4.0 * held[:rows]
    current[0] = 0.0
    time = np.cumsum(20.0 * (1.0 + jitter * rng.uniform(-1.0, 1.0, rows)))
    degrees = 25.0 + 15.0 * np.sin(np.linspace(0.0, 6.0, rows)) if temperature else None
    return CellLog(time - time[0], current, np.full(rows, 3.6), degrees)


def make_theta(layout: Layout, rng) -> np.ndarray:
    """Parameters that differ from knot to knot, every block alive."""
    theta = np.zeros(layout.size)
    theta[: layout.knots_ocv] = 0.02 * rng.standard_normal(layout.knots_ocv)
    spread = 0.3 * rng.standard_normal((7, layout.block))
    theta[layout.r0 : layout.r0 + layout.block] = np.log(0.02) + spread[0]
    for j in range(layout.branches):
        at = layout.r(j), layout.tau(j)
        theta[at[0] : at[0] + layout.block] = np.log((0.01, 0.015, 0.02)[j]) + spread[1 + 2 * j]
        theta[at[1] : at[1] + layout.block] = np.log((5.0, 80.0, 1500.0)[j]) + spread[2 + 2 * j]
    if layout.hysteresis:
        theta[layout.m : layout.m + layout.block] = 0.02 + 0.01 * rng.standard_normal(layout.block)
        theta[layout.gamma] = np.log(60.0)
    theta[layout.activation] = 2.3
    theta[layout.asinh] = 1.7
    own_activation = slice(layout.own_activation, layout.capacity)
    theta[own_activation] = 0.5 * rng.standard_normal(theta[own_activation].size)
    theta[layout.capacity], theta[layout.sample], theta[layout.start] = 0.06, -0.02, 0.03
    theta[layout.past : layout.bend] = (0.004, -0.01, 0.02)[: layout.branches]
    theta[layout.bend :] = 0.01, -0.004
    theta[layout.skew] = 7.0  # 0.7 s: shorter than every interval here
    return theta


def prepare(log: CellLog, layout: Layout, *, soc0=0.6, skewed=True, h0=0.3) -> PreparedLog:
    item = FitLog(log, soc0, skewed=skewed, h0=h0)
    prepared = prepare_log(item, BASE, CAPACITY_AH, REFERENCE_C, GRID_C[layout.temperatures])
    assert prepared.temperatures == layout.temperatures
    return prepared


def evaluate(log: CellLog, theta, layout: Layout, *, skewed=True, prepared=None):
    """Voltage of all prepared rows and its Jacobian; base OCV 3.2 + 0.8 soc."""
    prepared = prepared or prepare(log, layout, skewed=skewed)
    shown = np.ones(prepared.rows.dt_s.size, dtype=np.bool_)
    every = np.arange(shown.size)
    prepared = replace(prepared, rows=prepared.rows._replace(evaluate=shown, ends=every))
    jacobian = np.full((shown.size, layout.size), np.nan)
    voltage = np.full(shown.size, np.nan)
    cell = scalars_of(layout, theta, 3600.0 * CAPACITY_AH, skewed=skewed)
    ln_capacity = float(theta[layout.capacity] + theta[layout.sample])
    away = float(theta[layout.start])
    rows = prepared.moved(BASE, away, ln_capacity or 1e-300)  # laid out again for all rows
    h0 = prepared.item.h0
    voltage_and_jacobian(rows, cell, layout, h0, skewed, theta, jacobian, voltage)
    return prepared, voltage, jacobian


def blocks(layout: Layout) -> dict[str, slice]:
    found = {"ocv": slice(0, layout.knots_ocv), "r0": slice(layout.r0, layout.r0 + layout.block)}
    for j in range(layout.branches):
        found[f"r{j + 1}"] = slice(layout.r(j), layout.r(j) + layout.block)
        found[f"tau{j + 1}"] = slice(layout.tau(j), layout.tau(j) + layout.block)
    if layout.hysteresis:
        found["m"] = slice(layout.m, layout.m + layout.block)
        found["gamma"] = slice(layout.gamma, layout.gamma + 1)
    ends = [*layout._fields[layout._fields.index("activation") : -1], "size"]
    for name, after in pairwise(ends):
        found[name] = slice(getattr(layout, name), getattr(layout, after))
    return found


def test_the_blocks_are_all_unknowns():
    for case in LAYOUTS:
        layout = make_layout(*case)
        every = np.concatenate([np.arange(layout.size)[part] for part in blocks(layout).values()])
        np.testing.assert_array_equal(every, np.arange(layout.size))


@pytest.mark.parametrize(("branches", "hysteresis", "temperatures"), LAYOUTS)
def test_jacobian_is_the_central_difference_of_the_voltage(branches, hysteresis, temperatures):
    rng = np.random.default_rng(branches + 10 * hysteresis)
    layout = make_layout(branches, hysteresis, temperatures)
    log, theta = make_log(rng), make_theta(layout, rng)
    prepared, _, jacobian = evaluate(log, theta, layout)
    step = 1e-4
    for name, part in blocks(layout).items():
        if name == "bend":  # of a low-rate test alone, beside the kernel: see the gradient
            np.testing.assert_array_equal(jacobian[:, part], 0.0)
            continue
        numeric = np.empty((jacobian.shape[0], part.stop - part.start))
        for column, k in enumerate(range(part.start, part.stop)):
            moved = np.zeros(layout.size)
            moved[k] = step
            # Fourth order: the error of the difference itself stays far below 1e-5.
            far, near = (
                evaluate(log, theta + c * moved, layout, prepared=prepared)[1]
                - evaluate(log, theta - c * moved, layout, prepared=prepared)[1]
                for c in (2.0, 1.0)
            )
            numeric[:, column] = (8.0 * near - far) / (12.0 * step)
        size = np.abs(numeric).max()
        assert size > 0.0, f"block {name} does not move the voltage: nothing was tested"
        np.testing.assert_allclose(
            jacobian[:, part], numeric, rtol=0.0, atol=1e-5 * size, err_msg=name
        )


def test_a_log_without_skew_does_not_know_the_skew():
    rng = np.random.default_rng(3)
    layout = make_layout()
    log, theta = make_log(rng), make_theta(layout, rng)
    _, voltage, jacobian = evaluate(log, theta, layout, skewed=False)
    assert np.all(jacobian[:, layout.skew] == 0.0)
    theta[layout.skew] = 0.0
    np.testing.assert_array_equal(evaluate(log, theta, layout, skewed=False)[1], voltage)
    np.testing.assert_allclose(evaluate(log, theta, layout)[1], voltage, atol=1e-14)


def test_a_skew_beyond_the_interval_shows_the_interval_before():
    # Held at one interval: further on neither voltage nor slope may run away.
    rng = np.random.default_rng(4)
    layout = make_layout(2, False)
    log, theta = make_log(rng, jitter=0.0), make_theta(layout, rng)
    theta[layout.skew] = 1000.0 / SKEW_UNIT_S
    _, voltage, jacobian = evaluate(log, theta, layout)
    assert np.all(jacobian[1:, layout.skew] == 0.0)
    theta[layout.skew] = 2000.0 / SKEW_UNIT_S
    np.testing.assert_array_equal(evaluate(log, theta, layout)[1], voltage)


def test_the_gradient_of_all_logs_is_the_difference_of_their_cost():
    """Places, weights, prior and bounds of a problem of two logs fit together."""
    rng = np.random.default_rng(6)
    layout = layout_of(3, True, 3, 2)
    theta = np.zeros(layout.size)
    one = make_layout(3, True, 3)
    first = make_theta(one, rng)
    theta[: layout.sample] = first[: one.sample]
    theta[layout.sample :] = 0.01 * rng.standard_normal(layout.size - layout.sample)
    logs = [
        FitLog(make_log(np.random.default_rng(k)), 0.6, 0.1, skewed=k > 0, low_rate=k > 0)
        for k in (0, 1)
    ]
    prior = Prior(np.zeros(layout.size), np.eye(layout.size), np.ones(layout.size, dtype=np.bool_))
    problem = Problem(logs, BASE, prior, layout, CAPACITY_AH, GRID_C[3], REFERENCE_C)
    ways = rng.standard_normal((5, layout.size))
    gradient = problem.normal_equations(theta).gradient
    step = 1e-5
    for way in ways:
        more, less = (problem.normal_equations(theta + c * step * way).cost for c in (1.0, -1.0))
        assert -gradient @ way == pytest.approx((more - less) / (2.0 * step), rel=1e-4)


def constant_theta(layout, r0, pairs):
    theta = np.zeros(layout.size)
    theta[layout.r0 : layout.r0 + layout.knots] = np.log(r0)
    for j, (r, tau) in enumerate(pairs):
        theta[layout.r(j) : layout.r(j) + layout.knots] = np.log(r)
        theta[layout.tau(j) : layout.tau(j) + layout.knots] = np.log(tau)
    return theta


def fine_log(rng, seconds=6000) -> CellLog:
    """One row per second, current constant for minutes: what merging is for."""
    levels = rng.choice([-1.0, 0.0, 0.5, 1.0], seconds)
    held = 3.0 * np.repeat(levels, rng.integers(200, 1500, seconds))
    current = np.concatenate(([0.0] * 20, held))[:seconds]
    voltage = 3.6 + 0.01 * rng.standard_normal(seconds)
    return CellLog(np.arange(seconds, dtype=float), current, voltage)


def test_merged_rows_give_the_voltage_of_every_row():
    # Constant tables: the branches are solved exactly, so leaving rows out changes nothing.
    rng = np.random.default_rng(9)
    layout = make_layout(3, True)
    theta = constant_theta(layout, 0.02, ((0.01, 5.0), (0.015, 80.0), (0.02, 1500.0)))
    theta[layout.m : layout.m + layout.knots] = 0.03
    theta[layout.gamma] = np.log(40.0)
    log = fine_log(rng)
    prepared, merged, _ = evaluate(log, theta, layout, skewed=False)
    soc = prepared.item.soc(CAPACITY_AH)
    assert prepared.rows.dt_s.size < 0.25 * len(log), "nothing was merged: nothing was tested"
    whole = step_through(log, soc, 0.02, ((0.01, 5.0), (0.015, 80.0), (0.02, 1500.0)), 0.03, 40.0)
    rows = np.searchsorted(log.time_s, np.cumsum(prepared.rows.dt_s))
    np.testing.assert_allclose(merged, whole[rows], rtol=0.0, atol=1e-12)


def step_through(log, soc, r0, pairs, m, gamma, h0=0.3):
    """Every row of the log, one after the other, in plain Python."""
    v, h, out = [0.0] * len(pairs), h0, []
    for k, (i, dt) in enumerate(zip(log.current_A, log.interval_s, strict=True)):
        for j, (r, tau) in enumerate(pairs):
            a = np.exp(-dt / tau)
            v[j] = a * v[j] + r * (1.0 - a) * i
        a = np.exp(-gamma * abs(i) * dt / (3600.0 * CAPACITY_AH))
        h = a * (h + np.sign(i)) - np.sign(i)
        out.append(3.2 + 0.8 * soc[k] - r0 * i - sum(v) + m * h)
    return np.array(out)


def choose(time, current, threshold=0.05):
    keep = np.zeros(time.size, dtype=np.bool_)
    shown = np.zeros(time.size, dtype=np.bool_)
    choose_rows(time, current, threshold, 0.95, 0.03, np.inf, keep, shown)
    return keep, shown


def test_hours_of_rest_do_not_outvote_a_pulse():
    # Ten seconds of pulse at 10 Hz, two hours of rest at 1 Hz: rows lie evenly on log time.
    pulse = np.arange(1, 101) * 0.1
    rest = 10.0 + np.arange(1, 7201)
    time = np.concatenate(([0.0], pulse, rest))
    current = np.concatenate(([0.0], np.full(100, 3.0), np.zeros(7200)))
    _, shown = choose(time, current)
    at = time[shown]
    in_pulse = np.count_nonzero((at > 0.0) & (at <= 10.0))
    assert 8 <= in_pulse <= 12, "about one a second"
    after = at[at > 50.0] - 10.0
    decade = [np.count_nonzero((after > a) & (after <= 10.0 * a)) for a in (60.0, 600.0)]
    assert decade[1] == pytest.approx(decade[0], rel=0.15)
    assert at.size < 300


def test_noise_below_the_threshold_merges_and_a_slow_ramp_is_followed():
    time = np.arange(20_000.0)
    ramp = 3.0 * time / time[-1]
    keep, _ = choose(time, ramp)
    kept = np.flatnonzero(keep)
    assert np.diff(ramp[kept]).max() <= 0.05 + 1e-9
    assert kept.size < 0.35 * time.size
    noise = np.random.default_rng(0).uniform(-0.02, 0.02, time.size)
    assert np.count_nonzero(choose(time, noise)[0]) < 0.02 * time.size


def test_nothing_is_compared_where_nothing_was_measured():
    log = fine_log(np.random.default_rng(12))
    voltage = log.voltage_V.copy()
    voltage[500:1500] = np.nan
    item = FitLog(replace(log, voltage_V=voltage), 0.6)
    prepared = prepare_log(item, BASE, CAPACITY_AH, REFERENCE_C)
    at = prepared.time_s
    assert not np.any((at >= 500) & (at < 1500))
    assert np.all(np.isfinite(prepared.measured_V))
    assert np.all(np.isfinite(prepared.soc))
    assert np.sum(prepared.rows.dt_s) == pytest.approx(log.duration_s), "time and charge go on"


def test_a_gap_keeps_both_its_rows_and_carries_the_counters_charge():
    # Hours into a rest, where compared rows lie half an hour apart: the gap's rows stay.
    time = np.concatenate((np.arange(0.0, 60_000.0, 10.0), 60_600.0 + np.arange(0.0, 9000.0, 10.0)))
    current = np.zeros(time.size)
    current[1:60] = 3.0
    counter = np.cumsum(current * np.diff(time, prepend=0.0)) / 3600.0
    row = int(np.searchsorted(time, 60_600.0))
    counter[row:] += 0.2
    gap = CellLog(time, current, np.full(time.size, 3.6), charge_Ah=counter)
    assert np.flatnonzero(gap.gap_rows).tolist() == [row]
    prepared = prepare_log(FitLog(gap, 0.6), BASE, CAPACITY_AH, REFERENCE_C)
    ends = np.cumsum(prepared.rows.dt_s)
    kept = int(np.searchsorted(ends, time[row]))
    assert ends[kept] == time[row]
    assert ends[kept - 1] == time[row - 1]
    assert prepared.rows.current_A[kept] * prepared.rows.dt_s[kept] / 3600.0 == pytest.approx(0.2)

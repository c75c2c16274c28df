"""Derivatives of a whole log are the central differences of the simulation, each and all.

Every scalar, every column, the start, the current and its delay; at every effect's neutral value
and away from it; with gaps, temperatures between and beyond those of the tables, SOC beyond 0..1.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from cellwise.cell.equations import (
    BEYOND,
    CellState,
    CellTables,
    advance,
    seen_current,
    surface_soc,
)
from cellwise.cell.point_kernels import (
    COLUMNS,
    ENTROPY,
    ERROR,
    OCV,
    R0,
    R1,
    R2,
    R3,
    TAU1,
    TAU2,
    TAU3,
    CellScalars,
    M,
)
from cellwise.cell.simulate import simulate_rows
from cellwise.diagnose.causes.sensitivity_kernels import Directions, Flow, derivative_rows
from cellwise.identify.refinement.derivative_kernels import seen_partials

POINTS = 21
GRID_C = np.array([0.0, 20.0, 45.0])
SKEW_S = 0.3
NEUTRAL = CellScalars(
    charge_As=3600.0, charge_efficiency=1.0, activation_K=0.0, reference_K=298.15,
    hysteresis_rate=0.0, skew_s=SKEW_S, rate_per_A=0.0, charge_scale=1.0, leak_A=0.0,
    heating_K_per_W=0.0, heating_s=400.0, branch_activation=0.0, r0_activation_K=0.0,
    r1_activation_K=0.0, tau1_activation_K=0.0, r2_activation_K=0.0, tau2_activation_K=0.0,
    r3_activation_K=0.0, tau3_activation_K=0.0, asinh_per_V=0.0, surface_per_A=0.0,
    surface_s=90.0, surface_activation_K=0.0, surface_reference_K=291.15, entropy_K=298.15,
)  # fmt: skip
# Size of every number: what a step is a small share of.
SIZE = NEUTRAL._replace(
    activation_K=1000.0, hysteresis_rate=10.0, rate_per_A=0.1, leak_A=0.1, heating_K_per_W=1.0,
    r0_activation_K=1000.0, r1_activation_K=1000.0, tau1_activation_K=1000.0,
    r2_activation_K=1000.0, tau2_activation_K=1000.0, r3_activation_K=1000.0,
    tau3_activation_K=1000.0, asinh_per_V=20.0, surface_per_A=0.05,
    surface_activation_K=1000.0,
)  # fmt: skip
COLUMN_SIZE = {
    OCV: 0.1, R0: 0.02, R1: 0.01, TAU1: 5.0, R2: 0.01, TAU2: 60.0, R3: 0.02, TAU3: 900.0, M: 0.03,
    ERROR: 0.01, ENTROPY: 2e-4,
}  # fmt: skip
COLUMN_NAMES = {
    OCV: "ocv", R0: "r0", R1: "r1", TAU1: "tau1", R2: "r2", TAU2: "tau2", R3: "r3", TAU3: "tau3",
    M: "m", ERROR: "error", ENTROPY: "entropy",
}  # fmt: skip
BRANCHES = ("r0", "r1", "tau1", "r2", "tau2", "r3", "tau3")
# Effects: their scalars, and the columns that are zero without them.
EFFECTS = {
    "slow branch": ({}, {R3}),
    "hysteresis": ({"hysteresis_rate": 25.0}, {M}),
    "common activation": ({"activation_K": 1500.0}, set()),
    "own activations": (
        {f"{b}_activation_K": 400.0 * (k - 2.5) for k, b in enumerate(BRANCHES)}
        | {"branch_activation": 1.0},
        set(),
    ),
    "entropy": ({}, {ENTROPY}),
    "rate": ({"rate_per_A": 0.15}, set()),
    "charge asymmetry": ({"charge_scale": 1.3}, set()),
    "charge transfer": ({"asinh_per_V": 40.0}, set()),
    "surface": ({"surface_per_A": 0.035, "surface_activation_K": 900.0}, set()),
    "leak": ({"leak_A": 0.02}, set()),
    "self-heating": ({"heating_K_per_W": 6.0}, set()),
    "coulombic efficiency": ({"charge_efficiency": 0.97}, set()),
}
CASES = ["none", *EFFECTS, "all", "all at one temperature"]
SCALAR_NAMES = [n for n in CellScalars._fields if n not in ("branch_activation", "skew_s")]
NAMES = [*SCALAR_NAMES, *COLUMN_NAMES.values(), "soc0", "voltage", "gain", "skew"]
STEP = 3e-6


def make_log(rng, rows=500):
    """Charge, discharge and rest, uneven time with a gap; beyond full and beyond empty."""
    current = np.repeat(rng.normal(0.0, 1.5, rows) * rng.integers(0, 3, rows), 7)[:rows]
    current[: rows // 4] += 3.5
    current[rows // 4 : rows // 2] -= 6.0
    current[rows // 2 :] += 0.8
    current[rng.integers(0, rows, rows // 6)] = 0.0
    dt = 8.0 * (1.0 + 0.5 * rng.uniform(-1.0, 1.0, rows))
    dt[0] = 0.0
    dt[[rows // 3, rows - 40]] = 400.0, 900.0
    current[[rows // 3, rows - 40]] = -0.2, 0.1
    warm = 22.0 + 32.0 * np.sin(np.linspace(0.3, 9.0, rows))
    return dt, current, warm


def make_cell(case):
    """Tables that differ from point to point, and the scalars of a case."""
    rng = np.random.default_rng(11)
    soc = np.linspace(0.0, 1.0, POINTS)
    table = np.zeros((GRID_C.size, POINTS, COLUMNS))
    for column, size in COLUMN_SIZE.items():
        table[..., column] = size * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, table.shape[:2]))
    table[..., OCV] += 3.0 + soc
    effects = list(EFFECTS) if case.startswith("all") else [case] if case in EFFECTS else []
    cell = NEUTRAL
    for effect in effects:
        cell = cell._replace(**EFFECTS[effect][0])
    for effect, (_, columns) in EFFECTS.items():
        if effect not in effects:
            table[..., list(columns)] = 0.0
    kept = slice(1, 2) if case == "all at one temperature" else slice(None)
    return CellTables(np.ascontiguousarray(table[kept]), GRID_C[kept].copy(), cell)


LOG = make_log(np.random.default_rng(12))


def start_of(cell):
    """Not at rest; a slow branch or a rise that the cell does not have is zero."""
    slow = 0.002 if np.any(cell.table[..., R3]) else 0.0
    warmer = 1.5 if cell.cell.heating_K_per_W != 0.0 else 0.0
    return CellState(0.7123, 0.01, -0.005, slow, 0.4, warmer, 0.8)


@functools.cache
def seen_by_skew():
    """Current that the voltage has seen, and its derivative."""
    dt, current, _ = LOG
    before = np.concatenate((current[:1], current[:-1]))
    rows = list(zip(current, before, dt, strict=True))
    seen = [seen_current(NEUTRAL, *row) for row in rows]
    return np.array(seen), np.array([seen_partials(NEUTRAL, *row).seen_by_skew_s for row in rows])


def simulated(tables, start, gain=1.0):
    dt, current, warm = LOG
    voltage, soc = np.empty(dt.size), np.empty(dt.size)
    simulate_rows(tables, start, dt, gain * current, warm, voltage, soc)
    return voltage, soc


def surface_of(tables):
    """SOC at the particles' surface, row by row."""
    dt, _, warm = LOG
    state, found = start_of(tables), []
    for row in zip(seen_by_skew()[0], dt, warm, strict=True):
        before = state
        state, _ = advance(tables, before, *row)
        found.append(surface_soc(tables.cell, state.soc, state.slow_A, row[2] + before.heat_K))
    return np.array(found)


def column_change(name, tables):
    """A direction of one column that differs from point to point."""
    column = next(c for c, n in COLUMN_NAMES.items() if n == name)
    change = np.zeros_like(tables.table)
    share = 0.5 + np.random.default_rng(13).uniform(0.0, 1.0, change.shape[:2])
    change[..., column] = COLUMN_SIZE[column] * share
    return change


def central_difference(name, tables):
    """Of the simulated voltage; own activations are switched on on both sides."""
    ends = []
    for sign in (1.0, -1.0):
        step, moved = sign * STEP, tables
        cell = tables.cell._replace(branch_activation=1.0)
        if name in SCALAR_NAMES:
            size = getattr(SIZE, name)
            cell = cell._replace(**{name: getattr(cell, name) + step * size})
        elif name in COLUMN_NAMES.values():
            moved = tables._replace(table=tables.table + step * column_change(name, tables))
        elif name == "skew":
            cell = cell._replace(skew_s=SKEW_S + step)
        start = start_of(tables)
        if name == "soc0":
            start = start._replace(soc=start.soc + step)
        gain = 1.0 + step if name == "gain" else 1.0
        added = step if name == "voltage" else 0.0
        ends.append(simulated(moved._replace(cell=cell), start, gain)[0] + added)
    return (ends[0] - ends[1]) / (2.0 * STEP)


def directions_of(names, tables):
    scalars = np.zeros((len(names), len(CellScalars._fields)))
    changes, flows, table_of, flow_of = [], [], [], []
    seen, by_skew = seen_by_skew()
    for p, name in enumerate(names):
        if name in SCALAR_NAMES:
            scalars[p, CellScalars._fields.index(name)] = getattr(SIZE, name)
        if name in COLUMN_NAMES.values():
            changes.append(column_change(name, tables))
        if name in ("gain", "skew"):
            flows.append(seen if name == "gain" else by_skew)
        table_of.append(len(changes) - 1 if name in COLUMN_NAMES.values() else -1)
        flow_of.append(len(flows) - 1 if name in ("gain", "skew") else -1)
    return seen, Directions(
        scalars,
        np.array([float(n == "soc0") for n in names]),
        np.array([float(n == "voltage") for n in names]),
        np.array(changes) if changes else np.zeros((1, *tables.table.shape)),
        np.array(table_of, dtype=np.int32),
        np.array(flows) if flows else np.zeros((1, 1)),
        np.array(flow_of, dtype=np.int32),
    )


def derivatives(names, tables, stride=1):
    dt, _, warm = LOG
    flow, directions = directions_of(names, tables)
    found = np.full((len(range(0, dt.size, stride)), len(names)), np.nan)
    derivative_rows(
        tables,
        start_of(tables),
        Flow(dt, flow, warm),
        directions,
        stride,
        found,
    )
    return found


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_the_central_differences(case):
    tables = make_cell(case)
    found = derivatives(NAMES, tables)
    for p, name in enumerate(NAMES):
        expected = central_difference(name, tables)
        tolerance = 1e-6 * np.abs(expected).max() + 1e-10
        np.testing.assert_allclose(found[:, p], expected, rtol=0.0, atol=tolerance, err_msg=name)
        if case == "all" and name != "error":
            assert np.abs(expected).max() > 1e-4, f"{name} moves no voltage: nothing was tested"


@pytest.mark.parametrize("case", ["none", "self-heating", "all"])
def test_rows_that_are_not_scored_change_nothing_of_those_that_are(case):
    """Directions without a memory skip those rows, to the last bit."""
    tables = make_cell(case)
    every = derivatives(NAMES, tables)
    np.testing.assert_array_equal(derivatives(NAMES, tables, stride=7), every[::7])


def test_the_log_goes_everywhere():
    dt, current, warm = LOG
    soc = simulated(make_cell("none"), start_of(make_cell("none")))[1]
    assert soc.min() < -BEYOND
    assert soc.max() > 1.0 + BEYOND
    assert np.mean((soc > 0.0) & (soc < 1.0)) > 0.3
    assert warm.min() < GRID_C[0]
    assert warm.max() > GRID_C[-1]
    assert dt.max() > 20.0 * np.median(dt)
    assert np.any(current == 0.0)
    for case in CASES:  # no row so near a kink of the tables that a step would cross it
        tables = make_cell(case)
        soc = simulated(tables, start_of(tables))[1]
        place = np.concatenate((soc, surface_of(tables))) * (POINTS - 1)
        ends = np.array([-BEYOND * (POINTS - 1), (1.0 + BEYOND) * (POINTS - 1)])
        kinks = np.concatenate((np.arange(POINTS), ends))
        assert np.abs(place[:, None] - kinks).min() > 60.0 * STEP, case


def test_directions_together_are_as_each_alone_and_add_up():
    tables = make_cell("all")
    whole = derivatives(NAMES, tables, stride=3)
    for p, name in enumerate(NAMES):
        alone = derivatives([name], tables)[::3, 0]
        np.testing.assert_allclose(whole[:, p], alone, rtol=1e-12, atol=1e-15, err_msg=name)
    flow, one = directions_of(["charge_As"], tables)
    _, other = directions_of(["r0"], tables)
    _, third = directions_of(["gain"], tables)
    dt, _, warm = LOG
    both = one._replace(
        tables=other.tables, table_of=other.table_of, currents=third.currents,
        current_of=third.current_of, soc0=np.ones(1),
    )  # fmt: skip
    found = np.empty((dt.size, 1))
    derivative_rows(tables, start_of(tables), Flow(dt, flow, warm), both, 1, found)
    parts = derivatives(["charge_As", "r0", "gain", "soc0"], tables).sum(axis=1)
    np.testing.assert_allclose(found[:, 0], parts, rtol=0.0, atol=1e-12 * np.abs(parts).max())

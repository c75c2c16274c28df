"""A pack in the fixed step: weak cells found, others left alone.

By its C, which compiles in a tenth of the time; `test_twin`: the same bits in Python.
"""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise import InputError
from cellwise.estimate.fixed.fixed_step import samples_of
from cellwise.estimate.fixed.options import CellSettings
from cellwise.estimate.fixed_pack import FixedPack
from cellwise.export.firmware import Firmware
from cellwise.logs.cell_log import CellLog
from cellwise.pack.pack_estimate import estimate_pack
from emulated_packs import Fault, emulated_pack
from example_cells import curved_cell
from firmware_cases import power_asked
from virtual_tester import logged

pytest.importorskip("cffi")
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
CELLS = 12
ASKED = CellSettings()


@pytest.fixture(scope="module")
def healthy():
    return emulated_pack(CELLS, hours=6.0)


def drives(model, pack, days=1):
    """What the fixed step knows after as many days of one drive each: mean cell, every cell."""
    fixed = FixedPack(Firmware(model, dt_s=1.0, cells=ASKED), pack.cells)
    stepper, cells = fixed.filter.stepper(1.0), fixed.init(0.85).cells
    for day in range(days):
        state = fixed.init(0.85, 0.1)._replace(cells=cells)
        samples = samples_of(model, pack.mean, 1.0).records
        samples["sequence"] += np.uint32(86_400 * day)
        stepper.pack_rows(state.mean, cells, samples, pack.cell_V)
    return state.mean, fixed.cells(state)


def after(model, pack):
    """What it knows of every cell after twenty days."""
    return drives(model, pack, 20)[1]


def odd(values, cell):
    """How far one cell stands out of the others, in their standard deviations."""
    others = np.delete(values.astype(float), cell)
    return (values[cell] - np.mean(others)) / np.std(others)


@pytest.mark.parametrize(
    ("fault", "name", "least"),
    [
        (Fault(3, capacity=-0.06), "capacity_share", -0.03),
        pytest.param(Fault(3, resistance=0.20), "resistance_scale", 0.10, marks=pytest.mark.slow),
        pytest.param(Fault(3, soc=-0.03), "soc", -0.025, marks=pytest.mark.slow),
    ],
)
def test_an_odd_cell_stands_out_and_the_others_stay(healthy, fault, name, least):
    model, pack = emulated_pack(CELLS, fault, hours=6.0)
    found = after(model, pack)[name].astype(float)
    before = after(*healthy)[name].astype(float)
    assert abs(odd(found, 3)) > 5.0
    # A share of 1 / CELLS of the fault is in the mean cell, which all others are compared with.
    change = found - before
    shared = -least / (CELLS - 1)
    assert np.sign(change[3]) == np.sign(least)
    assert abs(change[3]) >= abs(least)
    assert np.all(np.abs(np.delete(change, 3)) < 3.0 * abs(shared))


@pytest.mark.slow
def test_what_is_said_of_each_cell_holds(healthy):
    """Differences of an emulated pack are known; so is what the estimates leave open."""
    model, pack = healthy
    found = after(model, pack)
    spread = np.random.default_rng(12345).normal(size=(CELLS, 4)) * [0.004, 0.015, 0.003, 0.0005]
    for name, k in (("capacity", 0), ("resistance", 1)):
        share = found[{"capacity": "capacity_share", "resistance": "resistance_scale"}[name]]
        true = spread[:, k] - spread[:, k].mean()
        error = share - 1.0 - true
        std = np.sqrt(found[f"{name}_variance"].astype(float))
        assert np.mean(np.abs(error) <= 2.0 * std) >= 0.9, name


@pytest.mark.slow
def test_its_order_is_that_of_the_whole_log_in_float64(healthy):
    model, pack = emulated_pack(CELLS, Fault(5, capacity=-0.05, resistance=0.1), hours=6.0)
    found, exact = after(model, pack), estimate_pack(model, [pack])
    soc = exact.cells.soc
    assert np.max(np.abs((found["soc"] - found["soc"].mean()) - (soc - soc.mean()))) < 0.01
    assert int(np.argmin(found["capacity_share"])) == 5
    assert int(np.argmax(found["resistance_scale"])) == 5


@pytest.mark.slow
def test_the_mean_cell_is_what_it_is_alone(healthy):
    """Cells that are followed change nothing of the mean cell's state."""
    model, pack = healthy
    with_cells, _ = drives(model, pack)
    alone = Firmware(model, dt_s=1.0, components=1)
    trace = alone.run(pack.mean, 0.85, 0.1)
    assert with_cells["soc"][0] == np.float32(trace.soc[-1])


@pytest.mark.slow
def test_a_dead_cell_and_a_missing_one_move_nobody(healthy):
    model, pack = healthy
    volts = pack.cell_V.copy()
    volts[9000:, 2] = np.nan
    volts[9000:, 7] = 0.0
    _, hurt = drives(model, replace(pack, cell_V=volts))
    _, whole = drives(model, pack)
    others = np.delete(np.arange(CELLS), (2, 7))
    for name in ("soc", "capacity_share", "resistance_scale"):  # the mean is that of fewer cells
        moved = (hurt[name] - whole[name])[others]
        assert np.max(np.abs(moved - np.mean(moved))) < 0.002, name


@pytest.mark.slow
def test_a_cell_that_jumps_is_looked_for_again(healthy):
    """A cell that was charged alone: its voltage is rejected, then its SOC is taken for unknown."""
    model, pack = healthy
    volts = pack.cell_V.copy()
    volts[9000:, 4] += 0.1
    _, found = drives(model, replace(pack, cell_V=volts))
    assert found["soc"][4] - np.median(found["soc"]) > 0.05
    assert np.max(np.abs(np.delete(found["soc"], 4) - np.median(found["soc"]))) < 0.03


@pytest.mark.slow
def test_all_cells_rejected_are_still_a_mean():
    """None is believed more than the others: the filter does not stay blind."""
    model = curved_cell()
    fixed = FixedPack(Firmware(model, dt_s=1.0, cells=ASKED), 4)
    state = fixed.init(0.6)
    level = float(model.ocv_V[0, 60])
    apart = np.array([-0.2, -0.1, 0.1, 0.2])
    for k in range(2000):
        fixed.step(state, 0.0, level + (k > 100) * apart, sequence=k)
    assert state.mean["cells_at"][0] == 1999
    assert np.all(np.diff(fixed.cells(state)["soc"]) > 0.01)


@pytest.mark.slow
def test_the_packs_power_is_that_of_its_weakest_cell():
    model = curved_cell()
    rng = np.random.default_rng(8)
    filter_ = Firmware(model, dt_s=1.0, cells=ASKED, power=power_asked(model))
    fixed, alone = FixedPack(filter_, 10), FixedPack(filter_, 2)
    for soc in (0.15, 0.5, 0.9):
        state = fixed.init(soc, 0.02)
        state.cells["soc"] = rng.normal(0.0, 0.02, 10)
        state.cells["resistance"] = rng.normal(0.0, 0.1, 10)
        whole = fixed.power(state)[0]
        each = []
        for k in range(10):
            twice = state.cells[[k, k]].copy()
            each.append(alone.power(state._replace(cells=twice))[0])
        for name in ("discharge_W", "charge_W"):
            least = min(float(one[name]) for one in each) / 2.0
            assert whole[name] / 10.0 == pytest.approx(least, rel=0.02), (soc, name)
            assert whole[name.replace("_W", "_low_W")] <= whole[name]


@pytest.mark.slow
def test_what_a_history_says_enters_the_state():
    """An aged cell, the model of the new one, and the two numbers of its history."""
    model = curved_cell()
    aged = replace(
        model,
        capacity_Ah=0.9 * model.capacity_Ah,
        **{name: 1.4 * getattr(model, name) for name in ("r0_ohm", "r1_ohm", "r2_ohm")},
    )
    rng = np.random.default_rng(0)
    current = np.repeat(rng.uniform(-2.0, 3.0, 300), 30)
    time = np.arange(current.size, dtype=float)
    log = CellLog(time, current, np.full(time.size, 3.7))
    log = logged(aged, log, 0.95)
    ends = []
    for kind, known in ((model, False), (model, True), (aged, False)):
        fixed = Firmware(kind, dt_s=1.0, health=known, wide=False)
        state = fixed.init(0.95, 0.01)
        if known:
            fixed.set_health(state, 0.9, 1.4)
        for k in range(log.time_s.size):
            info = fixed.step(state, log.current_A[k], log.voltage_V[k], sequence=k)
        ends.append(info.soc)
    assert ends[1] == pytest.approx(ends[2], abs=2e-3)
    assert abs(ends[0] - ends[2]) > 5.0 * abs(ends[1] - ends[2])


@pytest.mark.slow
def test_a_history_that_says_nothing_changes_no_bit():
    model = curved_cell()
    stress = np.random.default_rng(4).uniform(-3.0, 5.0, 500)
    with_health, plain = Firmware(model, dt_s=1.0, health=True), Firmware(model, dt_s=1.0)
    ours, theirs = with_health.init(0.7), plain.init(0.7)
    with_health.set_health(ours, 1.0, 1.0)
    for k, current in enumerate(stress):
        a = with_health.step(ours, current, 3.7, sequence=k)
        b = plain.step(theirs, current, 3.7, sequence=k)
        assert a == b, k


def test_wrong_use_is_said():
    model = curved_cell()
    plain = Firmware(model, dt_s=1.0)
    with pytest.raises(InputError, match="cells=CellSettings"):
        FixedPack(plain, 4)
    fixed = FixedPack(Firmware(model, dt_s=1.0, cells=ASKED), 4)
    for count in (1, 1001, True, 2.0):
        with pytest.raises(InputError, match="from 2 to 1000"):
            FixedPack(fixed.filter, count)
    state = fixed.init(0.5)
    for wrong in ([3.7] * 3, 3.7, ["a"] * 4, None):
        with pytest.raises(InputError, match=r"\(4,\): one for each cell"):
            fixed.step(state, 1.0, wrong, sequence=0)
    with pytest.raises(InputError, match="a PackState"):
        fixed.step(None, 1.0, [3.7] * 4, sequence=0)
    with pytest.raises(InputError, match="no state of power"):
        fixed.power(state)
    with pytest.raises(InputError, match="4 records of"):
        fixed.cells(state._replace(cells=state.cells[:2]))
    with pytest.raises(InputError, match="health=True"):
        plain.set_health(plain.init(0.5), 0.9, 1.0)
    aged = Firmware(model, dt_s=1.0, health=True)
    for share, scale in ((0.0, 1.0), (1.0, np.nan), (3.0, 1.0), (1.0, 21.0)):
        with pytest.raises(InputError, match=r"0\.1 to 2"):
            aged.set_health(aged.init(0.5), share, scale)
    with pytest.raises(InputError, match="capacity_share"):
        aged.set_health(aged.init(0.5), "new", 1.0)
    for wrong in ({"soc": 0.0}, {"lag_s": np.nan}, {"capacity": "1 %"}):
        with pytest.raises(InputError, match="a number above zero"):
            CellSettings(**wrong)

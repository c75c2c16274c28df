"""The generator: its rows and profiles without a cell, and the committed files with one."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "datasets"


@pytest.fixture(scope="module", autouse=True)
def generator_on_path():
    pytest.importorskip("pybamm", reason="PyBaMM is missing: install the extra 'generate'")
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


def test_rows_follow_the_plan_and_end_with_the_step():
    from generator.tester import row_instants

    rows = row_instants(((2.0, 0.5), (10.0, 4.0), (1e9, 100.0)), 25.0)
    np.testing.assert_allclose(rows, [0.5, 1.0, 1.5, 2.0, 6.0, 10.0, 25.0])


def test_instrument_writes_multiples_of_its_resolution_with_the_stated_noise():
    from generator.instrument import Instrument, measure
    from generator.tester import TrueLog

    rows = 40_000
    time = np.arange(rows, dtype=np.float64)
    log = TrueLog(
        time, np.full(rows, 2.0), np.full(rows, 3.7), np.full(rows, 25.0), time / 1800.0, time * 0
    )
    seen = measure(log, Instrument(range_A=20.0), False, np.random.default_rng(7))
    assert seen.temperature_C is None
    assert np.std(seen.voltage_V) == pytest.approx(0.5e-3, rel=0.03)
    assert np.std(seen.current_A) == pytest.approx(4e-3, rel=0.03)
    assert np.mean(seen.voltage_V) == pytest.approx(3.7, abs=2e-5)
    assert np.abs(seen.ampere_hours - log.charge_Ah).max() <= 0.5e-4 + 1e-12


def test_depleting_cycle_has_the_charge_asked_for():
    from generator.vehicle import Vehicle, depleting_cycle

    car = Vehicle(cells=2600, cell_V=3.25, peak_A=7.5, regen_A=5.0)
    for seed in range(5):
        current = depleting_cycle(car, 0.0759, 420, np.random.default_rng(seed))
        assert current.size == 420
        assert current.sum() / 3600.0 == pytest.approx(0.0759, abs=1e-4)
        assert current.min() < 0.0 < current.max()


@pytest.mark.slow
def test_cell_keeps_charge_and_stops_at_its_limit():
    from generator.cells import LFP
    from generator.physics import PhysicsCell
    from generator.tester import ConstantCurrent, ConstantVoltage, VirtualTester

    cell = PhysicsCell(LFP, soc=0.06)
    tester = VirtualTester(cell, LFP.lower_V, LFP.upper_V)
    tester.start_recording()
    rows = ((1e9, 5.0),)
    tester.run([ConstantCurrent(4.6, rows), ConstantVoltage(1.0, 0.5, rows)])
    log = tester.true_log()
    moved = np.concatenate(([0.0], np.cumsum(log.current_A[1:] * np.diff(log.time_s)))) / 3600.0
    np.testing.assert_allclose(moved, log.charge_Ah, atol=1e-9)
    assert log.voltage_V[log.step == 1][-1] == pytest.approx(2.0, abs=1e-5)
    np.testing.assert_allclose(log.voltage_V[log.step == 2], 2.0, atol=1e-5)
    assert cell.soc == pytest.approx(0.06 - log.charge_Ah[-1] / cell.capacity_Ah, abs=1e-9)


@pytest.mark.slow
def test_pulse_beyond_the_limit_in_its_first_instant_is_held_at_the_limit():
    from generator.cells import LFP
    from generator.physics import PhysicsCell
    from generator.tester import ConstantCurrent, VirtualTester

    cell = PhysicsCell(LFP, soc=0.999)
    tester = VirtualTester(cell, LFP.lower_V, LFP.upper_V)
    tester.start_recording()
    tester.run([ConstantCurrent(-23.0, ((1e9, 0.1),), 5.0, hold_at_limit=True)])
    log = tester.true_log()
    assert log.time_s[-1] == pytest.approx(5.0, abs=1e-6)
    np.testing.assert_allclose(log.voltage_V[1:], LFP.upper_V, atol=2e-3)
    assert np.all(log.current_A[1:] < 0.0)
    assert np.abs(log.current_A).max() < 23.0


def test_unknown_name_is_refused(tmp_path):
    from generator.generate import generate

    with pytest.raises(ValueError, match=r"unknown data sets \['nmc_nothing'\]"):
        generate(tmp_path, ["nmc_nothing"])
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nmc_cap_c3", "lfp_cap_3c"])
def test_generating_again_gives_the_committed_file(tmp_path, name):
    from generator.generate import generate

    calls: list[tuple[str, int, int]] = []
    [path] = generate(tmp_path, [name], lambda *call: calls.append(call))
    assert calls == [(name, 0, 1), ("done", 1, 1)]
    relative = path.relative_to(tmp_path)
    again, kept = pq.read_table(path), pq.read_table(FOLDER / relative)
    assert again.column_names == kept.column_names
    assert again.num_rows == kept.num_rows
    # Same seed, same noise: what is left is the solver's tolerance and one step of rounding.
    for column, tolerance in (
        ("time_s", 0.5),
        ("current_A", 2.1e-3),
        ("voltage_V", 3e-4),
        ("ampere_hours", 2.1e-4),
    ):
        difference = np.abs(again[column].to_numpy() - kept[column].to_numpy())
        assert difference.max() <= tolerance, column
    [entry] = tomllib.loads((tmp_path / "catalogue.toml").read_text(encoding="utf-8"))["dataset"]
    assert entry["name"] == name
    assert entry["rows"] == kept.num_rows

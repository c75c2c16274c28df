"""Rows of other packages: a process each, fitted on the tests alone, judged as everybody else."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.benchmark.package_rows import HERE, PackageRow, RowError, environment
from cellwise.benchmark.run_suite import run_suite
from cellwise.benchmark.suite import GAUGES, read_suite, with_estimators
from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import simulate
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.writing import write_log
from example_cells import curved_cell

ROWS, SOC0 = 1800, 0.8
SUITE = """
estimators = ["ekf"]
start_errors = [0.0, -0.3]
faults = ["offset +3 % of 1C"]
dt_s = 1.0
[quick]
faults = ["offset +3 % of 1C"]
[slow]
start_errors = []
faults = []
[[row]]
name = "theirs"
file = "theirs.py"
about = "counts by the capacity that it was fitted to"
[[row]]
name = "theirs, every 10 s"
file = "theirs.py"
about = "the same"
period_s = 10.0
[[row]]
name = "broken"
file = "broken.py"
about = "fails in its fit"
cut = "quick"
[[cell]]
name = "cell"
model = "cell.json"
[[log]]
cell = "cell"
log = "drive.csv"
soc0 = 0.8
reference_Ah = 3.0
quick = true
"""
THEIRS = """
print("what a library prints does not disturb the answers")


class Row:
    state_bytes = 8

    @staticmethod
    def fit(cell, seed):
        return {"ampere_seconds": 3600.0 * cell.capacity_Ah, "tests": len(cell.logs)}

    def __init__(self, cell, fitted):
        self.fitted = fitted

    def start(self, soc0, soc0_std):
        self.soc, self.std, self.steps = soc0, soc0_std, 0

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        self.soc -= current_A * dt_s / self.fitted["ampere_seconds"]
        return self.soc, self.std, voltage_V
"""
BROKEN = """
class Row:
    @staticmethod
    def fit(cell, seed):
        raise ValueError("no such cell")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("packages")
    cell = curved_cell()
    write_model(cell, place / "cell.json")
    time_s = np.arange(ROWS, dtype=np.float64)
    current = 1.5 + np.sin(time_s / 40.0)
    current[0] = 0.0
    log = CellLog(time_s, current, np.full(ROWS, 3.7))
    voltage = simulate(cell, log, soc0=SOC0).voltage_V
    charge = np.cumsum(current) / 3600.0
    write_log(replace(log, voltage_V=voltage, charge_Ah=charge), place / "drive.csv")
    (place / "suite.toml").write_text(SUITE)
    shutil.copy(HERE / "serve.py", place)
    (place / "theirs.py").write_text(THEIRS)
    (place / "broken.py").write_text(BROKEN)
    return place


@pytest.fixture(scope="module")
def found(folder):
    suite = read_suite(folder / "suite.toml")
    return run_suite(suite, folder / "out", page=False, adapters=folder)


def rows_of(found, name):
    return [r for r in found.rows if r["estimator"] == name]


def test_a_foreign_row_counts_as_ours_does(found):
    """Its current and its intervals are those that an estimator of cellwise sees."""
    for name, tolerance in (("theirs", 1e-6), ("theirs, every 10 s", 1e-4)):
        own, ours = rows_of(found, name), rows_of(found, "coulomb")
        assert len(own) == len(ours) == 3
        for theirs, counted in zip(own, ours, strict=True):
            assert theirs["problem"] == ""
            for figure in ("soc_rmse", "soc_final_error"):
                assert theirs[figure] == pytest.approx(counted[figure], abs=tolerance)
            assert theirs["state_bytes"] == 8
            assert theirs["process_MB"] > 1.0


def test_easy_and_quick_runs_are_marked(found):
    marks = [(r["fault"] != "none", r["start_error"], r["easy"], r["quick"])
             for r in rows_of(found, "theirs")]  # fmt: skip
    assert marks == [(False, 0.0, True, False), (False, -0.3, False, False),
                     (True, -0.3, False, True)]  # fmt: skip


def test_a_fit_that_fails_is_said_and_the_others_go_on(found):
    (row,) = rows_of(found, "broken")
    assert row["problem"] == "its fit: ValueError: no such cell"


def test_runs_are_taken_over_until_the_adapter_changes(folder, found):
    suite = read_suite(folder / "suite.toml")
    again = run_suite(suite, folder / "out", page=False, adapters=folder)
    assert again.resumed == len(again.rows)
    quick = run_suite(replace(suite, only_quick=True), folder / "out", page=False, adapters=folder)
    assert {r["quick"] for r in quick.rows} == {True}
    assert {"theirs", "broken", "ekf"} <= {r["estimator"] for r in quick.rows}
    (folder / "theirs.py").write_text(THEIRS + "\n# changed\n")
    changed = run_suite(suite, folder / "out", page=False, adapters=folder)
    assert changed.resumed == len(changed.rows) - 6


def test_without_the_adapters_package_rows_are_not_run(folder, tmp_path):
    suite = read_suite(folder / "suite.toml")
    left = run_suite(suite, tmp_path / "out", page=False, adapters=tmp_path)
    assert {r["estimator"] for r in left.rows} == {
        "ekf",
        "coulomb",
        "rest-ocv",
        *(name.rpartition(":")[2] for name in GAUGES),
    }
    assert [one.name for one in left.suite.not_run] == ["theirs", "theirs, every 10 s", "broken"]


def test_a_name_belongs_to_one_estimator(folder):
    twice = (folder / "suite.toml").read_text().replace('name = "theirs"', 'name = "ekf"')
    (folder / "twice.toml").write_text(twice)
    with pytest.raises(InputError, match="two of estimator 'ekf'"):
        read_suite(folder / "twice.toml")
    assert with_estimators(read_suite(folder / "suite.toml"), ("ukf",)).rows


@pytest.mark.slow
def test_what_does_not_install_is_said(tmp_path):
    row = PackageRow("x", "x.py", "", requires=("./no-such-folder",))
    with pytest.raises(RowError, match="did not install"):
        environment(row, tmp_path)

"""Runs of a small suite: figures by hand, what resumes, adapters, processes."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from cellwise.benchmark.adapter import short_name
from cellwise.benchmark.figures import COLUMNS, figures_of, state_bytes
from cellwise.benchmark.run_suite import run_suite
from cellwise.benchmark.suite import BASELINES, read_suite
from cellwise.cell.model_file import write_model
from cellwise.errors import InputError
from cellwise.estimate.filters.filterpy_filters import FilterpyEkf
from cellwise.estimate.filters.kalman import Ekf
from cellwise.estimate.replay import Replay, replay
from cellwise.logs.cell_log import CellLog
from cellwise.logs.reading import read_log
from cellwise.logs.writing import write_log
from example_cells import curved_cell
from virtual_tester import logged

ROWS = 3600
SOC0 = 0.8
SUITE = """
about = "a cell that is its own model"
estimators = ["ekf", "coulomb"{more}]
start_errors = [0.0, 0.3, -0.3]
[[fault]]
name = "offset"
current_offset_A = 0.3
[slow]
start_errors = [-0.3]
faults = ["none"]
dt_s = 10.0
[[cell]]
name = "cell"
model = "cell.json"
[[log]]
cell = "cell"
log = "drive.csv"
soc0 = 0.8
reference_Ah = 3.0
"""
ADAPTER = '''
import math

from cellwise import FilterOutput


class Counter:
    """Counts, and says how it would be wrong."""

    def __init__(self, model):
        self.ampere_seconds = 3600.0 * model.capacity_Ah

    def start(self, soc0, soc0_std):
        self.soc, self.std = soc0, soc0_std

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        if math.isfinite(current_A):
            self.soc -= current_A * dt_s / self.ampere_seconds
        return FilterOutput(self.soc, self.std)


class Broken(Counter):
    def step(self, current_A, voltage_V, temperature_C, dt_s):
        raise RuntimeError("out of ideas")


class Silent(Counter):
    def step(self, *sample):
        return math.nan
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("suite")
    cell = curved_cell()
    rng = np.random.default_rng(11)
    current = np.repeat(rng.normal(0.8, 2.0, ROWS // 10), 10)
    current[:30] = 0.0
    log = CellLog(np.arange(float(ROWS)), current, np.full(ROWS, 3.7),
                  charge_Ah=np.cumsum(current) / 3600.0)  # fmt: skip
    log = logged(cell, log, SOC0)
    write_model(cell, place / "cell.json")
    write_log(log, place / "drive.csv")
    (place / "filters.py").write_text(ADAPTER, encoding="utf-8")
    more = "".join(f', "filters.py:{n}"' for n in ("Counter", "Broken", "Silent"))
    (place / "plain.toml").write_text(SUITE.format(more=""), encoding="utf-8")
    (place / "adapters.toml").write_text(SUITE.format(more=more), encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def found(folder):
    return run_suite(read_suite(folder / "adapters.toml"), folder / "out", page=False)


def rows_of(found, **wanted):
    return [r for r in found.rows if all(r[k] == v for k, v in wanted.items())]


def test_there_is_one_row_per_run_and_baselines_are_among_them(found):
    # +30 points from 80 % are beyond full: two starts, and the fault from one.
    for name in ("ekf", "coulomb", "rest-ocv", "Counter"):
        assert [(r["fault"], r["start_error"]) for r in rows_of(found, estimator=name)] == [
            ("none", 0.0), ("none", -0.3), ("offset", -0.3),
        ]  # fmt: skip
    for name in ("filterpy-ekf", "filterpy-ukf"):
        (row,) = rows_of(found, estimator=name)
        assert (row["start_error"], row["fault"], row["dt_s"]) == (-0.3, "none", 10.0)
    assert set(map(short_name, BASELINES)) <= {r["estimator"] for r in found.rows}
    assert all(list(r) == list(COLUMNS) for r in found.rows)


def test_a_filter_whose_model_is_the_cell_finds_the_truth(found):
    for row in rows_of(found, estimator="ekf", fault="none"):
        assert row["settled_rmse"] < 0.01
        assert row["convergence_s"] < 60.0
        assert row["state_bytes"] > 20 * 8


def test_counting_keeps_the_error_that_it_began_with(found):
    right, wrong = rows_of(found, estimator="coulomb", fault="none")
    assert right["soc_max_error"] < 1e-3
    assert wrong["soc_rmse"] == pytest.approx(0.3, abs=1e-3)
    assert np.isnan(wrong["convergence_s"])
    # And an offset of 0.3 A for an hour on 3 Ah adds 10 points to the 30.
    (offset,) = rows_of(found, estimator="coulomb", fault="offset")
    assert offset["soc_final_error"] == pytest.approx(-0.4, abs=2e-3)


def test_an_adapter_is_judged_like_everybody_else(found):
    for mine, ours in zip(
        rows_of(found, estimator="Counter"), rows_of(found, estimator="coulomb"), strict=True
    ):
        assert mine["soc_rmse"] == pytest.approx(ours["soc_rmse"], abs=1e-6)
        assert mine["problem"] == ""
    assert rows_of(found, estimator="Counter")[0]["coverage_2sigma"] == 1.0


def test_a_filter_that_fails_is_reported_and_the_others_go_on(found):
    (said,) = {r["problem"] for r in rows_of(found, estimator="Broken")}
    assert said.startswith("RuntimeError: out of ideas, in line ")
    assert said.endswith(': raise RuntimeError("out of ideas")')
    assert all("no SOC in 3600" in r["problem"] for r in rows_of(found, estimator="Silent"))


def test_the_parquet_holds_the_rows(found):
    table = pq.read_table(found.parquet).to_pydict()
    assert list(table) == list(COLUMNS)
    assert table["estimator"] == [r["estimator"] for r in found.rows]
    np.testing.assert_array_equal(table["soc_rmse"], [r["soc_rmse"] for r in found.rows])


def test_it_resumes_where_it_stopped(folder, tmp_path):
    suite = read_suite(folder / "plain.toml")
    first = run_suite(suite, tmp_path, page=False)
    assert first.resumed == 0
    kept = tmp_path / "rows.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines(keepends=True)
    # Interrupted in the middle of a line.
    kept.write_text("".join(lines[:4]) + lines[4][:50], encoding="utf-8")
    told = []
    second = run_suite(suite, tmp_path, page=False, progress=lambda *a: told.append(a))
    assert second.resumed == 4
    assert told[-1][1:] == (len(first.rows), len(first.rows))
    same = [{k: v for k, v in r.items() if k != "ns_per_step"} for r in first.rows]
    again = [{k: v for k, v in r.items() if k != "ns_per_step"} for r in second.rows]
    np.testing.assert_equal(again, same)
    assert run_suite(suite, tmp_path, page=False).resumed == len(first.rows)
    assert run_suite(suite, tmp_path, page=False, fresh=True).resumed == 0


def test_what_changed_is_run_again(folder, tmp_path):
    suite = read_suite(folder / "plain.toml")
    run_suite(suite, tmp_path, page=False)
    louder = replace(suite.faults[0], current_offset_A=0.4)
    after = run_suite(replace(suite, faults=(louder,)), tmp_path, page=False)
    faulty = len(rows_of(after, fault="offset"))
    assert after.resumed == len(after.rows) - faulty


@pytest.mark.slow
def test_two_processes_find_what_one_finds(folder, found, tmp_path):
    suite = read_suite(folder / "adapters.toml")
    both = run_suite(suite, tmp_path, page=False, processes=2)
    for a, b in zip(found.rows, both.rows, strict=True):
        np.testing.assert_equal({**a, "ns_per_step": 0}, {**b, "ns_per_step": 0})
    missing = replace(suite, cells=(replace(suite.cells[0], model="filters.py"),))
    with pytest.raises(InputError, match=r"filters\.py that is not JSON"):
        run_suite(missing, tmp_path / "bad", page=False, processes=2)


def test_figures_are_those_of_the_definition(folder):
    """Metrics again, by hand, from one replay."""
    cell = curved_cell()
    log = read_log(folder / "drive.csv")
    truth = SOC0 - log.charge_Ah / 3.0
    truth -= np.min(truth) - 0.02  # down to 2 %
    made = replay(cell, log, "ekf", soc0=0.5, reference_soc0=SOC0, reference_capacity_Ah=3.0)
    # An error that is known: 5 points for 100 s, then one.
    soc = truth + np.where(np.arange(ROWS) < 100, 0.05, 0.01)
    made = Replay(log, "e", made.start, replace(made.trace, soc=soc, soc_std=np.full(ROWS, 0.01)),
                  1.0, truth)  # fmt: skip
    told = figures_of(made, truth)
    assert told["convergence_s"] == 100.0
    assert told["settled_rmse"] == pytest.approx(0.01)
    assert told["soc_max_error"] == pytest.approx(0.05)
    assert told["soc_mae"] == pytest.approx((100 * 0.05 + 3500 * 0.01) / ROWS)
    assert told["coverage_2sigma"] == pytest.approx(3500 / ROWS)
    low = np.abs(soc - truth)[truth <= 0.1]
    assert low.size
    assert told["low_soc_rmse"] == pytest.approx(np.sqrt(np.mean(low**2)))


def test_bytes_of_state_are_those_of_its_numbers():
    cell = curved_cell()
    assert state_bytes(FilterpyEkf(cell)) == (5 + 25) * 8

    def count(value):
        return sum(map(count, value)) if isinstance(value, list) else 1

    state = json.loads(json.dumps(Ekf(cell).init(0.5)))  # every number of it, nested
    assert state_bytes(Ekf(cell)) == 8 * count(state)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nowhere.py:Counter", "no file 'nowhere.py'"),
        ("filters.py:Missing", "no 'Missing'"),
        ("filters.py:math", "no 'math'"),
        ("no_such_package.filters:X", "ModuleNotFoundError"),
    ],
)
def test_an_adapter_that_cannot_be_loaded_is_refused(folder, tmp_path, name, said):
    suite = replace(read_suite(folder / "plain.toml"), estimators=("ekf", name))
    with pytest.raises(InputError, match=said):
        run_suite(suite, tmp_path, page=False)


def test_a_log_without_a_counter_cannot_be_judged(folder, tmp_path):
    text = (folder / "drive.csv").read_text(encoding="utf-8").splitlines()
    bare = "\n".join(",".join(line.split(",")[:3]) for line in text) + "\n"
    (folder / "bare.csv").write_text(bare, encoding="utf-8")
    suite = read_suite(folder / "plain.toml")
    suite = replace(suite, logs=(replace(suite.logs[0], log="bare.csv"),))
    with pytest.raises(InputError, match="no charge counter in log 'bare'"):
        run_suite(suite, tmp_path, page=False)


def test_tables_for_papers_are_written(found):
    folder = found.parquet.parent
    with (folder / "results.csv").open(newline="") as file:
        told = list(csv.DictReader(file))
    assert [r["estimator"] for r in told] == [r["estimator"] for r in found.rows]
    for read, row in zip(told, found.rows, strict=True):
        figure = read["settled_rmse"]
        np.testing.assert_equal(float(figure) if figure else np.nan, row["settled_rmse"])
        assert int(read["seed"]) > 0
        assert "numpy" in read["made_with"]
    text = (folder / "results.tex").read_text()
    assert r"\begin{tabular}" in text
    assert "Counter" in text  # somebody's own filter among the others

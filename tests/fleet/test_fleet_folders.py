"""A folder for each pack or cell: one row for all its logs, the same as of one by itself."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_file import write_model
from cellwise.cell.simulate import simulate
from cellwise.cell.stock import stock_model
from cellwise.cli import main
from cellwise.errors import InputError, MachineError
from cellwise.fleet import HistoryTask, PackTask, run_fleet
from cellwise.fleet.store import read_prepared
from cellwise.history.ageing import ageing_history
from cellwise.history.log_health import changed_model
from cellwise.logs import CellLog, read_log, write_log
from cellwise.logs.reading import read_pack
from cellwise.logs.writing import write_columns
from cellwise.pack.pack_estimate import estimate_pack
from emulated_packs import Fault, emulated_pack
from fleet_logs import rows_in

FRESH = stock_model("nca-18650")


def discharge(share):
    """A complete discharge of a cell that has kept this share of its capacity."""
    cell = changed_model(FRESH, np.log(share), 0.0)
    time = np.arange(0.0, 7400.0, 10.0)
    current = np.full(time.size, 0.5 * FRESH.capacity_Ah)
    current[0] = 0.0
    log = CellLog(time, current, np.full(time.size, 3.7), np.full(time.size, 25.0))
    volts = simulate(cell, log, 1.0).voltage_V
    stop = int(np.argmax(volts < 2.9)) or time.size
    return replace(log, voltage_V=volts).part(0, stop)


@pytest.fixture(scope="module")
def lives(tmp_path_factory):
    """Two cells, one of which has lost a tenth; their logs out of order by their plain names."""
    place = tmp_path_factory.mktemp("lives")
    for cell, shares in (("good", (1.0, 0.99)), ("bad", (1.0, 0.90))):
        (place / cell).mkdir()
        for number, share in zip((2, 10), shares, strict=True):
            write_log(discharge(share), place / cell / f"cycle{number}.parquet")
    (place / "bad" / "cycle11.parquet").write_bytes(b"cut off")
    return place


@pytest.fixture(scope="module")
def packs(tmp_path_factory):
    """Two packs of four cells, one with a weak cell; two days each."""
    place = tmp_path_factory.mktemp("packs")
    for name, fault in (("van_1", None), ("van_2", Fault(cell=2, capacity=-0.08))):
        (place / name).mkdir()
        for day in (1, 2):
            _, log = emulated_pack(4, fault, hours=2.0, seed=day, name=f"2026-03-0{day}")
            write_columns(log.columns(), place / name / f"2026-03-0{day}.parquet")
    return place


def test_a_cells_row_is_its_life(lives, tmp_path):
    told = run_fleet(HistoryTask(FRESH), lives, tmp_path / "out", workers=2)
    rows = rows_in(tmp_path / "out")
    assert (told.logs, told.done, told.failed) == (2, 2, 0)
    assert set(rows) == {"good", "bad"}
    names = [lives / "bad" / f"cycle{k}.parquet" for k in (2, 10)]
    life = ageing_history(FRESH, [read_log(path) for path in names])
    assert rows["bad"]["capacity_share"] == pytest.approx(float(life.trend.share[-1]), rel=1e-12)
    assert rows["bad"]["capacity_share"] < 0.93 < rows["good"]["capacity_share"]
    assert rows["bad"]["logs"] == 2
    assert "cycle11.parquet" in rows["bad"]["unread"]
    assert rows["good"]["unread"] is None


def test_a_new_log_has_its_row_made_again_and_a_folder_without_one_is_its_error(lives, tmp_path):
    place = tmp_path / "lives"
    shutil.copytree(lives / "bad", place / "bad")
    (place / "none").mkdir()
    (place / "none" / "notes.md").write_text("not a log\n")
    told = run_fleet(HistoryTask(FRESH), place, tmp_path / "out", workers=1)
    assert told.failed == 1
    assert "none of them a log" in rows_in(tmp_path / "out")["none"]["error"]
    write_log(discharge(0.88), place / "bad" / "cycle12.parquet")
    told = run_fleet(HistoryTask(FRESH), place, tmp_path / "out", workers=1)
    assert (told.done, told.resumed, told.failed) == (1, 1, 1)
    assert rows_in(tmp_path / "out")["bad"]["logs"] == 3


def test_folders_without_any_log_are_refused(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "notes.md").write_text("not a log\n")
    with pytest.raises(InputError, match="none of the 1 folders"):
        run_fleet(HistoryTask(FRESH), tmp_path, tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_log_that_the_machine_does_not_give_is_tried_again(lives, tmp_path, monkeypatch):
    def without(path, *_, **options):
        if path.name == "cycle2.parquet" and path.parent.name == "good":
            raise MachineError("a disk that does not answer", "a file", "Try again.")
        return read_prepared(path, *_, **options)

    with monkeypatch.context() as patch:
        patch.setattr("cellwise.fleet.tasks.read_prepared", without)
        told = run_fleet(HistoryTask(FRESH), lives, tmp_path / "out", workers=1)
    assert (told.failed, told.machine) == (1, 1)
    again = run_fleet(HistoryTask(FRESH), lives, tmp_path / "out", workers=1)
    assert (again.done, again.resumed, again.failed) == (1, 1, 0)


def test_a_packs_row_is_its_estimate(packs, tmp_path):
    told = run_fleet(PackTask(FRESH), packs, tmp_path / "out", workers=2)
    rows = rows_in(tmp_path / "out")
    assert (told.logs, told.failed) == (2, 0)
    alone = estimate_pack(FRESH, [read_pack(p) for p in sorted((packs / "van_2").iterdir())])
    assert rows["van_2"]["capacity_min_Ah"] == pytest.approx(float(alone.cells.capacity_Ah.min()))
    assert rows["van_2"]["weakest_by_capacity"] == "cell_03"
    assert rows["van_2"]["cells"] == 4
    assert rows["van_1"]["weak"] is None
    assert rows["van_1"]["causes"] is None


@pytest.mark.slow
def test_fleet_history_and_pack_take_folders(lives, packs, tmp_path, capsys):
    model = tmp_path / "m.json"
    write_model(FRESH, model)
    for action, place in (("history", lives), ("pack", packs)):
        out = tmp_path / action
        words = ["fleet", action, "--model", str(model), str(place), "-o", str(out)]
        assert main([*words, "--workers", "1", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["done"] == 2
        assert main(words) == 0
        assert "0 of 2 folders done" in capsys.readouterr().out


def test_a_fleet_pack_of_logs_without_cells_is_refused(lives, tmp_path, capsys):
    words = ["fleet", "pack", "--model", "nca-18650", str(lives), "-o", str(tmp_path / "out")]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "cell" in said

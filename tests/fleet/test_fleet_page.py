"""The page that a fleet's replay ends on: a row for each cell, the worst first."""

from __future__ import annotations

import re

import pytest

from cellwise.cell.model_file import write_model
from cellwise.cli import main
from cellwise.fleet import ReplayTask, run_fleet
from cellwise.fleet.store import all_rows
from cellwise.report.fleet_page import cells_of


def test_a_cell_is_all_of_its_logs_and_the_worst_come_first(model, folder, tmp_path):
    run_fleet(ReplayTask(model), folder, tmp_path / "out", workers=1)
    rows = all_rows(tmp_path / "out")
    cells = cells_of(rows)
    assert sum(cell.logs for cell in cells) == len(rows["log"])
    assert len({cell.name for cell in cells}) == len(cells)
    assert [cell.failed > 0 for cell in cells] == sorted(
        (c.failed > 0 for c in cells), reverse=True
    )
    sound = [cell.voltage_rmse_V for cell in cells if not cell.failed]
    assert sound == sorted(sound, reverse=True)
    truck = next(cell for cell in cells if cell.name == "truck_2")
    own = [k for k, cell in enumerate(rows["cell"]) if cell == "truck_2"]
    assert truck.voltage_rmse_V == pytest.approx(max(rows["voltage_rmse_V"][k] for k in own))
    assert rows["voltage_rmse_V"][rows["log"].index(truck.worst_log)] == truck.voltage_rmse_V


def test_the_command_ends_on_the_page(model, folder, tmp_path, capsys):
    place, out = tmp_path / "model.json", tmp_path / "out"
    write_model(model, place)
    assert main(["fleet", "replay", "--model", str(place), str(folder), "-o", str(out)]) == 0
    assert "_report.html" in "".join(capsys.readouterr().out.split())
    page = (out / "_report.html").read_text(encoding="utf-8")
    assert page.count("<tr>") == 1 + len(cells_of(all_rows(out)))
    assert re.search(r"<h1>.*2.logs of 8 failed", page.replace("\u00a0", " "))
    assert "aria-sort" in page

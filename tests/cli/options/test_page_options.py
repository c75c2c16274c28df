"""Pages and pictures of the commands: where they go, in which formats, what is refused."""

from __future__ import annotations

import json

import pytest

from cellwise.cli import main
from cellwise.data import load_dataset
from cellwise.logs import write_log


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    place = tmp_path_factory.mktemp("drive") / "drive.parquet"
    return write_log(load_dataset("nmc_drive_b").part(0, 1200), place)


def suffixes(folder):
    return {path.suffix for path in folder.iterdir()}


def test_pictures_of_a_replay_without_its_page(identified, drive, tmp_path, capsys):
    arguments = ["replay", "--model", str(identified.path), str(drive), "--figures"]
    assert main([*arguments, str(tmp_path / "png")]) == 0
    assert "pictures in" in capsys.readouterr().out
    assert suffixes(tmp_path / "png") == {".png"}
    kinds = ["--figure-format", "svg", "--figure-format", "pdf"]
    assert main([*arguments, str(tmp_path / "both"), *kinds]) == 0
    assert suffixes(tmp_path / "both") == {".svg", ".pdf"}
    assert {p.name for p in tmp_path.iterdir()} == {"png", "both"}  # no page was left


@pytest.mark.slow
def test_an_export_has_its_page_and_its_pictures(identified, drive, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "")  # no cross compiler: counting instructions takes long
    page, figures = tmp_path / "export.html", tmp_path / "figures"
    code = main(
        ["export", "--model", str(identified.path), "--dt", "1", "-o", str(tmp_path / "out"),
         "--log", str(drive), "--report", str(page), "--figures", str(figures), "--json"]
    )  # fmt: skip
    told = json.loads(capsys.readouterr().out)
    assert code == 0
    text = page.read_text(encoding="utf-8")
    block = text.split('id="cellwise-data">')[1].split("</script>")[0]
    assert json.loads(block) == told
    finding = text.split("<h1>")[1].split("</h1>")[0]
    assert f"{told['state_bytes']} bytes per cell" in finding
    assert "of the float64 EKF" in finding
    assert "No cross compiler" in text
    assert 'class="trace"' in text
    assert "RMSE [points]" in text

"""The command: one JSON object, a page, refusals."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from cellwise.cli.command_line import main
from cellwise.studies import capacity_study

CELL = ["capacity-study", "--cell", "embedded-nmc-rates"]


@pytest.fixture(scope="module", autouse=True)
def once():
    """A cell is studied once for all commands of this file."""
    kept, study = {}, capacity_study.study_cell

    def remembered(cell, *arguments):
        if cell.name not in kept:
            quick = replace(cell, settings=replace(cell.settings, refine=False))
            kept[cell.name] = study(quick, *arguments)
        return kept[cell.name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(capacity_study, "study_cell", remembered)
        yield


def test_one_object_with_winners_and_the_papers_orders(tmp_path, capsys):
    page = tmp_path / "study.html"
    both = ["--estimator", "coulomb", "--estimator", "ekf"]
    assert main([*CELL, *both, "--report", str(page), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    (study,) = data["studies"]
    assert [c["choice"] for c in study["choices"]] == ["rate:C/20", "rate:C/5", "rate:C/3"]
    for choice in study["choices"]:
        assert set(choice["soc"]) == {"coulomb", "ekf"}
        assert set(choice["soc"]["ekf"]) == {"rmse", "mae", "max", "end", "axis_share"}
    assert set(study["winners"]) == {"voltage", "coulomb", "ekf"}
    behind = study["winners"]["coulomb"]["behind"]["rate:C/3"]
    assert behind["low"] <= behind["value"] <= behind["high"]
    assert data["published_orders"]["lfp"][-1] == "nominal"
    text = page.read_text(encoding="utf-8")
    assert "rate:C/20" in text
    assert "<svg" in text
    assert "LFP paper" in text


def test_tables_and_reasons_for_people(capsys):
    assert main([*CELL, "--estimator", "coulomb"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "coulomb counting: rate:C/20 wins" in text
    assert "is its SOC scale" in text
    assert "NCR18650B paper" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--cell", "my-cell"], "embedded-nmc"),
        (["--estimator", "oracle"], "ekf"),
        (["--judge", "drive.csv"], "reference capacity"),
    ],
)
def test_wrong_arguments_of_the_capacity_study_are_refused(arguments, said, capsys):
    assert main(["capacity-study", *arguments]) == 2
    assert said in capsys.readouterr().err

"""The command: one JSON object, a page, refusals."""

from __future__ import annotations

import json

import pytest

from cellwise.cli.command_line import main


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    page = tmp_path_factory.mktemp("study") / "study.html"
    return page, ["capacity-study", "--cell", "embedded-nmc-rates", "--estimator", "coulomb",
                  "--estimator", "ekf", "--report", str(page), "--json"]  # fmt: skip


def test_one_object_with_winners_and_the_papers_orders(told, capsys):
    page, arguments = told
    assert main(arguments) == 0
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
    arguments = ["capacity-study", "--cell", "embedded-nmc-rates", "--estimator", "coulomb"]
    assert main(arguments) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "coulomb counting: rate:C/20 wins" in text
    assert "counting divides by it" in text
    assert "NCR18650B paper" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--cell", "my-cell"], "embedded-nmc"),
        (["--cell", "leaf"], "--data"),
        (["--estimator", "oracle"], "ekf"),
        (["--data", "nowhere-at-all"], "nowhere-at-all"),
        (["--judge", "drive.csv"], "reference capacity"),
    ],
)
def test_refusals(arguments, said, capsys, monkeypatch):
    monkeypatch.delenv("CELLWISE_DATA", raising=False)
    assert main(["capacity-study", *arguments]) == 2
    assert said in capsys.readouterr().err

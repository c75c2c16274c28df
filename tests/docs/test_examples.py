"""The examples run as a reader would run them, and each is on the page that lists them."""

from __future__ import annotations

import re
import runpy

import pytest
from doc_blocks import DOCS, REPOSITORY, page_blocks

EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
CASES = {
    "identify_a_cell": "m50.json",
    "replay_a_flight": "flight.html",
    "compare_estimators": None,
    "find_a_hidden_fault": None,
    "export_to_a_cortex_m": "firmware/cellwise_export.json",
    "leo_battery_study": "leo.svg",
}


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()
    written = CASES[path.stem]
    assert written is None or (tmp_path / written).stat().st_size > 0


def test_there_is_an_example_for_each_case():
    assert {path.stem for path in EXAMPLES} == set(CASES)


def test_every_example_is_on_the_page():
    text = (DOCS / "examples.md").read_text(encoding="utf-8")
    for path in EXAMPLES:
        assert f"<!-- code: examples/{path.name} -->" in text
        assert f"(../examples/{path.name})" in text


def test_the_code_below_each_picture_of_the_gallery_draws_it():
    page = DOCS / "gallery.md"
    shown = re.findall(r"!\[.+\]\(pictures/(gallery_\w+\.png)\)", page.read_text(encoding="utf-8"))
    drawn = [re.findall(r'savefig\("(.+)"\)', block.text) for block in page_blocks(page)]
    assert drawn == [[name] for name in shown]
    assert len(shown) == 6
    assert {path.name for path in (DOCS / "pictures").glob("gallery_*")} == set(shown)

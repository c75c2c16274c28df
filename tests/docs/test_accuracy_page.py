"""What README, the accuracy and the firmware page show is what the results files hold."""

from __future__ import annotations

import json
import re

import pytest
from benchmarks.accuracy_page import (
    MARKS,
    MOST_ROWS,
    PAGE,
    README,
    family_of,
    headlines,
    page_of,
    readme_table,
)
from benchmarks.figures import between_marks
from benchmarks.firmware import table
from benchmarks.publish import RESULTS
from doc_blocks import DOCS, PAGES, page_name

MEASURED = {
    "criticism.md": (
        "How often",
        "Effects hidden in measured logs",
        "Measured cells with nothing hidden",
    ),
    "firmware.md": ("What a step costs",),
    "leaderboard.md": ("How rows of other packages are run",),
}


@pytest.fixture(scope="module")
def results():
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def test_the_page_is_printed_from_the_results(results):
    assert PAGE.read_text(encoding="utf-8") == page_of(results)


def test_the_table_of_the_readme_is_printed_from_the_results(results):
    text = README.read_text(encoding="utf-8")
    assert text == between_marks(text, MARKS, readme_table(results))
    assert readme_table(results) in text


def test_results_say_of_which_commit_and_day_they_are(results):
    for row in results["figures"]:
        assert re.fullmatch(r"[0-9a-f]{8}", row["commit"]), "measured beside changes of no commit"
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", row["date"])


def test_rows_of_two_commits_say_so_each(results):
    """No row stands under the commit of another."""
    rows = [dict(row) for row in results["figures"]]
    last = family_of(headlines(results)[-1])
    other = {**headlines(results)[-1], "group": "another cell", "commit": "0123abcd"}
    page = page_of({**results, "figures": [*rows, other]})
    assert "Commit `0123abcd`" in page.partition("## another cell")[2]
    assert "Commit `0123abcd`" not in page.partition("## another cell")[0]
    assert f"Commit `{rows[-1]['commit']}`" in page.partition(f"## {last}")[2]


def test_a_row_that_was_not_measured_leaves_its_cell_of_the_readme_empty(results):
    lost = next(f for f in headlines(results) if f["who"].startswith("EKF, under load"))
    kept = {**results, "figures": [f for f in results["figures"] if f != lost]}
    row = next(line for line in readme_table(kept).splitlines() if line.startswith("| EKF |"))
    assert row.split("|")[2].strip() == ""


def test_more_rows_than_a_page_has_room_for_are_refused(results):
    row = headlines(results)[0]
    with pytest.raises(ValueError, match=f"at most {MOST_ROWS}"):
        page_of({**results, "figures": [row] * (MOST_ROWS + 1)})


def test_a_missed_bound_is_bold(results):
    missed = {**headlines(results)[0], "value": 2.0, "target": 1.0, "passed": False}
    assert f"**2** {missed['unit']}" in page_of({**results, "figures": [missed]})


@pytest.fixture(scope="module")
def costs():
    return json.loads(table.RESULTS.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("page", "text_of"), [(table.PAGE, table.cost_table), (README, table.readme_line)]
)
def test_what_a_step_costs_is_printed_from_the_results(page, text_of, costs):
    text = page.read_text(encoding="utf-8")
    assert text == between_marks(text, table.MARKS, text_of(costs))
    assert text_of(costs) in text
    assert re.fullmatch(r"[0-9a-f]{8}", costs["commit"]), "measured beside changes of no commit"
    assert set(table.CALLED) <= set(costs["costs"])


COMMIT = re.compile(r"[Cc]ommit\s+`[0-9a-f]{8}`,\s+(\d{4}-\d\d-\d\d|\d+\s+\w+\s+\d{4})")


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_a_commit_that_figures_are_of_has_its_date(page):
    text = page.read_text(encoding="utf-8")
    assert len(re.findall(r"[Cc]ommit\s+`[0-9a-f]", text)) == len(COMMIT.findall(text))


def test_pages_of_measured_figures_say_of_which_commit_they_are():
    """Every section with a table of what was measured; settings and methods have none."""
    for page, sections in MEASURED.items():
        text = (DOCS / page).read_text(encoding="utf-8")
        for heading in sections:
            section = text.partition(f"## {heading}\n")[2].partition("\n## ")[0]
            assert COMMIT.search(section), f"{page}: {heading}"

"""What README and the accuracy page show is what the results file holds."""

from __future__ import annotations

import json
import re

import pytest
from benchmarks.publish import (
    MOST_ROWS,
    PAGE,
    README,
    RESULTS,
    headlines,
    page_of,
    readme_table,
    with_table,
)


@pytest.fixture(scope="module")
def results():
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def test_the_page_is_printed_from_the_results(results):
    assert PAGE.read_text(encoding="utf-8") == page_of(results)


def test_the_table_of_the_readme_is_printed_from_the_results(results):
    text = README.read_text(encoding="utf-8")
    assert text == with_table(text, readme_table(results))
    assert readme_table(results) in text


def test_results_say_of_which_commit_and_day_they_are(results):
    assert re.fullmatch(r"[0-9a-f]{8}", results["commit"]), "measured beside changes of no commit"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", results["date"])


def test_more_rows_than_a_page_has_room_for_are_refused(results):
    row = headlines(results)[0]
    with pytest.raises(ValueError, match=f"at most {MOST_ROWS}"):
        page_of({**results, "figures": [row] * (MOST_ROWS + 1)})


def test_a_missed_bound_is_bold(results):
    missed = {**headlines(results)[0], "value": 2.0, "target": 1.0, "passed": False}
    assert f"**2** {missed['unit']}" in page_of({**results, "figures": [missed]})

"""The reliability diagram: what counts as there, and that its table and docs say the same."""

from __future__ import annotations

import pytest
from benchmarks.measured_data import REPOSITORY
from benchmarks.physics_laboratory.reliability import groups, read_table, said_in

CASE = {
    "seed": 1,
    "kind": "single",
    "cell": "Chen2020",
    "changes": ["current_offset"],
    "probability": {"current_offset": 0.95, "capacity": 0.4, "nothing": 0.05},
}


def test_a_cause_is_there_where_the_change_written_down_beforehand_has_it():
    found = {s.cause: s.true for s in said_in([CASE])}
    assert found == {"current_offset": True, "capacity": False, "nothing": False}
    clean = {**CASE, "changes": [], "probability": {"nothing": 0.8}}
    assert [s.true for s in said_in([clean])] == [True]


def test_shares_are_counted_between_the_edges():
    found = groups(said_in([CASE, CASE]))
    assert [(g.said, g.true) for g in found] == [(2, 0), (2, 0), (2, 2)]
    assert found[-1].mean == pytest.approx(0.95)
    assert 0.0 < found[-1].low < found[-1].high < 1.0


def test_the_page_states_what_the_committed_table_says():
    page = (REPOSITORY / "docs" / "criticism.md").read_text()
    for g in groups(read_table()):
        assert f"| {g.above:.2f} to {g.up_to:.2f} | {g.said} | {g.true} |" in page

"""A benchmark in few numbers, on rows by hand."""

from __future__ import annotations

import math

from cellwise.benchmark.page import (
    benchmark_finding,
    division_table,
    divisions,
    own_part,
)
from page_cases import benchmark_rows, row


def rows():
    found = []
    for name, healthy, faulty in (("a", 1.0, 0.7), ("b", 0.9, 0.9)):
        found += [row(name, "log", "none", s, 0.01, 0) | {"coverage_2sigma": healthy}
                  for s in (0.0, -0.3)]  # fmt: skip
        found.append(row(name, "log", "offset", -0.3, 0.02, 0) | {"coverage_2sigma": faulty})
    return found


def by(found, key):
    """Labels to figures of one division."""
    divided = {one.key: one for one in divisions(found)}
    return {r[0]: r[1:] for r in division_table(divided[key], lambda x: x).rows}


def test_a_figure_by_fault_is_of_the_start_that_faults_are_run_from():
    assert by(rows(), "faults") == {"none": [0.01, 0.01], "offset": [0.02, 0.02]}
    assert by(rows(), "inside") == {"none": [1.0, 0.9], "offset": [0.7, 0.9]}
    assert set(by(rows(), "starts")) == {"right start", "−30 points"}


def test_a_run_that_could_not_be_judged_counts_nowhere():
    bad = rows()[2] | {"problem": "no SOC", "settled_rmse": 1.0}
    assert by([*rows(), bad], "faults") == by(rows(), "faults")
    assert "nothing could be judged" in finding([r | {"problem": "x"} for r in rows()])


def test_what_is_not_known_is_no_number():
    silent = [r | {"estimator": "c", "coverage_2sigma": math.nan} for r in rows()[:3]]
    assert math.isnan(by([*rows(), *silent], "inside")["none"][2])


def test_without_faults_or_starts_there_is_no_table_of_them():
    assert [d.key for d in divisions([r for r in rows() if not r["start_error"]])] == ["logs"]


def finding(found):
    return benchmark_finding("s", own_part(found))


def test_the_first_line_says_who_is_first_on_hard_runs():
    assert finding(benchmark_rows()).startswith("s: ekf is first of 3, ")
    easy = [r | {"easy": True, "fault": "none", "start_error": 0.0} for r in rows()[:1]]
    assert finding(easy) == "s: a is first of 1, 1.00 points of SOC on easy runs"

"""A benchmark in few numbers, on rows by hand."""

from __future__ import annotations

import math
import re

import pytest

from cellwise.report.benchmark.overview import (
    coverage_text,
    overviews,
    suite_coverage,
)
from cellwise.report.benchmark.page import benchmark_finding, starts_table
from cellwise.report.page.numerals import SPACE, percent
from page_cases import benchmark_table, row


def rows():
    found = []
    for name, healthy, faulty in (("a", 1.0, 0.7), ("b", 0.9, 0.9)):
        found += [row(name, "log", "none", s, 0.01, 0) | {"coverage_2sigma": healthy}
                  for s in (0.0, -0.3)]  # fmt: skip
        found.append(row(name, "log", "offset", -0.3, 0.02, 0) | {"coverage_2sigma": faulty})
    return found


def test_coverage_of_a_suite_counts_runs_with_a_fault_and_the_overview_does_not():
    assert suite_coverage(rows()) == pytest.approx({"a": 0.9, "b": 0.9})
    assert {o.estimator: o.coverage for o in overviews(rows())} == pytest.approx(
        {"a": 1.0, "b": 0.9}
    )
    assert f"a {percent(0.9, 1)}" in coverage_text(rows())


def test_an_estimator_that_ran_without_faults_alone_or_tells_no_band_has_none():
    healthy = [r for r in rows() if r["fault"] == "none" or r["estimator"] == "a"]
    silent = [r | {"estimator": "c", "coverage_2sigma": float("nan")} for r in rows()[:3]]
    assert set(suite_coverage(healthy + silent)) == {"a"}
    assert coverage_text([r for r in rows() if r["fault"] == "none"]) == ""


def test_a_run_that_could_not_be_judged_counts_nowhere():
    bad = rows()[2] | {"problem": "no SOC", "coverage_2sigma": 0.0}
    assert suite_coverage([*rows(), bad])["a"] == pytest.approx(0.9)


def test_the_first_line_says_who_is_best_under_a_fault():
    said = benchmark_finding(benchmark_table())
    assert re.search(r"with a fault ekf is best, .* at most", said)


def test_an_estimator_that_does_not_come_back_from_a_start_is_said_so():
    table = [r | {"convergence_s": math.nan if r["estimator"] == "ekf" else 90.0}
             for r in benchmark_table().rows]  # fmt: skip
    text = starts_table(table).replace(SPACE, " ")
    assert text.count("never, ") == 3  # of three starts
    assert text.count("90 s, ") == 6

"""Rows of the benchmark tables: verdicts, ratios, JSON, the clock."""

from __future__ import annotations

import json
import time

import pytest
from benchmarks.figures import (
    Figure,
    clock,
    describe_machine,
    machine_lines,
    missing,
    print_figures,
    report_json,
    with_ratios,
)


@pytest.mark.parametrize(
    ("value", "at_least", "met"),
    [(39.9, False, True), (40.0, False, True), (40.1, False, False), (None, False, False),
     (40.1, True, True), (39.9, True, False), (float("nan"), False, False)],
)  # fmt: skip
def test_a_figure_passes_on_the_right_side_of_its_target(value, at_least, met):
    assert Figure("g", "w", value, "ns", target=40.0, at_least=at_least).passed is met


def test_no_target_no_verdict():
    assert Figure("g", "w", 1.0, "ns").passed is None


def test_ratios_refer_to_the_first_row():
    rows = with_ratios([Figure("g", "ours", 20.0, "ns"), Figure("g", "theirs", 500.0, "ns"),
                        missing("g", "absent", "ns", "not installed")])  # fmt: skip
    assert [r.ratio for r in rows] == [1.0, 25.0, None]
    assert rows[2].note == "not installed"


def test_report_counts_targets_and_survives_json():
    rows = [Figure("g", "a", 1.0, "s", target=2.0), Figure("g", "b", 3.0, "s", target=2.0),
            Figure("g", "c", 3.0, "s")]  # fmt: skip
    report = json.loads(json.dumps(report_json(rows, describe_machine(), time.perf_counter())))
    assert report["targets"] == {"judged": 2, "met": 1}
    assert [f["passed"] for f in report["figures"]] == [True, False, None]
    assert report["machine"]["cores"] >= 1


def test_table_shows_misses_and_reasons(capsys):
    print_figures([Figure("speed", "slow one", 90.0, "ns", target=40.0),
                   missing("speed", "peer", "ns", "not installed")],
                  "Title", machine_lines(describe_machine()))  # fmt: skip
    out = capsys.readouterr().out
    assert "missed" in out
    assert "not installed" in out
    assert "cores" in out


def test_clock_takes_the_best_run():
    calls = []

    def work():
        calls.append(1)
        time.sleep(0.02 if len(calls) == 3 else 0.002)

    timing = clock(work, seconds=0.05)
    assert 0.002 <= timing.best < 0.015
    assert timing.runs == len(calls) - 1
    assert timing.best <= timing.median

"""Tables for papers: paired by log, intervals from logs, the error of an adapter with its line."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.benchmark.adapter import described, load_adapter
from cellwise.benchmark.figures import whole_row
from cellwise.benchmark.paper_tables import differences, latex_text
from cellwise.errors import InputError


def rows_of(own, other, starts=(-0.1, 0.0, 0.1)):
    """Runs of two estimators: one figure for each log, the same for every start."""
    return [
        whole_row(
            {"estimator": name, "log": f"log_{k}", "fault": "none", "start_error": start,
             "settled_rmse": value + 0.001 * start, "settled_max": 2 * value, "ns_per_step": 100.0}
        )
        for name, values in (("a", own), ("b", other))
        for k, value in enumerate(values)
        for start in starts
    ]  # fmt: skip


def test_a_difference_is_paired_by_log():
    """What differs between logs is no uncertainty of what differs between estimators."""
    level = np.linspace(0.01, 0.20, 12)
    (one,) = differences(rows_of(level + 0.002, level))
    assert (one.estimator, one.against, one.logs) == ("a", "b", 12)
    assert one.mean == pytest.approx(0.002)
    assert (one.low, one.high) == pytest.approx((0.002, 0.002))
    assert one.better == 0.0


def test_the_interval_is_that_of_a_mean_of_logs():
    """Of many logs it is the normal one, however many runs each has."""
    rng = np.random.default_rng(3)
    apart = rng.normal(0.01, 0.004, 400)
    level = np.full(400, 0.02)
    for starts in ((0.0,), (-0.1, 0.0, 0.1)):
        (one,) = differences(rows_of(level + apart, level, starts))
        wide = 2 * 1.96 * apart.std() / np.sqrt(400)
        assert one.high - one.low == pytest.approx(wide, rel=0.05)
        assert one.low < apart.mean() < one.high


def test_few_logs_have_no_interval_and_one_estimator_no_difference():
    (one,) = differences(rows_of([0.02, 0.03], [0.01, 0.01]))
    assert np.isnan(one.low)
    assert np.isnan(one.high)
    assert differences(rows_of([0.02], [])) == ()


def test_latex_has_every_estimator_and_what_it_was_made_with():
    rows = rows_of([0.02, 0.03, 0.04], [0.01, 0.01, 0.01])
    for row in rows:
        row["estimator"] = {"a": "my_filter", "b": "ekf"}[row["estimator"]]
    text = latex_text("standard", rows, differences(rows))
    assert r"my\_filter & 9 & 3.00" in text
    assert text.count(r" \\") == 3
    assert "seed 0" in text
    assert "numpy " in text


def test_an_adapter_that_fails_says_in_which_line(tmp_path):
    (tmp_path / "mine.py").write_text("class Mine:\n    pass\n\nwrong = 1 / 0\n")
    with pytest.raises(InputError, match=r"line 4 of mine.py: wrong = 1 / 0"):
        load_adapter("mine.py:Mine", tmp_path)
    (tmp_path / "good.py").write_text(
        "class Good:\n    def __init__(self, model):\n        self.soc = 0.5\n\n"
        "    def step(self, *row):\n        return self.missing\n"
    )
    filter_ = load_adapter("good.py:Good", tmp_path)(None)
    try:
        filter_.step()
    except AttributeError as error:
        assert "line 6 of good.py" in described(error)  # noqa: PT017

"""Tables for papers: paired by log, intervals from logs, the error of an adapter with its line."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.benchmark.adapter import described, load_adapter
from cellwise.benchmark.figures import whole_row
from cellwise.benchmark.leaderboard import provenance
from cellwise.benchmark.standings import COLUMNS, by_estimator, latex, standings
from cellwise.errors import InputError


def rows_of(own, other, starts=(-0.1, 0.1)):
    """Runs of two estimators: one figure for each log, the same for every start."""
    return [
        whole_row(
            {"estimator": name, "log": f"log_{k}", "fault": "none", "start_error": start,
             "settled_rmse": value + 0.001 * start, "settled_max": 2 * value, "ns_per_step": 100.0}
        )
        for name, values in (("my_filter", own), ("ekf", other))
        for k, value in enumerate(values)
        for start in starts
    ]  # fmt: skip


def against(rows):
    """Difference of the first to the second, with the ends of its interval."""
    return next(s.against for s in standings(by_estimator(rows)) if s.estimator == "my_filter")


def test_a_difference_is_paired_by_log():
    """What differs between logs is no uncertainty of what differs between estimators."""
    level = np.linspace(0.01, 0.20, 12)
    assert against(rows_of(level + 0.002, level)) == pytest.approx((0.002, 0.002, 0.002))


def test_the_interval_is_that_of_a_mean_of_logs():
    """Of many logs it is the normal one, however many runs each has."""
    rng = np.random.default_rng(3)
    apart = rng.normal(0.01, 0.004, 400)
    level = np.full(400, 0.02)
    for starts in ((-0.1,), (-0.1, 0.1, 0.2)):
        _, low, high = against(rows_of(level + apart, level, starts))
        assert high - low == pytest.approx(2 * 1.96 * apart.std() / np.sqrt(400), rel=0.05)
        assert low < apart.mean() < high


def test_few_logs_have_no_interval_and_one_estimator_no_difference():
    mean, *ends = against(rows_of([0.02, 0.03], [0.01, 0.01]))
    assert mean == pytest.approx(0.015)
    assert ends == [None, None]
    assert against(rows_of([0.02], [])) is None


@pytest.mark.parametrize(
    ("logs", "said"),
    [(1, "1 (too few logs"), (2, "1 (too few logs"), (3, "1 [1, 1]")],
)
def test_a_rank_by_one_log_or_two_claims_no_interval(logs, said):
    found = standings(by_estimator(rows_of([0.02] * logs, [0.01] * logs)))
    assert COLUMNS["rank [95 %]"](found[0]).startswith(said)


def test_latex_has_every_estimator_and_what_it_was_made_with():
    found = standings(by_estimator(rows_of([0.02, 0.03, 0.04], [0.01, 0.01, 0.01])))
    text = latex(found, provenance())
    assert r"my\_filter & 6 & 3.00 & 8.00" in text
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

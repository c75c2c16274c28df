"""Both papers' tables on the embedded data: what must hold whatever the cell."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cellwise.cli.studies import paper_rows
from cellwise.errors import InputError
from cellwise.studies.papers import CHOICES, paper_tables

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def tables(datasets, told):
    return paper_tables(datasets, told.append, method="varpro")


@pytest.fixture(scope="module")
def as_dict(tables):
    return json.loads(json.dumps(tables, allow_nan=False))


def test_capacity_parts_add_up(as_dict):
    rows = as_dict["lfp"]["capacity"]
    assert [r["rate"] for r in rows] == ["C/2", "1C", "2C", "3C"]
    for row in rows:
        assert row["cc_Ah"] + row["cv_Ah"] == pytest.approx(row["total_Ah"], abs=1e-9)
        assert row["published"]["total_Ah"] > 40.0


def test_cc_part_shrinks_with_rate_and_total_does_not(as_dict):
    rows = as_dict["lfp"]["capacity"]
    cc = [r["cc_Ah"] for r in rows]
    assert cc == sorted(cc, reverse=True)
    totals = [r["total_Ah"] for r in rows]
    assert max(totals) - min(totals) < 0.005 * max(totals)


def test_choices_follow_from_the_tables(as_dict):
    q = {e["choice"]: e["capacity_Ah"] for e in as_dict["lfp"]["errors"]}
    rows = as_dict["lfp"]["capacity"]
    assert set(q) == set(CHOICES)
    assert q["cc-average"] == pytest.approx(np.mean([r["cc_Ah"] for r in rows]))
    assert q["cc-cv-average"] == pytest.approx(np.mean([r["total_Ah"] for r in rows]))
    assert q["nominal"] == 2.3
    # Charge that the charge pulses put back is taken out again: net, the tests hold it all.
    assert q["hppc-total"] == pytest.approx(as_dict["lfp"]["hppc_total_Ah"], rel=0.01)


def test_capacity_is_near_the_truth_of_the_physics_model(as_dict):
    q = {e["choice"]: e["capacity_Ah"] for e in as_dict["lfp"]["errors"]}
    assert q["cc-cv-average"] == pytest.approx(2.30345, rel=0.002)  # true_capacity_Ah


def test_eighteen_tests_of_eight_pulses(as_dict):
    tests = as_dict["lfp"]["pulses"]
    assert len(tests) == 18
    for t in tests:
        assert t["healthy"] + t["trimmed"] + t["distorted"] + t["spurious"] == 8
        assert t["published_charge_Ah"] > 0.0
    soc = [t["soc_start"] for t in tests]
    assert soc == sorted(soc, reverse=True)


def test_trimmed_pulses_are_at_the_ends(as_dict):
    for t in as_dict["lfp"]["pulses"]:
        if 0.15 < t["soc_start"] < 0.95:
            assert t["trimmed"] == 0
    middle = [t for t in as_dict["lfp"]["pulses"] if 0.2 < t["soc_start"] < 0.9]
    assert sum(t["healthy"] for t in middle) >= 0.9 * 8 * len(middle)


OURS_BY_CC = pytest.param(
    "cc-average",
    "ours",
    marks=pytest.mark.xfail(strict=True, reason="0.31 V where the log goes on below its empty"),
)
OTHERS = [(c, m) for c in CHOICES for m in ("paper_method", "ours")]
OTHERS.remove(("cc-average", "ours"))


@pytest.mark.parametrize(("choice", "method"), [*OTHERS, OURS_BY_CC])
def test_errors_are_finite_and_ordered(as_dict, choice, method):
    e = next(row for row in as_dict["lfp"]["errors"] if row["choice"] == choice)[method]
    assert 0.0 < e["rms_V"] < 0.2
    assert 0.0 < e["mean_abs"] <= e["peak"] < 0.3
    assert e["mean_abs_window"] <= e["peak_window"] <= e["peak"]


RATES = ["C/20", "C/5", "C/3"]


@pytest.mark.parametrize("name", ["segments", "segments-relaxation"])
@pytest.mark.parametrize("figure", ["mae_V", "rmse_V"])
@pytest.mark.parametrize("rate", RATES)
def test_ours_has_the_smaller_error_on_the_same_hppc(tables, rate, figure, name):
    errors = next(row["methods"] for row in tables["ncr18650b"]["rates"] if row["rate"] == rate)
    assert errors["ours"][figure] <= errors[name][figure]


def test_published_rows_stand_below_ours(as_dict):
    head, rows = paper_rows(as_dict["lfp"]["capacity"])
    assert head == ["", "rate", "total_Ah", "cc_Ah", "cv_Ah"]
    assert rows[1] == ["published", "", "47.71", "46.3", "1.407"]
    head, rows = paper_rows(as_dict["ncr18650b"]["rates"])
    assert [row[0] for row in rows[:5]] == [
        *("", "segments", "segments-relaxation", "ours", "published")
    ]
    assert rows[4][head.index("max_mV")] == "196.9"


def test_equation_8_follows_the_rests_less_closely_than_the_spline(as_dict):
    ocv = as_dict["lfp"]["ocv"][0]
    assert ocv["spline_rmse_V"] < ocv["rmse_V"] < 0.03
    assert 3.0 < ocv["a"] + ocv["b"] * np.log(0.5 + ocv["c"]) + 0.5 * ocv["d"] < 3.4, "LFP"


def test_a_missing_log_of_a_paper_is_named(tmp_path):
    with pytest.raises(InputError, match=r"lfp/hppc\.parquet"):
        paper_tables(tmp_path)

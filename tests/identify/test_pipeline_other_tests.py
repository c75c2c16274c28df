"""Tests other than HPPC, on a cell of four branches that no model holds: judged on drives.

What pulses at every 10 % give is the measure: a model of another test may miss the same drives by
half as much again, never by more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.simulate import simulate
from cellwise.identify import CellTests, Identification, IdentifySettings, identify_cell
from cellwise.notices import Code, coded, texts
from rich_cell import Logger, drive, gitt, hppc, low_rate, rich_nmc, run

CELL = rich_nmc(3.0)
SETTINGS = IdentifySettings(nominal_Ah=3.0)
WORSE, CLIMBING = 1.5, 2.5


@pytest.fixture(scope="module")
def drives():
    return [run(CELL, drive(CELL, seed=s), 1.0, Logger(1.0), seed=s, name="d").log for s in (7, 11)]


def identified(steps, soc0=1.0, logger=None, *, seed=3, settings=SETTINGS, **more):
    log = run(CELL, steps, soc0, logger or Logger(1.0), seed=seed, name="test").log
    return identify_cell(CellTests(hppc=((log, None),), **more), settings)


def missed_V(found: Identification, drives) -> float:
    errors = [simulate(found.model, log, 1.0).rmse_above_10pct_V for log in drives]
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.fixture(scope="module")
def of_pulses(drives):
    """Of the two ways to log pulses, every 0.1 s and every second, the one that says less."""
    return max(missed_V(identified(hppc(CELL), logger=Logger(s)), drives) for s in (0.1, 1.0))


def climbing_pulses(both=False):
    """From empty: 10 s in (and out) at 1C, 10 % at C/2, an hour; ends at the limit, no CV."""
    one = [(-3.0, 10.0), (0.0, 600.0), *([(3.0, 10.0), (0.0, 600.0)] if both else [])]
    return [(0.0, 1800.0), *([*one, (-1.5, 720.0), (0.0, 3600.0)] * 10)]


def pulses_of(seconds):
    """One discharge pulse at 1C at each of nine levels, hours of rest."""
    move = [(1.5, round(720.0 - 2.0 * seconds)), (0.0, 3600.0)]
    return [(0.0, 1800.0), *([(3.0, seconds), (0.0, 600.0), *move] * 9)]


def short_rests():
    one = [(1.5, 10.0), (0.0, 40.0), (-1.1, 10.0), (0.0, 60.0), (3.0, 10.0), (0.0, 60.0)]
    return [(0.0, 60.0), *([*one, (1.5, 700.0), (0.0, 60.0)] * 10)]


CASES = {
    "C/2, 10 %, 1 h": (gitt(CELL, rest_s=3600.0), 1.0, Logger(1.0)),
    "C/2, 10 %, rows of 10 s": (gitt(CELL, rest_s=3600.0), 1.0, Logger(10.0)),
    "1C, 10 %": (gitt(CELL, rate=1.0, rest_s=3600.0), 1.0, Logger(1.0)),
    "C/10, 10 %": (gitt(CELL, rate=0.1, rest_s=3600.0), 1.0, Logger(1.0)),
    "C/2 by change of value": (gitt(CELL, rest_s=3600.0), 1.0, Logger(0.1, change_V=2e-3)),
    "C/2 up from empty": (gitt(CELL, rest_s=3600.0, charge=True), 0.0, Logger(1.0)),
    "charge pulses up from empty": (climbing_pulses(), 0.0, Logger(1.0)),
    "pulses by change of value": (hppc(CELL), 1.0, Logger(0.1, change_V=2e-3)),
    "1 s at 10 Hz": (pulses_of(1.0), 1.0, Logger(0.1)),
    "30 s at 0.1 Hz": (pulses_of(30.0), 1.0, Logger(10.0)),
}


def short(reason):
    return pytest.mark.xfail(strict=True, reason=reason)


QUICK = ("C/2 by change of value", "pulses by change of value")


MISSED = {
    "C/10, 10 %": "12 mV, 2.4 times that of pulses (asked 1.5)",
    "C/2 up from empty": "17 mV, 3.2 times (asked 2.5): capacity 2.7 % large",
    "charge pulses up from empty": "20 mV, 3.8 times (asked 2.5): capacity 3.3 % large",
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(c, marks=[*([] if c in QUICK else [pytest.mark.slow]),
                               *([short(MISSED[c])] if c in MISSED else [])])
        for c in CASES
    ],
)  # fmt: skip
def test_drives_are_missed_by_hardly_more_than_with_pulses(case, drives, of_pulses):
    # A cell that climbs from empty has its capacity found, and was never seen full.
    most = WORSE if "up from empty" not in case else CLIMBING
    assert missed_V(identified(*CASES[case]), drives) < most * of_pulses


@pytest.mark.parametrize(
    ("rate", "period_s"),
    [(0.5, 1.0), (0.2, 1.0), pytest.param(0.1, 1.0, marks=pytest.mark.slow), (0.5, 10.0)],
)
def test_r0_of_a_long_step_is_the_resistance_after_a_row(rate, period_s):
    """Between R0 and what the cell resists one row after the switch; once 40 % too high."""
    found = identified(gitt(CELL, rate=rate, rest_s=3600.0), logger=Logger(period_s))
    soc = np.linspace(0.25, 0.9, 27)
    after = CELL.r0_ohm(soc)
    for r, tau in CELL.branches:
        after = after - r(soc) * np.expm1(-period_s / tau(soc))
    model = np.interp(soc, np.linspace(0.0, 1.0, found.model.r0_ohm.shape[-1]),
                      found.model.r0_ohm[0])  # fmt: skip
    assert float(np.median(model / CELL.r0_ohm(soc))) > 0.97
    assert float(np.median(model / after)) < 1.06


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_pulses_with_short_rests_only_beside_a_low_rate_test(period_s, drives, of_pulses):
    slow = run(CELL, low_rate(CELL), 1.0, Logger(10.0), seed=1, name="c20").log
    found = identified(short_rests(), logger=Logger(period_s), ocv=(slow,))
    assert missed_V(found, drives) < WORSE * of_pulses


@short("9.8 mV, 1.9 times that of pulses (asked 1.5): capacity 8 % large, as stated")
def test_a_stated_start_is_where_an_incremental_test_begins(drives, of_pulses):
    log = run(CELL, gitt(CELL)[:-4], 0.95, Logger(1.0), seed=3, name="part").log
    found = identify_cell(CellTests(hppc=((replace(log, soc0=0.95), None),)), SETTINGS)
    off = np.log(found.model.capacity_Ah / 3.0)
    assert abs(off) < 2.5 * found.model.posterior.capacity_std, "a part of the range is no capacity"
    assert any("is no capacity" in n for n in texts(found.notices))
    assert missed_V(found, drives) < WORSE * of_pulses


@pytest.mark.slow
def test_a_c100_discharge_serves_as_ocv(drives, of_pulses):
    slow = run(CELL, low_rate(CELL, 0.01, charge=False), 1.0, Logger(60.0), name="c100").log
    found = identified(hppc(CELL), ocv=(slow,))
    assert found.capacity_choice == "rate:C/100"
    assert missed_V(found, drives) < WORSE * of_pulses


@pytest.mark.slow
def test_ocv_of_another_sample_is_said_with_the_numbers():
    slow = run(CELL, low_rate(CELL), 1.0, Logger(10.0), seed=1, name="sample_a").log
    other = rich_nmc(2.8)
    log = run(other, hppc(other), 1.0, Logger(1.0), seed=2, name="sample_b").log
    found = identify_cell(CellTests(hppc=((log, None),), ocv=(slow,)), SETTINGS)
    (said,) = coded(found.notices, Code.TWO_CELLS)
    assert "sample_a" in said.text
    assert "sample_b" in said.text
    same = identified(hppc(CELL), ocv=(slow,))
    assert not coded(same.notices, Code.TWO_CELLS)
    assert found.contradictions == found.notices[:1] == (said,)


def test_a_script_that_finishes_a_charge_with_small_steps_spoils_nothing(drives, of_pulses):
    low = run(CELL, low_rate(CELL), 1.0, Logger(10.0), seed=1, name="ocv").log
    steps = [(0.0, 600.0), *([(-0.1, 600.0), (0.1, 500.0)] * 5), (0.0, 600.0)]
    finish = run(CELL, steps, 0.99, Logger(1.0), seed=2, name="finish").log
    found = identified(hppc(CELL), ocv=(low, finish))
    assert all("'ocv' left out" not in n for n in texts(found.notices))
    assert missed_V(found, drives) < WORSE * of_pulses

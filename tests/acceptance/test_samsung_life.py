"""A measured life, Samsung 30Q from 2.89 to 2.24 Ah, judged by its own complete discharges.

What the trend is given of them changes from test to test: all, a part of each, one in ten.
"""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.stock import stock_model
from cellwise.history.ageing import ageing_history
from cellwise.logs import read_log

pytestmark = pytest.mark.slow

LONG_PAUSE_S = 600.0  # between the charge and the discharge of a file
MOST_RMSE = 0.015


@pytest.fixture(scope="module")
def discharges(real_data):
    """Every tenth complete discharge of cell A, without the charge before it."""
    found = []
    for path in sorted((real_data / "samsung_30q_ageing").glob("d1_cellA_cycle*.csv.gz")):
        log = read_log(path)
        pauses = np.flatnonzero(log.interval_s > LONG_PAUSE_S)
        found.append(log.part(int(pauses[-1]) if pauses.size else 0, len(log)))
    return found


def charge_Ah(log):
    return np.cumsum(log.known_current_A() * log.interval_s) / 3600.0


@pytest.fixture(scope="module")
def truth(discharges):
    """Counted charge of each over that of the first."""
    counted = np.array([charge_Ah(log)[-1] for log in discharges])
    return counted / counted[0]


def window(log):
    """From 80 to 20 % of its own charge."""
    left = 1.0 - charge_Ah(log) / charge_Ah(log)[-1]
    rows = np.flatnonzero((left <= 0.8) & (left >= 0.2))
    return log.part(int(rows[0]), int(rows[-1]) + 1)


def judged(given, truth):
    """RMSE of the trend and the share of logs within two standard deviations."""
    trend = ageing_history(stock_model("nca-18650"), given).trend
    off = trend.share - truth
    return float(np.sqrt(np.mean(off**2))), float(np.mean(np.abs(off) < 2.0 * trend.std))


def test_complete_discharges_give_the_capacity_within_its_band(discharges, truth):
    rmse, inside = judged(discharges, truth)
    assert rmse < MOST_RMSE
    assert 0.90 <= inside <= 0.99


def test_windows_with_a_complete_discharge_every_hundred_cycles(discharges, truth):
    given = [log if k % 10 == 0 else window(log) for k, log in enumerate(discharges)]
    rmse, inside = judged(given, truth)
    assert rmse < MOST_RMSE
    assert 0.90 <= inside <= 0.99


WINDOWS_ALONE = {"one complete discharge first": 1, "windows alone": 0}


@pytest.fixture(scope="module", params=WINDOWS_ALONE)
def of_windows(request, discharges, truth):
    first = WINDOWS_ALONE[request.param]
    return judged([*discharges[:first], *map(window, discharges[first:])], truth)


def test_windows_do_not_claim_what_they_do_not_see(of_windows):
    assert of_windows[1] >= 0.90


@pytest.mark.xfail(
    strict=True,
    reason="9.5 and 5.8 %: the lithium that this cell loses moves the ends of the range, which the "
    "windows do not see; two published half cells leave 6 to 14 mV of the aged curves",
)
def test_windows_alone_are_as_good(of_windows):
    assert of_windows[0] < MOST_RMSE

"""An aged Panasonic 18650PF by the model of the fresh cell and the logs of its life.

What its capacity has become is told by its last 1C tests, which give less than all there is, and by
the rests after them through the fresh OCV, which ageing has moved.
"""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.cell.stock import stock_model
from cellwise.history.ageing import ageing_history
from cellwise.logs import read_log

pytestmark = pytest.mark.slow

FIRST = ("cap_1c_p25_start_1", "cap_1c_p25_start_2")
LAST = ("cap_1c_p25_end_1", "cap_1c_p25_end_2")
# One drive of each chamber temperature, in the campaign's order; the last is of the aged cell.
DRIVES = tuple(f"drive_{k}_us06" for k in ("p25", "p10", "p00", "n10", "n20", "n20rise"))
TO_THE_END = (*FIRST, *DRIVES, *LAST)
WITHOUT_LAST_TESTS = (*FIRST, *DRIVES)


@pytest.fixture(scope="module")
def logs(real_data):
    folder = real_data / "panasonic_18650pf"
    return {n: read_log(folder / f"{n}.csv.gz") for n in (*FIRST, *LAST, *DRIVES)}


@pytest.fixture(scope="module")
def fresh():
    """The stock model of this cell type, 2.997 Ah: what its C/20 test gave when it was fresh."""
    return stock_model("nca-18650")


def counted_Ah(log):
    return float(np.sum(log.known_current_A() * log.interval_s)) / 3600.0


def told_Ah(fresh, logs):
    """What the last 1C tests give, and the rest after each: its charge from full to that OCV."""
    found = []
    for name in LAST:
        log = logs[name]
        warm = fresh.at_temperature(float(log.temperature_C[-1]))
        soc = float(np.interp(log.voltage_V[-1], warm.ocv_V[0], fresh.soc))
        found += [counted_Ah(log), counted_Ah(log) / (1.0 - soc)]
    return min(found), max(found)


def judged(fresh, logs, given):
    """Whether the capacity to use lies between both referees, and whether its band covers them."""
    low, high = told_Ah(fresh, logs)
    use = ageing_history(fresh, [logs[n] for n in given]).to_dict()["trend"]["use"]
    capacity, std = use["capacity_Ah"], use["capacity_std_Ah"]
    return low < capacity < high, capacity - 2.0 * std < low and high < capacity + 2.0 * std


def test_capacity_lies_between_what_tests_and_rests_tell(fresh, logs):
    assert judged(fresh, logs, TO_THE_END) == (True, True)


@pytest.mark.xfail(
    strict=True,
    reason="2.96 +- 0.26 Ah, of which 2.35 to 2.72 is not covered: drives of the aged cell are "
    "fitted 0.1 to 0.4 Ah too high, since what its warming and the cold cost is not told from the "
    "fade",
)
def test_capacity_lies_there_without_the_last_tests(fresh, logs):
    assert judged(fresh, logs, WITHOUT_LAST_TESTS) == (True, True)

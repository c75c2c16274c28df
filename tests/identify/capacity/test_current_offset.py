"""A low-rate test whose current sensor is off: the offset comes back, sound tests have none."""

from dataclasses import replace

import numpy as np
import pytest

from cellwise.data import load_dataset
from cellwise.identify.capacity.current_offset import find_current_offset, without_current_offset
from cellwise.logs import read_log
from rich_cell import Logger, low_rate, rich_nmc, run

CELL = rich_nmc(3.0)
AMPERE = 3e-4  # 0.2 % of the current of C/20


def c20(offset_A=0.0, steps=None, soc0=1.0):
    logger = Logger(period_s=10.0, offset_A=offset_A)
    return run(CELL, steps or low_rate(CELL), soc0, logger, seed=1, name="c20").log


def with_relay(log, offset_A):
    """The same tester with its relay open at rest: it writes zero there."""
    idle = np.abs(log.current_A) < 0.05
    back = offset_A * np.cumsum(idle * log.interval_s) / 3600.0
    current = np.where(idle, 0.0, log.current_A)
    return replace(log, current_A=current, charge_Ah=log.charge_Ah - back)


@pytest.mark.parametrize("offset_A", [0.016, 0.006, -0.010])
@pytest.mark.parametrize("relay", [False, True])
def test_the_offset_comes_back(offset_A, relay):
    log = c20(offset_A)
    found = find_current_offset([with_relay(log, offset_A) if relay else log])
    assert found.offset_A == pytest.approx(offset_A, abs=AMPERE)
    assert found.at_rest is not relay
    sound = c20()
    first = np.flatnonzero(np.diff(np.sign(np.diff(sound.charge_Ah))) < 0)
    true_Ah = float(np.max(sound.charge_Ah))
    assert first.size
    assert found.capacity_Ah == pytest.approx(true_Ah, rel=0.003)


def test_without_a_rest_after_the_charge():
    log = c20(0.016)
    cut = log.rows(np.arange(len(log)) <= np.flatnonzero(log.current_A < -0.05)[-1])
    assert find_current_offset([cut]).offset_A == pytest.approx(0.016, abs=AMPERE)


def test_a_test_that_begins_empty_and_is_charged_first():
    steps = [(0.0, 3600.0), (-0.15, 90000.0), (0.0, 3600.0), (0.15, 90000.0), (0.0, 3600.0)]
    log = c20(0.012, steps, soc0=0.0)
    assert find_current_offset([log]).offset_A == pytest.approx(0.012, abs=2 * AMPERE)


def test_parts_of_one_test_are_taken_together():
    log = c20(0.016)
    middle = int(np.argmax(log.charge_Ah))
    rows = np.arange(len(log))
    parts = [log.rows(rows <= middle), log.rows(rows >= middle)]
    assert find_current_offset(parts).offset_A == pytest.approx(0.016, abs=AMPERE)


def test_it_is_taken_out_of_current_and_counter_and_said():
    logs, notices = without_current_offset([c20(0.016)])
    sound = c20()
    np.testing.assert_allclose(np.max(logs[0].charge_Ah), np.max(sound.charge_Ah), rtol=0.003)
    loaded = sound.current_A > 0.1
    assert float(np.median(logs[0].current_A[logs[0].current_A > 0.1])) == pytest.approx(
        float(np.median(sound.current_A[loaded])), abs=1e-3
    )
    (notice,) = notices
    assert "mA" in notice
    assert "3.362 Ah out" in notice  # 3.0235 Ah at 0.166 for 0.150 A, and the rest's 0.016 Ah


def test_with_a_relay_another_test_has_to_say_so():
    log = with_relay(c20(0.016), 0.016)
    logs, notices = without_current_offset([log])
    assert logs == (log,)
    assert "capacity test at C/2" in notices[0]
    half = run(CELL, [(0.0, 1800.0), (1.5, 9000.0), (0.0, 3600.0)], 1.0, Logger(10.0), name="c2")
    logs, notices = without_current_offset([log], [half.log])
    assert logs[0] is not log
    assert "Taken out" in notices[0]


def test_a_sound_test_has_none():
    assert find_current_offset([c20()]) is None
    assert find_current_offset([]) is None
    assert without_current_offset([c20()])[1] == ()
    # Charge cut short at 80 %: an incomplete branch, which is what it is.
    steps = [(0.0, 1800.0), (0.15, 90000.0), (0.0, 3600.0), (-0.15, 57600.0), (0.0, 3600.0)]
    assert find_current_offset([c20(steps=steps)]) is None


@pytest.mark.parametrize("name", ["nmc_ocv_c20", "lfp_ocv_c20", "nmc_cap_c20"])
def test_the_embedded_tests_have_none(name):
    assert find_current_offset([load_dataset(name)]) is None


def test_measured_low_rate_tests_have_none(real_data):
    for path in sorted(real_data.glob("lg_18650hg2/ocv_c20_*.csv.gz")):
        assert find_current_offset([read_log(path)]) is None, path.name
    for path in sorted(real_data.glob("plett_a123/ocv_*_s1.csv.gz")):
        parts = [read_log(str(path).replace("_s1", f"_s{k}")) for k in range(1, 5)]
        assert find_current_offset(parts) is None, path.name

"""A low-rate test whose current sensor is off: the offset comes back, sound tests have none."""

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


@pytest.mark.parametrize("offset_A", [0.016, 0.006, -0.010])
def test_the_offset_comes_back(offset_A):
    log = c20(offset_A)
    found = find_current_offset([log])
    assert found.offset_A == pytest.approx(offset_A, abs=AMPERE)
    sound = c20()
    first = np.flatnonzero(np.diff(np.sign(np.diff(sound.charge_Ah))) < 0)
    true_Ah = float(np.max(sound.charge_Ah))
    assert first.size
    assert found.capacity_Ah == pytest.approx(true_Ah, rel=0.003)


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
    assert "3.362 Ah went out" in notice  # 3.0235 Ah at 0.166 for 0.150 A, and the rest's 0.016 Ah


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

"""What a pulse test says of the capacity, and when it says nothing."""

import numpy as np
import pytest

from cellwise.identify.checked_logs import check_logs
from cellwise.identify.identification import CellTests, IdentifySettings
from cellwise.identify.measured_capacity import (
    hppc_reaches_empty,
    hppc_total_Ah,
    measure_capacity,
)
from cellwise.logs import read_log
from rich_cell import Logger, gitt, hppc, rich_nmc, run

CELL = rich_nmc(3.0)


def steps_of(steps, soc0=1.0):
    return run(CELL, steps, soc0, Logger(1.0), seed=2, name="steps").log


def cut(log, share):
    q = log.counted_charge_Ah()
    return log.rows(np.arange(len(log)) <= int(np.argmax(q >= share * q.max())))


def measured(log, nominal_Ah):
    settings = IdentifySettings(nominal_Ah=nominal_Ah)
    return measure_capacity(check_logs(CellTests(hppc=log), settings), settings)


@pytest.mark.parametrize("steps", [gitt(CELL), gitt(CELL, step=0.05), hppc(CELL)])
def test_a_whole_test_ends_empty_and_a_part_does_not(steps):
    log = steps_of(steps)
    assert hppc_reaches_empty(log)
    assert measured(log, 3.0).choices_Ah["hppc-total"] == pytest.approx(3.0, rel=0.01)
    part = measured(cut(log, 0.85), 3.0)
    assert list(part.choices_Ah) == ["nominal"]
    assert "is no capacity" in part.notices[0].text


def test_without_a_nominal_capacity_a_part_counts_and_is_said():
    part = cut(steps_of(gitt(CELL)), 0.8)
    found = measured(part, None)
    assert found.capacity_Ah == pytest.approx(hppc_total_Ah(part))
    assert len(found.notices) == 1


def test_a_climb_moves_what_it_brings_in():
    log = steps_of(gitt(CELL, charge=True), soc0=0.0)
    assert hppc_total_Ah(log) == pytest.approx(float(np.ptp(log.charge_Ah)), rel=1e-9)


def test_measured_tests_end_empty_and_their_parts_do_not(real_data):
    names = [f"panasonic_18650pf/hppc_{t}" for t in ("p25", "p10", "p00", "n10", "n20")]
    names += [f"nissan_leaf/hppc_{t}" for t in ("p10", "p25", "p40")]
    for name in names:
        log = read_log(real_data / f"{name}.csv.gz")
        assert hppc_reaches_empty(log), name
        if "panasonic" in name:
            assert not hppc_reaches_empty(cut(log, 0.8)), name

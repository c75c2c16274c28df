"""A judged log on an even time step: what was a gap stays one. Where a test begins."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.benchmark.suite import read_suite
from cellwise.benchmark.suite_logs import JudgedLog, at_step, cell_tests, training_logs
from cellwise.cell.stock import stock_model
from cellwise.logs.cell_log import CellLog


def test_a_week_without_rows_is_no_week_of_steps():
    rows, week = 2000, 604800.0
    time = 0.1 * np.arange(rows)
    time[rows // 2 :] += week
    current = np.full(rows, 2.0)
    charge = 2.0 * 0.1 * np.arange(rows) / 3600.0  # nothing flowed in the gap
    log = CellLog(time, current, np.full(rows, 3.7), charge_Ah=charge)
    judged = JudgedLog(log, 0.9 - charge / 3.0, 3.0)
    even = at_step(judged, 1.0)
    assert len(even.log) < 250
    (gap,) = even.log.gaps
    assert gap.duration_s == pytest.approx(week, abs=2.5)
    np.testing.assert_allclose(
        even.truth, np.interp(even.log.time_s, log.time_s, judged.truth), atol=1e-4
    )
    assert np.count_nonzero(even.log.gap_rows) == 1


@pytest.mark.parametrize(("stated", "began"), [("", 1.0), ("@soc0=0.8", 0.8)])
def test_identification_has_the_start_that_other_rows_have(tmp_path, stated, began):
    """A drive that begins under load: without its start it is no test of a cold cell."""
    log = "embedded:nmc_drive_b"
    (tmp_path / "one.toml").write_text(
        f'[[cell]]\nname = "A"\nnominal_Ah = 5.0\nrested_full_V = 4.18\ndrive = ["{log}{stated}"]\n'
        f'[[log]]\ncell = "A"\nlog = "embedded:nmc_drive_a"\n'
    )
    suite = read_suite(tmp_path / "one.toml")
    (cell,) = suite.cells
    (drive, _) = cell_tests(cell, suite, None).drive[0]
    ((_, _, given),) = training_logs(cell, stock_model("nmc-18650"), suite, None)
    assert drive.soc0 == given == began

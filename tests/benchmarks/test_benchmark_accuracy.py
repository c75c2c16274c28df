"""Judgements of the accuracy benchmark, on logs whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.accuracy import __main__ as accuracy
from benchmarks.accuracy.judging import from_the_middle, judge_soc, voltage_rmse_mV
from benchmarks.accuracy.power import reading_of
from benchmarks.example_cell import START_SOC, load_log, three_branches
from benchmarks.firmware import __main__ as firmware
from benchmarks.measured_data import data_folder
from benchmarks.parts import measure
from benchmarks.speed import __main__ as speed

from cellwise.identify.hppc.pulse_quality import Pulse
from cellwise.logs import CellLog


@pytest.fixture(scope="module")
def counted():
    log = load_log()
    model = three_branches()
    counter = np.cumsum(log.current_A * log.interval_s) / 3600.0
    return CellLog(log.time_s, log.current_A, log.voltage_V, charge_Ah=counter), model


def test_noise_is_all_that_is_left_of_the_right_model(counted):
    log, model = counted
    assert voltage_rmse_mV(model, log, START_SOC) == pytest.approx(1.0, rel=0.05)


def test_right_model_finds_back_from_30_points(counted):
    log, model = counted
    told = judge_soc(model, log, start=START_SOC - 0.3, true_start=START_SOC,
                     reference_Ah=model.capacity_Ah, after_s=300.0)  # fmt: skip
    assert told.convergence_s is not None
    assert told.convergence_s <= 300.0
    assert told.late_rmse < 0.02
    wrong = judge_soc(model, log, start=START_SOC, true_start=START_SOC - 0.2,
                      reference_Ah=model.capacity_Ah, after_s=300.0)  # fmt: skip
    assert wrong.late_rmse > 0.1


def test_middle_begins_where_the_counter_says(counted):
    log, model = counted
    part, soc = from_the_middle(log, START_SOC, model.capacity_Ah, 0.6)
    assert soc == pytest.approx(0.6, abs=2e-3)
    assert len(part) < len(log)
    used = (part.charge_Ah[0] - log.charge_Ah[0]) / model.capacity_Ah
    assert used == pytest.approx(START_SOC - soc, abs=1e-9)


def test_without_measured_cells_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("CELLWISE_DATA", str(tmp_path / "nowhere"))
    assert data_folder() is None
    figures = measure(accuracy.PARTS, ["panasonic", "leaf", "lfp"], print)
    assert len(figures) == 3
    figures += measure(firmware.PARTS, ["agreement"], print)
    assert all(f.value is None and "CELLWISE_DATA" in f.note for f in figures)


@pytest.mark.parametrize("main", [accuracy.main, firmware.main, speed.main])
def test_unknown_part_is_refused(main, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--only", "nothing"])
    assert stop.value.code == 2
    assert "name at least one of" in capsys.readouterr().err


# 22.9 (18), 15.8 (12), 29.3 mV (25), 1.00, 0.74 % (0.6): where the C/20 gave 4 % more charge than
# the loads of other days, no OCV serves both below 15 % SOC (decision 0009).
LABORATORY, DRIVEN = "laboratory tests alone", "laboratory tests + drives cycle 2, 3"
SHORT = (
    f"{DRIVEN}: voltage RMSE above 10 % SOC, drive_p25_hwfta",
    f"{DRIVEN}: voltage RMSE above 10 % SOC, mean",
    f"{DRIVEN}: EKF from 70 % at full: SOC RMSE after 300 s, drive_p25_hwfta",
    "SOC RMSE after 300 s, drive_p25_cycle_4",
    f"{LABORATORY}: voltage RMSE above 10 % SOC, drive_p25_hwfta",
)


@pytest.mark.slow
def test_measured_cells_meet_their_targets(real_data):
    figures = measure(accuracy.PARTS, ["panasonic", "leaf"], print)
    missed = [f"{f.group}: {f.who} = {f.value}" for f in figures if f.passed is False]
    assert [m for m in missed if not any(known in m for known in SHORT)] == []
    assert len(missed) <= len(SHORT)
    assert sum(f.passed is not None for f in figures) >= 31  # so many are judged


def a_pulse(
    size_A: float = 6.0, every_s: float = 1.0, first_s: float = 1.0, scatter_V: float = 0.0
) -> tuple[CellLog, Pulse]:
    """Rest, a row in which nothing flows yet, 12 s of a current; scatter in turn up and down."""
    pulse_s = np.concatenate(([first_s], np.full(int(12 / every_s) - 1, every_s)))
    time_s = np.cumsum(np.concatenate((np.full(5, 10.0), [6.0], pulse_s))) - 10.0
    current_A = np.concatenate((np.zeros(5), [0.03], np.full(pulse_s.size, size_A)))
    voltage_V = 3.7 - 0.04 * current_A + scatter_V * (-1.0) ** np.arange(time_s.size)
    log = CellLog(time_s, current_A, voltage_V)
    stop = time_s.size
    return log, Pulse(5, stop, stop, 0, stop, size_A, 18.0, 0.02, "pulse")


def test_a_pulse_is_read_from_where_its_current_begins():
    log, pulse = a_pulse()
    before, end = reading_of(log, pulse)
    assert before == 5  # not row 4: in row 5 nothing flows yet
    assert log.time_s[end] - log.time_s[before] == 10.0


@pytest.mark.parametrize(
    "unread",
    [{"first_s": 10.0}, {"size_A": 0.1, "scatter_V": 5e-4}, {"every_s": 4.0}],
    ids=["nobody knows when it began", "its fall scatters", "too few rows to see its scatter"],
)
def test_a_pulse_that_no_log_shows_judges_nothing(unread):
    assert reading_of(*a_pulse(**unread)) is None

"""What somebody writes in Python on the first day works, or says what to write."""

from __future__ import annotations

import datetime
import sys

import numpy as np
import pandas as pd
import pytest

import cellwise
from cellwise import CellLog, InputError, TestLogs, load_dataset, simulate
from cellwise.cell.initial_soc import initial_soc
from example_cells import curved_cell


def test_simulate_finds_its_start_as_the_command_does():
    model, log = curved_cell(), load_dataset("nmc_drive_b").part(0, 2000)
    start = initial_soc(model, log, likeliest=True, whole_log=True).soc
    assert simulate(model, log).soc0 == start
    assert simulate(model, log, 0.4).soc0 == 0.4


def test_test_logs_are_taken_as_they_come():
    log = load_dataset("nmc_drive_b").part(0, 50)
    assert TestLogs(hppc=log).hppc == ((log, None),)
    assert TestLogs(hppc=[log, log]).hppc == ((log, None), (log, None))
    assert TestLogs(hppc=(log, -10.0)).hppc == ((log, -10.0),)
    assert TestLogs(drive=[(log, -10), (log, None)]).drive == ((log, -10), (log, None))
    assert TestLogs(ocv=log).ocv == (log,)


@pytest.mark.parametrize("wrong", ["hppc.csv", 3, {"a": 1}, [1], [("hppc.csv", 25.0)]])
def test_test_logs_say_what_to_write(wrong):
    with pytest.raises(InputError, match=r"TestLogs\(hppc=read_log"):
        TestLogs(hppc=wrong)


@pytest.mark.parametrize(
    "stamps",
    [
        pd.date_range("2024-05-01", periods=40, freq="1s"),
        pd.date_range("2024-05-01", periods=40, freq="1s", tz="Europe/Oslo"),
        pd.to_timedelta(np.arange(40.0), unit="s"),
        [datetime.datetime(2024, 5, 1) + datetime.timedelta(seconds=k) for k in range(40)],
        np.datetime64("2024-05-01T00:00:00.000") + np.arange(40) * np.timedelta64(1000, "ms"),
    ],
)
def test_dates_and_durations_are_understood(stamps):
    frame = pd.DataFrame({"time_s": stamps, "current_A": 1.0, "voltage_V": np.linspace(4, 3.9, 40)})
    log = CellLog.from_table(frame)
    np.testing.assert_allclose(log.time_s - log.time_s[0], np.arange(40.0))


def test_what_a_session_needs_is_on_the_first_page():
    for name in ("resample", "Adaptive", "forecast", "tune_noise"):
        assert name in cellwise.__all__
        assert callable(getattr(cellwise, name))


def test_a_notebook_shows_a_plot_once(monkeypatch):
    """Pyplot shows what it holds when a cell ends; the cell's value is shown besides."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.close("all")
    log = load_dataset("nmc_drive_b").part(0, 100)
    monkeypatch.setitem(sys.modules, "ipykernel", object())
    figure = log.plot()
    assert hasattr(figure, "savefig")
    assert pyplot.get_fignums() == []


def test_a_notebook_shows_a_log_as_a_table():
    html = load_dataset("nmc_drive_b").part(0, 100)._repr_html_()
    assert "<th>voltage_V</th>" in html
    assert html.count("<tr>") == 6


def test_no_message_to_python_names_only_an_option_of_the_command():
    log = load_dataset("nmc_drive_b").part(0, 50)
    with pytest.raises(InputError) as caught:
        simulate(curved_cell(), log, 80.0)
    assert "--soc0" not in str(caught.value)
    assert "Divide by 100" in str(caught.value)

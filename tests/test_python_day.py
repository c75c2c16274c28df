"""What somebody writes in Python on the first day works, or says what to write."""

from __future__ import annotations

import datetime
import sys

import numpy as np
import pandas as pd
import pytest

import cellwise
from cellwise import CellLog, CellTests, InputError, load_dataset, simulate
from cellwise.fit.start import initial_soc
from diagnosis_cases import diagnosis
from example_cells import curved_cell


def test_simulate_finds_its_start_as_the_command_does():
    model, log = curved_cell(), load_dataset("nmc_drive_b").part(0, 2000)
    start = initial_soc(model, log, whole_log=True).soc
    assert simulate(model, log).soc0 == start
    assert simulate(model, log, 0.4).soc0 == 0.4


def test_test_logs_are_taken_as_they_come():
    log = load_dataset("nmc_drive_b").part(0, 50)
    assert CellTests(hppc=log).hppc == ((log, None),)
    assert CellTests(hppc=[log, log]).hppc == ((log, None), (log, None))
    assert CellTests(hppc=(log, -10.0)).hppc == ((log, -10.0),)
    assert CellTests(drive=[(log, -10), (log, None)]).drive == ((log, -10), (log, None))
    assert CellTests(ocv=log).ocv == (log,)


@pytest.mark.parametrize("wrong", ["hppc.csv", 3, {"a": 1}, [1], [("hppc.csv", 25.0)]])
def test_test_logs_say_what_to_write(wrong):
    with pytest.raises(InputError, match=r"CellTests\(hppc=read_log"):
        CellTests(hppc=wrong)


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
    # The cell's value: a notebook knows how to show matplotlib's figures once pyplot has drawn one.
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_a_notebook_shows_a_log_as_a_table():
    html = load_dataset("nmc_drive_b").part(0, 100)._repr_html_()
    assert "<th>voltage_V</th>" in html
    assert html.count("<tr>") == 6


def test_a_notebook_shows_the_facts_of_models_and_diagnoses():
    html = curved_cell()._repr_html_()
    assert "capacity" in html
    assert "mohm" in html
    found = diagnosis("current_offset")
    assert found.causes[0].name in found._repr_html_()
    assert "next test" in found._repr_html_()
    x_label, panels = found.panels()
    assert x_label == "time [h]"
    assert [line.label for line in panels[0].lines] == ["before", "after"]


def test_no_message_to_python_names_only_an_option_of_the_command():
    log = load_dataset("nmc_drive_b").part(0, 50)
    with pytest.raises(InputError) as caught:
        simulate(curved_cell(), log, 80.0)
    assert "--soc0" not in str(caught.value)
    assert "Divide by 100" in str(caught.value)


def test_signatures_of_the_face_say_what_they_take():
    """No parameter is Any: where a kind of object will do, its protocol is named."""
    import inspect

    for name in cellwise.__all__:
        value = getattr(cellwise, name)
        methods = inspect.getmembers(value, callable) if inspect.isclass(value) else [("", value)]
        for method, function in methods:
            if method.startswith("_") and method != "__init__":
                continue
            try:
                parameters = inspect.signature(function).parameters.values()
            except (TypeError, ValueError):
                continue
            wide = [p for p in parameters if str(p.annotation) in ("Any", "object", "Any | None")]
            assert not wide or method == "checked_before", (name, method, wide)
    for method in ("plot", "to_pandas", "to_polars"):
        assert inspect.signature(getattr(CellLog, method)).return_annotation != "Any"
    assert "model" in inspect.signature(cellwise.diagnose).parameters


class Notebook:
    """IPython's display, as far as a bar needs it."""

    def __init__(self):
        self.shown = []

    def HTML(self, text):
        return text

    def display(self, text, *, display_id):
        assert display_id
        self.shown.append([text])
        return self

    def update(self, text):
        self.shown[-1].append(text)


@pytest.fixture
def notebook(monkeypatch):
    fake = Notebook()
    monkeypatch.setitem(sys.modules, "ipykernel", object())
    monkeypatch.setitem(sys.modules, "IPython.display", fake)
    return fake


def test_a_notebook_has_one_bar_that_goes_away(notebook):
    with cellwise.progress_bar() as bar:
        bar(0.25, "capacity <Q>")
        bar("log", 3, 4)
        bar("OCV")
    assert len(notebook.shown) == 1
    first, second, third, last = notebook.shown[0]
    assert first == "<progress max='1' value='0.250'></progress> capacity &lt;Q&gt;"
    assert second == "<progress max='1' value='0.750'></progress> log, 3 of 4"
    assert "value=" not in third
    assert last == ""


def test_a_terminal_has_one_line_and_a_file_none(monkeypatch, capsys):
    with cellwise.progress_bar() as bar:
        bar(0.5, "unseen")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with cellwise.progress_bar() as bar:
        bar(0.5, "pulses")
    said = capsys.readouterr().err
    assert " 50% pulses" in said
    assert "\n" not in said
    assert said.endswith("\x1b[2K")


@pytest.mark.slow
def test_a_diagnosis_says_how_far_it_is(notebook):
    from dataclasses import replace

    model, log = curved_cell(), load_dataset("nmc_drive_b").part(0, 3000)
    voltage_V = simulate(model, log, 0.9).voltage_V
    off = replace(log, voltage_V=voltage_V, current_A=log.current_A + 0.3)
    with cellwise.progress_bar() as bar:
        cellwise.diagnose(model, off, soc0=0.9, causes=["current_offset"], progress=bar)
    assert any("current offset" in said for said in notebook.shown[0])

"""Results as plots and data frames, and what importing the package costs."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import cellwise as cw
from cellwise.errors import InputError
from cellwise.plotting import MOST_POINTS, Line, Panel, Plottable, _extreme_rows
from example_cells import curved_cell, random_log, random_model


def results():
    model = curved_cell()
    log = random_log(np.random.default_rng(0), rows=300, temperature_C=(20.0, 30.0))
    log = cw.CellLog(log.time_s, log.current_A, log.voltage_V, log.temperature_C,
                     np.cumsum(log.current_A) / 3600.0)  # fmt: skip
    simulation = cw.simulate(model, log, 0.8)
    replay = cw.replay(model, log, soc0=0.7, reference_soc0=0.8, reference_capacity_Ah=3.0)
    return {"log": log, "simulation": simulation, "replay": replay, "model": model,
            "three": random_model(np.random.default_rng(1), temperatures=3)}  # fmt: skip


RESULTS = results()


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_has_a_plot_of_its_own_numbers(name):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    result = RESULTS[name]
    x_label, panels = result.panels()
    figure = result.plot()
    assert len(figure.axes) == len(panels) >= 3
    assert figure.axes[-1].get_xlabel() == x_label
    for axes, panel in zip(figure.axes, panels, strict=True):
        assert axes.get_ylabel() == panel.y_label
        for drawn, line in zip(axes.get_lines(), panel.lines, strict=True):
            np.testing.assert_array_equal(drawn.get_ydata(), line.y)
    matplotlib.pyplot.close(figure)


def test_units_stand_at_the_axes_and_the_band_is_two_deviations():
    _, (soc, *_rest) = RESULTS["replay"].panels()
    np.testing.assert_array_equal(soc.lines[0].band, 2.0 * RESULTS["replay"].trace.soc_std)
    labels = [p.y_label for r in RESULTS.values() for p in r.panels()[1]]
    assert all("[" in label or label.startswith("SOC") for label in labels)


def test_a_plot_into_a_figure_of_ones_own():
    figures = pytest.importorskip("matplotlib.figure")
    figure = figures.Figure()
    assert RESULTS["log"].plot(figure=figure) is figure


def test_a_plot_into_axes_of_ones_own_with_a_style_of_ones_own():
    figures = pytest.importorskip("matplotlib.figure")
    run, figure = RESULTS["replay"], figures.Figure()
    above, below = figure.subplots(2)
    assert run.plot(ax=above, panel="soc", color="crimson", lw=3.0, label="mine") is figure
    assert {line.get_color() for line in above.get_lines()} == {"crimson"}
    assert {line.get_linewidth() for line in above.get_lines()} == {3.0}
    assert above.get_lines()[0].get_label() == "mine"
    assert below.get_lines() == []
    first, second = figures.Figure().subplots(2)
    run.plot([first, second])
    assert [a.get_ylabel() for a in (first, second)] == [p.y_label for p in run.panels()[1][:2]]
    assert [a.get_xlabel() for a in (first, second)] == ["", "time [h]"]  # none between two rows


def test_a_plot_looks_as_rcparams_say():
    """No grid, no title and no width of line that a person has not asked for."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    for grid, width in ((False, 0.5), (True, 2.5)):
        with matplotlib.rc_context({"axes.grid": grid, "lines.linewidth": width}):
            figure = RESULTS["simulation"].plot()
        assert figure.get_suptitle() == ""
        for axes in figure.axes:
            assert axes.get_title() == ""
            assert axes.xaxis.get_gridlines()[0].get_visible() == grid
            assert axes.get_lines()[0].get_linewidth() == width
        matplotlib.pyplot.close(figure)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"panel": "power"}, "the beginning of one of 'SOC'"),
        ({"ax": "left"}, "matplotlib's axes"),
        ({"ax": []}, "matplotlib's axes"),
    ],
)
def test_a_plot_that_cannot_be_drawn_says_what_to_give(given, said):
    with pytest.raises(InputError, match=said):
        RESULTS["replay"].plot(**given)


def test_more_axes_than_panels_are_refused():
    figures = pytest.importorskip("matplotlib.figure")
    with pytest.raises(InputError, match="no more axes than panels"):
        RESULTS["log"].plot(figures.Figure().subplots(5))


class Long(Plottable):
    def panels(self):
        y = np.zeros(1_000_000)
        y[777_777], y[333_333], y[5] = 9.0, -9.0, np.nan
        return "x", (Panel("y", (Line("y", np.arange(1e6), y),)),)


def test_a_million_points_keep_their_peaks():
    line = Long().panels()[1][0].lines[0]
    rows = _extreme_rows(line.y)
    assert rows.size <= MOST_POINTS
    assert {777_777, 333_333} <= set(rows.tolist())


@pytest.mark.parametrize("name", RESULTS)
def test_a_table_is_columns_of_one_length_that_a_data_frame_takes(name):
    frames = pytest.importorskip("pandas")
    table = RESULTS[name].table()
    assert {column.ndim for column in table.values()} == {1}
    frame = frames.DataFrame(table)
    assert list(frame.columns) == list(RESULTS[name].columns())
    first = next(iter(table))
    table[first][:] = 0.0  # a copy: the result stays as it is
    assert np.any(RESULTS[name].table()[first])


@pytest.mark.parametrize("library", ["pandas", "polars"])
@pytest.mark.parametrize("name", RESULTS)
def test_columns_come_out_as_a_data_frame(library, name):
    pytest.importorskip(library)
    result = RESULTS[name]
    frame = getattr(result, f"to_{library}")()
    assert list(frame.columns) == list(result.columns())
    for column, values in result.columns().items():
        np.testing.assert_array_equal(np.asarray(frame[column]), values)


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_log_goes_through_a_data_frame_and_back(library):
    pytest.importorskip(library)
    log = RESULTS["log"]
    again = cw.CellLog.from_table(getattr(log, f"to_{library}")())
    for field in ("time_s", "current_A", "voltage_V", "temperature_C", "charge_Ah"):
        np.testing.assert_array_equal(getattr(again, field), getattr(log, field))


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_missing_values_and_whole_numbers_of_a_frame(library):
    frames = pytest.importorskip(library)
    frame = frames.DataFrame(
        {"time_s": [0, 1, 2, 3], "current_mA": [1000, 1000, None, 1000],
         "voltage_V": [3.7, None, 3.68, 3.67]}
    )  # fmt: skip
    log = cw.CellLog.from_table(frame)
    assert np.isnan(log.voltage_V[1])
    assert np.isnan(log.current_A[2])
    assert log.current_A[0] == 1.0


def test_a_library_that_is_missing_is_named(monkeypatch):
    libraries = ("matplotlib.pyplot", "plot"), ("polars", "to_polars"), ("pandas", "to_pandas")
    for name, call in libraries:
        monkeypatch.setitem(sys.modules, name, None)
        with pytest.raises(InputError, match="Install it"):
            getattr(RESULTS["log"], call)()


@pytest.mark.parametrize("name", RESULTS)
def test_a_repr_is_one_line_that_says_what_it_is(name):
    text = repr(RESULTS[name])
    assert text.startswith(type(RESULTS[name]).__name__ + "(")
    assert "\n" not in text
    assert len(text) < 200


def test_importing_costs_little_and_loads_nothing_heavy():
    script = (
        "import time; t = time.process_time(); import cellwise; t = time.process_time() - t; "
        "import sys; print(t, *sorted(set(sys.modules) & {'numba', 'scipy', 'pyarrow', 'pandas', "
        "'polars', 'matplotlib', 'distributed'}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    seconds, *heavy = done.stdout.split()
    assert heavy == []
    assert float(seconds) <= 0.5

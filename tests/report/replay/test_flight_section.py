"""Remaining time and energy, on a page: first line, table, picture, figures for machines."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cellwise.forecast.remaining import forecast
from cellwise.notices import Code, Notice
from cellwise.report.page.numerals import duration_between
from cellwise.report.replay.page import flight_finding, flight_plot, replay_page
from report_cases import drive, model, replay


@pytest.fixture(scope="module")
def flight():
    run = replay(drive())
    return run, forecast(model(), run, cutoff_V=2.8)


def test_the_plot_shows_both_with_their_bands(flight):
    _, left = flight
    shown = left.typical
    above, below, _ = flight_plot(left).panels
    for panel, values, band in (
        (above, shown.remaining_s / 60, shown.remaining_s_band / 60),
        (below, shown.remaining_Wh, shown.remaining_Wh_band),
    ):
        (line,) = panel.lines
        np.testing.assert_allclose(line.y, values)
        np.testing.assert_allclose(line.edges, band.T)
    assert "min" in above.y_label


@pytest.mark.usefixtures("undrawn")
def test_the_page_holds_the_figures(flight, tmp_path):
    run, left = flight
    page = replay_page([run], tmp_path / "page.html", flights=[left]).read_text(encoding="utf-8")
    assert "Remaining time and energy" in page
    (data,) = re.findall(r"<script[^>]*application/json[^>]*>(.*?)</script>", page, flags=re.S)
    told = json.loads(data)["flights"][0]
    assert told["remaining_s"] == pytest.approx(left.last.remaining_s)
    assert told["end_voltage_V"] == pytest.approx(left.last.end_voltage_V)


def test_the_finding_names_time_and_band_at_the_usual_load(flight):
    """An hour of flight, then a rest at a small load: 3.9 h at that is no answer."""
    _, left = flight
    text = flight_finding(left)
    now = left.typical.last
    assert text.endswith("A.")
    assert duration_between(now.remaining_s, *now.remaining_s_band) + " left at the usual" in text
    unusual = flight_finding(replace(left, typical=None))
    assert "at the last minute's" in unusual


@pytest.mark.usefixtures("undrawn")
def test_a_log_far_off_its_model_is_the_first_line(flight, tmp_path):
    run, left = flight
    shifted = replace(run, log=replace(run.log, voltage_V=run.log.voltage_V + 0.5), model=model())
    shifted = replace(shifted, trace=replace(run.trace, innovation_V=run.trace.innovation_V + 0.5))
    page = replay_page([shifted], tmp_path / "far.html", flights=[left]).read_text("utf-8")
    first = re.search(r"<h1>(.*?)</h1>", page)[1]
    assert "FAR OFF" in first
    assert "remaining" not in first


@pytest.mark.usefixtures("undrawn")
def test_what_is_unsure_comes_before_how_the_log_was_read(tmp_path):
    """A start that nobody knows and a band that lies are read without a click."""
    run = replay(drive())
    unused = (Notice(Code.COLUMN_UNUSED, f"column {k} was not used") for k in range(4))
    read = replace(run.log, notices=tuple(unused))
    trace = replace(run.trace, soc_std=np.full(len(run.trace), 0.2))
    start = replace(run.start, std=0.3)
    unsure = replace(run, log=read, trace=trace, start=start, reference_soc=None)
    text = replay_page([unsure], tmp_path / "p.html").read_text("utf-8").replace("\xa0", " ")
    lead = text[text.index("</h1>") : text.index("<nav")]
    shown, _, folded = lead.partition("<details>")
    assert "SOC ends no better than ± 40 %" in shown
    assert "LOG@soc0=1" in shown
    assert "column 3 was not used" in folded

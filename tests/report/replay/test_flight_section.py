"""Remaining time and energy, on a page: first line, table, picture, figures for machines."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cellwise.forecast.remaining import forecast
from cellwise.report import replay_page
from cellwise.report.page.numerals import duration
from cellwise.report.replay.forecast_section import flight_finding, flight_picture
from report_cases import drive, model, replay


@pytest.fixture(scope="module")
def flight():
    run = replay(drive())
    return run, forecast(model(), run, cutoff_V=2.8)


def test_the_picture_shows_both_with_their_bands(flight):
    _, left = flight
    figure = flight_picture(left).figure
    above, below = figure.axes
    for axes, values in ((above, left.remaining_s / 60), (below, left.remaining_Wh)):
        (line,) = axes.lines
        np.testing.assert_allclose(line.get_ydata(), values)
        assert len(axes.collections) == 1
    assert "min" in above.get_ylabel()


def test_the_page_holds_the_figures(flight, tmp_path):
    run, left = flight
    page = replay_page([run], tmp_path / "page.html", flights=[left]).read_text(encoding="utf-8")
    assert "Remaining time and energy" in page
    (data,) = re.findall(r"<script[^>]*application/json[^>]*>(.*?)</script>", page, flags=re.S)
    told = json.loads(data)["flights"][0]
    assert told["remaining_s"] == pytest.approx(left.last.remaining_s)
    assert told["end_voltage_V"] == pytest.approx(left.last.end_voltage_V)


def test_the_finding_names_time_and_band(flight):
    _, left = flight
    assert re.search(r"remaining at the present load \(.* to .*\)\.$", flight_finding(left))


def test_whoever_stands_is_told_of_the_usual_load(flight):
    """An hour of flight, then a rest at a small load: 3.9 h at that is no answer."""
    _, left = flight
    usual = left.typical.last
    resting = replace(left, load_A=np.append(left.load_A[:-1], 0.05 * usual.load_A))
    text = flight_finding(resting)
    assert "at the usual load of" in text
    assert duration(usual.remaining_s) in text
    busy = replace(left, load_A=np.append(left.load_A[:-1], 0.5 * usual.load_A))
    assert "at the present load" in flight_finding(busy)

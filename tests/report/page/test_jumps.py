"""Rows and times that a notice names lead into the plots."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise.report import replay_page
from cellwise.report.page.markup import linked, linked_among
from report_cases import Page, drive, replay


@pytest.mark.parametrize(
    ("notice", "begin", "end"),
    [
        ("1e6 A in row 101 of 'x'", 100.0, 100.0),
        ("voltage stands still (rows 11 to 21)", 10.0, 20.0),
        ("7 rows between 11 and 21", 10.0, 20.0),
        ("a gap of 20 min without rows at 812.0 s", 812.0, 812.0),
        ("up to 270 mV off, most at SOC 0.028 after 0.30 h: near empty", 1062.0, 1098.0),
        ("stands still for 40 s from 812.5 s on", 812.5, 812.5),
    ],
)
def test_a_place_is_seconds_from_the_first_row(notice, begin, end):
    text = linked(notice, drive())
    assert text.count("<button ") == 1
    assert f'data-from="{begin:g}" data-to="{end:g}"' in text


def test_a_log_whose_time_begins_later_counts_from_its_first_row():
    log = drive()
    later = replace(log, time_s=log.time_s + 1000.0)
    for notice in ("in row 101", "at 1100.0 s"):
        assert 'data-from="100" data-to="100"' in linked(notice, later)


@pytest.mark.parametrize(
    "notice",
    [
        "3 rows are without it",
        "in row 9999",
        "in row 0",
        "at 99999 s",
        "in <b> & more",
        "2.5 V at 25 degC",
    ],
)
def test_what_names_no_place_of_the_log_is_text(notice):
    text = linked(notice, drive())
    assert "<button " not in text
    assert "<b>" not in text


def test_among_several_logs_the_named_one_is_meant():
    logs = [drive(name="a"), drive(name="b")]
    assert 'data-clock="b"' in linked_among("b: voltage is missing (rows 3 to 5)", logs)
    assert 'data-clock="a"' in linked_among("'a' has a gap at 40 s", logs)
    assert "<button " not in linked_among("a gap at 40 s", logs)


@pytest.mark.usefixtures("undrawn")
def test_an_alert_of_a_page_leads_to_its_row(tmp_path):
    log = replace(drive(name='<odd> "name"'), notices=("the current LOOKS WRONG in row 300",))
    text = replay_page([replay(log)], tmp_path / "p.html").read_text(encoding="utf-8")
    assert Page(text).text_in("button").count("row 300") == 1

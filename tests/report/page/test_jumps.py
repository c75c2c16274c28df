"""Rows and times that a notice names lead into the plots."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwise.notices import Code, Notice
from cellwise.report.page.markup import linked, linked_among
from cellwise.report.replay.page import replay_page
from cellwise.wording import RowPlace, place
from report_cases import Page, drive, replay


def in_row(row, log=""):
    return Notice(Code.IMPOSSIBLE_VALUE, ("the current in ", place(range(row, row + 1))), log=log)


@pytest.mark.parametrize(
    ("said", "rows", "begin", "end", "shown"),
    [
        (("1e6 A in ", place(range(100, 101)), " of x"), None, 100.0, 100.0, ">row 101<"),
        (("stands still (", place(range(10, 21)), ")"), None, 10.0, 20.0, ">rows 11 to 21<"),
        (
            ("off ", RowPlace("after 0.3 h", range(1080, 1081))),
            None,
            1080.0,
            1080.0,
            ">after 0.3 h<",
        ),
        ("a load that empties it", range(30, 41), 30.0, 40.0, ">show<"),
    ],
)
def test_the_rows_of_a_notice_are_seconds_from_the_first_row(said, rows, begin, end, shown):
    text = linked(Notice(Code.GAP, said, rows=rows), drive())
    assert text.count("<button ") == 1
    assert f'data-from="{begin:g}" data-to="{end:g}"' in text
    assert shown in text


def test_a_log_whose_time_begins_later_counts_from_its_first_row():
    log = drive()
    later = replace(log, time_s=log.time_s + 1000.0)
    assert 'data-from="100" data-to="100"' in linked(in_row(100), later)


def test_rows_of_a_log_of_which_a_part_is_drawn_are_shown_where_they_are_drawn():
    log = drive()
    assert 'data-from="40" data-to="40"' in linked(in_row(100), log, log.part(60, 200))
    assert "<button " not in linked(in_row(100), log, log.part(200, 400))


def test_several_places_of_a_text_are_several_links():
    said = (place(range(3, 4)), " and ", place(range(8, 10)))
    assert linked(Notice(Code.IMPOSSIBLE_VALUE, said), drive()).count("<button ") == 2


@pytest.mark.parametrize("said", ["in row 12", "at 812 s", "in <b> & more"])
def test_what_has_no_rows_is_text_whatever_it_says(said):
    text = linked(Notice(Code.GAP, said), drive())
    assert "<button " not in text
    assert "<b>" not in text


@pytest.mark.parametrize("rows", [range(9998, 9999), range(-1, 0), range(5, 5)])
def test_rows_that_the_log_has_not_are_no_link(rows):
    assert "<button " not in linked(Notice(Code.GAP, "here", rows=rows), drive())


def test_among_several_logs_the_named_one_is_meant():
    logs = [drive(name="a"), drive(name="b")]
    assert 'data-clock="b"' in linked_among(in_row(3, log="b"), logs)
    assert 'data-clock="a"' in linked_among(in_row(3, log="a"), logs)
    assert "<button " not in linked_among(in_row(3), logs)


@pytest.mark.usefixtures("undrawn")
def test_an_alert_of_a_page_leads_to_its_row(tmp_path):
    log = replace(drive(name='<odd> "name"'), notices=(in_row(299),))
    text = replay_page([replay(log)], tmp_path / "p.html").read_text(encoding="utf-8")
    assert Page(text).text_in("button").count("row 300") == 1

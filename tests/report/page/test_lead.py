"""What stands before the first picture: alerts first, three bullets at most."""

from __future__ import annotations

import re

from cellwise.report.page.markup import Markup, lead_of

TILES = Markup("<dl>tiles</dl>")


def shown(text):
    """Bullets that are read without a click."""
    return re.findall(r"<li>(.*?)</li>", text.partition("<details>")[0])


def test_alerts_come_first_and_three_bullets_are_all():
    text = lead_of(["alert 1", "alert 2"], TILES, ["line 1", "line 2", "line 3"])
    assert shown(text) == ["alert 1", "alert 2", "line 1"]
    assert text.index("alert 1") < text.index("tiles") < text.index("line 1")
    assert "2 more" in text
    assert "line 3" in text


def test_many_alerts_leave_no_line_and_nothing_is_lost():
    alerts = [f"alert {k}" for k in range(5)]
    text = lead_of(alerts, TILES, ["line"])
    assert shown(text) == alerts[:3]
    assert all(one in text for one in (*alerts, "line"))


def test_without_more_to_say_nothing_is_folded():
    assert "<details>" not in lead_of((), TILES, ["line"])
    assert lead_of((), TILES) == TILES

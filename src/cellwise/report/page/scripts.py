"""The two programs of a page: pictures that zoom, and traces with every sample."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files

from cellwise.report.page.markup import Markup

# What a page holds that needs the program.
NEEDED_BY = {"zoom.js": "<figure ", "interactive.js": '<div class="trace"'}


def scripts_for(parts: Iterable[str]) -> list[Markup]:
    """The programs that the parts of a page need."""
    inside = list(parts)
    return [
        script(name) for name, mark in NEEDED_BY.items() if any(mark in part for part in inside)
    ]


@cache
def script(name: str) -> Markup:
    """A program as it stands in a page."""
    text = (files("cellwise.report.page") / name).read_text(encoding="utf-8")
    return Markup(text.replace("</", "<\\/"))

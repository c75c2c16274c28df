"""Pages whose words are tested, without the pictures that take most of their time."""

from __future__ import annotations

from contextlib import contextmanager

import pytest

from cellwise.report.page.markup import Markup, escape
from cellwise.report.page.picture import safe_key


def captioned(picture):
    """A picture as its caption: drawn, but not written as SVG."""
    key = f"figure-{safe_key(picture.key)}"
    return Markup(f'<figure id="{key}"><figcaption>{escape(picture.caption)}</figcaption></figure>')


@contextmanager
def captions_alone():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.report.page.section.inline", captioned)
        yield


@pytest.fixture
def undrawn():
    """What a page says: its pictures stand in it as their captions."""
    with captions_alone():
        yield


@pytest.fixture(scope="session")
def without_pictures():
    """The same as a context, for fixtures that make several pages."""
    return captions_alone

"""The page's colours by day and by night: ink reads on every field, and nothing glares."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cellwise.benchmark.page import tinted
from cellwise.report.page.markup import page_file
from cellwise.report.page.picture import VARIABLES

READABLE = 4.5  # WCAG 2.2, contrast of text


def colours(text):
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", text))


def luminance(colour):
    """WCAG 2.2, relative luminance."""
    channels = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


DAY, _, NIGHT = page_file("page.css").partition("prefers-color-scheme: dark")


@pytest.mark.parametrize("mode", ["day", "night"])
def test_ink_reads_on_paper_and_on_every_tint(mode):
    found = colours(DAY if mode == "day" else NIGHT)
    for name in ("paper", "tint-1", "tint-2", "tint-3", "tint-4"):
        light, dark = sorted((luminance(found["ink"]), luminance(found[name])), reverse=True)
        assert (light + 0.05) / (dark + 0.05) > READABLE, name
        assert mode == "day" or luminance(found[name]) < 0.1, name


def test_every_colour_that_a_picture_takes_from_the_page_is_there_by_day_and_night():
    for variable in VARIABLES.values():
        assert variable.removeprefix("--") in colours(DAY)
        assert variable.removeprefix("--") in colours(NIGHT)


def test_fields_behind_numbers_take_their_colours_from_the_page():
    html = "".join(map(tinted, (0.002, 0.015, 0.04, 0.2)))
    assert all(f'class="tint-{k}"' in html for k in range(1, 5))
    assert "tint" not in tinted(float("nan"))

"""The day on which a log was recorded, where its name says it."""

from __future__ import annotations

import re
from datetime import date

_DAY = re.compile(r"(?<!\d)((?:19|20)\d\d)[-_]?([01]\d)[-_]?([0-3]\d)(?!\d)")


def day_of_name(name: str) -> date | None:
    """The day in a name (``leaf_20170330``, ``drive_2017-03-30``); None where there is none."""
    for found in _DAY.finditer(name):
        try:
            return date(*(int(part) for part in found.groups()))
        except ValueError:  # digits that are no day
            continue
    return None

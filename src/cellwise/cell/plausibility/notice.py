"""A notice with its size, so that the first one is that which does most to the result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from cellwise.logs.checks.grave import is_grave

# A charge or SOC that is wrong by the whole range is wrong by about this in voltage.
RANGE_V = 1.0


class Notice(NamedTuple):
    """What a person should know, and about how far it moves a voltage [V]."""

    size_V: float
    text: str


def in_order(found: Iterable[Notice], of_reading: Sequence[str] = ()) -> tuple[str, ...]:
    """Notices as text, the most harmful first, those of reading a log last.

    A channel that cannot be what it is taken for, such as a current of the wrong sign, comes before
    all: it turns every other figure into nonsense.
    """
    grave = [n for n in of_reading if is_grave(n)]
    texts = [n.text for n in sorted(found, key=lambda n: -n.size_V)]
    return tuple(dict.fromkeys((*grave, *texts, *of_reading)))

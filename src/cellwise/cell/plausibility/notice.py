"""A notice with its size, so that the first one is that which does most to the result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from cellwise.logs.checks.sign import contradiction

# A charge or SOC that is wrong by the whole range is wrong by about this in voltage.
RANGE_V = 1.0


class Notice(NamedTuple):
    """What a person should know, and about how far it moves a voltage [V]."""

    size_V: float
    text: str


def in_order(found: Iterable[Notice], of_reading: Sequence[str] = ()) -> tuple[str, ...]:
    """Notices as text, the most harmful first, those of reading a log last.

    A current of the wrong sign comes before all: it turns every other figure into nonsense.
    """
    wrong_sign = [n for n in of_reading if contradiction("") in n]
    texts = [n.text for n in sorted(found, key=lambda n: -n.size_V)]
    return tuple(dict.fromkeys((*wrong_sign, *texts, *of_reading)))

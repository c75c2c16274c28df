"""What a limit needs: which sensor, tests, tables and step keep it, as a front over what they cost.

Options that do not keep the limit on a few cells are not tried on many.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.certify.designs import Ask, Design, DesignOption, all_options
from cellwise.errors import InputError
from cellwise.estimate.sensor import CLASSES
from cellwise.report.page.markup import paragraph, record_table
from cellwise.report.page.section import Section, write_page
from cellwise.typing import FloatArray

LIMIT = re.compile(
    r"(?P<limit>[0-9.]+) ?% (?P<figure>rmse|p95|worst) at (?P<temperature_C>[-+0-9.]+) ?"
    r"(?:degC|°C|C), (?P<years>[0-9.]+) years?"
)
FIRST_CELLS = 4  # that every option is tried on; twice as many after each round,
MOST_CELLS = 64  # up to so many: half an hour at a time step of one second, on two cores
KEPT = 0.5  # share of those beyond the limit that goes on


class DesignResult(NamedTuple):
    """An option, the figure that was asked for, of so many cells, and its costs."""

    option: DesignOption
    error: float
    cells: int
    costs: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**vars(self.option), "error": self.error, "cells": self.cells, **self.costs}


def parse_ask(text: str) -> Ask:
    """A limit as people write it: ``5 % worst at -10 degC, 3 years``.

    Raises
    ------
    InputError        another text
    """
    found = LIMIT.fullmatch(" ".join(text.split()))
    try:
        numbers = {} if found is None else found.groupdict()
        ask = Ask(
            float(numbers["limit"]) / 100.0,
            numbers["figure"],
            float(numbers["temperature_C"]),
            float(numbers["years"]),
        )
    except (KeyError, ValueError):
        raise InputError(
            f"'{text}'",
            "a limit, one of rmse, p95, worst, a temperature and an age",
            "Write e.g. '5 % worst at -10 degC, 3 years'.",
        ) from None
    return ask


def find_designs(
    design: Design,
    cells: int,
    options: Sequence[DesignOption] | None = None,
    follow: Callable[[int, int], None] | None = None,
) -> list[DesignResult]:
    """Options that keep a limit, none cheaper than another in everything; else the nearest ones.

    Parameters
    ----------
    design : Design
    cells : int                   that the last options are tried on, `MOST_CELLS` at most
    options : sequence or None    None: all of them
    follow : callable or None     called with how many options of a round are done, and of how many

    Returns
    -------
    list of DesignResult          the smallest error first; without one that keeps the limit the
                                  front over costs and error together
    """
    options = all_options() if options is None else options
    cells, limit = min(cells, MOST_CELLS), design.ask.limit
    tried = min(FIRST_CELLS, cells)
    while True:
        found: list[tuple[float, DesignOption]] = []
        for _, group in groupby(sorted(options, key=_lives_of), _lives_of):
            own = list(group)
            found += zip(design.errors(own, tried), own, strict=True)
            if follow is not None:
                follow(len(found), len(options))
        found.sort(key=lambda one: one[0])
        kept = [one for one in found if one[0] <= limit]
        more = [one for one in found if one[0] > limit]
        if tried >= cells:
            break
        options = [option for _, option in kept or more[: math.ceil(KEPT * len(more))]]
        tried = min(2 * tried, cells)
    results = [DesignResult(o, e, tried, design.costs(o)) for e, o in kept or more]
    return front(results, bool(kept))


def _lives_of(option: DesignOption) -> tuple[str, str, bool]:
    return option.sensor, option.tests, option.updated


def front(results: Sequence[DesignResult], is_kept: bool) -> list[DesignResult]:
    """Results that no other is at least as good as in everything."""

    def of(one: DesignResult) -> FloatArray:
        return np.array([*one.costs.values(), *([] if is_kept else [one.error])])

    values = np.array([of(one) for one in results])
    best = []
    for k, one in enumerate(values):
        others = np.all(values <= one, axis=1) & np.any(values < one, axis=1)
        same = np.flatnonzero(np.all(values == one, axis=1))
        if not others.any() and same[0] == k:
            best.append(results[k])
    return best


def ask_data(design: Design, found: Sequence[DesignResult]) -> dict[str, Any]:
    """JSON values: the limit, whether it is reached, the front."""
    return {
        "ask": design.ask._asdict(),
        "reached": bool(found) and found[0].error <= design.ask.limit,
        "front": [one.to_dict() for one in found],
        "settings": {"dt_s": design.dt_s, "hours": design.hours, "seed": design.seed},
        "sensor_classes": {name: one.to_dict(1.0) for name, one in CLASSES.items()},
    }


FRONT_COLUMNS: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("error", lambda r: f"{100.0 * r['error']:.1f} %"),
    ("sensor", lambda r: str(r["sensor"])),
    ("step", lambda r: str(r["step"])),
    ("SOC points", lambda r: str(r["points"])),
    ("tests", lambda r: str(r["tests"])),
    ("yearly update", lambda r: "yes" if r["updated"] else "no"),
    ("bytes", lambda r: f"{r['bytes']:,.0f}"),
    ("instructions", lambda r: f"{r['instructions']:,.0f}"),
    ("hours of tests", lambda r: f"{r['hours']:.0f}"),
)


def ask_finding(data: Mapping[str, Any]) -> str:
    """The first line: whether the limit is reached, and how many ways there are."""
    ask = data["ask"]
    limit = f"{100.0 * ask['limit']:g} % {ask['figure']} at {ask['temperature_C']:g} degC"
    what = f"{limit} after {ask['years']:g} year{'' if ask['years'] == 1 else 's'}"
    count = len(data["front"])
    return f"{what}: {count} ways" if data["reached"] else f"{what}: not reached; {count} nearest"


def ask_page(data: Mapping[str, Any], model: str, path: str) -> None:
    """Write the front as a page."""
    said = paragraph(
        "None of these is cheaper than another in everything. Virtual cells without faults, whose "
        "tables are off by what the tests leave open; instructions on a Cortex-M4F."
    )
    table = record_table(data["front"], *FRONT_COLUMNS, text_columns=(1, 2, 4, 5))
    title = f"What a limit needs, {model or 'an unnamed cell'}, by cellwise"
    write_page(path, ask_finding(data), title, [Section("front", "Ways", (said, table))], data)

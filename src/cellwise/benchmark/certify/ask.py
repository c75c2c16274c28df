"""What a limit needs: sensor, tests, tables and step that keep it, as a front over their costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from cellwise.benchmark.certify.certificate import soc_error
from cellwise.benchmark.certify.designs import (
    Ask,
    Design,
    DesignOption,
    LifeError,
    all_options,
)
from cellwise.errors import InputError
from cellwise.estimate.sensor import CLASSES
from cellwise.report.page.markup import paragraph, record_table
from cellwise.report.page.section import Section, write_page
from cellwise.typing import FloatArray

LIMIT = re.compile(
    r"(?P<limit>[0-9.]+) ?% (?P<figure>rmse|p95|worst) at (?P<temperature_C>[-+0-9.]+) ?"
    r"(?:degC|°C|C), (?P<years>[0-9.]+) years?"
)
FIRST_CELLS = 4  # that every option is tried on,
GROWS, MOST_CELLS = 4, 64  # then those that may stand on the front on so many times, up to so many


class DesignResult(NamedTuple):
    """An option, the figure that was asked for, of so many cells, and its costs."""

    option: DesignOption
    error: float
    cells: int
    costs: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {**vars(self.option), "error": self.error, "cells": self.cells, **self.costs}


class TriedOption(NamedTuple):
    """An option, what it costs, and its errors so far."""

    option: DesignOption
    costs: dict[str, float]
    errors: list[LifeError]

    def result(self, figure: str) -> DesignResult:
        """As far as it has been tried."""
        error = soc_error(self.errors)[figure]
        return DesignResult(self.option, error, len(self.errors), self.costs)


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

    Only what may stand on the front is tried on more cells: a largest error grows with the cells,
    so that ``worst`` gives the front of a search that tries everything on all of them.

    Parameters
    ----------
    design : Design
    cells : int                   that the front is tried on, `MOST_CELLS` at most
    options : sequence or None    None: all of them
    follow : callable or None     called with how many options of a round are done, and of how many

    Returns
    -------
    list of DesignResult          the smallest error first; without one that keeps the limit the
                                  front over costs and error together
    """
    cells, limit = min(cells, MOST_CELLS), design.ask.limit
    asked = all_options() if options is None else options
    tried = [TriedOption(option, design.costs(option), []) for option in asked]
    open_ones = tried
    while open_ones:
        done = 0
        for key, group in groupby(sorted(open_ones, key=_lives_of), _lives_of):
            own = list(group)
            more = min(max(FIRST_CELLS, GROWS * key[-1]), cells)
            design.try_on([one.errors for one in own], [one.option for one in own], more)
            done += len(own)
            if follow is not None:
                follow(done, len(open_ones))
        found = [one.result(design.ask.figure) for one in tried]
        kept = [one for one in found if one.error <= limit]
        best = front(kept or found, bool(kept))
        named = {one.option for one in best if one.cells < cells}
        open_ones = [one for one in tried if one.option in named]
    return sorted(best, key=lambda one: one.error)


def _lives_of(one: TriedOption) -> tuple[str, str, bool, int]:
    option = one.option
    return option.sensor, option.tests, option.updated, len(one.errors)


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
    """JSON values: the limit, whether it is reached, the front; if not, what the best lacks."""
    best, reached = found[0], found[0].error <= design.ask.limit
    left = {} if reached else design.without_each(best.option, best.cells)
    ordered = sorted(left.items(), key=lambda one: one[1])
    causes = [{"name": name, "error_without": error} for name, error in ordered]
    return {
        "ask": design.ask._asdict(),
        "reached": reached,
        "causes_of_best": causes,
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

CAUSE_WORDS = {
    "age": "age",
    "temperature": "the cold or heat",
    "cells": "differences between cells",
    "model_error": "the model's own error",
    "sensor": "errors of the sensors",
    "start": "a start that is off",
}
CAUSE_COLUMNS: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("without", lambda r: CAUSE_WORDS[r["name"]]),
    ("error", lambda r: f"{100.0 * r['error_without']:.1f} %"),
)


def ask_finding(data: Mapping[str, Any]) -> str:
    """The first line: whether the limit is reached, and how many ways there are."""
    ask = data["ask"]
    limit = f"{100.0 * ask['limit']:g} % {ask['figure']} at {ask['temperature_C']:g} degC"
    what = f"{limit} after {ask['years']:g} year{'' if ask['years'] == 1 else 's'}"
    count = len(data["front"])
    if data["reached"]:
        return f"{what}: {count} ways"
    best, first = data["front"][0], data["causes_of_best"][0]
    size, rest = 100.0 * best["error"], 100.0 * first["error_without"]
    name = CAUSE_WORDS[first["name"]]
    return f"{what}: not reached, {size:.1f} % at best, {rest:.1f} % without {name}"


def ask_page(data: Mapping[str, Any], model: str, path: str) -> None:
    """Write the front as a page."""
    said = paragraph(
        "None of these is cheaper than another in everything. Virtual cells without faults, whose "
        "tables are off by what the tests leave open; instructions on a Cortex-M4F."
    )
    table = record_table(data["front"], *FRONT_COLUMNS, text_columns=(1, 2, 4, 5))
    sections = [Section("front", "Ways", (said, table))]
    if not data["reached"]:
        each = paragraph("The error of the best way where one cause is made perfect in turn.")
        causes = record_table(data["causes_of_best"], *CAUSE_COLUMNS, text_columns=(0,))
        sections.append(Section("causes", "What it takes", (each, causes)))
    title = f"What a limit needs, {model or 'an unnamed cell'}, by cellwise"
    write_page(path, ask_finding(data), title, sections, data)

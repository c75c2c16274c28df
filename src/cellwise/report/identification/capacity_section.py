"""Capacity: the table of the tests in the LFP paper's layout, and every choice beside the taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.identification import Identification
from cellwise.report.page.markup import Markup, beside, bullets, details, table
from cellwise.report.page.numerals import ampere_hours, percent, significant
from cellwise.report.page.picture import Picture
from cellwise.report.page.style import (
    AMBER,
    BLUE,
    INK,
    MUTED,
    VERMILLION,
    finding,
    labels,
    legend,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def capacity_rows(identification: Identification) -> tuple[CapacityRow, ...]:
    """Means per rate over the tests that count; none without a complete test."""
    try:
        return capacity_table(usable_tests(identification.capacity_tests)[0])
    except InputError:
        return ()


def capacity_content(identification: Identification) -> Markup:
    """Table of the rates, table of the choices with the taken one marked, tests left out."""
    rows = capacity_rows(identification)
    parts = []
    if rows:
        parts.append(
            table(
                ("rate", "total", "CC part", "CV part", "tests", "spread", "coulombic efficiency"),
                [
                    (
                        row.rate,
                        ampere_hours(row.total_Ah, rows[0].total_Ah),
                        ampere_hours(row.cc_Ah, rows[0].total_Ah),
                        ampere_hours(row.cv_Ah, rows[0].total_Ah),
                        row.n,
                        ampere_hours(row.spread_Ah, rows[0].total_Ah) if row.n > 1 else "",
                        ""
                        if row.coulombic_efficiency is None
                        else f"{row.coulombic_efficiency:.4f}",
                    )
                    for row in rows
                ],
                caption="Charge taken out from full to the lower limit: at constant current (CC), "
                "and while the tester held the limit (CV). Means per rate.",
            )
        )
    taken = identification.model.capacity_Ah
    names = list(identification.capacities)
    parts.append(
        table(
            ("choice", "capacity", "against the taken one"),
            [
                (name, ampere_hours(value, taken), percent(value / taken - 1.0, 1))
                for name, value in identification.capacities.items()
            ],
            caption="Every capacity these logs offer; the marked one defines SOC.",
            marked=names.index(identification.capacity_choice)
            if identification.capacity_choice in names
            else None,
        )
    )
    content = beside(*parts)
    lines = [
        f"{test.name} ({significant(test.current_A)} A): {notice}"
        for test in identification.capacity_tests
        for notice in test.notices
    ]
    if lines:
        content = Markup(content + details("Notices on single tests", bullets(lines)))
    return content


def capacity_picture(identification: Identification) -> Picture:
    """Charge per rate, and the choices."""
    caption = (
        "Left: charge that came out at each rate; a fast discharge meets the lower limit early, "
        "and the remainder flows only while the limit is held. Right: the numbers that could be "
        "called the capacity. SOC, OCV and every table refer to the one that is taken, so a wrong "
        "one tilts them all."
    )
    return Picture("capacity", draw_capacity(identification), caption)


@styled
def draw_capacity(identification: Identification) -> Figure:
    """Bars of CC and CV charge per rate; dots of the choices."""
    rows = capacity_rows(identification)
    longest = max(len(rows), len(identification.capacities))
    figure = new_figure(min(1.3 + 0.24 * longest, 5.0))
    if rows:
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
        _draw_rates(left, rows)
    else:
        right = figure.subplots()
    _draw_choices(right, identification, 0.41 if rows else 0.9)
    return figure


def _draw_rates(axes: Axes, rows: tuple[CapacityRow, ...]) -> None:
    place = np.arange(len(rows))
    axes.barh(place, [r.cc_Ah for r in rows], 0.6, color=BLUE, label="constant current")
    held = [max(r.cv_Ah, 0.0) for r in rows]
    if max(held) > 5e-4 * rows[0].total_Ah:
        axes.barh(
            place, held, 0.6, left=[r.cc_Ah for r in rows], color=AMBER, label="limit held (CV)"
        )
        axes.set_ylim(len(rows) + 0.1, -0.6)  # a free row for the legend
        legend(axes, place="lower left", columns=2)
    else:
        axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(place, [r.rate for r in rows])
    axes.grid(visible=False, axis="y")
    if len(rows) == 1:
        text = f"{ampere_hours(rows[0].total_Ah)} at {rows[0].rate}"
    else:
        lost = 1.0 - rows[-1].cc_Ah / rows[0].cc_Ah
        text = f"{percent(lost, 1)} less at constant current at {rows[-1].rate} than at "
        text += rows[0].rate
    finding(axes, text, 0.42)
    labels(axes, "charge [Ah]", "rate [1/h]")


def _draw_choices(axes: Axes, identification: Identification, share: float) -> None:
    names = list(identification.capacities)
    values = np.array([identification.capacities[n] for n in names])
    taken = identification.model.capacity_Ah
    place = np.arange(len(names))
    axes.hlines(place, taken, values, color=MUTED, linewidth=1.0)
    axes.plot(values, place, "o", color=INK, markersize=5)
    axes.axvline(taken, color=VERMILLION, linewidth=1.3)
    if identification.capacity_choice in names:
        axes.plot(
            [taken], [names.index(identification.capacity_choice)], "o", color=VERMILLION, ms=8
        )
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    low, high = values.min() / taken - 1.0, values.max() / taken - 1.0
    text = f"{identification.capacity_choice} taken: {ampere_hours(taken)}"
    finding(axes, text + _spread(low, high) if len(names) > 1 else text, share)
    labels(axes, "capacity [Ah]", "choice")


def _spread(low: float, high: float) -> str:
    """How the other choices lie to the taken one, as shares of it."""
    if high < 5e-4:
        return f"; the others are up to {percent(-low, 1)} smaller"
    if low > -5e-4:
        return f"; the others are up to {percent(high, 1)} larger"
    return f"; the others lie {percent(low, 1)} to +{percent(high, 1)} from it"

"""Capacity: the table of the tests in the LFP paper's layout, and every choice beside the taken."""

from __future__ import annotations

import numpy as np

from cellwise.errors import InputError
from cellwise.identify.capacity.capacity_choice import CapacityRow, capacity_table, usable_tests
from cellwise.identify.identification import Identification
from cellwise.report.page import style
from cellwise.report.page.markup import Markup, beside, bullets, details, record_table
from cellwise.report.page.numerals import ampere_hours, percent, significant
from cellwise.report.page.picture import pictured


def capacity_rows(identification: Identification) -> tuple[CapacityRow, ...]:
    """Means per rate over the tests that count; none without a complete test."""
    try:
        return capacity_table(usable_tests(identification.capacity_tests)[0])
    except InputError:
        return ()


def capacity_content(identification: Identification) -> Markup:
    """Table of the rates, table of the choices with the taken one marked, tests left out."""
    rows = capacity_rows(identification)
    whole = rows[0].total_Ah if rows else None
    taken = identification.model.capacity_Ah
    names = list(identification.capacities)
    chosen = identification.capacity_choice
    rates = record_table(
        rows,
        ("rate", lambda row: row.rate),
        ("total", lambda row: ampere_hours(row.total_Ah, whole)),
        ("CC part", lambda row: ampere_hours(row.cc_Ah, whole)),
        ("CV part", lambda row: ampere_hours(row.cv_Ah, whole)),
        ("tests", lambda row: row.n),
        ("spread", lambda row: ampere_hours(row.spread_Ah, whole) if row.n > 1 else ""),
        ("coulombic efficiency", lambda row: _efficiency(row.coulombic_efficiency)),
        caption="Charge taken out from full to the lower limit: at constant current (CC), "
        "and while the tester held the limit (CV). Means per rate.",
    )
    choices = record_table(
        identification.capacities.items(),
        ("choice", lambda one: one[0]),
        ("capacity", lambda one: ampere_hours(one[1], taken)),
        ("against the taken one", lambda one: percent(one[1] / taken - 1.0, 1)),
        caption="Every capacity these logs offer; the marked one defines SOC.",
        marked=names.index(chosen) if chosen in names else None,
    )
    content = beside(rates if rows else "", choices)
    lines = [
        f"{test.name} ({significant(test.current_A)} A): {notice}"
        for test in identification.capacity_tests
        for notice in test.notices
    ]
    if lines:
        content = Markup(content + details("Notices on single tests", bullets(lines)))
    return content


def _efficiency(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


@pictured(
    "capacity",
    "First: charge that came out at each rate; a fast discharge meets the lower limit early, "
    "and the remainder flows only while the limit is held. Then: the numbers that could be "
    "called the capacity. SOC, OCV and every table refer to the one that is taken, so a wrong "
    "one tilts them all.",
)
def capacity_picture(identification: Identification) -> style.Figure:
    """Bars of CC and CV charge per rate; dots of the choices."""
    rows = capacity_rows(identification)
    longest = max(len(rows), len(identification.capacities))
    figure = style.new_figure(min(1.3 + 0.24 * longest, 5.0))
    axes = style.panels(figure, 1, 2 if rows else 1)
    if rows:
        _draw_rates(axes[0], rows)
    _draw_choices(axes[-1], identification, 0.41 if rows else 0.9)
    return figure


def _draw_rates(axes: style.Axes, rows: tuple[CapacityRow, ...]) -> None:
    place = np.arange(len(rows))
    axes.barh(place, [r.cc_Ah for r in rows], 0.6, color=style.BLUE, label="constant current")
    held = [max(r.cv_Ah, 0.0) for r in rows]
    if max(held) > 5e-4 * rows[0].total_Ah:
        axes.barh(
            place,
            held,
            0.6,
            left=[r.cc_Ah for r in rows],
            color=style.AMBER,
            label="limit held (CV)",
        )
        axes.set_ylim(len(rows) + 0.1, -0.6)  # a free row for the legend
        style.legend(axes, place="lower left", columns=2)
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
    style.finding(axes, text, 0.42)
    style.labels(axes, "charge [Ah]", "rate [1/h]")


def _draw_choices(axes: style.Axes, identification: Identification, share: float) -> None:
    names = list(identification.capacities)
    values = np.array([identification.capacities[n] for n in names])
    taken = identification.model.capacity_Ah
    place = np.arange(len(names))
    axes.hlines(place, taken, values, color=style.MUTED, linewidth=1.0)
    axes.plot(values, place, "o", color=style.INK, markersize=5)
    axes.axvline(taken, color=style.VERMILLION, linewidth=1.3)
    if identification.capacity_choice in names:
        axes.plot(
            [taken],
            [names.index(identification.capacity_choice)],
            "o",
            color=style.VERMILLION,
            ms=8,
        )
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    low, high = values.min() / taken - 1.0, values.max() / taken - 1.0
    text = f"{identification.capacity_choice} taken: {ampere_hours(taken)}"
    style.finding(axes, text + _spread(low, high) if len(names) > 1 else text, share)
    style.labels(axes, "capacity [Ah]", "choice")


def _spread(low: float, high: float) -> str:
    """How the other choices lie to the taken one, as shares of it."""
    if high < 5e-4:
        return f"; the others are up to {percent(-low, 1)} smaller"
    if low > -5e-4:
        return f"; the others are up to {percent(high, 1)} larger"
    return f"; the others lie {percent(low, 1)} to +{percent(high, 1)} from it"

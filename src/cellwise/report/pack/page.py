"""The page of a pack: what it can give, which cell limits it, which sensor is odd."""

from __future__ import annotations

from pathlib import Path

from cellwise.pack.pack_estimate import PackEstimate
from cellwise.report.pack.pictures import pack_pictures
from cellwise.report.page.markup import Markup, details, lead_of, paragraph, table, tiles
from cellwise.report.page.numerals import millivolt, percent, plural, significant
from cellwise.report.page.picture import FigureFiles
from cellwise.report.page.section import Section, write_page


def pack_page(
    found: PackEstimate, path: str | Path, *, figures: str | Path | FigureFiles | None = None
) -> Path:
    """Write the page of a pack.

    Raises
    ------
    InputError        matplotlib is missing; the path cannot be written
    """
    time, load, estimates, sensors = pack_pictures(found)
    data = found.to_dict()
    causes = [
        f"{cause['name']}: {'; '.join(cause['evidence'])}"
        + (f" (or {', '.join(cause['confusable_with'])})" if cause["confusable_with"] else "")
        for cause in data["causes"]
    ]
    sections = [
        Section("cells", "Cells over time", (time,), "Over time"),
        Section("load", "At rest and under load", (load,), "Rest and load"),
        Section("estimates", "Capacity and resistance", (estimates,), "Estimates"),
        Section("sensors", "Sensors and polling", (sensors,), "Sensors"),
        Section("table", "Every cell", (details("the numbers", _table(found)),), "Table"),
    ]
    return write_page(
        path,
        _first_line(found),
        f"{len(found.names)} cells, {plural(len(found.days), 'log')}, by cellwise",
        sections,
        data,
        lead=lead_of([*causes, *data["notices"]], _figures(found)),
        figures=figures,
    )


def _first_line(found: PackEstimate) -> str:
    cells = list(dict.fromkeys(c["cell"] for c in found.causes))
    if not cells:
        return f"{len(found.names)} cells, and none is odd"
    named = ", ".join(cells[:4]) + (f" and {len(cells) - 4} more" if len(cells) > 4 else "")
    return f"{named} of {len(found.names)} cells: {found.causes[0]['name'].replace('_', ' ')}"


def _figures(found: PackEstimate) -> Markup:
    data = found.to_dict()
    soc, weakest = data["soc"], data["weakest"]
    facts = [
        ("SOC, lowest to highest", f"{percent(soc['min'], 1)} to {percent(soc['max'], 1)}"),
        ("usable as the cells are", f"{significant(data['usable_Ah'], 4)} Ah"),
        ("balancing would bring", f"{significant(data['balancing_gain_Ah'], 2)} Ah"),
        ("least SOC", weakest["by_soc"]),
        ("least capacity", weakest["by_capacity"]),
        ("most resistance", weakest["by_resistance"]),
    ]
    text = paragraph(
        "The least and most are those of any pack: weak is only who is named as such above."
    )
    return Markup(f"{tiles(facts)}\n{text}")


def _table(found: PackEstimate) -> Markup:
    head = ("cell", "SOC", "±", "capacity Ah", "±", "resistance", "±", "offset mV", "polled s",
            "left mV")  # fmt: skip
    rows = [
        (
            row["name"],
            percent(row["soc"], 2),
            percent(row["soc_std"], 2),
            significant(row["capacity_Ah"], 4),
            significant(row["capacity_std_Ah"], 2),
            significant(row["resistance_scale"], 4),
            significant(row["resistance_std"], 2),
            millivolt(row["offset_V"]),
            significant(row["skew_s"], 2),
            millivolt(row["voltage_rmse_V"]),
        )
        for row in found.to_dict()["per_cell"]
    ]
    return Markup(table(head, rows))

"""What the model explains and where it ends: its own logs, the effects tried, its validity."""

from __future__ import annotations

import math

from cellwise.cell.plausibility.validity import Validity
from cellwise.identify.identification import Identification, OwnLog
from cellwise.report.page.markup import Markup, table
from cellwise.report.page.numerals import celsius, millivolt, percent, significant

ROLES = {"hppc": "HPPC", "ocv": "low rate", "capacity": "capacity", "drive": "drive"}


def scope_content(identification: Identification) -> Markup:
    """Tables of every log given, of the effects that were tried, and of the validity."""
    return Markup(
        _own_logs(identification.own_logs)
        + _effects(identification)
        + _validity(identification.model.validity)
    )


def _own_logs(logs: tuple[OwnLog, ...]) -> Markup:
    rows = []
    for own in logs:
        s = own.simulation
        rows.append(
            (
                s.log.name or "log",
                ROLES[own.role],
                "yes" if own.used else "no",
                percent(s.soc0),
                millivolt(s.metrics.rmse_V),
                _volt(s.rmse_above_10pct_V),
                _volt(own.sides_V.get("discharge")),
                _volt(own.sides_V.get("charge")),
                own.reason,
            )
        )
    head = (
        "log", "test", "in the fit", "initial SOC", "RMSE", "above 10 % SOC", "discharge", "charge",
        "remarks",
    )  # fmt: skip
    return table(
        head,
        rows,
        caption="Every log given, simulated back with the finished model from its initial SOC.",
        text_columns=(0, 1, 2, 8),
    )


def _effects(identification: Identification) -> Markup:
    found = identification.to_dict()["effects"]
    rows = [
        (
            str(effect["name"]).replace("_", " "),
            "in the model" if effect["accepted"] else "refused",
            "" if effect["gain"] is None else percent(effect["gain"]),
            effect["reason"],
        )
        for effect in found
    ]
    return table(
        ("effect", "decision", "gain", "why"),
        rows,
        caption="Effects beyond the two RC branches. Gain: fall of the RMSE on logs held out.",
        text_columns=(0, 1, 3),
    )


def _validity(validity: Validity) -> Markup:
    rows: list[tuple[str, str]] = []
    if validity.soc is not None:
        rows.append(("SOC", " to ".join(percent(v) for v in validity.soc)))
    if validity.temperature_C is not None:
        rows.append(("temperature", " to ".join(celsius(v) for v in validity.temperature_C)))
    if validity.current_A is not None:
        rows.append(("current", " to ".join(significant(v) for v in validity.current_A) + " A"))
    if not rows:
        return Markup("")
    return table(
        ("quantity", "covered by the data"),
        rows,
        caption="Outside, every command says so and the standard deviation grows.",
        text_columns=(0, 1),
    )


def _volt(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else millivolt(value)

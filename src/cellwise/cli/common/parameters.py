"""What the adaptive estimator estimated: rows for people, columns for files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cellwise.cli.common import printing

if TYPE_CHECKING:
    from cellwise.estimate.trace import Trace

UNITS = {"offset_A": ("sensor offset", "A"), "gain": ("sensor gain", ""),
         "capacity_Ah": ("capacity", "Ah"), "resistance_scale": ("R0, R1 times", ""),
         "polarisation_scale": ("R2 times", "")}  # fmt: skip


def parameter_rows(data: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of the table of a replay; none for an estimator without parameters."""
    values = data.get("parameters")
    if values is None:
        return []
    rows = []
    for name, (label, unit) in UNITS.items():
        one = values[name]
        text = f"{one['value']:.4f} +- {2 * one['std']:.4f} {unit}".rstrip()
        if one["held"] is not None:
            text += f" (held: {one['held']})"
        elif one["probability"] is not None:
            text += f" ({100 * one['probability']:.0f} % that it is not the model's)"
        rows.append((label, text))
    soh = f"{printing.percent(values['soh_capacity'], 1)} % by capacity, resistance x "
    rows.append(("state of health", soh + f"{values['soh_resistance']:.3f}"))
    return rows


def parameter_columns(trace: Trace) -> dict[str, Any]:
    """Columns of the file of a replay; none for an estimator without parameters."""
    from cellwise.estimate.adaptive.trace import AdaptiveTrace

    if not isinstance(trace, AdaptiveTrace):
        return {}
    names = ("offset_A", "offset_std_A", "gain", "gain_std", "capacity_Ah", "capacity_std_Ah",
             "resistance_scale", "resistance_std", "polarisation_scale",
             "polarisation_std")  # fmt: skip
    held = dict(zip(("held_offset", "held_resistance", "held_charge"), trace.held, strict=True))
    return {name: getattr(trace, name) for name in names} | held

"""A suspicion in the words and units of `cellwise diagnose`."""

from __future__ import annotations

from typing import Any

from cellwise.cell.model import CellModel
from cellwise.pack.suspicion import Suspicion

TWO_SIDED_95 = 1.96
DAY_H = 24.0


def cause_of(
    one: Suspicion, name: str, model: CellModel, period: int, periods: int
) -> dict[str, Any]:
    """One entry of ``causes``: name, cell, parameters with 95 % intervals, evidence."""
    value, std, text = _in_units(one, model)
    low, high = sorted((value - TWO_SIDED_95 * std, value + TWO_SIDED_95 * std))
    against = "its own past" if one.changed else "the other cells"
    parameter = one.explanation.parameter
    lines = [f"{name}: {text} against {against}"]
    if periods > 1:
        lines.append(f"found in period {period + 1} of {periods}")
    return {
        "name": one.explanation.cause,
        "cell": name,
        "probability": one.probability,
        "parameters": {parameter: value},
        "ci95": {parameter: [low, high]},
        "of": "sensor" if one.explanation.sensor else "cell",
        "changed": one.changed,
        "period": period + 1,
        "gain": one.gain,
        "evidence": lines,
        "confusable_with": list(one.others),
    }


def _in_units(one: Suspicion, model: CellModel) -> tuple[float, float, str]:
    """Value, deviation and text of the parameter that the cause has in `cellwise diagnose`."""
    size, std = one.size, one.std
    capacity = model.capacity_Ah
    match one.explanation.cause:
        case "capacity":
            return (
                capacity * (1.0 + size), capacity * std,
                f"capacity {100 * size:+.1f} +- {100 * std:.1f} %",
            )  # fmt: skip
        case "resistance_scale":
            return 1.0 + size, std, f"resistance {100 * size:+.1f} +- {100 * std:.1f} %"
        case "initial_soc":
            return size, std, f"SOC {100 * size:+.2f} +- {100 * std:.2f} points"
        case "self_discharge":
            ampere = capacity / DAY_H
            return (
                ampere * size, ampere * std,
                f"loses {1e3 * ampere * size:.2g} +- {1e3 * ampere * std:.1g} mA",
            )  # fmt: skip
        case "voltage_offset":
            return size, std, f"its voltage reads {1e3 * size:+.1f} +- {1e3 * std:.1f} mV"
        case _:
            return size, std, f"polled {size:+.2f} +- {std:.2f} s later"

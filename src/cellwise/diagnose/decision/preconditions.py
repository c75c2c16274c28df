"""When no diagnosis is possible: too little data, or a log of another cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellwise.cell.model import CellModel
from cellwise.diagnose.fit.least_squares import Fit
from cellwise.diagnose.fit.rows import IGNORED, Evidence
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

SHORTEST_S = 300.0
FEWEST_ROWS = 60
QUIET_C = 0.02
# A cell of the model's kind stays within this of its OCV and drops, whatever its age.
OTHER_CELL_V = 0.12
OTHER_CELL_SOC = 0.25
# Logs this far outside the model's temperatures are of a temperature it was not measured at [K].
OUTSIDE_K = 8.0


def too_little(model: CellModel, logs: Sequence[CellLog]) -> str:
    """What is missing for any verdict; empty if nothing is."""
    duration = sum(g.duration_s for g in logs)
    rows = sum(int(np.isfinite(g.voltage_V).sum()) for g in logs)
    if rows < FEWEST_ROWS or duration < SHORTEST_S:
        return (
            f"too short: {rows} rows with a voltage over {duration:.0f} s; at least {FEWEST_ROWS} "
            f"rows over {SHORTEST_S:.0f} s are needed"
        )
    current = np.concatenate([g.current_A[np.isfinite(g.current_A)] for g in logs])
    if current.size == 0:
        return "no current in the log"
    swing = float(np.quantile(np.abs(current), 0.99))
    if swing < QUIET_C * model.capacity_Ah:
        return (
            f"too quiet: the current stays below {swing:.3g} A "
            f"({swing / model.capacity_Ah:.3f} C); a load of C/20 or more is needed"
        )
    return ""


def another_cell(model: CellModel, evidence: Evidence, base: Fit, soc: FloatArray) -> str:
    """Why the log cannot be of the model's kind of cell; empty if it can.

    ``base`` is the best the model can do within its tolerances. A voltage far outside the model's
    window, a charge beyond any capacity, or an error no fault explains is another cell.
    """
    used = evidence.known & (evidence.role != IGNORED)
    voltage = evidence.voltage_V[used]
    low, high = float(np.min(model.ocv_V)), float(np.max(model.ocv_V))
    middle = float(np.median(voltage))
    if middle > high + OTHER_CELL_V or middle < low - OTHER_CELL_V:
        return (
            f"the log's median voltage {middle:.2f} V lies outside the model's OCV "
            f"({low:.2f} to {high:.2f} V)"
        )
    lowest, highest = float(np.min(soc[used])), float(np.max(soc[used]))
    if lowest < -OTHER_CELL_SOC or highest > 1.0 + OTHER_CELL_SOC:
        moved = (highest - lowest) * model.capacity_Ah
        return f"the log moves {moved:.3g} Ah through a model of {model.capacity_Ah:.3g} Ah"
    error = float(np.median(np.abs(evidence.voltage_V[used] - base.voltage_V[used])))
    if error > OTHER_CELL_V:
        return f"the model is {1e3 * error:.0f} mV off in the median, more than any fault explains"
    return ""


def unseen_temperature_C(model: CellModel, evidence: Evidence) -> float | None:
    """The logs' temperature where the model was not measured at it; None where it was."""
    middle = float(np.median(np.concatenate([g.temperature_C for g in evidence.logs])))
    seen = [*model.temperature_C, *(model.validity.temperature_C or ())]
    inside = float(min(seen)) - OUTSIDE_K <= middle <= float(max(seen)) + OUTSIDE_K
    return None if inside else middle

"""A log so far from the model that nothing which follows from both can be believed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.plausibility.notice import Notice
from cellwise.cell.stated_error import stated_error_V
from cellwise.logs.checks.grave import is_grave
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

# Half of a log's rows beyond so many of the model's own standard deviations: the model's statement
# of its error does not hold for this log. Of one that is right, half are within 0.7.
FAR_OFF = 3.0
FIRST_V = 1e3  # above what is said of a current or a SOC outside of the model's data
MOST_ROWS = 4000  # of more, every so manyth
OTHER = "a log of another cell, number of cells in series (`series=N`), temperature or age"
WITHHELD = "remaining time and health would be made of it: withheld (`anyway=True` gives them)"


def times_stated(
    model: CellModel, log: MeasuredLog, error_V: FloatArray, soc: FloatArray
) -> tuple[float, float]:
    """Median error of the rows, in standard deviations that the model states there, and in volts.

    Parameters
    ----------
    error_V : (n,) float      measured minus model, NaN where nothing was measured
    soc : (n,) float          where the model was
    """
    rows = np.flatnonzero(np.isfinite(error_V) & np.isfinite(soc))
    rows = rows[:: max(rows.size // MOST_ROWS, 1)]
    if rows.size == 0:
        return 0.0, 0.0
    stated_V = stated_error_V(model, log, soc, log.voltage_V - error_V)[rows]
    error = np.abs(error_V[rows])
    times = float(np.median(error / np.maximum(stated_V, 1e-6)))
    return times, float(np.median(error))


def far_off_text(
    model: CellModel | None, log: MeasuredLog, error_V: FloatArray, soc: FloatArray
) -> str | None:
    """What is said first of a log that is far off; None of one that is not, or without a model."""
    if model is None:
        return None
    times, typical_V = times_stated(model, log, error_V, soc)
    if times <= FAR_OFF or not math.isfinite(times):
        return None
    return (
        f"'{log.name or 'the log'}' is FAR OFF this model: typically {1e3 * typical_V:.0f} mV, "
        f"{times:.3g} times what the model states of itself: {OTHER} than the model's?"
    )


def far_off_notices(
    model: CellModel | None, log: MeasuredLog, error_V: FloatArray, soc: FloatArray
) -> list[Notice]:
    """The same as a notice: after one that names the unit or the temperature, before all others."""
    text = far_off_text(model, log, error_V, soc)
    return [] if text is None else [Notice(FIRST_V, text)]


def ends_forecasts(far_off: str | None, log: MeasuredLog) -> str | None:
    """Why nothing is foreseen from a log: a channel is not what it is taken for, or far off."""
    grave = next((n for n in log.notices if is_grave(n)), None)
    if grave is not None:
        return f"{grave}; {WITHHELD}"
    return None if far_off is None else f"{far_off} {WITHHELD[0].upper()}{WITHHELD[1:]}"

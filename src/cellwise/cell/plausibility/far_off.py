"""A log so far from the model that nothing which follows from both can be believed."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.plausibility.notice import Notice
from cellwise.cell.stated_error import stated_error_at, stated_error_V
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
# Of a stream: an hour, a look a second; before half a minute a start that is off says nothing.
LOOKS, FEWEST_LOOKS = 3600, 30
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
    return _said(f"'{log.name or 'the log'}'", times, typical_V)


def _said(what: str, times: float, typical_V: float) -> str | None:
    if times <= FAR_OFF or not math.isfinite(times):
        return None
    return (
        f"{what} is FAR OFF this model: typically {1e3 * typical_V:.0f} mV, "
        f"{times:.3g} times what the model states of itself: {OTHER} than the model's?"
    )


class FarOffStream:
    """The same of a stream: of its last hour, by one look a second."""

    def __init__(self, model: CellModel) -> None:
        self._model = model
        self._since_s = math.inf
        self._seen: deque[tuple[float, float]] = deque(maxlen=LOOKS)
        self.text: str | None = None

    def look(
        self, dt_s: float, error_V: float, soc: float, voltage_V: float, temperature_C: float
    ) -> None:
        """One sample: measured minus predicted, where the model is; then ``text`` is true of it."""
        self._since_s += dt_s
        if self._since_s < 1.0 or not math.isfinite(error_V):
            return
        self._since_s = 0.0
        warm = temperature_C if math.isfinite(temperature_C) else None
        stated_V = max(float(stated_error_at(self._model, soc, voltage_V, warm)), 1e-6)
        self._seen.append((abs(error_V) / stated_V, abs(error_V)))
        if len(self._seen) >= FEWEST_LOOKS:
            self.text = _said("the stream", *np.median(self._seen, axis=0).tolist())


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
    return None if far_off is None else withheld(far_off)


def withheld(far_off: str) -> str:
    """What is far off, and what is therefore not said."""
    return f"{far_off} {WITHHELD[0].upper()}{WITHHELD[1:]}"

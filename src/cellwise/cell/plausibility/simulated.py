"""What a simulated or filtered log shows against the model: charge, SOC, size of the error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cellwise.cell.metrics import band_metrics, error_metrics
from cellwise.cell.plausibility.far_off import FAR_OFF, OTHER
from cellwise.cell.plausibility.notice import RANGE_V, Notice
from cellwise.cell.stated_error import stated_error_V
from cellwise.logs.measured_log import MeasuredLog
from cellwise.typing import FloatArray

if TYPE_CHECKING:
    from cellwise.cell.model import CellModel

# No cell holds this much more than another of its kind.
MUCH_CHARGE = 1.15
SHOWN_SOC = 5e-4  # what shows in three digits
NEAR_EMPTY = 0.1
LEAST_V = 1e-4  # no voltage is known better
NO_MODEL_V = 0.2  # a voltage this far off says no SOC: a cell's goes over 0.5 to 1.5 V
MANY_REJECTED = 0.1


def soc_notices(log: MeasuredLog, soc: FloatArray) -> list[Notice]:
    """A SOC outside 0..1, and more charge than such a cell holds.

    Parameters
    ----------
    soc : (n,) float      simulated, or counted
    """
    low, high = float(np.min(soc)), float(np.max(soc))
    if not math.isfinite(low + high):
        low, high = float(np.nanmin(soc)), float(np.nanmax(soc))
    outside = max(-low, high - 1.0)
    if outside <= SHOWN_SOC:
        return []
    name = f"'{log.name or 'the log'}'"
    ran = f"SOC from {low:.3f} to {high:.3f}, outside 0..1"
    moved = float(np.ptp(log.counted_charge_Ah()))
    if high - low > MUCH_CHARGE:
        return [
            Notice(
                math.inf,  # every other figure follows from it
                f"{name} moves {moved:.4g} Ah, {high - low:.3g} times the model's capacity ({ran}):"
                " the unit of the current (mA?), the cells in parallel (`parallel=N`), or a log of "
                "another cell?",
            )
        ]
    return [
        Notice(
            RANGE_V * outside,
            f"{name} runs through {ran}, beginning at {soc[0]:.3f}: check the initial SOC "
            "(`soc0=X` states it) and the capacity",
        )
    ]


def error_notices(
    model: CellModel | None, log: MeasuredLog, error_V: FloatArray, soc: FloatArray
) -> list[Notice]:
    """An error beyond what the model states of itself, overall or at some SOC: where it is largest.

    A model of logs that contradict each other states a large error, so one of `NO_MODEL_V` is said
    whatever is stated.

    Parameters
    ----------
    error_V : (n,) float      measured minus model, NaN where nothing was measured
    soc : (n,) float
    """
    all_rows = error_metrics(error_V)
    if model is None or all_rows.samples == 0:
        return []
    stated_V = stated_error_V(model, log, soc, log.voltage_V - error_V)
    of_stated = error_V / np.maximum(stated_V, LEAST_V)
    everywhere = error_metrics(of_stated).rmse_V > FAR_OFF
    somewhere = max(b.metrics.rmse_V for b in band_metrics(of_stated, soc)) > FAR_OFF
    if not (everywhere or somewhere or all_rows.max_error_V >= NO_MODEL_V):
        return []
    row = int(np.nanargmax(np.abs(error_V)))
    at = round(float(soc[row]), 3) + 0.0  # no minus before zero
    text = (
        f"'{log.name or 'the log'}' is up to {1e3 * all_rows.max_error_V:.0f} mV off (RMSE "
        f"{1e3 * all_rows.rmse_V:.0f} mV), most at SOC {at:.3f} after "
        f"{(log.time_s[row] - log.time_s[0]) / 3600.0:.2f} h"
    )
    if everywhere:
        text += f": {OTHER} than the model's, or another initial SOC?"
    elif at < NEAR_EMPTY:
        text += ": near empty, where the OCV is steep and the resistance high"
    return [Notice(all_rows.rmse_V, text)]


def prediction_notices(log: MeasuredLog, rmse_V: float, rejected: float) -> list[Notice]:
    """A filter that used no voltage, or refuses many.

    Parameters
    ----------
    rmse_V : float        of the voltages predicted one step ahead; NaN: none was used
    rejected : float      share of the rows whose voltage was rejected
    """
    name = f"'{log.name or 'the log'}'"
    if math.isnan(rmse_V):
        if not np.any(np.isfinite(log.voltage_V)):
            return []
        text = f"no voltage of {name} was used: all are missing, or outside what a sensor reads"
        return [Notice(RANGE_V, f"{text} (another pack count?)")]
    if rejected < MANY_REJECTED:
        return []
    text = (
        f"the voltage of {name} is {1e3 * rmse_V:.0f} mV off one step ahead (RMSE) and was "
        f"rejected in {100.0 * rejected:.0f} % of the rows"
    )
    return [Notice(max(rmse_V, RANGE_V * rejected), f"{text}: {OTHER} than the model's?")]

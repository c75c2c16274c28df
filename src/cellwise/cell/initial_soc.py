"""SOC at a log's first row when nobody says it: from a rest, else from a short fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwise.cell.effects import Hysteresis
from cellwise.cell.model import CellModel
from cellwise.cell.simulate import (
    best_start_soc,
    check_soc0,
    known_temperature_C,
    model_temperature_C,
)
from cellwise.logs.cell_log import CellLog
from cellwise.typing import FloatArray

REST_RATE = 0.01  # below C/100 a cell counts as resting
FIT_S = 60.0
SHORT_REST_V = 0.010  # what may be left of an unknown past when the rest seen is short
RELAXED_S = 1800.0
STATED_STD = 0.005  # a start that is known: full and empty of two tests differ by about this
# By how much a used cell's resistance differs from its model's; aged or cold ones by more.
UNKNOWN_RESISTANCE = 0.3
HALF_NORMAL = 0.8  # mean of a half normal distribution, in its deviations: sqrt(2 / pi)


@dataclass(frozen=True)
class InitialSoc:
    """SOC at the first row, its standard deviation, and how it was found."""

    soc: float
    std: float
    how: str

    def to_dict(self) -> dict[str, float | str]:
        """As JSON values."""
        return {"value": self.soc, "std": self.std, "how": self.how}


def initial_soc(
    model: CellModel,
    log: CellLog,
    given: float | None = None,
    given_std: float = 0.15,
    *,
    likeliest: bool = False,
) -> InitialSoc:
    """SOC at the first row of a log.

    Taken as given, else as the log states it (`CellLog.soc0`); else from the voltage of a rest at
    the log's start through the OCV; else from the SOC at which the simulation fits the log's first
    minute best.

    Parameters
    ----------
    given : float or None     SOC that the user states, 0..1
    given_std : float         how sure that is
    likeliest : bool          under load, the SOC that fits best instead of the mean of all that
                              are possible: for a simulation, which has to be one of them

    Returns
    -------
    InitialSoc        the standard deviation includes the model's own voltage error, an unfinished
                      relaxation and a flat OCV: on a plateau it is large
    """
    if given is not None:
        check_soc0(given)
        return InitialSoc(float(given), given_std, "given")
    if log.soc0 is not None:
        return InitialSoc(log.soc0, STATED_STD, "stated")
    current = log.known_current_A()
    resting = np.abs(current) < REST_RATE * model.capacity_Ah
    resting[: int(np.argmax(np.isfinite(log.interval_current_A)))] = False  # nobody knows
    moving = np.flatnonzero(~resting)
    rest_end = int(moving[0]) if moving.size else len(log)
    voltages = log.voltage_V[:rest_end]
    if np.any(np.isfinite(voltages)):
        last = int(np.flatnonzero(np.isfinite(voltages))[-1])
        rest_s = float(log.time_s[last] - log.time_s[0])
        unfinished = SHORT_REST_V * np.exp(-rest_s / RELAXED_S)
        return _from_rest(model, log, last, rest_s, unfinished)
    return _from_first_minute(model, log, current, likeliest)


def soc_of_ocv(
    model: CellModel, voltage_V: float, std_V: float, temperature_C: float
) -> tuple[float, float]:
    """SOC at which the OCV is a given voltage, and its standard deviation.

    On a flat OCV every SOC within ``std_V`` is as good: the mean and the spread of all of them.
    """
    cold = model.at_temperature(temperature_C)
    gap = np.abs(np.broadcast_to(cold.effect(Hysteresis).m_V, cold.ocv_V.shape)[0])
    soc = np.linspace(0.0, 1.0, 2001)
    ocv = np.interp(soc, cold.soc, cold.ocv_V[0])
    known = np.hypot(std_V, model.slow_error_V(soc))
    spread = np.hypot(known, np.interp(soc, cold.soc, gap))
    # Beyond the table's ends the nearest end is the answer, not an unlikely one.
    target = min(max(voltage_V, float(ocv[0])), float(ocv[-1]))
    weight = np.exp(-0.5 * ((ocv - target) / spread) ** 2)
    mean = float(np.average(soc, weights=weight))
    std = float(np.sqrt(np.average((soc - mean) ** 2, weights=weight)))
    best = float(soc[int(np.argmin(np.abs(ocv - target)))])
    return (best, std) if abs(best - mean) < std else (mean, std)


def _from_rest(model: CellModel, log: CellLog, row: int, rest_s: float, std_V: float) -> InitialSoc:
    temperature = known_temperature_C(model, log)[row]
    soc, std = soc_of_ocv(model, float(log.voltage_V[row]), std_V, float(temperature))
    how = f"rest of {rest_s:.0f} s at the start, {log.voltage_V[row]:.4f} V"
    return InitialSoc(soc, max(std, 0.005), how)


def _from_first_minute(
    model: CellModel, log: CellLog, current: FloatArray, likeliest: bool
) -> InitialSoc:
    first = int(np.flatnonzero(np.isfinite(log.voltage_V))[0])
    rows = max(first + 2, int(np.searchsorted(log.time_s, log.time_s[first] + FIT_S, side="right")))
    head = replace(log.part(0, rows), current_A=current[:rows], current_meaning="interval_end")
    if log.temperature_C is None:
        head = replace(head, temperature_C=np.full(len(head), model_temperature_C(model)))
    best, _ = best_start_soc(model, head, np.linspace(0.0, 1.0, 101))
    near = np.linspace(max(0.0, best - 0.01), min(1.0, best + 0.01), 41)
    best, rms = best_start_soc(model, head, near)
    # The cell did not begin at rest here, so its past is in the voltage; and what the fit takes
    # for a low SOC may be a high resistance: say so in the spread.
    temperature = float(known_temperature_C(model, head)[0])
    ocv = float(np.interp(best, model.soc, model.at_temperature(temperature).ocv_V[0]))
    dropped = ocv - float(np.nanmean(head.voltage_V))
    std_V = float(np.sqrt(SHORT_REST_V**2 + rms**2 + (UNKNOWN_RESISTANCE * dropped) ** 2))
    _, std = soc_of_ocv(model, ocv, std_V, temperature)
    # Beyond full and empty there is nothing: at an end, the mean of the remaining part lies inside.
    inside = 0.0 if likeliest else min(HALF_NORMAL * std, 0.5)
    best = min(max(best, inside), 1.0 - inside)
    return InitialSoc(best, max(std, 0.01), f"fit of the first {head.duration_s:.0f} s under load")

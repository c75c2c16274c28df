"""Replay of a flight or a drive: remaining time and energy if the load goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from cellwise.arguments import check_kind, choice, number
from cellwise.cell.effects import SelfHeating
from cellwise.cell.equations import CellState, empty_state
from cellwise.cell.model import CellModel
from cellwise.cell.packed import place_of, size_of
from cellwise.cell.plausibility.sizes import check_is_model
from cellwise.cell.plausibility.validity import UNKNOWN, Validity
from cellwise.cell.plausibility.validity_kernels import validity_scalars
from cellwise.cell.simulate import known_temperature_C, start_hysteresis
from cellwise.errors import InputError
from cellwise.estimate.power.limits import LEAST_LOAD_C
from cellwise.estimate.replay import Replay
from cellwise.forecast.forecast_kernels import (
    BY_VOLTAGE,
    NEVER,
    USUAL_MEMORY_SOC,
    ForecastOutcome,
    Uncertain,
)
from cellwise.forecast.log_kernels import (
    WINDOW_S,
    FilteredRows,
    LoadAhead,
    asks_temperature,
    forecast_rows,
)
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import BoolArray, FloatArray

Hold = Literal["power", "current"]

MOST_FORECASTS = 400
# A load below this share of the one at which a usual ampere-hour is drawn is that of standing.
STANDING = 0.2
PEAK_SHARE = 1e-3  # of the rows are beyond a usual peak
# What of a moment is said of a charge.
ON_CHARGER = (
    *("time_s", "soc", "soc_std", "remaining_s", "remaining_s_band", "remaining_Wh"),
    *("remaining_Wh_band", "end_soc"),
)


class Forecast(NamedTuple):
    """Remaining time and energy at one moment, with bands of two standard deviations.

    A band holds what is not known of the SOC, how far the model's voltage may come to lie off what
    it is off by now, how the cell may warm, and that it has the model's capacity to its share.
    It takes the load to stay. ``time_s``, ``soc`` and ``soc_std`` are those of the moment,
    ``load_A`` and ``load_W`` the load that goes on, positive on discharge; ``remaining_s`` [s] and
    ``remaining_Wh`` lead to empty, on a charger to full, infinite where that never comes;
    ``remaining_s_band``, ``remaining_Wh_band`` and ``end_voltage_V_band`` are the bands' two ends.

    ``end_voltage_V`` and ``end_soc`` are those of the moment at which the cell is empty, ``by``
    says why it is: its charge ends, or its voltage reaches the cutoff.
    """

    time_s: float
    soc: float
    soc_std: float
    load_A: float
    load_W: float
    remaining_s: float
    remaining_s_band: tuple[float, float]
    remaining_Wh: float
    remaining_Wh_band: tuple[float, float]
    end_voltage_V: float
    end_voltage_V_band: tuple[float, float]
    end_soc: float
    by: str


@dataclass(frozen=True, eq=False, repr=False)
class ForecastTrace(Plottable, Tabular):
    """Forecasts along a log; arrays have shape (moments,), bands (moments, 2).

    ``load_A`` is the mean current of the last minute, the present load; a moment without a
    load of at least C/50 has no forecast. ``typical`` is the same at the usual load, the mean
    of all these under way: that of the last minute swings with every bend. The lower end of its
    band is where the load's usual peaks first press the voltage to the cutoff. ``given`` is
    what :func:`forecast_at` was asked for beside them, ``stands`` says that the log ends at a rest.
    On a charger the load is negative: time and energy to full, ``cutoff_V`` the voltage that it
    holds, ``taper_A`` the current at its end.
    All are of one cell; ``cells`` is how many the pack has, as the log was read.

    ``time_s``, ``soc`` and ``soc_std`` are those of the moments; ``load_W``, ``remaining_s``,
    ``remaining_Wh``, ``end_voltage_V``, each with its ``..._band`` (``remaining_s_band``,
    ``remaining_Wh_band``, ``end_voltage_V_band``), and ``end_soc`` as in :class:`Forecast`, one for
    each; ``by_voltage`` says which of them end at the cutoff. ``hold`` is what of the load stays,
    ``name`` the log's, ``validity`` the model's.
    """

    name: str
    cutoff_V: float
    hold: Hold
    time_s: FloatArray
    soc: FloatArray
    soc_std: FloatArray
    load_A: FloatArray
    load_W: FloatArray
    remaining_s: FloatArray
    remaining_s_band: FloatArray
    remaining_Wh: FloatArray
    remaining_Wh_band: FloatArray
    end_voltage_V: FloatArray
    end_voltage_V_band: FloatArray
    end_soc: FloatArray
    by_voltage: BoolArray
    typical: ForecastTrace | None = None
    given: Forecast | None = None
    taper_A: float = 0.0
    validity: Validity = UNKNOWN
    cells: int = 1

    def __len__(self) -> int:
        return self.time_s.size

    @property
    def last(self) -> Forecast:
        """The last moment under load."""
        return self.at(len(self) - 1)

    @property
    def stands(self) -> bool:
        """Whether the load of the last minute is none to go on with: a rest's, or of standing."""
        return self.taper_A == 0.0 and not under_way(self.load_A)[-1]

    def at(self, k: int) -> Forecast:
        """One moment."""
        found: dict[str, Any] = {}
        for name in Forecast._fields[:-1]:
            value = getattr(self, name)[k].tolist()
            found[name] = tuple(value) if isinstance(value, list) else value
        return Forecast(**found, by="voltage" if self.by_voltage[k] else "charge")

    def columns(self) -> dict[str, FloatArray]:
        """One row for each moment; a band as two, ``_low`` and ``_high`` before the unit."""
        found: dict[str, FloatArray] = {}
        for name in Forecast._fields[:-1]:
            value = getattr(self, name)
            if value.ndim == 1:
                found[name] = value
                continue
            quantity, _, unit = name.removesuffix("_band").rpartition("_")
            found |= {
                f"{quantity}_{end}_{unit}": value[:, k] for k, end in enumerate(("low", "high"))
            }
        return found

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Remaining time and energy with their bands, and the SOC, over the log's time."""
        hours, to = self.time_s / 3600.0, "full" if self.taper_A > 0.0 else "empty"
        shown = (
            (f"time to {to} [min]", self.remaining_s / 60.0, self.remaining_s_band / 60.0),
            (f"energy to {to} [Wh]", self.remaining_Wh, self.remaining_Wh_band),
            ("SOC", self.soc, 2.0 * self.soc_std),
        )
        return "time [h]", tuple(Panel(label, (Line(label, hours, *x),)) for label, *x in shown)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Whether the last forecast goes where the model's data never were."""
        now = self.last
        if self.validity.soc is None or now.end_soc >= self.validity.bounds().soc_low:
            return ()
        text = (
            f"the forecast goes on to SOC {max(now.end_soc, 0.0):.2f}, and the model's data end at "
            f"SOC {self.validity.soc[0]:.2f}: below, its OCV is an extension, and the band is "
            "widened by that"
        )
        return (Notice(Code.FORECAST_OUTSIDE_DATA, text),)

    def to_dict(self) -> dict[str, Any]:
        """The last moment as JSON values, keys as the command prints them."""
        now = self.last._asdict()
        if self.taper_A > 0.0:
            full = {k.replace("remaining", "full"): v for k, v in now.items() if k in ON_CHARGER}
            charge_A = -self.last.load_A
            return {"limit_V": self.cutoff_V, "taper_A": self.taper_A, **full, "charge_A": charge_A}
        return {
            "cutoff_V": self.cutoff_V,
            "hold": self.hold,
            "window_s": WINDOW_S,
            "moments": len(self),
            "stands": self.stands,
            "cells": self.cells,
            "remaining_pack_Wh": self.cells * self.last.remaining_Wh,
            **now,
            "typical": None if self.typical is None else self.typical.last._asdict(),
        }

    def __repr__(self) -> str:
        now = self.last
        return (
            f"ForecastTrace({self.name or 'log'}: {now.remaining_s:.0f} s and "
            f"{now.remaining_Wh:.3g} Wh remaining at {now.time_s:.0f} s, "
            f"SOC {now.soc:.3f} +- {2 * now.soc_std:.3f})"
        )


def forecast(
    model: CellModel,
    replay: Replay,
    *,
    cutoff_V: float | None = None,
    hold: Hold = "power",
) -> ForecastTrace | None:
    """Remaining time and energy along a replay, at the load of each moment.

    From the filter's SOC, with the branch voltages that the log's current left, the model goes on
    with the mean load of the last minute until the terminal voltage reaches the cutoff or the
    charge ends. What the model was off by of late (an aged cell's resistance) is taken to stay, and
    to grow with the polarisation as far as the model's stated error does. The cell warms by its
    losses as it did so far, or as cells do (`cellwise.forecast.warming_kernels`).

    Parameters
    ----------
    model : CellModel         the one of the replay
    replay : Replay
    cutoff_V : float or None  terminal voltage at which the load gives up; None: the model's lower
                              limit, else its OCV at SOC 0
    hold : str                what of the load is held constant: its ``power`` or its ``current``

    Returns
    -------
    ForecastTrace or None     None where the log holds no load of C/50 or more

    Raises
    ------
    InputError                a cutoff above the model's full OCV, an unknown ``hold``
    """
    check_is_model(model)
    check_kind("replay", replay, Replay, "Write forecast(model, replay(model, log)).")
    cutoff = cutoff_of(model, cutoff_V)
    hold = "power" if choice("hold", hold, get_args(Hold)) == "power" else "current"
    log = replay.log
    load_A, load_W = present_load(log, log.known_current_A())
    wanted = at_most(load_A > LEAST_LOAD_C * model.capacity_Ah)
    if not wanted.any():
        return None
    load = LoadAhead(load_A, np.nan, wanted, hold == "power", cutoff, warms_unseen(model))
    flight = flight_of(model, replay, load, load_W)
    busy = under_way(load_A[wanted])
    usual_A, usual_W = (
        np.full(len(log), np.mean(x[wanted][busy])) for x in (load_A, load_W)
    )  # fmt: skip
    load = load._replace(current_A=usual_A)
    typical = flight_of(model, replay, load, usual_W)
    drop_V = _peak_drop_V(log, load_A >= usual_A)
    at_peaks = flight_of(model, replay, load._replace(cutoff_V=cutoff + drop_V), usual_W)
    for low, band in (
        (at_peaks.remaining_s_band, typical.remaining_s_band),
        (at_peaks.remaining_Wh_band, typical.remaining_Wh_band),
    ):
        np.minimum(band[:, 0], low[:, 0], out=band[:, 0])
    return replace(flight, typical=typical)


def under_way(load_A: FloatArray) -> BoolArray:
    """Loads at which one is under way: the others are those of a vehicle that stands."""
    return np.asarray(load_A > STANDING * np.sum(load_A**2) / np.sum(load_A))


def _peak_drop_V(log: CellLog, busy: BoolArray) -> float:
    """By how much the usual peaks of the load press the voltage below its mean [V]."""
    known = np.isfinite(log.voltage_V)
    time, voltage = log.time_s[known], log.voltage_V[known]
    area = np.cumsum(voltage * np.diff(time, prepend=time[0]))
    begins = time - WINDOW_S
    whole = (begins >= time[0]) & busy[known]
    if not whole.any():
        return 0.0
    mean = (area - np.interp(begins, time, area)) / WINDOW_S
    return max(float(np.quantile((mean - voltage)[whole], 1.0 - PEAK_SHARE)), 0.0)


def forecast_at(
    model: CellModel,
    replay: Replay,
    load: float,
    *,
    cutoff_V: float | None = None,
    hold: Hold = "power",
) -> Forecast:
    """Remaining time and energy from the end of a replay at a load that is given.

    As :func:`forecast`, which see; the load need not be one that the log has seen.

    Parameters
    ----------
    load : float              of one cell: its power [W], or with hold="current" its current [A]

    Raises
    ------
    InputError                a load that is not above zero; what :func:`forecast` raises
    """
    check_is_model(model)
    check_kind("replay", replay, Replay, "Write forecast_at(model, replay(model, log), 5.0).")
    cutoff = cutoff_of(model, cutoff_V)
    check_load(load, hold)
    rows = len(replay.log)
    ocv_V = float(np.interp(replay.trace.soc[-1], model.soc, np.atleast_2d(model.ocv_V)[0]))
    power = hold == "power"
    load_A = np.full(rows, load / ocv_V if power else load)
    wanted, power_W = np.arange(rows) == rows - 1, load if power else np.nan
    asked = LoadAhead(load_A, power_W, wanted, power, cutoff, warms_unseen(model))
    return flight_of(model, replay, asked, load_A * ocv_V).last


def check_load(load: float, hold: str) -> None:
    """Refuse a load that is none.

    Raises
    ------
    InputError        not a finite number above zero
    """
    load = number("load", load, "one number above zero")
    if not (np.isfinite(load) and load > 0.0):
        unit = "W" if hold == "power" else "A"
        raise InputError(
            f"a load of {load:g} {unit}",
            "one above zero, that of one cell",
            f"Give 10 {unit}, say.",
        )


def flight_of(
    model: CellModel, replay: Replay, load: LoadAhead, load_W: FloatArray
) -> ForecastTrace:
    """The wanted rows through the kernel; ``load_W`` is what is said of the load's power.

    An end that never comes is infinite.
    """
    log, trace, rows, wanted = replay.log, replay.trace, filtered_rows(model, replay), load.wanted
    out = np.empty((int(np.count_nonzero(wanted)), size_of(ForecastOutcome)))
    forecast_rows(model.parameters(), start_state(rows), rows, load, uncertain_of(model), out)

    def found(path: str, many: int = 1) -> FloatArray:
        first = place_of(ForecastOutcome, path)
        return out[:, first : first + many] if many > 1 else out[:, first]

    time_s, energy_Wh = found("usual.time_s"), found("usual.energy_J") / 3600.0
    time_s_band, energy_Wh_band = found("time_s", 2), found("energy_J", 2) / 3600.0
    never = found("usual.reason") == NEVER
    time_s[never] = energy_Wh[never] = time_s_band[never, 1] = energy_Wh_band[never, 1] = np.inf
    return ForecastTrace(
        name=log.name,
        cutoff_V=load.cutoff_V,
        hold="power" if load.hold_power else "current",
        time_s=log.time_s[wanted],
        soc=trace.soc[wanted],
        soc_std=np.nan_to_num(trace.soc_std)[wanted],
        load_A=found("load_A"),
        load_W=load_W[wanted],
        remaining_s=time_s,
        remaining_s_band=time_s_band,
        remaining_Wh=energy_Wh,
        remaining_Wh_band=energy_Wh_band,
        end_voltage_V=found("usual.voltage_V"),
        end_voltage_V_band=found("voltage_V", 2),
        end_soc=found("usual.soc"),
        by_voltage=found("usual.reason") == BY_VOLTAGE,
        taper_A=load.taper_A,
        validity=model.validity,
        cells=log.series * log.parallel,
    )


def filtered_rows(model: CellModel, replay: Replay) -> FilteredRows:
    """A replay as the kernels read it."""
    log, trace = replay.log, replay.trace
    measured_C = log.temperature_C
    return FilteredRows(
        log.interval_s,
        np.ascontiguousarray(log.known_current_A()),
        known_temperature_C(model, log),
        np.full(len(log), np.nan) if measured_C is None else np.array(measured_C),
        np.array(log.voltage_V),
        np.ascontiguousarray(trace.soc, dtype=np.float64),
        np.nan_to_num(np.ascontiguousarray(trace.soc_std, dtype=np.float64)),
    )


def start_state(rows: FilteredRows) -> CellState:
    """A cell at rest, as the log begins."""
    return empty_state(rows.soc[0], start_hysteresis(float(rows.soc[0])))


def warms_unseen(model: CellModel) -> bool:
    """Whether a forecast must say how the cell warms although nobody measures a temperature.

    Not of a model on which temperature does nothing, nor of one with a warming of its own.
    """
    own = any(isinstance(effect, SelfHeating) for effect in model.effects)
    return bool(asks_temperature(model.parameters())) and not own


def uncertain_of(model: CellModel) -> Uncertain:
    """What is not known of a cell ahead of its present SOC."""
    error = model.error
    memory_soc = error.correlation_soc or USUAL_MEMORY_SOC
    return Uncertain(error.whole_share(), memory_soc, validity_scalars(model), model.capacity_share)


def cutoff_of(model: CellModel, given: float | None) -> float:
    """The voltage at which a load gives up: as given, the model's limit, its OCV at SOC 0.

    Raises
    ------
    InputError        above the model's full OCV, or not above zero
    """
    if given is None:
        given = model.voltage_min_V
    lowest, highest = float(np.min(model.ocv_V)), float(np.max(model.ocv_V))
    cutoff = lowest if given is None else number("cutoff_V", given, "a voltage of one cell")
    if not 0.0 < cutoff < highest:
        raise InputError(
            f"a cutoff of {cutoff:g} V for a cell of {lowest:.2f} to {highest:.2f} V",
            "a voltage of one cell, below its full one",
            "Give the voltage of a cell, not of the pack.",
        )
    return cutoff


def present_load(
    log: CellLog, current_A: FloatArray, since_s: FloatArray | float = -np.inf
) -> tuple[FloatArray, FloatArray]:
    """Mean current [A] and power [W] of the last minute at every row, of none before."""
    voltage = log.voltage_V
    known = np.isfinite(voltage)
    held = np.interp(np.arange(voltage.size), np.flatnonzero(known), voltage[known])
    charge = np.cumsum(current_A * log.interval_s)
    energy = np.cumsum(current_A * held * log.interval_s)
    begins = np.maximum(np.maximum(log.time_s - WINDOW_S, log.time_s[0]), since_s)
    span = log.time_s - begins
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_A = (charge - np.interp(begins, log.time_s, charge)) / span
        mean_W = (energy - np.interp(begins, log.time_s, energy)) / span
    first = span <= 0
    mean_A[first], mean_W[first] = current_A[first], (current_A * held)[first]
    return mean_A, mean_W


def at_most(possible: BoolArray) -> BoolArray:
    """At most a few hundred of the possible rows, the last among them."""
    rows = np.flatnonzero(possible)
    if rows.size > MOST_FORECASTS:
        places = np.linspace(0, rows.size - 1, MOST_FORECASTS).round().astype(np.int64)
        rows = rows[np.unique(places)]
    wanted = np.zeros(possible.size, dtype=np.bool_)
    wanted[rows] = True
    return wanted

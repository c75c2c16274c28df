"""Replay a log through an estimator and judge it against the tester's own counter."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np

from cellwise.arguments import check_kind, number
from cellwise.cell.initial_soc.initial_soc import InitialSoc, initial_soc
from cellwise.cell.initial_soc.padding import padded_rows
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import (
    ASSUMED_V,
    along_notices,
    find_mismatch,
    in_order,
    prediction_notices,
    reference_notices,
    times_stated,
)
from cellwise.cell.plausibility.sizes import check_log_of
from cellwise.cell.plausibility.validity import UNKNOWN, Validity
from cellwise.cell.simulate import check_soc0, simulate
from cellwise.errors import InputError
from cellwise.estimate.adaptive import AdaptiveTrace
from cellwise.estimate.estimators import Estimator, OnlineFilter, estimator_of
from cellwise.estimate.noise import Noise
from cellwise.estimate.power.power_along_log import PowerTrace, power_along
from cellwise.estimate.power.state_of_power import PowerSettings, power_settings
from cellwise.estimate.sensor import Sensor, assumed, seen_by
from cellwise.estimate.trace import (
    MINUTE_S,
    Trace,
    behind_rows,
    long_innovation,
    nis_by_scale,
    soc_step,
)
from cellwise.logs.cell_log import CellLog
from cellwise.notices import Code, Notice
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import FloatArray

CONVERGED_SOC = 0.02
SUSTAINED_S = 600.0
BEYOND_NIS = 4.0  # two deviations: a voltage that is missed by more is not as the model states


@dataclass(frozen=True)
class SocErrors:
    """Estimate minus reference, as fractions of SOC: ``rmse``, ``mae`` and ``max`` (magnitude)."""

    rmse: float
    mae: float
    max: float


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Plottable, Tabular):
    """A log, what the estimator made of it, and the errors where there is a reference.

    ``reference_soc`` is the tester's counter over the reference capacity, None without either; it
    never uses the current that the filter sees, nor the model's capacity. ``validity`` is the
    model's; ``power`` the state of power of every row where it was asked for; ``sensor`` what was
    stated of the sensors, in ``model`` as well; ``start`` the initial SOC and how it was found,
    ``trace`` every row of the estimate, ``ns_per_step`` the time of one [ns].
    """

    log: CellLog
    estimator: str
    start: InitialSoc
    trace: Trace
    ns_per_step: float
    reference_soc: FloatArray | None
    validity: Validity = UNKNOWN
    power: PowerTrace | None = None
    model: CellModel | None = None
    sensor: Sensor | None = None

    @property
    def time_s(self) -> FloatArray:
        """The log's, shape (rows,)."""
        return self.log.time_s

    @property
    def soc(self) -> FloatArray:
        """Estimated SOC, shape (rows,)."""
        return self.trace.soc

    @property
    def soc_std(self) -> FloatArray:
        """Its standard deviation, shape (rows,)."""
        return self.trace.soc_std

    @property
    def error(self) -> FloatArray | None:
        """Estimated less reference SOC, shape (rows,); None: nobody knows the true one."""
        return None if self.reference_soc is None else self.trace.soc - self.reference_soc

    @property
    def rmse(self) -> float | None:
        """RMS of the error over all rows, a fraction of SOC; None: nobody knows the true one."""
        return None if self.errors is None else self.errors.rmse

    @property
    def errors(self) -> SocErrors | None:
        """Over all rows."""
        return None if self.error is None else soc_errors(self.error)

    @property
    def convergence_s(self) -> float | None:
        """Time from which the error stays within 2 points of SOC for ten minutes or to the end."""
        if self.error is None:
            return None
        row = converged_row(self.log.time_s, self.error)
        return None if row is None else float(self.log.time_s[row] - self.log.time_s[0])

    @property
    def settled_s(self) -> float | None:
        """Time from which the stated deviation stays within 2 points as well.

        Before, an error that is small is luck: nobody who has no reference can know it.
        """
        if self.error is None:
            return None
        row = converged_row(self.log.time_s, np.maximum(np.abs(self.error), self.trace.soc_std))
        return None if row is None else float(self.log.time_s[row] - self.log.time_s[0])

    @property
    def settled(self) -> SocErrors | None:
        """After convergence; over the log's second half when it never converged."""
        if self.error is None:
            return None
        row = converged_row(self.log.time_s, self.error)
        if row is None:
            middle = self.log.time_s[0] + self.log.duration_s / 2
            row = int(np.searchsorted(self.log.time_s, middle))
        return soc_errors(self.error[row:])

    @property
    def coverage_2sigma(self) -> float | None:
        """Share of rows whose SOC error lies within two of the filter's standard deviations."""
        if self.error is None:
            return None
        known = np.isfinite(self.error)
        within = np.abs(self.error) <= 2.0 * self.trace.soc_std
        return float(np.mean(within[known])) if known.any() else None

    @property
    def nis_mean(self) -> float | None:
        """Mean of innovation squared over its variance, over the voltages that were used."""
        return self.trace.nis_mean

    @property
    def voltage_rmse_V(self) -> float:
        """RMSE of the voltage predicted before each measurement was used [V]; NaN: none was."""
        return self.trace.voltage_rmse_V

    @cached_property
    def nis(self) -> tuple[float, ...] | None:
        """NIS by the scales of the model's error: 1 where its statement is right, (scales,).

        Innovations of the voltages that were used, parted by running means, over the model's stated
        variance in each band. What the SOC is uncertain by has been taken out of the slowest: a
        filter that follows the model's error does not show it. None without a model.
        """
        return None if self.model is None else nis_by_scale(self.model, self.log, self.trace)

    @property
    def _seen(self) -> tuple[CellModel | None, CellLog, FloatArray, FloatArray]:
        return self.model, self.log, np.asarray(self.trace.innovation_V), self.trace.soc

    @cached_property
    def model_mismatch(self) -> Notice | None:
        """That the voltages are many times as far off as the model states; None: they are not.

        A filter moves the SOC to where another cell is followed best: where half of the rows stay
        beyond what the model states even so, the log simulated by itself says it.
        """
        model, log, innovation_V, soc = self._seen
        found = find_mismatch(model, log, innovation_V, soc)
        if model is None or found is not None:
            return found
        if times_stated(model, log, innovation_V, soc)[0] <= 1.0:
            return None
        return simulate(model, log, initial_soc(model, log, whole_log=True).soc).model_mismatch

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know, the most harmful first; those of reading the log last."""
        found = [] if self.model_mismatch is None else [self.model_mismatch]
        trace = self.trace
        found += along_notices(self.model, self.validity, self.log, trace.soc)
        found += reference_notices(self.log, self.reference_soc)
        if np.any(np.isfinite((trace.innovation_V, trace.voltage_V))):  # counting predicts none
            found += prediction_notices(self.log, self.voltage_rmse_V, trace.rejected)
            found += self._remarks()
        limits = () if self.power is None else self.power.known.notices
        return (*in_order(found, self.log.notices), *limits)

    def _remarks(self) -> list[Notice]:
        """A voltage that stays off for long, a SOC that steps: what a figure at the end hides."""
        model, log, trace = self.model, self.log, self.trace
        if model is None:
            return []
        found, since_s = [], log.time_s - log.time_s[0]
        if self.nis is not None and max(self.nis) > BEYOND_NIS:
            worst = int(np.argmax(self.nis))
            nis, scale_s = self.nis[worst], model.error.scales_s[worst]
            text = (
                f"the voltage over {scale_s:g} s is missed by {math.sqrt(nis):.1f} times what the "
                f"model states (NIS {nis:.1f}): it is further off than on the logs it was made of, "
                "so that the SOC's band may be too narrow"
            )
            found.append(Notice(Code.MODEL_OFF, text, size_V=self.voltage_rmse_V))
        span = long_innovation(model, log, trace)
        if span is not None:
            side = "below" if span.mean_V < 0.0 else "above"
            text = (
                f"the voltage stays {1e3 * abs(span.mean_V):.0f} mV {side} what is predicted for "
                f"{(since_s[span.last] - since_s[span.first]) / 60.0:.0f} min, from "
                f"{since_s[span.first] / 60.0:.0f} min on: {span.times:.1f} times what the model "
                "states of its error, so that the SOC's band is too narrow"
            )
            stated = self.start.how in ("given", "stated")
            if stated and since_s[span.first] <= MINUTE_S:
                text += f"; the stated start ({self.start.soc:.3f}) may be wrong: leave it out"
            rows, size_V = range(span.first, span.last + 1), abs(span.mean_V)
            found.append(Notice(Code.LONG_INNOVATION, text, rows=rows, size_V=size_V))
        row = soc_step(model, log, trace)
        if row is not None:
            before, after = (100.0 * float(trace.soc[k]) for k in (row - 1, row))
            text = (
                f"the SOC steps from {before:.1f} to {after:.1f} % in one sample after "
                f"{since_s[row] / 60.0:.0f} min: from there on another start explains the voltages "
                "better, and what was said before was wrong by about as much"
            )
            steps = range(row, row + 1)
            found.append(Notice(Code.SOC_STEP, text, rows=steps, size_V=ASSUMED_V))
        return found

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values, keys as the command prints them."""
        errors, settled, rmse_V = self.errors, self.settled, self.voltage_rmse_V
        found = {
            "estimator": self.estimator,
            "samples": len(self.trace),
            "soc0": self.start.to_dict(),
            "soc_final": float(self.trace.soc[-1]),
            "soc_final_std": float(self.trace.soc_std[-1]),
            "soc_rmse": None if errors is None else errors.rmse,
            "soc_mae": None if errors is None else errors.mae,
            "soc_max_error": None if errors is None else errors.max,
            "convergence_s": self.convergence_s,
            "settled_s": self.settled_s,
            "settled": None if settled is None else vars(settled),
            "coverage_2sigma": self.coverage_2sigma,
            "nis_mean": self.nis_mean,
            "nis": None if self.nis is None else list(self.nis),
            "voltage_rmse_V": rmse_V if math.isfinite(rmse_V) else None,
            "ns_per_step": self.ns_per_step,
        }
        if self.model is not None:
            found["sensor"] = assumed(self.sensor, self.model.capacity_Ah)
        if isinstance(self.trace, AdaptiveTrace):
            found["parameters"] = self.trace.parameters().to_dict()
        if self.power is not None:
            found["power"] = self.power.to_dict()
        return found

    def columns(self) -> dict[str, Any]:
        """What the estimator said of every row, and the reference where there is one."""
        found = Trace.columns(self.trace)
        if self.reference_soc is not None:
            found["reference_soc"] = self.reference_soc
        return found | ({} if self.power is None else self.power.columns())

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """SOC with two standard deviations, its error where it is known, the innovation."""
        hours = self.log.time_s / 3600.0
        trace = self.trace
        soc = [Line(self.estimator, hours, trace.soc, 2.0 * trace.soc_std)]
        panels = []
        if self.reference_soc is not None and self.error is not None:
            soc.append(Line("reference", hours, self.reference_soc))
            panels.append(Panel("SOC error [%]", (Line("error", hours, 100 * self.error),)))
        innovation = Line("innovation", hours, 1e3 * trace.innovation_V)
        panels.append(Panel("innovation [mV]", (innovation,)))
        return "time [h]", (Panel("SOC", tuple(soc)), *panels)

    def __repr__(self) -> str:
        text = f"Replay({self.estimator} on {self.log.name or 'log'}: "
        text += f"SOC {self.start.soc:.3f} -> {self.trace.soc[-1]:.3f}"
        if self.settled is not None:
            text += f", settled RMSE {100 * self.settled.rmse:.2f} %"
        if self.model_mismatch:
            text += ", FAR OFF this model"
        return text + f", {self.ns_per_step:.0f} ns/step)"


def soc_errors(error: FloatArray) -> SocErrors:
    """RMSE, MAE and largest error of a SOC error, shape (n,)."""
    e = np.abs(error[np.isfinite(error)])
    if e.size == 0:
        return SocErrors(float("nan"), float("nan"), float("nan"))
    return SocErrors(float(np.sqrt(np.mean(e * e))), float(np.mean(e)), float(e.max()))


def converged_row(time_s: FloatArray, error: FloatArray) -> int | None:
    """First row from which the error stays within 2 points for ten minutes, or to the end."""
    outside = np.abs(error) > CONVERGED_SOC
    edges = np.flatnonzero(outside)
    if edges.size == 0:
        return 0
    for start, stop in zip(
        np.concatenate(([0], edges + 1)), np.concatenate((edges, [error.size])), strict=True
    ):
        if stop <= start:
            continue
        end = time_s[min(stop, error.size - 1)]
        if stop == error.size or end - time_s[start] >= SUSTAINED_S:
            return int(start)
    return None


def reference_soc(log: CellLog, soc0: float, capacity_Ah: float) -> FloatArray | None:
    """SOC by the tester's counter over a stated capacity, shape (rows,); None without a counter.

    Raises
    ------
    InputError        capacity not above zero
    """
    if not (np.isfinite(capacity_Ah) and capacity_Ah > 0):
        raise InputError(
            f"a reference capacity of {capacity_Ah} Ah", "a number above zero", "Give it in Ah."
        )
    if log.charge_Ah is None or np.all(np.isnan(log.charge_Ah)):
        return None
    first = log.charge_Ah[np.isfinite(log.charge_Ah)][0]
    return np.asarray(soc0 - (log.charge_Ah - first) / capacity_Ah)


def replay(
    model: CellModel,
    log: CellLog,
    estimator: str | Estimator | OnlineFilter = "ekf",
    soc0: float | None = None,
    *,
    soc0_std: float | None = None,
    noise: Noise | None = None,
    sensor: Sensor | None = None,
    reference_soc0: float | None = None,
    reference_capacity_Ah: float | None = None,
    power: bool | PowerSettings = False,
) -> Replay:
    """Replay a log through an estimator.

    Parameters
    ----------
    estimator : str, filter or OnlineFilter      a name of ``ESTIMATORS`` in any case, a filter of
                                      cellwise, or one's own: an object with ``start`` and ``step``
    soc0 : float or None              initial SOC; None: from a rest or a fit at the log's start
    soc0_std : float or None          its standard deviation; None: 0.15 for a given start, else
                                      what the search for it says
    noise : Noise or None             None: from the model's own validation error, and the sensors
    sensor : Sensor or None           what the sensors are off by; None: as a car's
    reference_soc0 : float or None    true SOC at the first row; None: as the whole log shows it,
                                      which no estimator sees
    reference_capacity_Ah : float or None   charge between SOC 1 and 0 for the reference; None: no
                                      errors
    power : bool or PowerSettings     the state of power at every row, too: for 2, 10 and 30 s, or
                                      as `power_settings` says

    Returns
    -------
    Replay

    Raises
    ------
    InputError        what is of another type; an estimator that there is not; the power is asked
                      for, and no limit is known (see `power_limits`); a sensor for an estimator
                      that is made already
    """
    check_log_of(model, log)
    if sensor is not None:
        check_kind("sensor", sensor, Sensor, "Write Sensor(current_offset_A=0.05), say.")
        if not isinstance(estimator, str):
            raise InputError(
                f"a sensor for {type(estimator).__name__}, which is made already",
                "an estimator by its name",
                "Name it, or make it of `seen_by(model, sensor)`.",
            )
        model, of_sensor = seen_by(model, sensor)
        noise = of_sensor if noise is None else noise
    asked = power_settings(model, noise=noise) if power is True else power
    if asked:
        check_kind("power", asked, PowerSettings, "Write power=True, or power_settings(model).")
    filter_ = estimator_of(estimator, model, noise)
    start = initial_soc(model, log, soc0)
    if soc0_std is not None:
        start = InitialSoc(start.soc, soc0_std, start.how)
    # Compiles, so that the clock does not see it.
    head = CellLog(log.time_s[:2], np.zeros(2), np.full(2, np.nanmean(log.voltage_V)))
    filter_.run(head, start.soc, start.std)
    began = time.perf_counter()
    trace = _run_measured(filter_, model, log, start)
    ns = 1e9 * (time.perf_counter() - began) / len(log)
    reference = None
    if reference_capacity_Ah is not None:
        true0 = reference_soc0
        if true0 is None:
            true0 = initial_soc(model, log, whole_log=True).soc
        true0 = check_soc0(true0)
        capacity = number("reference_capacity_Ah", reference_capacity_Ah, "a number above zero")
        reference = reference_soc(log, true0, capacity)
    limits = power_along(asked, log, trace) if asked else None
    # fmt: off
    return Replay(
        log, filter_.name, start, trace, ns, reference, model.validity, limits, model, sensor
    )
    # fmt: on


def _run_measured(filter_: Estimator, model: CellModel, log: CellLog, start: InitialSoc) -> Trace:
    """The rows that are measured: over those that somebody put before a log SOC is counted."""
    rows = padded_rows(model, log)
    if not rows:
        return filter_.run(log, start.soc, start.std)
    moved_As = np.cumsum(log.known_current_A()[: rows + 1] * log.interval_s[: rows + 1])
    soc = np.clip(start.soc - (moved_As - moved_As[0]) / (3600.0 * model.capacity_Ah), 0.0, 1.0)
    trace = filter_.run(log.part(rows, len(log)), float(soc[-1]), start.std)
    return behind_rows(trace, log.time_s[:rows], soc[:-1], start.std)


def expected_std(model: CellModel, replayed: Replay, estimator: Estimator) -> FloatArray:
    """The deviation of the SOC that a filter expects over a log's current, shape (rows,).

    The recursion of the covariance needs a trajectory and no measurement: here that of the log's
    current, counted back from the SOC at which the replay ends, with the voltage that the model
    itself gives. From the replay's own start deviation. It says what this drive can show
    (observability): nothing of how far the model is off beyond what it states.

    Parameters
    ----------
    replayed : Replay         its log, its start's deviation, its final SOC
    estimator : Estimator     as it made the replay; one that uses no voltage expects no convergence
    """
    log = replayed.log
    counted = simulate(model, log, 0.5).soc - 0.5
    start = float(np.clip(replayed.trace.soc[-1] - counted[-1], 0.0, 1.0))
    voltage = np.where(np.isfinite(log.voltage_V), simulate(model, log, start).voltage_V, np.nan)
    trace = estimator.run(replace(log, voltage_V=voltage), start, replayed.start.std)
    return np.asarray(trace.soc_std, dtype=np.float64)


def expected_convergence_s(
    model: CellModel, replayed: Replay, estimator: Estimator
) -> float | None:
    """Time from which an error of that deviation stays within 2 points as likely as not.

    Stays means for ten minutes or to the log's end; None: not on this log.
    """
    half = NormalDist().inv_cdf(0.75)  # half of a normal distribution lies within
    time_s = replayed.log.time_s
    row = converged_row(time_s, half * expected_std(model, replayed, estimator))
    return None if row is None else float(time_s[row] - time_s[0])

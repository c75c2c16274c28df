"""Simulate a log with a model and say how far it is from the measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwise.arguments import SOC_BEYOND, held_soc, number
from cellwise.cell.compiled import announce, rows
from cellwise.cell.equations import (
    CellState,
    CellTables,
    advance,
    delayed_current,
    empty_state,
    voltage_of,
)
from cellwise.cell.metrics import (
    NEAR_EMPTY,
    BandMetrics,
    ErrorMetrics,
    band_metrics,
    error_metrics,
    metrics_to_dict,
)
from cellwise.cell.model import CellModel
from cellwise.cell.plausibility.notice import (
    along_notices,
    error_notices,
    find_mismatch,
    in_order,
    stated_error_V,
)
from cellwise.cell.plausibility.validity import UNKNOWN, Validity
from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.checks.charge import check_current
from cellwise.logs.checks.units import check_is_log
from cellwise.notices import Notice
from cellwise.plotting import Line, Panel, Plottable, Tabular
from cellwise.typing import FloatArray


@rows
def simulate_rows(
    tables: CellTables,
    start: CellState,
    dt_s: FloatArray,
    current_A: FloatArray,
    temperature_C: FloatArray,
    voltage_V: FloatArray,
    soc: FloatArray,
) -> CellState:
    """Terminal voltage and SOC of every row, into ``voltage_V`` and ``soc``.

    Row k carries the current of the interval that ends there; row 0 has an interval of zero
    length, so its voltage is that of the start state under the first row's current.
    """
    state = start
    previous = current_A[0]
    for k in range(dt_s.size):
        delayed_A = delayed_current(tables.cell, current_A[k], previous, dt_s[k])
        previous = current_A[k]
        state, point = advance(tables, state, delayed_A, dt_s[k], temperature_C[k])
        voltage_V[k] = voltage_of(point, state, delayed_A)
        soc[k] = state.soc
    return state


UPPER_HALF = 0.5  # from here on a rested cell was charged, not discharged


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Plottable, Tabular):
    """A log and what the model makes of it.

    ``voltage_V`` and ``soc`` are the model's, shape (n,); ``residual_V`` is measured minus model,
    NaN where nothing was measured; ``soc0`` is the SOC at the first row, ``validity`` the model's.
    """

    log: CellLog
    soc0: float
    voltage_V: FloatArray
    soc: FloatArray
    validity: Validity = UNKNOWN
    model: CellModel | None = None

    @property
    def residual_V(self) -> FloatArray:
        """Measured minus simulated voltage [V], shape (n,)."""
        return np.asarray(self.log.voltage_V - self.voltage_V)

    @property
    def time_s(self) -> FloatArray:
        """The log's, shape (n,)."""
        return self.log.time_s

    @property
    def rmse_V(self) -> float:
        """RMS of the residual over all rows [V]; NaN: nothing was measured."""
        return self.metrics.rmse_V

    @property
    def metrics(self) -> ErrorMetrics:
        """Residual over all rows."""
        return error_metrics(self.residual_V)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """What a person should know, the most harmful first; those of reading the log last."""
        found = [] if self.model_mismatch is None else [self.model_mismatch]
        found += along_notices(self.model, self.validity, self.log, self.soc)
        found += error_notices(self.model, self.log, self.residual_V, self.soc)
        return in_order(found, self.log.notices)

    @property
    def model_mismatch(self) -> Notice | None:
        """That the log is many times as far off as the model states of itself; None: it is not."""
        return find_mismatch(self.model, self.log, self.residual_V, self.soc)

    @property
    def bands(self) -> tuple[BandMetrics, ...]:
        """Error by tenth of simulated SOC."""
        return band_metrics(self.residual_V, self.soc)

    @property
    def rmse_above_10pct_V(self) -> float:
        """RMSE over the rows whose simulated SOC is above 0.1 [V]."""
        return error_metrics(self.residual_V[self.soc > NEAR_EMPTY]).rmse_V

    @property
    def band_V(self) -> float:
        """RMS of the deviation that the model states of its voltage along the log [V].

        One deviation over logs: of a single one the slow part of the error is one draw, and mostly
        below. NaN without a model.
        """
        return float(np.sqrt(np.mean(self.stated_V**2)))

    @property
    def band_above_10pct_V(self) -> float:
        """The same over the rows whose simulated SOC is above 0.1 [V]; NaN: there is none."""
        above = self.stated_V[self.soc > NEAR_EMPTY]
        return float(np.sqrt(np.mean(above**2))) if above.size else math.nan

    @property
    def stated_V(self) -> FloatArray:
        """The deviation that the model states of its voltage at every row [V], shape (n,).

        Its error, in which the OCV and the resistances that its fit left open are, and its
        capacity, off by which the SOC is the more off the more charge has flowed. NaN without a
        model.
        """
        if self.model is None:
            return np.full(len(self.soc), math.nan)
        stated_V = stated_error_V(self.model, self.log, self.soc, self.voltage_V)
        fitted = self.model.posterior
        off = 0.0 if fitted is None else fitted.capacity_std * (self.soc - self.soc0)
        ocv_V = self.model.ocv_at(self.model.usual_temperature_C)
        slope_V = np.interp(self.soc, self.model.soc, np.gradient(ocv_V, self.model.soc))
        return np.asarray(np.hypot(stated_V, slope_V * off))

    def to_dict(self) -> dict[str, Any]:
        """The figures as JSON values, keys as the command prints them."""
        return {
            **metrics_to_dict(self.metrics),
            "rmse_above_10pct_V": _known(self.rmse_above_10pct_V),
            "band_V": _known(self.band_V),
            "band_above_10pct_V": _known(self.band_above_10pct_V),
            "bands": [
                {"soc": [b.soc_low, b.soc_high], **metrics_to_dict(b.metrics)} for b in self.bands
            ],
        }

    def columns(self) -> dict[str, FloatArray]:
        """Time, current, measured and simulated voltage, the residual as ``error_V``, SOC."""
        return {
            "time_s": self.log.time_s,
            "current_A": self.log.current_A,
            "measured_voltage_V": self.log.voltage_V,
            "voltage_V": self.voltage_V,
            "error_V": self.residual_V,
            "soc": self.soc,
        }

    def panels(self) -> tuple[str, tuple[Panel, ...]]:
        """Both voltages, their difference, and the SOC over time."""
        hours = self.log.time_s / 3600.0
        both = Line("measured", hours, self.log.voltage_V), Line("model", hours, self.voltage_V)
        return "time [h]", (
            Panel("voltage [V]", both),
            Panel("residual [mV]", (Line("residual", hours, 1e3 * self.residual_V),)),
            Panel("SOC", (Line("SOC", hours, self.soc),)),
        )

    def __repr__(self) -> str:
        m = self.metrics
        return (
            f"Simulation({self.log.name or 'log'}: RMSE {1e3 * m.rmse_V:.1f} mV, "
            f"MAE {1e3 * m.mae_V:.1f} mV, max {1e3 * m.max_error_V:.0f} mV over {m.samples} rows"
            f"{', FAR OFF this model' if self.model_mismatch else ''})"
        )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def simulate(model: CellModel, log: CellLog, soc0: float, h0: float | None = None) -> Simulation:
    """Simulate a log from a known initial SOC; the public one also finds it."""
    check_is_log(log)
    check_current(log, model.capacity_Ah)
    soc0 = check_soc0(soc0)
    if h0 is not None:
        h0 = number("h0", h0, "from -1 after a discharge to 1 after a charge, or None")
    tables = model.parameters()
    voltage = np.empty(len(log))
    soc = np.empty(len(log))
    announce(simulate_rows, "the simulation")
    simulate_rows(
        tables,
        empty_state(soc0, start_hysteresis(soc0) if h0 is None else h0),
        log.interval_s,
        log.known_current_A(),
        known_temperature_C(model, log),
        voltage,
        soc,
    )
    return Simulation(log, float(soc0), voltage, soc, model.validity, model)


def start_hysteresis(soc0: float) -> float:
    """The likelier branch of a resting cell: a full one was charged, an empty one discharged."""
    return 1.0 if soc0 > UPPER_HALF else -1.0


def check_soc0(soc0: float) -> float:
    """An initial SOC, 0..1; one that is further beyond than a counter's error is refused."""
    soc0 = held_soc(number("soc0", soc0, "a fraction from 0 to 1", "Give 0.5, say."))
    if not (np.isfinite(soc0) and 0.0 <= soc0 <= 1.0):
        hint = " Per cent? Divide by 100." if 1.0 < soc0 <= 100.0 else ""
        raise InputError(
            f"an initial SOC of {soc0:g}",
            f"a fraction from 0 to 1 (up to {SOC_BEYOND:g} beyond is held there)",
            f"Give 0.5, say; left out it is found from the log.{hint}",
        )
    return soc0


def check_soc0_std(soc0_std: float) -> None:
    """Refuse a standard deviation of the initial SOC that is not above zero."""
    expected, way_out = "a number above zero", "Give e.g. 0.15."
    if not 0.0 < number("soc0_std", soc0_std, expected, way_out) < math.inf:
        raise InputError(f"an initial SOC deviation of {soc0_std}", expected, way_out)


def known_temperature_C(model: CellModel, log: CellLog) -> FloatArray:
    """Temperature of every row [degC]: measured, held over missing values, else the model's."""
    if log.temperature_C is None or not np.any(np.isfinite(log.temperature_C)):
        return np.full(len(log), model.usual_temperature_C)
    measured = log.temperature_C
    missing = np.isnan(measured)
    if missing.any():
        rows = np.arange(measured.size)
        measured = np.interp(rows, rows[~missing], measured[~missing])
    return np.array(measured)  # a copy: kernels are compiled for one kind of array

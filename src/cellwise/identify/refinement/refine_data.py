"""A log made ready for refinement: few rows, known SOC and temperature, splines laid out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import SurfaceSoc
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.errors import InputError
from cellwise.identify.refinement.refine_kernels import LogRows, choose_rows
from cellwise.identify.refinement.splines import SplineRows, spline_rows
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray


class ChosenRows(NamedTuple):
    """Which rows of a log are kept and compared.

    Parameters
    ----------
    edge_share : float      of the largest current: smaller changes are noise
    shortest_s : float      between two compared rows [s]
    growth : float          of the time since the last change of current: what lies between them
    most_soc : float        that a constant load moves between them
    most : int              compared rows of one log
    """

    edge_share: float = 0.005
    shortest_s: float = 0.95
    growth: float = 0.03
    most_soc: float = 0.0025
    most: int = 2000


ROWS = ChosenRows()
BEYOND = 0.5  # how far a temperature may lie outside the grid, in its first and last step
SELDOM = 0.02  # of the charge: temperatures at which less flowed bring no row of tables along


NO_SURFACE = SurfaceSoc()


@dataclass(frozen=True, eq=False)
class RefineLog:
    """One log for refinement.

    ``soc`` is known at every row (the tester's counter over the capacity, from a known start);
    ``skewed`` logs share the fitted sampling delay; ``h0`` is the hysteresis state at the first
    row; ``compare`` marks rows that may be compared (None: all); ``temperature_C`` holds where the
    log measured none; the tables are looked up where ``surface`` says; ``low_rate`` tests hold the
    OCV and are no load; a log with a ``sample`` keeps a capacity of its own, of that number; one
    whose SOC at the start is known to ``start_std`` only has it fitted where that is not 0, with
    what a past that nobody saw left in the slow states, ``past_V`` +- as much.
    """

    log: CellLog
    soc: FloatArray
    skewed: bool = False
    h0: float = 1.0
    weight: float = 1.0
    compare: BoolArray | None = None
    temperature_C: float | None = None
    surface: SurfaceSoc = NO_SURFACE
    low_rate: bool = False
    sample: int | None = None
    start_std: float = 0.0
    past_V: float = 0.0


@dataclass(frozen=True, eq=False)
class PreparedLog:
    """What the kernel reads: merged rows; ``error``-relevant arrays cover compared rows only.

    ``row`` and ``share`` say between which temperatures of the log's own a row lies; these are
    ``temperatures`` of the grid's, from ``first_temperature`` on. ``table_soc`` is where the tables
    are looked up.
    """

    name: str
    dt_s: FloatArray
    current_A: FloatArray
    inverse_K: FloatArray
    rows: SplineRows
    ocv_rows: SplineRows
    soc: FloatArray
    evaluate: BoolArray
    measured_V: FloatArray
    time_s: FloatArray
    skewed: bool
    h0: float
    weight: float
    row: IndexArray
    share: FloatArray
    table_soc: FloatArray
    sample: int | None = None
    start_std: float = 0.0
    past_V: float = 0.0
    first_temperature: int = 0
    temperatures: int = 1

    @property
    def compared(self) -> int:
        """Number of rows that are compared with the measurement."""
        return int(self.measured_V.size)

    def temperature_C(self, reference_C: float) -> FloatArray:
        """Temperature of the compared rows [degC]."""
        kelvin = reference_C + ZERO_CELSIUS_K
        return np.asarray(1.0 / (self.inverse_K[self.evaluate] + 1.0 / kelvin) - ZERO_CELSIUS_K)

    def for_kernel(self, base_ocv_V: FloatArray) -> LogRows:
        """The arrays that the kernel takes."""
        return LogRows(
            self.dt_s,
            self.current_A,
            self.inverse_K,
            self.row,
            self.share,
            self.rows.first,
            self.rows.values,
            self.ocv_rows.first,
            self.ocv_rows.values,
            base_ocv_V,
            self.evaluate,
        )


def prepare_log(
    item: RefineLog,
    knots: FloatArray,
    ocv_knots: FloatArray,
    reference_C: float,
    grid_C: FloatArray | None = None,
    capacity_Ah: float = np.inf,
    most_rows: int = ROWS.most,
) -> PreparedLog:
    """Merge rows of equal current, choose the rows to compare, lay out the splines.

    Parameters
    ----------
    grid_C : (temperatures,) float or None      ascending; temperatures with tables of their own
    capacity_Ah : float                         for the spacing of rows under a constant load

    Raises
    ------
    InputError        no voltage to compare with
    """
    log = item.log
    current = log.known_current_A()
    n = len(log)
    usable = np.isfinite(log.voltage_V) & np.isfinite(item.soc) & (item.soc >= 0.0)
    if item.compare is not None:
        usable &= item.compare
    keep, evaluate = _chosen_rows(item, current, capacity_Ah, usable, most_rows)
    if not evaluate.any():
        raise InputError(
            f"no row with a voltage above SOC 0 in log '{log.name}'",
            "at least some measured voltages in the SOC range of the model",
            "Leave the log out, or check where its SOC starts.",
        )
    kept = np.flatnonzero(keep)
    time_s = log.time_s[kept]
    dt = np.diff(time_s, prepend=time_s[0])
    moved = np.cumsum(current * log.interval_s)[kept]
    merged = np.diff(moved, prepend=moved[0])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(dt > 0, merged / dt, current[kept])
    finite = np.isfinite(item.soc)
    soc = np.interp(np.arange(n), np.flatnonzero(finite), item.soc[finite])[kept]
    shown = evaluate[kept]
    inverse = _inverse_kelvin(log, reference_C, item.temperature_C)[kept]
    first, count, row, share = _between(inverse, np.abs(mean) * dt, reference_C, grid_C)
    table_soc = _surface_soc(item, soc, mean, dt, kept, capacity_Ah)
    return PreparedLog(
        name=log.name,
        dt_s=dt,
        current_A=mean,
        inverse_K=inverse,
        rows=spline_rows(table_soc, knots),
        ocv_rows=spline_rows(soc, ocv_knots),
        soc=soc,
        evaluate=shown,
        measured_V=log.voltage_V[kept][shown],
        time_s=time_s[shown],
        skewed=item.skewed,
        h0=item.h0,
        weight=item.weight,
        row=row,
        share=share,
        table_soc=table_soc,
        sample=item.sample,
        start_std=item.start_std,
        past_V=item.past_V,
        first_temperature=first,
        temperatures=count,
    )


def _chosen_rows(
    item: RefineLog, current: FloatArray, capacity_Ah: float, usable: BoolArray, most_rows: int
) -> tuple[BoolArray, BoolArray]:
    """Rows to keep and rows to compare; of a long log evenly chosen ones of these."""
    log = item.log
    threshold = ROWS.edge_share * float(np.max(np.abs(current)))
    # A test whose discharge alone is compared is there for its OCV; pulses have their edges.
    charge = np.inf if item.compare is None else ROWS.most_soc * 3600.0 * capacity_Ah
    keep = np.zeros(len(log), dtype=np.bool_)
    evaluate = np.zeros(len(log), dtype=np.bool_)
    choose_rows(
        log.time_s, current, threshold, ROWS.shortest_s, ROWS.growth, charge, keep, evaluate
    )
    evaluate &= usable
    shown = np.flatnonzero(evaluate)
    if shown.size > most_rows:
        evaluate[:] = False
        evaluate[shown[np.linspace(0, shown.size - 1, most_rows).round().astype(np.intp)]] = True
    gaps = log.gap_rows
    keep |= gaps
    keep[:-1] |= gaps[1:]
    return keep, evaluate


def inverse_K(temperature_C: FloatArray | float, reference_C: float) -> FloatArray:
    """1/T - 1/T_ref [1/K]."""
    kelvin = np.asarray(temperature_C) + ZERO_CELSIUS_K
    return np.asarray(1.0 / kelvin - 1.0 / (reference_C + ZERO_CELSIUS_K))


def _surface_soc(
    item: RefineLog,
    soc: FloatArray,
    current: FloatArray,
    dt: FloatArray,
    kept: IndexArray,
    capacity_Ah: float,
) -> FloatArray:
    """SOC at which the tables are looked up, of every kept row."""
    effect = item.surface
    if effect.depth_h == 0.0:
        return soc
    slow = lagged(current, dt, effect.tau_s)
    inverse = _inverse_kelvin(item.log, effect.reference_C, item.temperature_C)[kept]
    depth = effect.depth_h * np.exp(effect.activation_K * inverse) / capacity_Ah
    return np.asarray(np.clip(soc - depth * slow, 0.0, 1.0))


def lagged(values: FloatArray, dt: FloatArray, tau_s: float) -> FloatArray:
    """Values through a first-order lag, each constant over the interval that ends at its row."""
    found = np.empty(values.size)
    now = 0.0
    for k, (a, x) in enumerate(zip(np.exp(-dt / tau_s).tolist(), values.tolist(), strict=True)):
        now = a * now + (1.0 - a) * x
        found[k] = now
    return found


def _inverse_kelvin(log: CellLog, reference_C: float, otherwise_C: float | None) -> FloatArray:
    """1/T - 1/T_ref of every row [1/K]; at the reference where nothing is known."""
    measured = log.temperature_C
    good = None if measured is None else np.isfinite(measured)
    if measured is None or good is None or not good.any():
        held = np.full(len(log), reference_C if otherwise_C is None else otherwise_C)
    else:
        held = np.interp(np.arange(len(log)), np.flatnonzero(good), measured[good])
    return inverse_K(held, reference_C)


def _between(
    inverse: FloatArray, charge: FloatArray, reference_C: float, grid_C: FloatArray | None
) -> tuple[int, int, IndexArray, FloatArray]:
    """First temperature of the log, how many, and between which of them its rows lie."""
    if grid_C is None or grid_C.size == 1:
        return 0, 1, np.zeros(inverse.size, dtype=np.int64), np.zeros(inverse.size)
    grid = inverse_K(grid_C, reference_C)  # falls as the temperature rises
    order = np.argsort(inverse)
    moved = np.cumsum(charge[order])
    share = moved / moved[-1] if moved[-1] > 0.0 else np.linspace(0.0, 1.0, moved.size)
    warmest = float(inverse[order][np.searchsorted(share, SELDOM)])
    coldest = float(inverse[order][np.searchsorted(share, 1.0 - SELDOM)])
    last = grid.size - 2
    low = int(np.clip(np.searchsorted(-grid, -coldest, side="right") - 1, 0, last))
    high = int(np.clip(np.searchsorted(-grid, -warmest, side="left"), low + 1, grid.size - 1))
    part = grid[low : high + 1]
    row = np.clip(np.searchsorted(-part, -inverse, side="right") - 1, 0, part.size - 2)
    way = (inverse - part[row]) / (part[row + 1] - part[row])
    return (
        low,
        part.size,
        row.astype(np.int64),
        np.clip(way, -BEYOND, 1.0 + BEYOND),
    )

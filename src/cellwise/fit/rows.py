"""A log made ready for the fit: few rows, SOC and temperature of each, splines laid out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.effects import SurfaceSoc
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.errors import InputError
from cellwise.fit.sensitivity_kernels import FittedRows
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, SplineRows, spline_rows
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray


class ChosenRows(NamedTuple):
    """Which rows of a log are kept and compared.

    Parameters
    ----------
    edge_share : float      of the largest current: smaller changes are noise
    shortest_s : float      between two compared rows [s]
    growth : float          of the time since the last change of current: what lies between them
    most_soc : float        that a constant load moves between them; tables are looked up again
                            after as much, and after ``most_K``
    most_K : float          see there
    most : int              compared rows of one log
    """

    edge_share: float = 0.005
    shortest_s: float = 0.95
    growth: float = 0.03
    most_soc: float = 0.0025
    most_K: float = 0.5
    most: int = 2000


ROWS = ChosenRows()
BEYOND = 0.5  # how far a temperature may lie outside the grid, in its first and last step
SELDOM = 0.02  # of the charge: temperatures at which less flowed bring no row of tables along


NO_SURFACE = SurfaceSoc()
PAST_V = 0.036  # deviation of what a slow branch holds after a mean load of C/3 [V]


@dataclass(frozen=True, eq=False)
class FitLog:
    """One log of a fit, and what is known of it beforehand.

    Parameters
    ----------
    log : CellLog
    soc0, soc0_std : float      SOC at the first row and its standard deviation; 0: known
    skewed : bool               shares the fitted sampling delay
    h0 : float                  hysteresis state at the first row
    weight : float              of its evidence
    compare : (n,) bool or None      rows that may be compared; None: all
    temperature_C : float or None    where the log measured none
    surface : SurfaceSoc        where the tables are looked up
    low_rate : bool             shows the OCV, and is no load
    ln_sample, sample_std : float    ln of its cell's capacity over the others', and its
                                deviation; 0: known
    past_V : float              standard deviation of what each slow branch holds at first; of the
                                fast one a fifth [V]
    """

    log: CellLog
    soc0: float
    soc0_std: float = 0.0
    skewed: bool = False
    h0: float = 1.0
    weight: float = 1.0
    compare: BoolArray | None = None
    temperature_C: float | None = None
    surface: SurfaceSoc = NO_SURFACE
    low_rate: bool = False
    ln_sample: float = 0.0
    sample_std: float = 0.0
    past_V: float = 0.0

    def soc(self, capacity_Ah: float) -> FloatArray:
        """SOC of every row, counted from ``soc0`` over a capacity."""
        return np.asarray(self.soc0 - self.log.counted_charge_Ah() / capacity_Ah)


@dataclass(frozen=True, eq=False)
class PreparedLog:
    """A log as the fit reads it: merged ``rows``, of which some are compared.

    ``soc`` and ``depth_soc``, by how much less the tables are looked up at, are of all rows;
    ``measured_V`` and ``time_s`` of the compared ones. ``rows.row`` and ``rows.share`` say between
    which of the log's own temperatures a row lies; these are ``temperatures`` of the grid's, from
    ``first_temperature`` on.
    """

    item: FitLog
    rows: FittedRows
    soc: FloatArray
    depth_soc: FloatArray
    measured_V: FloatArray
    time_s: FloatArray
    first_temperature: int = 0
    temperatures: int = 1

    @property
    def compared(self) -> int:
        """Number of rows that are compared with the measurement."""
        return int(self.measured_V.size)

    @property
    def compared_soc(self) -> FloatArray:
        """SOC of the compared rows, as taken beforehand."""
        return np.asarray(self.soc[self.rows.evaluate])

    def temperature_C(self, reference_C: float) -> FloatArray:
        """Temperature of the compared rows [degC]."""
        kelvin = reference_C + ZERO_CELSIUS_K
        inverse = self.rows.inverse_K[self.rows.evaluate]
        return np.asarray(1.0 / (inverse + 1.0 / kelvin) - ZERO_CELSIUS_K)

    def moved(self, base: BaseOcv, start: float, ln_capacity: float) -> FittedRows:
        """The rows of a log that begins by ``start`` elsewhere, of a cell of another capacity."""
        if start == 0.0 and ln_capacity == 0.0:
            return self.rows
        used = (self.soc[0] - self.soc) * math.exp(-ln_capacity)
        soc = self.soc[0] + start - used
        return _at_soc(self.rows, soc, self.depth_soc, used, base)


class BaseOcv(NamedTuple):
    """The OCV that a fit corrects: over an even SOC grid from 0 to 1 [V]."""

    voltage_V: FloatArray

    def at_soc(self, soc: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Voltage and slope at each SOC; beyond the ends the end value holds."""
        steps = self.voltage_V.size - 1
        at = np.clip(soc, 0.0, 1.0) * steps
        low = np.minimum(at.astype(np.int64), steps - 1)
        rise = self.voltage_V[low + 1] - self.voltage_V[low]
        inside = (soc >= 0.0) & (soc <= 1.0)
        return self.voltage_V[low] + (at - low) * rise, np.where(inside, rise * steps, 0.0)


def _at_soc(
    rows: FittedRows, soc: FloatArray, depth: FloatArray, used: FloatArray, base: BaseOcv
) -> FittedRows:
    shown = soc[rows.evaluate]
    base_V, slope_V = base.at_soc(shown)
    ends = rows.ends
    below = np.clip(soc[ends] - depth[ends], 0.0, 1.0) if depth.any() else soc[ends]
    return rows._replace(
        tables=spline_rows(below, TABLE_KNOTS),
        ocv=spline_rows(shown, OCV_KNOTS),
        base_V=base_V,
        base_slope_V=slope_V,
        used_soc=used,
    )


def prepare_log(
    item: FitLog,
    base: BaseOcv,
    capacity_Ah: float,
    reference_C: float,
    grid_C: FloatArray | None = None,
    most_rows: int = ROWS.most,
) -> PreparedLog:
    """Merge rows of equal current, choose the rows to compare, lay out the splines.

    Parameters
    ----------
    grid_C : (temperatures,) float or None      ascending; temperatures with tables of their own

    Raises
    ------
    InputError        no voltage to compare with
    """
    log = item.log
    current = log.known_current_A()
    every_soc = item.soc(capacity_Ah)
    usable = np.isfinite(log.voltage_V) & np.isfinite(every_soc)
    if item.soc0_std == 0.0:
        usable &= every_soc >= 0.0
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
    soc = _bridged(every_soc)[kept]
    shown = evaluate[kept]
    warm_C = _temperature_C(item, reference_C)[kept]
    inverse = inverse_K(warm_C, reference_C)
    first, count, row, share = _between(inverse, np.abs(mean) * dt, reference_C, grid_C)
    depth_soc = np.zeros(soc.size)
    effect = item.surface
    if effect.depth_h != 0.0:
        grown = np.exp(effect.activation_K * inverse_K(warm_C, effect.reference_C))
        depth_soc = effect.depth_h * grown / capacity_Ah * lagged(mean, dt, effect.tau_s)
    none = np.empty(0)
    blank = SplineRows(np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty((0, 4)))
    ends = np.flatnonzero(run_ends(soc, warm_C, shown))
    rows = FittedRows(dt, mean, inverse, row, share, blank, blank, none, none, none, shown, ends)
    return PreparedLog(
        item=item,
        rows=_at_soc(rows, soc, depth_soc, soc[0] - soc, base),
        soc=soc,
        depth_soc=depth_soc,
        measured_V=log.voltage_V[kept][shown],
        time_s=time_s[shown],
        first_temperature=first,
        temperatures=count,
    )


def _chosen_rows(
    item: FitLog, current: FloatArray, capacity_Ah: float, usable: BoolArray, most_rows: int
) -> tuple[BoolArray, BoolArray]:
    """Rows to keep and rows to compare; of a long log evenly chosen ones of these."""
    log = item.log
    threshold = ROWS.edge_share * float(np.max(np.abs(current)))
    # A test whose discharge alone is compared is there for its OCV; pulses have their edges.
    charge = np.inf if item.compare is None else ROWS.most_soc * 3600.0 * capacity_Ah
    keep, evaluate = np.zeros((2, len(log)), dtype=np.bool_)
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


def lagged(values: FloatArray, dt: FloatArray, tau_s: float) -> FloatArray:
    """Values through a first-order lag, each constant over the interval that ends at its row."""
    found = np.empty(values.size)
    fill_lagged(values, np.exp(-dt / tau_s), found)
    return found


@cached(error_model="numpy")
def fill_lagged(values: FloatArray, left: FloatArray, found: FloatArray) -> None:
    """The same, from the share of the value before that each interval keeps."""
    now = 0.0
    for k in range(values.size):
        now = left[k] * now + (1.0 - left[k]) * values[k]
        found[k] = now


def _temperature_C(item: FitLog, reference_C: float) -> FloatArray:
    """Temperature of every row [degC]; the reference where nothing is known."""
    measured = item.log.temperature_C
    if measured is None or not np.isfinite(measured).any():
        known = reference_C if item.temperature_C is None else item.temperature_C
        return np.full(len(item.log), known)
    return _bridged(measured)


def _bridged(values: FloatArray) -> FloatArray:
    """What is missing, straight between its neighbours."""
    known = np.isfinite(values)
    return np.interp(np.arange(values.size), np.flatnonzero(known), values[known])


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


def run_ends(soc: FloatArray, temperature_C: FloatArray, compared: BoolArray) -> BoolArray:
    """Marks the last row of every run over which the tables are taken to be the same.

    Every compared row ends one.
    """
    steps = np.floor(soc / ROWS.most_soc), np.floor(temperature_C / ROWS.most_K)
    ends = compared | (np.diff(steps, append=np.nan) != 0.0).any(axis=0)
    return np.asarray(ends, dtype=np.bool_)


@cached(error_model="numpy")
def choose_rows(
    time_s: FloatArray,
    current_A: FloatArray,
    threshold_A: float,
    shortest_s: float,
    growth: float,
    most_charge_As: float,
    keep: BoolArray,
    evaluate: BoolArray,
) -> None:
    """Mark the rows to keep and those to compare with the measurement.

    Compared rows lie evenly on the logarithm of the time since the last change of current
    (at least ``shortest_s`` apart, then ``growth`` times that time), so that hours of rest do not
    outvote seconds of pulse; under load they are no further apart than ``most_charge_As``, so that
    hours of a low rate show every bend of the OCV. Between them only rows at which the current
    changes are kept: merging rows of equal current loses nothing, because the branches are solved
    exactly.
    """
    kept = 0
    edge_s = time_s[0]
    compared_s = time_s[0]
    moved_As = 0.0
    keep[0] = True
    evaluate[0] = True
    for k in range(1, time_s.size):
        moved_As += abs(current_A[k]) * (time_s[k] - time_s[k - 1])
        if abs(current_A[k] - current_A[kept]) > threshold_A:
            keep[k - 1] = True
            keep[k] = True
            kept = k
            edge_s = time_s[k - 1]
        spacing = max(shortest_s, growth * (time_s[k] - edge_s))
        since_s = time_s[k] - compared_s
        if since_s >= spacing or (since_s >= shortest_s and moved_As >= most_charge_As):
            evaluate[k] = True
            keep[k] = True
            compared_s = time_s[k]
            moved_As = 0.0
    keep[-1] = True

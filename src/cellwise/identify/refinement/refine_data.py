"""A log made ready for refinement: few rows, known SOC and temperature, splines laid out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.compiled import cached
from cellwise.cell.effects import SurfaceSoc
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.errors import InputError
from cellwise.identify.refinement.refine_kernels import LogRows
from cellwise.identify.refinement.splines import OCV_KNOTS, TABLE_KNOTS, spline_rows
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
    """A log as the fit reads it: merged ``rows``, of which some are compared.

    ``soc`` and ``table_soc``, where the tables are looked up, are of all rows; ``measured_V`` and
    ``time_s`` of the compared ones. ``rows.row`` and ``rows.share`` say between which of the log's
    own temperatures a row lies; these are ``temperatures`` of the grid's, from
    ``first_temperature`` on.
    """

    item: RefineLog
    rows: LogRows
    soc: FloatArray
    table_soc: FloatArray
    measured_V: FloatArray
    time_s: FloatArray
    first_temperature: int = 0
    temperatures: int = 1

    @property
    def compared(self) -> int:
        """Number of rows that are compared with the measurement."""
        return int(self.measured_V.size)

    def temperature_C(self, reference_C: float) -> FloatArray:
        """Temperature of the compared rows [degC]."""
        kelvin = reference_C + ZERO_CELSIUS_K
        inverse = self.rows.inverse_K[self.rows.evaluate]
        return np.asarray(1.0 / (inverse + 1.0 / kelvin) - ZERO_CELSIUS_K)

    def moved(self, away: FloatArray) -> LogRows:
        """The rows of a log that lies elsewhere on the SOC axis, (rows,)."""
        return self.rows._replace(
            tables=spline_rows(self.table_soc + away, TABLE_KNOTS),
            ocv=spline_rows(self.soc + away, OCV_KNOTS),
        )


def prepare_log(
    item: RefineLog,
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
    soc = _bridged(item.soc)[kept]
    shown = evaluate[kept]
    warm_C = _temperature_C(item, reference_C)[kept]
    inverse = inverse_K(warm_C, reference_C)
    first, count, row, share = _between(inverse, np.abs(mean) * dt, reference_C, grid_C)
    table_soc = soc
    effect = item.surface
    if effect.depth_h != 0.0:
        grown = np.exp(effect.activation_K * inverse_K(warm_C, effect.reference_C))
        depth = effect.depth_h * grown / capacity_Ah
        table_soc = np.clip(soc - depth * lagged(mean, dt, effect.tau_s), 0.0, 1.0)
    splines = spline_rows(table_soc, TABLE_KNOTS), spline_rows(soc, OCV_KNOTS)
    return PreparedLog(
        item=item,
        rows=LogRows(dt, mean, inverse, row, share, *splines, shown),
        soc=soc,
        table_soc=table_soc,
        measured_V=log.voltage_V[kept][shown],
        time_s=time_s[shown],
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
    now = 0.0
    for k, (a, x) in enumerate(zip(np.exp(-dt / tau_s).tolist(), values.tolist(), strict=True)):
        now = a * now + (1.0 - a) * x
        found[k] = now
    return found


def _temperature_C(item: RefineLog, reference_C: float) -> FloatArray:
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

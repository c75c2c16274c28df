"""How wrong a model is on every time scale: likelihood of what it left of loads it has not seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellwise.cell.effects import SlowDiffusion
from cellwise.cell.model import CellModel
from cellwise.cell.model_error import SCALES_S, ModelError, in_bands
from cellwise.cell.plausibility.validity import SHARE_AT_TWICE
from cellwise.cell.posterior import POINTS
from cellwise.fit.problem import EVIDENCE, autocorrelation
from cellwise.fit.splines import TABLE_KNOTS
from cellwise.logs.cell_log import CellLog
from cellwise.typing import BoolArray, FloatArray, IndexArray

SAME_TEMPERATURE_K = 4.0  # logs this near to each other report one temperature


class Likelihood(NamedTuple):
    """What the error's likelihood takes for granted.

    Parameters
    ----------
    fewest, most : float    independent errors of a cell; SOC by SOC a log repeats what it gets
                            wrong, however many rows there are
    tail : float            a mean square over few errors scatters, and a single log may be far
                            off: an F distribution of so many degrees of freedom
    optimism : float        a fit sees its own residuals smaller than a new log will
    least_V : float         no band is smaller [V]
    """

    fewest: float = 0.02
    most: float = 2.0
    tail: float = 2.0
    optimism: float = 1.2
    least_V: float = 1e-4


class Priors(NamedTuple):
    """Standard deviations of logarithms.

    Parameters
    ----------
    step : float            from knot to knot
    temperature : float     of a temperature about all
    own_step : float        of a temperature from knot to knot, beside all
    share : float           of the share of the polarisation about ``usual_share``
    charge : float          of that on charge over that on discharge
    """

    step: float = 0.5
    temperature: float = 0.7
    own_step: float = 0.3
    share: float = 1.0
    charge: float = 0.5
    usual_share: float = 0.02


class AlongSoc(NamedTuple):
    """How the memory along the SOC is found: on which step, of logs that move how much [SOC]."""

    step: float = 0.002
    deep: float = 0.3


TAKEN, PRIORS, ALONG_SOC = Likelihood(), Priors(), AlongSoc()
LEAST_LOG = 20  # rows: fewer say nothing
SUSTAINED_S = EVIDENCE.memory_s  # what builds up within minutes has done so
SHOWN = 1.0  # doublings of the current that lasted: up to there the tests' own errors count
MOST_DOUBLINGS = 3.0  # a resistance that nothing sustained has shown
MIDDLE = (0.1, 0.9)


@dataclass(frozen=True, eq=False)
class ResidualLog:
    """Residual of one log, arrays of shape (n,): measured minus model [V].

    ``polarisation_V`` is of the model, positive on discharge; ``temperature_C`` of the log.
    """

    time_s: FloatArray
    soc: FloatArray
    polarisation_V: FloatArray
    residual_V: FloatArray
    temperature_C: float = 25.0


def polarisation_of(
    model: CellModel, soc: FloatArray, temperature_C: FloatArray, voltage_V: FloatArray
) -> FloatArray:
    """What a simulated voltage lies below the model's OCV, shape (n,) [V]."""
    rows = [np.interp(soc, model.soc, row) for row in model.ocv_V]
    if len(rows) == 1:
        return np.asarray(rows[0] - voltage_V)
    grid = model.temperature_C
    low = np.clip(np.searchsorted(grid, temperature_C) - 1, 0, grid.size - 2)
    way = np.clip((temperature_C - grid[low]) / (grid[low + 1] - grid[low]), 0.0, 1.0)
    each, at = np.array(rows), np.arange(soc.size)
    return np.asarray((1.0 - way) * each[low, at] + way * each[low + 1, at] - voltage_V)


class _Cells(NamedTuple):
    """Rows of one log, SOC and direction together, for each band; arrays of shape (cells,).

    A cell is a bin of the SOC here, ``EVIDENCE.cell_soc`` wide, and no battery.
    """

    soc: FloatArray
    charge: FloatArray  # 1 where the cell is charged
    group: IndexArray  # of a temperature
    drop2: FloatArray
    square: FloatArray  # (scales, cells) mean square of the residual
    errors: FloatArray  # (scales, cells) how many independent ones


def estimate_model_error(
    logs: Sequence[ResidualLog],
    elsewhere: Sequence[ResidualLog] = (),
    unseen: tuple[float, float] = (0.0, 0.0),
) -> ModelError:
    r"""Voltage error of a model from its residuals over loads, best those that its fit left out.

    In each band of time scale a squared residual is that of two errors that know nothing of each
    other, one of SOC and temperature, and a share of the polarisation, on discharge and charge:

    .. math:: \sigma_k^2 = e_k(s, T)^2 + \left(\kappa_{k\pm}\, v_p\right)^2

    Parameters
    ----------
    logs : sequence of ResidualLog
    elsewhere : sequence of ResidualLog    tests of another kind and of the fit itself, which count
                                           at a SOC where none of ``logs`` has been
    unseen : (discharge, charge)           shares of the polarisation, what no log can show

    Returns
    -------
    ModelError        over :data:`~cellwise.cell.model_error.SCALES_S`; persists for one over one
                      more than the logs of a temperature, which have shown what they share
    """
    usable = [log for log in logs if log.residual_V.size >= LEAST_LOG]
    if not usable:
        return ModelError()
    groups = _by_temperature(usable)
    warm = [float(np.mean([usable[k].temperature_C for k in g])) for g in groups]
    cells = [_cells(usable[k], i) for i, g in enumerate(groups) for k in g]
    seen = np.unique(np.concatenate([_place(c.soc) for c in cells]))
    for log in elsewhere:
        if log.residual_V.size >= LEAST_LOG:
            nearest = int(np.argmin(np.abs(np.array(warm) - log.temperature_C)))
            other = _cells(log, nearest)
            new = ~np.isin(_place(other.soc), seen)
            cells.append(_of(other._replace(square=TAKEN.optimism**2 * other.square), new))
    every = _Cells._make(np.concatenate(part, axis=-1) for part in zip(*cells, strict=True))
    grid = np.linspace(0.0, 1.0, POINTS)
    fits = [_fit(every, k, len(groups)) for k in range(len(SCALES_S))]
    resolved = next((k for k, fit in enumerate(fits) if fit is not None), len(SCALES_S) - 1)
    known = [fits[max(k, resolved)] or _nothing(len(groups)) for k in range(len(SCALES_S))]
    std = []
    for ln_size, _, _ in known:
        rows = [np.exp(np.interp(grid, TABLE_KNOTS, row)) for row in ln_size]
        std.append(tuple(tuple(_short(v) for v in np.maximum(row, TAKEN.least_V)) for row in rows))
    each = len(usable) / len(groups)
    return ModelError(
        scales_s=SCALES_S,
        std_V=tuple(std),
        temperature_C=tuple(warm) if len(groups) > 1 else (),
        share=tuple(_short(fit[1]) for fit in known),
        charge_share=tuple(_short(fit[2]) for fit in known),
        persistent_share=1.0 / (each + 1.0),
        correlation_soc=_correlation_soc(usable),
        unseen_share=unseen[0],
        unseen_charge_share=unseen[1],
    )


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _by_temperature(logs: Sequence[ResidualLog]) -> list[list[int]]:
    """Numbers of the logs of one temperature together, coldest first."""
    groups: list[list[int]] = []
    for k in sorted(range(len(logs)), key=lambda k: logs[k].temperature_C):
        first = logs[groups[-1][0]].temperature_C if groups else -np.inf
        if logs[k].temperature_C - first < SAME_TEMPERATURE_K:
            groups[-1].append(k)
        else:
            groups.append([k])
    return groups


def _place(soc: FloatArray) -> IndexArray:
    return np.asarray(np.floor(np.clip(soc, 0.0, 1.0) / EVIDENCE.cell_soc), dtype=np.int64)


def _of(cells: _Cells, which: BoolArray) -> _Cells:
    return _Cells._make(np.asarray(part)[..., which] for part in cells)


def _cells(log: ResidualLog, group: int) -> _Cells:
    """The log's rows by SOC and direction.

    A band that its rows do not resolve, since they are further apart, has no errors in it.
    """
    bands = in_bands(log.time_s, log.residual_V)
    step = np.diff(log.time_s, append=log.time_s[-1])
    step = np.clip(step, 1e-9, 10.0 * max(float(np.median(step)), 1e-9))
    charged = (log.polarisation_V < 0.0).astype(np.int64)
    _, first, cell = np.unique(
        2 * _place(log.soc) + charged, return_index=True, return_inverse=True
    )
    seconds = np.bincount(cell, step)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, step * values) / seconds)

    tau = np.array(SCALES_S)[:, None]
    count = np.bincount(cell)
    errors = np.clip(np.minimum(seconds / (2.0 * tau), count), TAKEN.fewest, TAKEN.most)
    coarse = 2.0 * float(np.median(np.diff(log.time_s))) > np.array([*SCALES_S[1:], np.inf])
    errors[coarse] = 0.0
    return _Cells(
        np.clip(mean(log.soc), 0.0, 1.0),
        charged[first].astype(np.float64),
        np.full(first.size, group),
        mean(log.polarisation_V**2),
        np.array([mean(band**2) for band in bands]),
        errors,
    )


# ln size of each temperature at the knots, shares of the polarisation on discharge and charge
_Fit = tuple[FloatArray, float, float]


def _nothing(groups: int) -> _Fit:
    return np.full((groups, TABLE_KNOTS.size), np.log(TAKEN.least_V)), 0.0, 0.0


def _fit(cells: _Cells, band: int, groups: int) -> _Fit | None:
    """Most likely size of one band; None where no log resolves it."""
    from scipy.optimize import minimize

    used = cells.errors[band] > 0.0
    if not used.any():
        return None
    n, square = (
        cells.errors[band][used],
        np.maximum(cells.square[band][used], TAKEN.least_V**2 / 4.0),
    )
    drop2, charge, group = cells.drop2[used], cells.charge[used], cells.group[used]
    knots = TABLE_KNOTS.size
    soc = cells.soc[used]
    low = np.clip(np.searchsorted(TABLE_KNOTS, soc) - 1, 0, knots - 2)
    way = (soc - TABLE_KNOTS[low]) / np.diff(TABLE_KNOTS)[low]
    place = group * knots + low
    first = 0.5 * np.log(np.average(square, weights=n))

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        """Negative logarithm of likelihood and prior, and its slope."""
        rows = x[: knots * (groups + 1)].reshape(groups + 1, knots)  # all, each temperature's own
        size, own = rows[0], rows[1:]
        ln = (1.0 - way) * (size[low] + own[group, low])
        ln += way * (size[low + 1] + own[group, low + 1])
        still, load = np.exp(2.0 * ln), np.exp(2.0 * (x[-2] + charge * x[-1])) * drop2
        variance = still + load
        over = n * square / (TAKEN.tail * variance)
        value = 0.5 * float(np.sum(n * np.log(variance) + (n + TAKEN.tail) * np.log1p(over)))
        slope = 0.5 * (n - (n + TAKEN.tail) * over / (1.0 + over)) / variance
        by_still, by_load = 2.0 * slope * still, 2.0 * slope * load
        g = np.zeros_like(rows)
        for side, part in ((0, 1.0 - way), (1, way)):
            g[1:] += np.bincount(place + side, by_still * part, groups * knots).reshape(groups, -1)
        g[0] = g[1:].sum(axis=0)
        for k, row in enumerate(rows):
            step = np.diff(row) / (PRIORS.own_step if k else PRIORS.step) ** 2
            value += 0.5 * float(step @ np.diff(row))
            g[k] -= np.diff(step, prepend=0.0, append=0.0)
            if k:
                mean = float(row.mean()) / PRIORS.temperature**2
                value += 0.5 * mean * float(row.mean())
                g[k] += mean / knots
        off = np.array([x[-2] - np.log(PRIORS.usual_share), x[-1]])
        std2 = np.array([PRIORS.share, PRIORS.charge]) ** 2
        value += 0.5 * float(np.sum(off**2 / std2))
        ends = np.array([np.sum(by_load), np.sum(by_load * charge)]) + off / std2
        return value, np.concatenate([g.ravel(), ends])

    x0 = np.concatenate(
        [np.full(knots, first), np.zeros(groups * knots), [np.log(PRIORS.usual_share), 0.0]]
    )
    x = minimize(cost, x0, jac=True, method="L-BFGS-B").x
    rows = x[: knots * (groups + 1)].reshape(groups + 1, knots)
    share = float(np.exp(x[-2]))
    return rows[0] + rows[1:], share, share * float(np.exp(x[-1]))


def _correlation_soc(logs: Sequence[ResidualLog]) -> float | None:
    """How far along the SOC the error remembers itself; None where fewer than two logs show it.

    Half the area under the two-sided autocorrelation over SOC up to its first zero, mean left in.
    """
    found = []
    for log in logs:
        if float(np.ptp(log.soc)) < ALONG_SOC.deep:
            continue
        place = ((log.soc - log.soc.min()) / ALONG_SOC.step).astype(int)
        count = np.bincount(place)
        limit = 6.0 * 1.4826 * float(np.median(np.abs(log.residual_V))) + 1e-9
        mean = np.bincount(place, np.clip(log.residual_V, -limit, limit))[count > 0]
        found.append(ALONG_SOC.step * _memory(mean / count[count > 0]))
    return min(float(np.mean(found)), 1.0) if len(found) > 1 else None


def _memory(r: FloatArray) -> float:
    """Half the area under the autocorrelation up to its first zero, in steps of an even grid."""
    correlation = autocorrelation(r, max(2, r.size // 2))
    if correlation.size == 0:
        return 1.0
    below = np.flatnonzero(correlation <= 0.0)
    return float(0.5 + np.sum(correlation[1 : int(below[0]) if below.size else None]))


def sustained_A(log: CellLog, sign: float) -> float:
    """The largest mean current of a log over SUSTAINED_S in one direction [A]; 0 where none is.

    ``sign`` 1 is discharge, -1 charge; a shorter log shows nothing.
    """
    end_s = log.time_s[log.time_s >= log.time_s[0] + SUSTAINED_S]
    if end_s.size == 0:
        return 0.0
    charge_Ah = log.counted_charge_Ah()
    before_Ah = np.interp(end_s - SUSTAINED_S, log.time_s, charge_Ah)
    moved_Ah = charge_Ah[charge_Ah.size - end_s.size :] - before_Ah
    return max(float(np.max(sign * moved_Ah)), 0.0) * 3600.0 / SUSTAINED_S


def charged_for_minutes(log: CellLog) -> BoolArray:
    """Rows before which more charge went in than out over SUSTAINED_S, shape (n,)."""
    charge_Ah = log.counted_charge_Ah()
    before_Ah = np.interp(log.time_s - SUSTAINED_S, log.time_s, charge_Ah)
    whole = log.time_s >= log.time_s[0] + SUSTAINED_S
    return np.asarray(whole & (charge_Ah < before_Ah))


def slow_part(model: CellModel) -> float:
    """The share of a steady polarisation that takes minutes to build up: beyond R0 and R1."""
    rows = (model.soc > MIDDLE[0]) & (model.soc < MIDDLE[1])
    slow = float(model.r2_ohm[:, rows].mean())
    third = np.asarray(model.effect(SlowDiffusion).r3_ohm)
    slow += float(third[..., rows].mean() if third.ndim else third)
    return slow / (slow + float((model.r0_ohm + model.r1_ohm)[:, rows].mean()))


def unseen_shares(model: CellModel, logs: Sequence[CellLog]) -> tuple[float, float]:
    """By what share a polarisation may be wrong because no load lasted: discharge, charge.

    Pulses show what a current does within seconds. What it does within minutes is known up to the
    current that was sustained for as long; beyond it, up to 1C if the tests reached that,
    reaction and diffusion follow no straight line, and every doubling may be off by
    SHARE_AT_TWICE of what takes minutes. Within the first nothing is added to what the tests do
    show: a drive's mean is below 1C, and it has loads of every length up to it. What lasted in the
    other direction counts, too, but a direction of its own is a doubling by itself: a cell that
    is charged meets other concentrations, and other steps of its OCV, than one that is discharged.
    """
    largest_A = max((float(np.max(np.abs(g.known_current_A()))) for g in logs), default=0.0)
    usual_A = min(largest_A, model.capacity_Ah)
    out, into = (max((sustained_A(g, sign) for g in logs), default=0.0) for sign in (1.0, -1.0))
    share = SHARE_AT_TWICE * slow_part(model)
    return share * _doublings(usual_A, out, into), share * _doublings(usual_A, into, out)


def _doublings(usual_A: float, own_A: float, other_A: float) -> float:
    """From what lasted to the usual current, where the first doubling is free in one direction."""
    own, other = (math.log2(usual_A / a) if a > 0.0 else MOST_DOUBLINGS for a in (own_A, other_A))
    if own <= SHOWN:
        return 0.0
    return min(own, max(other, SHOWN), MOST_DOUBLINGS)

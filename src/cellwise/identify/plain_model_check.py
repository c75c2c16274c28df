"""Station "plain model": one of the same logs beside the fit, handed out where it is better.

The plain model is a low-rate curve, R0 and two branches of fixed time constants: one regularised
linear least squares that shares no table, no solver and no likelihood with the fit. It takes the
fit's starts alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, cho_solve, cholesky, solve_banded
from scipy.optimize import lsq_linear

from cellwise.cell.effects import Effect, TemperatureDependence
from cellwise.cell.equations import ZERO_CELSIUS_K
from cellwise.cell.metrics import held_out_gain
from cellwise.cell.model import CellModel, ModelTables
from cellwise.cell.posterior import POINTS
from cellwise.errors import InputError
from cellwise.fit.model_error import ResidualLog
from cellwise.fit.population import HOME_C, SPREAD
from cellwise.fit.problem import independent_errors
from cellwise.fit.rows import NO_SURFACE, BaseOcv, FitLog, inverse_K, prepare_log
from cellwise.fit.splines import SOC_GRID as SOC
from cellwise.fit.splines import TABLE_KNOTS
from cellwise.identify.assemble import monotone, own_model, temperatures_of
from cellwise.identify.checked_logs import CheckedLogs, nearest_test
from cellwise.identify.effect_selection import JointFit
from cellwise.identify.identification import LogErrors, PlainComparison
from cellwise.identify.joint_fit import QUICK_ROWS
from cellwise.identify.ocv.ocv_lowrate import ocv_from_low_rate
from cellwise.identify.stated_error import Fold, left_out_logs, residual_log
from cellwise.typing import BoolArray, FloatArray, IndexArray


class Plain(NamedTuple):
    """What the plain model takes for granted.

    Parameters
    ----------
    tau_s : floats          of its branches: seconds of a reaction, minutes of diffusion
    measured : float        share of the cells' spread that a low-rate test of the cell leaves
    spread : float          of a resistance, in usual ones of its class
    level : float           share of that which is alike at every SOC and temperature
    near_K : float          over which the rest is alike; over SOC as the prior's tables
    least : float           of a resistance, in usual ones
    size_V, off_soc : float       of a residual, and of the SOC axis where the OCV is steep
    """

    tau_s: tuple[float, float] = (10.0, 300.0)
    measured: float = 0.3
    spread: float = 2.0
    level: float = 0.5
    near_K: float = 20.0
    least: float = 0.02
    size_V: float = 0.01
    off_soc: float = 0.01


class Refused(NamedTuple):
    """When the fit is refused.

    ``loss``: of the RMSE against the plain one's; what both do on the logs of one kit says of other
    logs no more than a factor of 1.5 (one deviation). ``off_V``: a model that is as far off an own
    log is no result, if the plain one is off by less than a ``half`` of it; a plain one that is as
    far off all logs is none either. ``above``: SOC below which the OCV is too steep to compare
    models.
    """

    loss: float = 0.5
    off_V: float = 0.1
    half: float = 0.5
    above: float = 0.05


PLAIN, REFUSED = Plain(), Refused()
TABLES = (("r0",), ("r1",), ("r2", "r3"))  # of the prior that are R0 and the branches
TENTHS = 10  # of SOC: what is drawn together, both of one log
NONE_OUT: Mapping[int, BoolArray] = {}


class _ComparedRows(NamedTuple):
    """Compared rows of a log: what the unknowns do, what they must, weights, rows of the log."""

    matrix: FloatArray
    target: FloatArray
    weight: FloatArray
    row: IndexArray


@dataclass(frozen=True, eq=False)
class PlainFit:
    """Everything that the least squares needs, whatever is left out of it.

    The unknowns are the correction of the OCV at its nodes [V] and, of R0 and each branch, the
    resistance over the usual one (temperatures x nodes).
    """

    fit: JointFit
    base: BaseOcv
    usual: FloatArray
    precision: FloatArray
    mean: FloatArray
    rows: tuple[_ComparedRows, ...]

    def model(self, out: Mapping[int, BoolArray] = NONE_OUT) -> CellModel:
        """The plain model of all logs but the rows ``out`` of some of them."""
        matrix, target = self.precision.copy(), self.precision @ self.mean
        for k, part in enumerate(self.rows):
            kept = np.ones(part.row.size, dtype=np.bool_) if k not in out else ~out[k][part.row]
            weighted = part.matrix[kept].T * part.weight[kept]
            matrix += weighted @ part.matrix[kept]
            target += weighted @ part.target[kept]
        root = cholesky(matrix)
        low = np.where(np.arange(self.mean.size) < POINTS, -np.inf, PLAIN.least)
        right = root @ cho_solve((root, False), target)
        return self._of(lsq_linear(root, right, (low, np.inf), method="bvls").x)

    def _of(self, x: FloatArray) -> CellModel:
        joint = self.fit.joint
        warm_C = temperatures_of(self.fit.result)
        grown = np.exp(joint.cells.activation_K[0] * inverse_K(warm_C, HOME_C))
        place = _hats(warm_C, joint.grid_C)
        soc = _hats(SOC, TABLE_KNOTS)
        part = x[POINTS:].reshape(len(TABLES), joint.grid_C.size, -1)
        r = [
            grown[:, None] * (place @ (y * usual) @ soc.T)
            for y, usual in zip(part, self.usual, strict=True)
        ]
        level = self.base.voltage_V + _hats(SOC, _ocv_nodes()) @ x[:POINTS]
        ocv, same = np.tile(monotone(level), (warm_C.size, 1)), np.ones((warm_C.size, SOC.size))
        hot = any(item.log.temperature_C is not None for item in joint.logs)
        effects: tuple[Effect, ...] = ()
        if hot and joint.grid_C.size == 1:
            effects = (TemperatureDependence(joint.cells.activation_K[0], joint.reference_C),)
        fast, slow = PLAIN.tau_s
        tables = ModelTables(ocv, r[0], r[1], fast * same, r[2], slow * same)
        return CellModel(joint.capacity_Ah, *tables, warm_C, effects)


def prepare_plain_fit(checked: CheckedLogs, fit: JointFit) -> PlainFit:
    """Everything of a plain fit of the logs of a fit, at its starts."""
    joint = fit.joint
    nodes, at_ocv = TABLE_KNOTS, _ocv_nodes()
    base, share = _base_ocv(checked, fit)
    tables = [
        [joint.cells.table(name, nodes, np.array([HOME_C]))[0] for name in names]
        for names in TABLES
    ]
    usual = np.array([np.exp(several).sum(axis=0) for several in tables]) / joint.capacity_Ah
    near = np.exp(-np.abs(np.subtract.outer(nodes, nodes)) / SPREAD.table_soc)
    warm = np.exp(-np.abs(np.subtract.outer(joint.grid_C, joint.grid_C)) / PLAIN.near_K)
    alike = PLAIN.level + (1.0 - PLAIN.level) * np.kron(warm, near)
    one = np.linalg.inv(PLAIN.spread**2 * alike)
    of_ocv = share**2 * joint.cells.ocv_covariance(at_ocv)
    precision = block_diag(np.linalg.inv(of_ocv), *([one] * len(TABLES)))
    mean = np.concatenate((np.zeros(at_ocv.size), np.ones(len(precision) - at_ocv.size)))
    rows = tuple(_rows(fit, item, base, usual) for item in joint.as_found(fit.result))
    return PlainFit(fit, base, usual, precision, mean, rows)


def _base_ocv(checked: CheckedLogs, fit: JointFit) -> tuple[BaseOcv, float]:
    """The OCV of the cell's own low-rate test, else its class's; what share of its spread stays.

    What a test has not reached goes on as the class does.
    """
    mean = fit.joint.cells.base()
    slow = nearest_test(checked.low_rate, checked.default_C)
    try:
        curve = ocv_from_low_rate(slow, capacity_Ah=fit.joint.capacity_Ah) if slow else None
    except InputError:  # no low rate in it
        curve = None
    if curve is None:
        return mean, 1.0
    shown = np.clip(SOC, max(curve.points_soc[0], 0.0), min(curve.points_soc[-1], 1.0))
    own = curve.function.evaluate(shown)
    return BaseOcv(monotone(own + mean.voltage_V - mean.at_soc(shown)[0])), PLAIN.measured


def _rows(fit: JointFit, item: FitLog, base: BaseOcv, usual: FloatArray) -> _ComparedRows:
    """What the unknowns do to the compared rows of one log."""
    joint = fit.joint
    of_log = replace(item, surface=NO_SURFACE)
    capacity_Ah = joint.capacity_Ah * math.exp(item.ln_sample)
    known = prepare_log(of_log, base, capacity_Ah, joint.reference_C, joint.grid_C, QUICK_ROWS)
    rows, shown = known.rows, known.rows.evaluate
    inverse = rows.inverse_K
    warm_C = 1.0 / (inverse + 1.0 / (joint.reference_C + ZERO_CELSIUS_K)) - ZERO_CELSIUS_K
    soc = np.clip(known.soc, 0.0, 1.0)
    home = inverse - float(inverse_K(HOME_C, joint.reference_C))
    load = rows.current_A * np.exp(joint.cells.activation_K[0] * home)
    each = _hats(warm_C, joint.grid_C)[:, :, None] * _hats(soc, TABLE_KNOTS)[:, None, :]
    driven = [load[:, None] * (each * size).reshape(soc.size, -1) for size in usual]
    slow = zip(driven[1:], PLAIN.tau_s, strict=True)
    drops = [driven[0], *(_branch(u, rows.dt_s / tau) for u, tau in slow)]
    matrix = np.hstack([_hats(soc[shown], _ocv_nodes()), *(-drop[shown] for drop in drops)])
    level_V, slope_V = base.at_soc(soc[shown])
    size_V = np.hypot(PLAIN.size_V, PLAIN.off_soc * slope_V)
    weight = independent_errors(known) / known.compared / size_V**2
    row = np.searchsorted(item.log.time_s, known.time_s)
    return _ComparedRows(matrix, known.measured_V - level_V, weight, row)


def _branch(driven: FloatArray, x: FloatArray) -> FloatArray:
    """Voltage of a branch over the rows that a current through its resistances leads to.

    Exact for currents that are constant over each interval of ``x`` time constants.
    """
    kept, found = np.exp(-x), np.zeros_like(driven)
    bands = np.vstack((np.ones(x.size), np.append(-kept[1:], 0.0)))
    moved = driven.any(axis=0)
    found[:, moved] = solve_banded((1, 0), bands, (1.0 - kept)[:, None] * driven[:, moved])
    return found


def _hats(at: FloatArray, nodes: FloatArray) -> FloatArray:
    """Weight of each node at each place, straight in between, shape (places, nodes)."""
    each = np.arange(nodes.size)
    return np.maximum(0.0, 1.0 - np.abs(np.interp(at, nodes, each)[:, None] - each))


def _ocv_nodes() -> FloatArray:
    return np.linspace(0.0, 1.0, POINTS)


class PlainCheck(NamedTuple):
    """The plain model, what it leaves of what was left out, and how it compares with the fit."""

    model: CellModel
    folds: tuple[Fold, ...]
    comparison: PlainComparison


def check_against_plain(checked: CheckedLogs, fit: JointFit, folds: Sequence[Fold]) -> PlainCheck:
    """Judge a fit against the plain model, on its own logs and on what was left out of it.

    Each log counts once as its own and once as left out, however long. The plain one is handed out
    where the fit is worse by more than such a comparison scatters, and surely worse, with tenths of
    SOC drawn again; or where the fit is far off a log that it follows.

    Parameters
    ----------
    folds : sequence of Fold      rows left out, and what the fit without them leaves there
    """
    plain = prepare_plain_fit(checked, fit)
    fitted, model, logs = fit.model, plain.model(), fit.joint.as_found(fit.result)

    def residual(of: CellModel, k: int, rows: BoolArray | None = None) -> ResidualLog:
        return residual_log(own_model(of, math.exp(logs[k].ln_sample)), logs[k], rows)

    found = []
    for fold in folds:
        without = plain.model(fold.rows)
        left = {k: residual(without, k, rows) for k, rows in fold.rows.items()}
        found.append(Fold(fold.rows, left))
    judged, blocks = [], np.zeros((len(logs), TENTHS, 2))
    of_plain = left_out_logs(found)
    own = [(k, False, residual(fitted, k), residual(model, k)) for k in range(len(logs))]
    unseen = [(k, True, log, of_plain[k]) for k, log in left_out_logs(folds).items()]
    for k, left_out, *both in (*own, *unseen):
        squares = _mean_squares(*both)
        if squares is not None:
            fit_V, plain_V = np.sqrt(squares.sum(axis=0)).tolist()
            judged.append(LogErrors(logs[k].log.name, left_out, fit_V, plain_V))
            blocks[k] += squares
    return PlainCheck(model, tuple(found), _compared(judged, blocks.reshape(-1, 2)))


def _mean_squares(fit: ResidualLog, plain: ResidualLog) -> FloatArray | None:
    """What each tenth of SOC adds to the mean squares of both models, (TENTHS, 2) [V^2].

    At the rows that both have, above the lowest SOC; None where there is none.
    """
    at = np.searchsorted(plain.time_s[:-1], fit.time_s)
    a = np.flatnonzero(plain.time_s[at] == fit.time_s) if plain.time_s.size else at[:0]
    a = a[np.minimum(fit.soc[a], plain.soc[at[a]]) > REFUSED.above]
    if a.size == 0:
        return None
    tenth = np.clip(np.floor(TENTHS * fit.soc[a]), 0, TENTHS - 1).astype(np.int64)
    each = (fit.residual_V[a], plain.residual_V[at[a]])
    return np.array([np.bincount(tenth, r * r, TENTHS) for r in each]).T / a.size


def _compared(judged: Sequence[LogErrors], blocks: FloatArray) -> PlainComparison:
    """Both models over all logs, and why the plain one is handed out, if it is."""
    if not judged:
        return PlainComparison(0.0, 0.0, (0.0, 0.0), (), "")
    drawn = blocks[blocks.any(axis=1)]
    fit_V, plain_V = np.sqrt(drawn.T * len(drawn) / len(judged))
    gain = held_out_gain(plain_V, fit_V, np.arange(len(drawn)))
    far = [
        x
        for x in judged
        if not x.left_out and x.fit_V > REFUSED.off_V and x.plain_V < REFUSED.half * x.fit_V
    ]
    reason = ""
    surely = gain.high < 0.0 and gain.gain < -REFUSED.loss
    if surely and gain.before_V < REFUSED.off_V:
        reason = _said(" over its own logs and those left out of it", gain.after_V, gain.before_V)
    elif far:
        worst = max(far, key=lambda x: x.fit_V)
        reason = _said(f" off its own log '{worst.log}'", worst.fit_V, worst.plain_V)
    interval = (gain.low, gain.high)
    return PlainComparison(gain.after_V, gain.before_V, interval, tuple(judged), reason)


def _said(where: str, fit_V: float, plain_V: float) -> str:
    return (
        f"the fit of all tables is {1e3 * fit_V:.0f} mV{where}, a plain model of the same logs "
        f"{1e3 * plain_V:.0f} mV"
    )

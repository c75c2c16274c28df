"""Bayesian least squares in the coordinates of :mod:`cellwise.diagnose.causes.coordinates`.

Every coordinate is always in the fit, held near zero by what a good laboratory leaves uncertain
(its *tolerance*); a cause is a coordinate with a wide prior. So a small error of identification
does not pass for a fault, and two explanations compete by how much they explain for what they
cost: the marginal likelihood (Laplace).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.rows import FITTED, START, Evidence
from cellwise.typing import BoolArray, FloatArray


class Solving(NamedTuple):
    """Gauss-Newton: ``iterations`` at most, until a step gains less than ``converged`` [nats].

    From ``clip`` standard deviations of an error on a residual counts in proportion (Huber).
    """

    iterations: int = 7
    converged: float = 0.02
    clip: float = 6.0


SOLVING = Solving()


@dataclass(frozen=True)
class Prior:
    """Mean and standard deviation of every coordinate in a fit, with bounds.

    ``cross`` (m, m) are covariances between the coordinates ``linked``, zero on its diagonal: what
    was calibrated together on a baseline log stays correlated. ``read``: start to coordinate to
    what a unit of it moves the start's mean by (:mod:`cellwise.diagnose.fit.priors`).
    """

    std: Mapping[str, float]
    mean: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    linked: tuple[str, ...] = ()
    cross: FloatArray | None = None
    read: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """The coordinates, in order."""
        return list(self.std)

    def widened(
        self,
        std: Mapping[str, float],
        mean: Mapping[str, float],
        low: Mapping[str, float],
        high: Mapping[str, float],
    ) -> Prior:
        """The prior with some coordinates widened."""
        return Prior(
            {**self.std, **std},
            {**self.mean, **mean},
            {**self.low, **low},
            {**self.high, **high},
            self.linked,
            self.cross,
            self.read,
        )

    def with_readings(self, read: Mapping[str, Mapping[str, float]]) -> Prior:
        """The prior with what further coordinates make of the starts' readings."""
        both = {s: {**self.read.get(s, {}), **read.get(s, {})} for s in {**self.read, **read}}
        return replace(self, read=both)

    def precision(self) -> FloatArray:
        """Inverse covariance of the coordinates, in the order of ``names``."""
        names = self.names
        covariance = np.diag([self.std[n] ** 2 for n in names])
        if self.cross is None or not self.linked:
            precision = np.asarray(np.diag(1.0 / np.diag(covariance)))
        else:
            place = [names.index(n) for n in self.linked]
            covariance[np.ix_(place, place)] += self.cross
            precision = np.asarray(np.linalg.inv(covariance))
        if not self.read:
            return precision
        own = 2.0 * np.eye(len(names)) - shear(names, self.read)
        return np.asarray(own.T @ precision @ own)

    def mean_with(self, name: str, z: Mapping[str, float]) -> float:
        """Mean of a start whose reading other coordinates change."""
        moved = (by * z.get(n, 0.0) for n, by in self.read.get(name, {}).items())
        return self.mean.get(name, 0.0) + sum(moved)


def shear(names: Sequence[str], read: Mapping[str, Mapping[str, float]]) -> FloatArray:
    """From what starts were read as, and all else, to the coordinates ``names``."""
    found = np.eye(len(names))
    for start, moved in read.items():
        for name, by in moved.items():
            if start in names and name in names:
                found[names.index(start), names.index(name)] = by
    return found


@dataclass(frozen=True, eq=False)
class Fit:
    """A point, its covariance, and how well it explains what was fitted and what was held out.

    ``log_evidence`` is ln p(fitted rows). Logs that are only held out are NaN in ``voltage_V`` and
    ``soc`` until the fit is completed (:func:`complete`).
    """

    z: dict[str, float]
    names: tuple[str, ...]
    covariance: FloatArray
    log_evidence: float
    voltage_V: FloatArray
    soc: FloatArray
    coordinates: Coordinates

    def std(self, name: str) -> float:
        """Standard deviation of one coordinate."""
        k = self.names.index(name)
        return float(math.sqrt(max(self.covariance[k, k], 0.0)))


@dataclass(frozen=True, eq=False)
class Objective:
    """Rows, how wrong the model may be at each of them, and how much each counts.

    ``size_V`` (rows,) is the standard deviation of what no cause explains. It stays for minutes, so
    that thousands of rows hold as few errors as ``weight`` (rows,) sums up to. What changes within
    a window of :attr:`Evidence.windows` has a size of its own, ``fast_V``, and more errors.
    """

    evidence: Evidence
    size_V: FloatArray
    weight: FloatArray
    fast_V: FloatArray
    fast_weight: FloatArray

    @property
    def fitted(self) -> Objective:
        """The same over the logs that have rows to fit."""
        part = self.evidence.fitted
        return self.part(part, slice(0, part.rows))

    def part(self, evidence: Evidence, rows: slice) -> Objective:
        """The same over some of the rows."""
        fast = self.fast_V[rows], self.fast_weight[rows]
        return Objective(evidence, self.size_V[rows], self.weight[rows], *fast)

    def times(self, scale: float) -> Objective:
        """The same with what may be wrong so many times as large."""
        return replace(self, size_V=scale * self.size_V, fast_V=scale * self.fast_V)

    @property
    def clip(self) -> float:
        """Where a residual in these units is wilder than the rest (Huber)."""
        return SOLVING.clip * math.sqrt(float(np.mean(self.errors)))

    @property
    def errors(self) -> FloatArray:
        """How many independent errors every row counts for."""
        return self.weight + self.fast_weight

    def bands(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is slow of columns (rows, P), and what is fast, in units of what may be wrong.

        Each row as much as it counts. Within a window the fast part adds up to zero: the squares
        of both together are those of their sum.
        """
        known = self.evidence.known
        with np.errstate(over="ignore", invalid="ignore"):  # a step too far is refused by its cost
            mean = self.evidence.window_means(columns)
            slow = mean * (known * np.sqrt(self.weight) / self.size_V)[:, None]
            fast = (columns - mean) * (np.sqrt(self.fast_weight) / self.fast_V)[:, None]
        fast[~known] = 0.0
        return slow, fast

    def scaled(self, columns: FloatArray) -> FloatArray:
        """Both bands of columns (rows, P) in units of what may be wrong."""
        slow, fast = self.bands(columns)
        slow += fast
        return slow

    def squares(self, residual_V: FloatArray) -> FloatArray:
        """Squared residuals in these units; beyond :attr:`clip` they grow in proportion (Huber)."""
        size, clip = np.abs(self.scaled(np.nan_to_num(residual_V)[:, None])[:, 0]), self.clip
        with np.errstate(over="ignore"):
            return np.where(size < clip, size * size, clip * (2.0 * size - clip))

    def terms(self, residual_V: FloatArray) -> FloatArray:
        """Ln likelihood of every row."""
        terms = -0.5 * self.squares(residual_V) - self.weight * np.log(self.size_V)
        terms -= self.fast_weight * np.log(self.fast_V)
        return np.where(self.evidence.known, terms, 0.0)


@dataclass(frozen=True, eq=False)
class Frozen:
    """Derivatives that a fit may take as they were at another point nearby."""

    names: tuple[str, ...]
    jacobian: FloatArray

    def jacobian_near(self, found: Fit, evidence: Evidence, moving: Sequence[str]) -> FloatArray:
        """Derivatives at a fit nearby, fresh by the coordinates in ``moving`` and by new ones."""
        fresh = [n for n in found.names if n in moving or n not in self.names]
        here = evidence.jacobian(found.coordinates, found.z, fresh)
        columns = np.empty((evidence.rows, len(found.names)))
        for k, name in enumerate(found.names):
            known = name not in fresh
            of, names = (self.jacobian, self.names) if known else (here, fresh)
            columns[:, k] = of[:, names.index(name)]
        return columns


NOTHING_KNOWN = Frozen((), np.empty((0, 0)))


def freeze(
    objective: Objective, coordinates: Coordinates, names: Sequence[str], z: Mapping[str, float]
) -> Frozen:
    """Derivatives at a point, for fits that stay near it."""
    return Frozen(tuple(names), objective.evidence.jacobian(coordinates, z, names))


def fit(
    objective: Objective,
    coordinates: Coordinates,
    prior: Prior,
    start: Mapping[str, float],
    iterations: int = SOLVING.iterations,
    fixed: Mapping[str, float] | None = None,
    frozen: Frozen | None = None,
    moving: Sequence[str] = (),
) -> Fit:
    """Most likely point under the prior, by damped Gauss-Newton with analytic sensitivities.

    Only the logs that have rows to fit are simulated; :func:`complete` adds the others. ``fixed``
    holds coordinates that are no part of the fit at given values. With ``frozen`` only the
    derivatives by ``moving`` and by the starts are computed at every point.
    """
    held_still = dict(fixed or {})
    train = objective.fitted
    evidence = train.evidence
    names = prior.names
    mean = np.array([prior.mean.get(n, 0.0) for n in names])
    weight = prior.precision()
    low = np.array([prior.low.get(n, -np.inf) for n in names])
    high = np.array([prior.high.get(n, np.inf) for n in names])
    x = np.clip(np.array([start.get(n, mean[k]) for k, n in enumerate(names)]), low, high)
    still = () if frozen is None else tuple(n for n in frozen.names if n not in moving)
    fresh = [k for k, n in enumerate(names) if n not in still]
    kept = [k for k, n in enumerate(names) if n in still]
    rows = (evidence.role == FITTED) & evidence.known
    white = np.empty((evidence.rows, 1 + len(names)))
    if frozen is not None and kept:
        places = [frozen.names.index(names[k]) for k in kept]
        columns = np.take(frozen.jacobian[: evidence.rows], places, axis=1)
        white[:, [1 + k for k in kept]] = train.scaled(columns)

    def cost_of(point: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        z = {**held_still, **dict(zip(names, point, strict=True))}
        voltage, soc = evidence.simulate(coordinates, z)
        terms = train.terms(evidence.voltage_V - voltage)
        penalty = 0.5 * float((point - mean) @ weight @ (point - mean))
        value = penalty - float(np.sum(terms[rows]))
        return (value if math.isfinite(value) else math.inf), voltage, soc

    cost, voltage, soc = cost_of(x)
    normal = weight.copy()
    for _ in range(iterations if names else 0):
        z = {**held_still, **dict(zip(names, x, strict=True))}
        jacobian = evidence.jacobian(coordinates, z, [names[k] for k in fresh])
        residual = np.nan_to_num(evidence.voltage_V - voltage)
        columns = np.column_stack((residual, jacobian))
        white[:, [0, *(1 + k for k in fresh)]] = train.scaled(columns)
        normal, gradient = _normal(white, rows, train.clip, weight, x - mean)
        step = _bounded_step(normal, gradient, x, low, high)
        expected = float(gradient @ step) / 2
        trial, value, v, s = x, math.inf, voltage, soc
        for scale in (1.0, 0.4, 0.15, 0.05, 0.01):
            trial = np.clip(x + scale * step, low, high)
            value, v, s = cost_of(trial)
            if value < cost:
                break
        if value >= cost:
            break
        gained = cost - value
        x, cost, voltage, soc = trial, value, v, s
        if min(gained, expected) < SOLVING.converged:
            break
    z = {**held_still, **dict(zip(names, (float(v) for v in x), strict=True))}
    covariance = np.asarray(np.linalg.pinv(normal), dtype=np.float64)
    _, ln_det = np.linalg.slogdet(normal)
    log_evidence = -cost - 0.5 * float(ln_det) + 0.5 * float(np.linalg.slogdet(weight)[1])
    missing = np.full(objective.evidence.rows - evidence.rows, np.nan)
    voltage, soc = np.concatenate((voltage, missing)), np.concatenate((soc, missing))
    return Fit(z, tuple(names), covariance, log_evidence, voltage, soc, coordinates)


def complete(objective: Objective, found: Fit, prior: Prior) -> Fit:
    """The fit with the held-out logs simulated, each from where its first part says it starts."""
    evidence = objective.evidence
    if evidence.fitted is evidence:
        return found
    z = _held_starts(objective, found, prior)
    many, done = len(evidence.fitted.logs), evidence.fitted.rows
    voltage, soc = found.voltage_V.copy(), found.soc.copy()
    voltage[done:], soc[done:] = evidence.simulate(found.coordinates, z, many)
    return replace(found, z=z, voltage_V=voltage, soc=soc)


def normal_of(white: FloatArray, rows: BoolArray, clip: float) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and gradient of scaled rows [e, J], residuals beyond ``clip`` held (Huber)."""
    used = white[rows]
    size = np.maximum(np.abs(used[:, :1]), clip)
    used *= np.sqrt(clip / size)
    every = used.T @ used
    return every[1:, 1:], every[1:, 0]


def _normal(
    white: FloatArray, rows: BoolArray, clip: float, weight: FloatArray, away: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and gradient with the prior's."""
    normal, gradient = normal_of(white, rows, clip)
    return normal + weight, gradient - weight @ away


def _bounded_step(
    normal: FloatArray, gradient: FloatArray, x: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """The Gauss-Newton step that is best within the bounds.

    Cutting the free step off at the bounds would leave the other coordinates where they make up
    for what was cut; so the quadratic is minimised inside the box (bounded least squares).
    """
    size = 1.0 / np.sqrt(np.diag(normal))
    root = np.linalg.cholesky(normal * np.outer(size, size) + 1e-10 * np.eye(x.size))
    target = solve_triangular(root, gradient * size, lower=True)
    ends = ((low - x) / size, (high - x) / size)
    free = cho_solve((root, True), gradient * size)
    if np.all((free >= ends[0]) & (free <= ends[1])):
        return np.asarray(free * size)
    found = lsq_linear(root.T, target, ends, method="bvls", max_iter=4 * x.size)
    return np.asarray(found.x * size)


def _held_starts(objective: Objective, found: Fit, prior: Prior) -> dict[str, float]:
    """The point with the starts of held-out logs as their first rows say, all else as it is."""
    evidence, z = objective.evidence, dict(found.z)
    for k, (log, whole) in enumerate(evidence.each()):
        name = f"soc0:{k}"
        begins = int(np.sum(log.role == START))
        if begins and name in prior.std:
            rows = slice(whole.start, whole.start + begins)
            first = objective.part(evidence.beginnings[k], rows)
            one = Prior(
                {"soc0:0": prior.std[name]},
                {"soc0:0": prior.mean_with(name, z)},
                {"soc0:0": prior.low[name]},
                {"soc0:0": prior.high[name]},
            )
            here = {"soc0:0": z[name]}
            z[name] = fit(first, found.coordinates, one, here, 4, z).z["soc0:0"]
    return z

"""Bayesian least squares in the coordinates of :mod:`cellwise.diagnose.causes.coordinates`.

Every coordinate is always in the fit, held near zero by what a good laboratory leaves uncertain
(its *tolerance*); a cause is a coordinate with a wide prior. So a small error of identification
does not pass for a fault, and two explanations compete by how much they explain for what they
cost: the marginal likelihood (Laplace).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.rows import FITTED, HELD, START, Evidence
from cellwise.diagnose.fit.whitening_kernels import NoiseLevel, normal_equations, whiten
from cellwise.typing import BoolArray, FloatArray

ITERATIONS = 7
CONVERGED = 0.02
CLIP = 6.0


@dataclass(frozen=True)
class Prior:
    """Mean and standard deviation of every coordinate in a fit, with bounds.

    ``cross`` (m, m) are covariances between the coordinates ``linked``, zero on its diagonal: what
    was calibrated together on a baseline log stays correlated.
    """

    std: Mapping[str, float]
    mean: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    linked: tuple[str, ...] = ()
    cross: FloatArray | None = None

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
        )

    def precision(self) -> FloatArray:
        """Inverse covariance of the coordinates, in the order of ``names``."""
        names = self.names
        covariance = np.diag([self.std[n] ** 2 for n in names])
        if self.cross is None or not self.linked:
            return np.asarray(np.diag(1.0 / np.diag(covariance)))
        place = [names.index(n) for n in self.linked]
        covariance[np.ix_(place, place)] += self.cross
        return np.asarray(np.linalg.inv(covariance))


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
    """Rows, their noise and the size of the model's error there: what a fit is judged by."""

    evidence: Evidence
    noise: NoiseLevel
    amplitude: FloatArray

    @property
    def fitted(self) -> Objective:
        """The same over the logs that have rows to fit."""
        part = self.evidence.fitted
        return Objective(part, self.noise, self.amplitude[: part.rows])

    def whitened(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns (rows, P) as independent unit normal terms, and ln of each row's deviation^2."""
        with np.errstate(over="ignore"):  # a step too far is refused by its cost
            work = np.ascontiguousarray(columns / self.amplitude[:, None])
        ln_s = np.empty(work.shape[0])
        work[~self.evidence.known] = 0.0
        whiten(work, self.evidence.dt_s, self.evidence.known, self.noise, ln_s)
        return work, ln_s + 2.0 * np.log(self.amplitude)

    def terms(self, residual_V: FloatArray) -> FloatArray:
        """Ln likelihood of every row; beyond CLIP deviations it falls in proportion (Huber)."""
        e, ln_s = self.whitened(np.nan_to_num(residual_V)[:, None])
        size = np.abs(e[:, 0])
        with np.errstate(over="ignore"):
            square = np.where(size < CLIP, size * size, CLIP * (2.0 * size - CLIP))
        terms = -0.5 * (square + ln_s)
        return np.where(self.evidence.known, terms, 0.0)


@dataclass(frozen=True, eq=False)
class Frozen:
    """Derivatives that a fit may take as they were at another point nearby."""

    names: tuple[str, ...]
    jacobian: FloatArray

    def column(self, name: str) -> FloatArray:
        """One derivative, shape (rows,)."""
        return np.asarray(self.jacobian[:, self.names.index(name)])


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
    iterations: int = ITERATIONS,
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
        columns = np.column_stack([frozen.column(names[k])[: evidence.rows] for k in kept])
        white[:, [1 + k for k in kept]], _ = train.whitened(columns)

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
        part, _ = train.whitened(np.column_stack((residual, jacobian)))
        white[:, [0, *(1 + k for k in fresh)]] = part
        normal, gradient = _normal(white, rows, weight, x - mean)
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
        if gained < CONVERGED or expected < CONVERGED:
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
    if np.any(evidence.role == START):
        z, voltage, soc = _held_starts(objective, found.coordinates, prior, found.z)
    elif evidence.fitted is evidence:
        return found
    else:
        z = found.z
        voltage, soc = evidence.simulate(found.coordinates, z)
    return replace(found, z=z, voltage_V=voltage, soc=soc)


def normal_of(white: FloatArray, rows: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and gradient of whitened rows [e, J], residuals beyond CLIP held (Huber)."""
    many = white.shape[1] - 1
    normal, gradient = np.zeros((many, many)), np.zeros(many)
    normal_equations(white, rows, CLIP, normal, gradient)
    return normal, gradient


def _normal(
    white: FloatArray, rows: BoolArray, weight: FloatArray, away: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and gradient with the prior's."""
    normal, gradient = normal_of(white, rows)
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


def _held_starts(
    objective: Objective, coordinates: Coordinates, prior: Prior, z: dict[str, float]
) -> tuple[dict[str, float], FloatArray, FloatArray]:
    """Starts of the held-out logs from their first rows, everything else as it is."""
    evidence = objective.evidence
    voltage, soc = evidence.simulate(coordinates, z)
    names = [
        n
        for n, g in zip(evidence.starts(), evidence.logs, strict=True)
        if np.any(g.role == START) and n in prior.std
    ]
    if not names:
        return z, voltage, soc
    rows = (evidence.role == START) & evidence.known
    weight = np.diag([1.0 / prior.std[n] ** 2 for n in names])
    for _ in range(4):
        jacobian = evidence.jacobian(coordinates, z, names)
        residual = np.nan_to_num(evidence.voltage_V - voltage)
        white, _ = objective.whitened(np.column_stack((residual, jacobian)))
        away = np.array([z[n] for n in names])
        normal, gradient = _normal(white, rows, weight, away)
        step = np.clip(np.linalg.solve(normal, gradient), -0.2, 0.2)
        moved = {
            n: min(max(z[n] + float(s), prior.low[n]), prior.high[n])
            for n, s in zip(names, step, strict=True)
        }
        z = {**z, **moved}
        voltage, soc = evidence.simulate(coordinates, z)
        if np.max(np.abs(step)) < 1e-4:
            break
    return z, voltage, soc


def held_rows(evidence: Evidence) -> BoolArray:
    """Rows on which a fit is judged."""
    return np.asarray((evidence.role == HELD) & evidence.known)

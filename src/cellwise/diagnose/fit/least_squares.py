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

from cellwise.diagnose.causes.coordinates import Coordinates, step_of
from cellwise.diagnose.fit.noise import Objective, normal_of
from cellwise.diagnose.fit.rows import FITTED, START, Evidence
from cellwise.typing import FloatArray

Values = Mapping[str, float]


class Solving(NamedTuple):
    """Gauss-Newton: ``iterations`` at most, until a step gains less than ``converged`` [nats].

    ``halvings`` are the shares of a step that are tried until one is better.
    """

    iterations: int = 7
    converged: float = 0.02
    halvings: tuple[float, ...] = (1.0, 0.4, 0.15, 0.05, 0.01)


SOLVING = Solving()


@dataclass(frozen=True)
class Prior:
    """Mean and standard deviation of every coordinate in a fit, with bounds.

    ``cross`` (m, m) are covariances between the coordinates ``linked``, zero on its diagonal: what
    was calibrated together on a baseline log stays correlated. ``read``: start to coordinate to
    what a unit of it moves the start's mean by (:mod:`cellwise.diagnose.fit.priors`).
    """

    std: Values
    mean: Values
    low: Values
    high: Values
    linked: tuple[str, ...] = ()
    cross: FloatArray | None = None
    read: Mapping[str, Values] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """The coordinates, in order."""
        return list(self.std)

    def widened(
        self,
        std: Values,
        mean: Values,
        low: Values,
        high: Values,
        read: Mapping[str, Values] | None = None,
    ) -> Prior:
        """The prior with some coordinates widened, and what those make of the starts' readings."""
        more = read or {}
        return replace(
            self,
            std={**self.std, **std},
            mean={**self.mean, **mean},
            low={**self.low, **low},
            high={**self.high, **high},
            read={s: {**self.read.get(s, {}), **more.get(s, {})} for s in {**self.read, **more}},
        )

    def precision(self) -> FloatArray:
        """Inverse covariance of the coordinates, in the order of ``names``."""
        names = self.names
        covariance = np.diag([self.std[n] ** 2 for n in names])
        if self.cross is None:
            precision = np.asarray(np.diag(1.0 / np.diag(covariance)))
        else:
            place = [names.index(n) for n in self.linked]
            covariance[np.ix_(place, place)] += self.cross
            precision = np.asarray(np.linalg.inv(covariance))
        if not self.read:
            return precision
        own = 2.0 * np.eye(len(names)) - shear(names, self.read)
        return np.asarray(own.T @ precision @ own)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the coordinates, in the order of ``names``."""
        low = np.array([self.low.get(n, -np.inf) for n in self.names])
        return low, np.array([self.high.get(n, np.inf) for n in self.names])

    def away(self, z: Values) -> FloatArray:
        """The way from the mean, in the order of ``names``."""
        return np.array([z.get(n, 0.0) - self.mean.get(n, 0.0) for n in self.names])


def shear(names: Sequence[str], read: Mapping[str, Values]) -> FloatArray:
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
class Frozen:
    """Derivatives of all rows that fits may take as they were at another point nearby."""

    names: tuple[str, ...]
    jacobian: FloatArray

    def jacobian_near(self, found: Fit, evidence: Evidence, moving: Sequence[str]) -> FloatArray:
        """Derivatives at a fit nearby, fresh by the coordinates in ``moving`` and by new ones."""
        fresh = [n for n in found.names if n in moving or n not in self.names]
        columns = np.empty((evidence.rows, len(found.names)))
        columns[:, [found.names.index(n) for n in fresh]] = evidence.jacobian(
            found.coordinates, found.z, fresh
        )
        kept = [n for n in found.names if n not in fresh]
        columns[:, [found.names.index(n) for n in kept]] = self.columns(kept, evidence.rows)
        return columns

    def columns(self, names: Sequence[str], rows: int) -> FloatArray:
        """Those by some of the coordinates, of the first rows."""
        if not names:
            return np.empty((rows, 0))
        return np.take(self.jacobian[:rows], [self.names.index(n) for n in names], axis=1)


NOTHING_KNOWN = Frozen((), np.empty((0, 0)))


def fit(
    objective: Objective,
    coordinates: Coordinates,
    prior: Prior,
    start: Values,
    iterations: int = SOLVING.iterations,
    frozen: Frozen = NOTHING_KNOWN,
    moving: Sequence[str] = (),
) -> Fit:
    """Most likely point under the prior, by damped Gauss-Newton.

    Only the logs that have rows to fit are simulated; :func:`complete` adds the others. With
    ``frozen`` only the derivatives by ``moving`` and by the starts are computed at every point.
    """
    train = objective.fitted
    evidence = train.evidence
    names, weight, (low, high) = prior.names, prior.precision(), prior.box()
    mean = np.array([prior.mean.get(n, 0.0) for n in names])
    x = np.clip(np.array([start.get(n, mean[k]) for k, n in enumerate(names)]), low, high)
    kept = [k for k, n in enumerate(names) if n in frozen.names and n not in moving]
    fresh = [k for k in range(len(names)) if k not in kept]
    rows = (evidence.role == FITTED) & evidence.known
    white = np.empty((evidence.rows, 1 + len(names)))
    still = frozen.columns([names[k] for k in kept], evidence.rows)
    white[:, [1 + k for k in kept]] = train.scaled(still)

    def point(at: FloatArray) -> dict[str, float]:
        return dict(zip(names, map(float, at), strict=True))

    def cost_of(at: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        voltage, soc = evidence.simulate(coordinates, point(at))
        terms = train.terms(evidence.voltage_V - voltage)
        penalty = 0.5 * float((at - mean) @ weight @ (at - mean))
        value = penalty - float(np.sum(terms[rows]))
        return (value if math.isfinite(value) else math.inf), voltage, soc

    cost, voltage, soc = cost_of(x)
    normal = weight.copy()
    for _ in range(iterations):
        jacobian = evidence.jacobian(coordinates, point(x), [names[k] for k in fresh])
        columns = np.column_stack((np.nan_to_num(evidence.voltage_V - voltage), jacobian))
        white[:, [0, *(1 + k for k in fresh)]] = train.scaled(columns)
        normal, gradient = normal_of(white, rows, train.clip)
        normal, gradient = normal + weight, gradient - weight @ (x - mean)
        step = _bounded_step(normal, gradient, x, low, high)
        expected = float(gradient @ step) / 2
        for share in SOLVING.halvings:
            trial = np.clip(x + share * step, low, high)
            value, v, s = cost_of(trial)
            if value < cost:
                break
        else:
            break
        gained = cost - value
        x, cost, voltage, soc = trial, value, v, s
        if min(gained, expected) < SOLVING.converged:
            break
    covariance = np.asarray(np.linalg.pinv(normal), dtype=np.float64)
    ln_det = float(np.linalg.slogdet(normal)[1]) - float(np.linalg.slogdet(weight)[1])
    missing = np.full(objective.evidence.rows - evidence.rows, np.nan)
    voltage, soc = np.concatenate((voltage, missing)), np.concatenate((soc, missing))
    evidence_ln = -cost - 0.5 * ln_det
    return Fit(point(x), tuple(names), covariance, evidence_ln, voltage, soc, coordinates)


def complete(objective: Objective, found: Fit, prior: Prior) -> Fit:
    """The fit with the held-out logs simulated, each from where its first part says it starts."""
    evidence = objective.evidence
    z, inputs = dict(found.z), found.coordinates.inputs(found.z)
    voltage, soc = found.voltage_V.copy(), found.soc.copy()
    for k, (log, rows) in enumerate(evidence.each()):
        first = int(np.sum(log.role == START))
        if not first:
            continue
        name, step = f"soc0:{k}", step_of("soc0")
        mean = prior.mean.get(name, 0.0)
        mean += sum(by * z.get(n, 0.0) for n, by in prior.read.get(name, {}).items())
        begins = np.zeros(evidence.rows, dtype=bool)
        begins[rows.start : rows.start + first] = True
        for _ in range(SOLVING.iterations):
            here, moved = (
                evidence.of_log(k, inputs, {**z, name: z[name] + s}, first)[0] for s in (0.0, step)
            )
            whole, slope = np.zeros(evidence.rows), np.zeros((evidence.rows, 1))
            whole[begins], slope[begins, 0] = here, (moved - here) / step
            normal, gradient = objective.normal(whole, slope, begins)
            pull = float(gradient[0]) - (z[name] - mean) / prior.std[name] ** 2
            at = z[name] + pull / (float(normal[0, 0]) + prior.std[name] ** -2)
            at = min(max(at, prior.low[name]), prior.high[name])
            z[name], change = at, abs(at - z[name])
            if change < step:
                break
        voltage[rows], soc[rows] = evidence.of_log(k, inputs, z)
    return replace(found, z=z, voltage_V=voltage, soc=soc)


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
